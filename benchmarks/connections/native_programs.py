"""Programs for other makers' libraries with a running loop: cost of calls, and delay of forces.

    python benchmarks/connections/native_programs.py [PART …] [--seconds S] [--kills N] [--device NAME]

Without a part, all of them:

    cost       a call of the library, in a program that does nothing else: below 2 µs
    latency    from a pose that a program reads to the force for it at the coils, while it polls without a pause:
               median below 2 ms, 99 % below 5 ms, and the loop in time in 99.9 % of its ticks
    scheduler  OpenHaptics' callbacks: 1000 ± 5 a second on average
    sphere     a sphere of 500 N/m along a scripted hand, rendered by a program through each of the two interfaces and
               by haptorb's own world: force within 2 % of the world's at the same pose
    kills      programs killed at random in contact: no tick asks for a force 70 ms later, and the next program commands

Every run is `haptorb run` with a recording; the programs are native/tests/dhd_client.c and hd_client.c. The exit code
is the number of parts that are beyond their limits. On a computer whose processors others use, the times are theirs.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from haptorb.recording.recording import Recording
from haptorb.serve.native_libraries import find_libraries

ROOT = Path(__file__).resolve().parents[2]
STIFFNESS, RADIUS, DEPTH = (
    500.0,
    0.03,
    0.012,
)  #: of the sphere [N/m, m], and how far the hand goes into it, if it yields nothing [m]
REST = {"omni": 0.05}  #: height of the programs' origin over the stator's, where it is not 0 [m]
ZERO = 1e-9  #: [N]
LIMIT_US, MEDIAN, LATE, ON_TIME, RATE, SHARE, GONE = 2.0, 2e-3, 5e-3, 0.999, 5.0, 0.02, 0.070

WORLD = """
from dataclasses import dataclass
import numpy as np
from haptorb.worlds import World, parameter

@dataclass(frozen=True)
class Sphere(World):
    \"\"\"A sphere that pushes out.\"\"\"
    stiffness: float = parameter({stiffness}, "N/m", 0.0, 2000.0, "stiffness")

    def wrench(self, state):
        out = np.zeros(6)
        d = state.p - np.array({centre})
        distance = np.sqrt(d @ d)
        if 0.0 < distance < {radius}:
            out[:3] = self.stiffness * ({radius} - distance) * d / distance
        return out
"""


class Run:
    """`haptorb run` with a recording at `path`, until `end`; `report` is what it printed."""

    def __init__(self, device: str, path: Path, *options: str, native: bool = True) -> None:
        serve = ["--serve", "native:1"] if native else []
        command = [sys.executable, "-m", "haptorb", "run", device, "--headless", "--json", "--record", str(path)]
        self._process = subprocess.Popen(
            [*command, *serve, *options], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.path, self.device, self.report = path, "", dict[str, Any]()
        assert self._process.stderr is not None
        while native and not self.device:
            line = self._process.stderr.readline()
            assert line, "the run did not start"
            self.device = line.removeprefix("native: ").strip() if line.startswith("native: ") else ""

    def start(self, *command: str) -> subprocess.Popen[str]:
        """A client, open."""
        folder = find_libraries()[0]
        environment = {**os.environ, "LD_LIBRARY_PATH": str(folder), "HAPTORB_RUN": self.device}
        process = subprocess.Popen(
            [str(folder / command[0]), *command[1:]], env=environment, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        assert process.stdout.readline() == "open\n"
        return process

    def wait(self) -> Recording:
        """Its recording, when it has ended by itself."""
        out, errors = self._process.communicate(timeout=300)
        assert self._process.returncode == 0, errors
        self.report = json.loads(out.splitlines()[-1])
        return Recording(self.path)

    def end(self) -> Recording:
        self._process.send_signal(signal.SIGINT)
        out, errors = self._process.communicate(timeout=60)
        assert out, errors
        self.report = json.loads(out.splitlines()[-1])
        return Recording(self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.communicate()


def tell(name: str, text: str, good: bool) -> int:
    print(f"{name:>10}  {text}{'' if good else '   BEYOND THE LIMIT'}", flush=True)
    return not good


def measure_cost(options: argparse.Namespace, folder: Path) -> int:
    with Run(options.device, folder / "cost.mcap") as run:
        said = run.start("dhd_client", "cost").communicate(timeout=60)[0]
        run.end()
    found = {name: float(text) for name, text in re.findall(r"(\w+) ([\d.]+)", said)}
    text = ", ".join(f"{name} {value:.2f} µs" for name, value in found.items())
    return tell("cost", text, len(found) == 4 and max(found.values()) < LIMIT_US)


def measure_latency(options: argparse.Namespace, folder: Path) -> int:
    with Run(options.device, folder / "latency.mcap") as run:
        run.start("dhd_client", "spin", str(options.seconds)).communicate(timeout=options.seconds + 60)
        rows = run.end()
    memory, stages = np.asarray(rows["memory"]), np.asarray(rows["stages"])
    force, session, age = memory[:, :3], memory[:, 3], memory[:, 4]  # of the world `remote`
    fresh = (np.abs(np.diff(force, axis=0)).max(axis=1) > 0.0) & (session[1:] > 0.0)
    late = age[1:][fresh] + stages[1:, :6][fresh].sum(axis=1)
    median, most = np.percentile(late, 50), np.percentile(late, 99)
    share = float(run.report["success_rate"])
    text = f"median {1e3 * median:.2f} ms, 99 %: {1e3 * most:.2f} ms of {len(late)} forces"
    text += f"; {100 * share:.2f} % of ticks in time"
    return tell("latency", text, median <= MEDIAN and most <= LATE and share >= ON_TIME)


def measure_scheduler(options: argparse.Namespace, folder: Path) -> int:
    with Run(options.device, folder / "scheduler.mcap") as run:
        said = run.start("hd_client", "rate", str(options.seconds)).communicate(timeout=options.seconds + 60)[0]
        run.end()
    rate = float(re.findall(r"rate ([\d.]+)", said)[0])
    return tell("scheduler", f"{rate:.2f} calls a second over {options.seconds:g} s", abs(rate - 1000.0) <= RATE)


def measure_sphere(options: argparse.Namespace, folder: Path) -> int:
    """The forces that were asked in each tick, against those of the world at the pose of that tick: the hand yields, so
    that no two runs have the same poses."""
    rest = REST.get(options.device, 0.0)
    height = rest + 0.002  # of the sphere's top, where the tool is free to move
    centre = np.array([0.0, 0.0, height - RADIUS])
    hand = folder / "path.hand"
    top, deep = 1e3 * (height + 0.004), 1e3 * (height - DEPTH)
    hand.write_text(
        f"start 0 0 {top} mm\nwait 1500 ms\nmove 0 0 {deep} mm in 1 s\nwait 300 ms\nmove 3 2 {deep} mm in 1 s\n"
        f"move -3 1 {deep} mm in 1.5 s\nmove 0 0 {top} mm in 1 s\nwait 200 ms\n"
    )
    (folder / "sphere_world.py").write_text(WORLD.format(stiffness=STIFFNESS, radius=RADIUS, centre=centre.tolist()))
    seen = centre - (0.0, 0.0, rest)  # straight above the origin: the same in the programs' frame
    programs = {
        "haptorb": None,
        "DHD": ("dhd_client", "sphere", str(STIFFNESS), str(RADIUS), *map(str, (-seen[1], seen[0], seen[2])), "6"),
        "HD": ("hd_client", "sphere", str(1e-3 * STIFFNESS), str(1e3 * RADIUS), *map(str, 1e3 * seen[[0, 2, 1]]), "6"),
    }
    bad = 0
    for name, command in programs.items():
        world = [] if command else ["--world", f"{folder / 'sphere_world.py'}:Sphere"]
        with Run(
            options.device,
            folder / f"{name}.mcap",
            "--hand",
            str(hand),
            "--duration",
            "6.7",
            *world,
            native=command is not None,
        ) as run:
            client = run.start(*command) if command else None
            rows = run.wait()
            if client is not None:
                client.communicate(timeout=60)
                assert client.returncode in (0, 1), "the program failed"  # 1: the run ended first
        t, asked = np.asarray(rows["t"]), np.asarray(rows["wrench_commanded"])[:, :3]
        out = np.asarray(rows["p"]) - centre
        distance = np.linalg.norm(out, axis=1)
        own = (STIFFNESS * np.clip(RADIUS - distance, 0.0, None) / distance)[:, None] * out
        there = (t > 1.5) & (t < 6.4)
        difference, peak = np.linalg.norm(asked - own, axis=1)[there], np.linalg.norm(own, axis=1)[there].max()
        rms = np.sqrt((difference**2).mean()) / peak
        most = 100 * difference.max() / peak
        text = f"{name}: {100 * rms:.2f} % of {peak:.2f} N (root mean square), at most {most:.1f} %"
        bad += tell("sphere", text, rms <= SHARE)
    return bad > 0


def kill_programs(options: argparse.Namespace, folder: Path) -> int:
    chance, times, felt = random.Random(1), list[float](), 0
    with Run(options.device, folder / "kills.mcap") as run:
        for _ in range(options.kills):
            client = run.start("dhd_client", "push", "0.4")
            assert client.stdout is not None
            felt += client.stdout.readline() == "contact\n"  # else it has ended: the device was not free
            time.sleep(0.05 * chance.random())
            client.kill()
            times.append(time.monotonic())
            client.communicate()
            time.sleep(0.1)
        rows = run.end()
    wall, asked = np.asarray(rows["wall"]), np.linalg.norm(np.asarray(rows["wrench_commanded"])[:, :3], axis=1)
    gone = []
    for at, following in zip(times, [*times[1:], np.inf], strict=True):
        after = (wall > at) & (wall < min(at + 0.1, following)) & (asked > ZERO)
        gone.append(wall[after].max() - at if after.any() else 0.0)
    text = f"{sum(one <= GONE for one in gone)} of {len(times)} forces gone within 70 ms"
    text += f" (at most {1e3 * max(gone):.0f} ms), {felt} were felt before"
    return tell("kills", text, max(gone) <= GONE and felt == len(times))


PARTS = {
    "cost": measure_cost,
    "latency": measure_latency,
    "scheduler": measure_scheduler,
    "sphere": measure_sphere,
    "kills": kill_programs,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="parts to measure (default: all)")
    parser.add_argument("--seconds", type=float, default=10.0, help="of latency and scheduler [s]")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--device", default="omni")
    options = parser.parse_args()
    find_libraries()
    subprocess.run(["make", "-C", ROOT / "native", "clients"], check=True, stdout=subprocess.DEVNULL)
    with tempfile.TemporaryDirectory() as folder:
        return sum(PARTS[part](options, Path(folder)) for part in options.parts or PARTS)


if __name__ == "__main__":
    sys.exit(main())
