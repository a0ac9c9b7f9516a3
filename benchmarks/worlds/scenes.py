"""MuJoCo scenes in the loop: timing, memory growth, and passivity with a random hand.

    python benchmarks/worlds/scenes.py [--minutes 10] [--seconds 60] [--ticks 100000] [--only PART] [--json]

tick      ten bodies on the dome at 1 kHz for `--seconds` with a console attached: share of the deadlines met and the
          99th percentile of a tick
heavy     300 bodies, whose single steps take longer than a tick: share of the deadlines met, in all and after a second
growth    memory of this process before and after `--ticks` steps of the same scene, in bytes of Python's own and of all
passivity each shipped scene in a random hand for `--minutes`, through sensors, estimator and latency: the coupling, its
          margin of stability, and the energy that the hand extracted beyond the stored energy, by the wrench asked and
          by the true one. Boxes three times: with a pose in every tick, with a tracker of 240 Hz that is 5 ms late, and
          with calibrated field sensors. With `--change` the detail changes at random, every so many seconds on average.
          `--specimen` chooses the simulated device and the hand's way; with `--as-file` the device is as its file says.
The exit code is 1 if fewer than 99.9 % of the deadlines were met (of `heavy`: 99.5 %, after a second), anything grew by
more than 200 kB, or more than 1 mJ came out of a scene; by the true wrench of a motor within its tolerances, whose
torque per ampere no controller knows, more may.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from haptorb.analysis.coupling import CouplingSetting, measure_margin
from haptorb.analysis.stability import GRIPS
from haptorb.devices.base import State
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.devices.motor import SphericalMotor
from haptorb.runtime.servo import Servo
from haptorb.web.console import Console
from haptorb.worlds import Scene
from haptorb.worlds.dynamic import bind_world
from haptorb.worlds.scene import SceneFile
from haptorb.worlds.scene_physics import SHIPPED, find_scene_file

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from oracles.scene_trial import try_scene

DEVICES = {"peg": "pmsm", "outlet": "pmsm", "boxes": "omni", "drawer": "pmsm"}
PARTS = ("tick", "heavy", "growth", "passivity")
HEAVY = """<mujoco><option timestep="0.001"/><worldbody><geom type="plane" size="1 1 .1" pos="0 0 0.05"/>
<body name="tool" pos="0 0 0.06"><freejoint/><geom type="sphere" size="0.003" mass="0.02"/></body>{}
</worldbody></mujoco>"""


def write_ten(folder: Path) -> Path:
    """The shipped boxes and six more bodies beside them."""
    text = find_scene_file("boxes").read_text()
    more = "".join(
        f'<body pos="{0.012 * np.cos(k):.4f} {0.012 * np.sin(k):.4f} {0.062 + 0.009 * (k % 2)}"><freejoint/>'
        '<geom type="box" size="0.003 0.003 0.003" mass="0.01"/></body>'
        for k in range(6)
    )
    path = folder / "ten.xml"
    path.write_text(text.replace("</worldbody>", more + "</worldbody>"))
    return path


def time_ticks(seconds: float) -> dict[str, Any]:
    """Ten bodies at 1 kHz, a console attached, a hand that wanders over the dome."""
    with tempfile.TemporaryDirectory() as folder:
        servo = Servo("omni", SceneFile(write_ten(Path(folder))), record=False)
        with Console(servo, 0) as console, servo:
            end = time.monotonic() + seconds
            site = Thread(target=lambda: console.serve(until=lambda: time.monotonic() > end), daemon=True)
            site.start()
            while time.monotonic() < end:
                a = 0.35 * np.sin(1.3 * time.monotonic())
                servo.hand.point([0.056 * np.sin(a), 0.01 * np.cos(time.monotonic()), 0.056 * np.cos(a)])
                time.sleep(0.02)
            site.join()
            report = servo.report()
    return {
        "seconds": seconds,
        "success_rate": report["success_rate"],
        "tick_p50_us": report["compute_us"]["p50"],
        "tick_p99_us": report["compute_us"]["p99"],
        "world_us": report["stage_us"].get("world"),
        "scene": report.get("scene"),
    }


def write_heavy(folder: Path) -> Path:
    """300 loose boxes that fall into a heap: a single step takes longer than a tick of 1 ms."""
    boxes = "".join(
        f'<body pos="{0.004 * (k % 10):.3f} {0.004 * (k // 10 % 10):.3f} {0.07 + 0.004 * (k // 100):.3f}"><freejoint/>'
        '<geom type="box" size="0.0019 0.0019 0.0019" mass="0.001"/></body>'
        for k in range(300)
    )
    path = folder / "heavy.xml"
    path.write_text(HEAVY.format(boxes))
    return path


def time_heavy(seconds: float) -> dict[str, Any]:
    """300 bodies at 1 kHz: deadlines met in all, and after the first second, in which the scene reduces its detail."""
    with (
        tempfile.TemporaryDirectory() as folder,
        Servo("omni", SceneFile(write_heavy(Path(folder)), "tool"), record=False) as servo,
    ):
        time.sleep(1.0)
        before = servo.report()
        time.sleep(seconds)
        after = servo.report()
    ticks, missed = (after[name] - before[name] for name in ("ticks", "missed"))
    return {
        "seconds": seconds,
        "success_rate": after["success_rate"],
        "success_after_a_second": ticks / (ticks + missed),
        "scene": after.get("scene"),
    }


def measure_growth(ticks: int) -> dict[str, Any]:
    """Bytes that `ticks` steps of ten bodies leave behind."""
    with tempfile.TemporaryDirectory() as folder:
        world = Scene(write_ten(Path(folder))).for_device(load("omni"))
    bound = bind_world(world, 1e-3)
    assert bound is not None

    def step(n: int) -> None:
        a = 0.3 * np.sin(1e-3 * n)
        bound.wrench(State.at((0.055 * np.sin(a), 0.0, 0.055 * np.cos(a))))

    for n in range(ticks // 10):
        step(n)
    tracemalloc.start()
    before, resident = tracemalloc.get_traced_memory()[0], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for n in range(ticks):
        step(n)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    return {
        "ticks": ticks,
        "python_bytes": grown,
        "resident_bytes": 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - resident),
    }


def measure_passivity(
    minutes: float, grip: str, names: tuple[str, ...], change: float, specimen: int = 0, *, as_file: bool = False
) -> list[dict[str, Any]]:
    """Each of the scenes `names` on its device; a tool also with a late tracker and with field sensors."""
    found = []
    for name in names:
        device, hand = load(DEVICES[name]), GRIPS[grip]
        if as_file:
            assert isinstance(device, SphericalMotor | SphericalElectromagnet)
            device = replace(device, tolerance=None)
        settings = {"a pose in every tick": CouplingSetting(device, 1000.0, hand)}
        if not device.kind.modes:
            settings["240 Hz, 5 ms late"] = CouplingSetting(device, 1000.0, hand, fed=True, latency=5e-3)
            settings["field sensors"] = CouplingSetting(device, 1000.0, hand, "hall")
        for poses, setting in settings.items():
            scene = setting.couple(Scene(name))
            assert isinstance(scene, Scene)
            trial = try_scene(scene, setting, 60.0 * minutes, seed=specimen, change_every=change)
            found.append(
                {
                    "scene": name, "device": device.name, "specimen": None if as_file else specimen,
                    "poses": poses if len(settings) > 1 else "its estimator's",
                    "stiffness_n_per_m": scene.stiffness, "damping_n_s_per_m": scene.damping,
                    "margin": measure_margin(scene, device, setting.loop, hand),
                    "passivity_mj": 1e3 * trial.passivity, "passivity_given_mj": 1e3 * trial.given,
                    "put_in_mj": 1e3 * trial.put_in, "greatest": trial.greatest,
                    "injected_n_s_per_m": trial.injected, "tripped": trial.tripped,
                }
            )  # fmt: skip
            print(found[-1], file=sys.stderr)
    return found


def main() -> int:
    """All parts, or one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--ticks", type=int, default=100_000)
    parser.add_argument("--grip", choices=tuple(GRIPS), default="light")
    parser.add_argument("--only", choices=PARTS)
    parser.add_argument("--scene", choices=SHIPPED, action="append", help="of `passivity`; several times")
    parser.add_argument("--change", type=float, default=0.0)
    parser.add_argument("--specimen", type=int, default=0)
    parser.add_argument("--as-file", action="store_true")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    parts = PARTS if asked.only is None else (asked.only,)
    found: dict[str, Any] = {}
    if "tick" in parts:
        found["tick"] = time_ticks(asked.seconds)
    if "heavy" in parts:
        found["heavy"] = time_heavy(asked.seconds)
    if "growth" in parts:
        found["growth"] = measure_growth(asked.ticks)
    if "passivity" in parts:
        found["passivity"] = measure_passivity(
            asked.minutes, asked.grip, tuple(asked.scene or SHIPPED), asked.change, asked.specimen,
            as_file=asked.as_file,
        )  # fmt: skip
    print(json.dumps(found) if asked.json else json.dumps(found, indent=1))
    well = (
        found.get("tick", {"success_rate": 1.0})["success_rate"] >= 0.999
        and found.get("heavy", {"success_after_a_second": 1.0})["success_after_a_second"] >= 0.995
        and max(found.get("growth", {"python_bytes": 0}).values(), default=0) < max(asked.ticks, 100_000) * 2
        and all(one["passivity_mj"] > -1.0 for one in found.get("passivity", []))
        and all(
            one["passivity_given_mj"] > -1.0
            for one in found.get("passivity", [])
            if asked.as_file or DEVICES[one["scene"]] == "omni"
        )
    )
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
