"""A run in a control group with little memory: what the kernel ends, the coils are off, and nothing is left.

    python benchmarks/safety/memory_limit.py [--runs 6] [--json]

Whole programs drive the emulated board (`make firmware && make -C firmware emulator`) in a memory control group of
their own, version 1 or 2. Where this account may not make one, nothing is run and one line says so. In turn:
- world: the world takes 0.4 MB in every tick, until the kernel ends the process of the loop;
- beside: another program of the group takes all memory, and the kernel ends what it chooses; where that is the other
  program, the run goes on, and ends by SIGINT;
- start: there is too little memory for a start.

Exit code 1 unless the coils are off at most 20 ms after the board's last byte, by the emulator's log of its PWM chip;
the program ends by itself, within 10 s, without a traceback of its own; a start without memory never switches on; and
after the next run nothing of it is left among processes, shared memory and temporary folders.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from ends import free_port, sending_poses

from haptorb.errors import DriverError
from haptorb.runtime.drivers.emulator_process import Emulator

LIMIT_MS = 20.0
ENDS_IN = 10.0  #: [s]
START = 90.0  #: for a program to have its coils on [s]
BUILD = Path(__file__).resolve().parents[2] / "firmware" / "build"
KINDS = ("world", "beside", "start")
#: of a run that works, with what it has loaded [MiB]; a start needs more than the second
ENOUGH, TOO_LITTLE = 700, 60
WORLD = """
import os
import numpy as np
kept = []

def push(state):
    if os.path.exists({flag!r}):
        kept.append(np.ones(50_000))
    return np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.0])
"""
EATER = "import time\nkept = []\nwhile True:\n    kept.append(bytearray(b'x') * (16 << 20))\n    time.sleep(0.002)\n"


@dataclass(frozen=True)
class Outcome:
    """One run: how long the coils were on after the last byte [ms], exit code, last line, and what is wrong with it."""

    kind: str
    off_ms: float
    code: int
    said: str
    wrong: tuple[str, ...]


class NoGroup(Exception):
    """This account may not make a memory control group."""


@contextmanager
def memory_group(mebibytes: int) -> Iterator[Path]:
    """A control group whose processes may have so much memory together, without swap."""
    root = Path("/sys/fs/cgroup")
    v1 = (root / "memory").is_dir()
    group = (root / "memory" if v1 else root) / f"haptorb-{os.getpid()}-{time.monotonic_ns()}"
    try:
        group.mkdir()
        (group / ("memory.limit_in_bytes" if v1 else "memory.max")).write_text(str(mebibytes << 20))
        with suppress(OSError):  # where the kernel does not count swap
            (group / ("memory.swappiness" if v1 else "memory.swap.max")).write_text("0")
    except OSError as cause:
        raise NoGroup(f"no memory control group can be made ({cause}): run this as root") from cause
    try:
        yield group
    finally:
        for _ in range(100):
            for pid in (group / "cgroup.procs").read_text().split():
                with suppress(OSError):
                    os.kill(int(pid), signal.SIGKILL)
            with suppress(OSError):
                group.rmdir()
                break
            time.sleep(0.05)


def start_in(group: Path, command: Sequence[str], **options: object) -> subprocess.Popen[str]:
    """Start a program that belongs to `group` from its first instruction on."""
    shell = ["sh", "-c", f'echo $$ > "{group / "cgroup.procs"}" && exec "$@"', "sh", *command]
    return subprocess.Popen(
        shell, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, text=True, start_new_session=True, **options
    )  # type: ignore[call-overload,no-any-return]


def run_once(kind: str, emulator: Emulator, tracker: int, folder: Path) -> Outcome:
    """One run that ends for lack of memory."""
    flag, world, errors = folder / "flag", folder / "world.py", folder / "errors"
    flag.unlink(missing_ok=True)
    world.write_text(WORLD.format(flag=str(flag)))
    command = [
        sys.executable, "-P", "-m", "haptorb", "run", "omni", "--world", f"{world}:push", "--driver",
        f"serial:{emulator.port}", "--tracker", f"osc:{tracker}", "--headless", "--record",
        str(folder / "run.mcap"), "--force",
    ]  # fmt: skip
    wrong, off_ms = list[str](), 0.0
    emulator.set_pace(1.0)
    emulator.discard_lines()
    with memory_group(TOO_LITTLE if kind == "start" else ENOUGH) as group, errors.open("w") as said:
        program = start_in(group, command, stderr=said)
        if kind == "start":
            if not _ends(program, START):
                wrong.append(f"a start with {TOO_LITTLE} MiB does not end")
            if emulator.status()["on"] != "0":
                wrong.append("it switched on")
        else:
            deadline = time.monotonic() + START
            while emulator.status()["on"] != "1":
                if program.poll() is not None or time.monotonic() > deadline:
                    raise SystemExit(f"the coils are not on: {errors.read_text()[-500:]}")
                time.sleep(0.05)
            time.sleep(0.5)
            emulator.discard_lines()
            if kind == "world":
                flag.touch()
            else:
                eater = start_in(group, [sys.executable, "-S", "-E", "-c", EATER])
                if not _ends(eater, ENDS_IN):
                    wrong.append("the kernel ended nothing")
                time.sleep(0.5)
                program.send_signal(signal.SIGINT)
            off_ms = _wait_for_off(emulator)
            if off_ms > LIMIT_MS:
                wrong.append(f"coils off {off_ms:.1f} ms after the last byte")
            if not _ends(program, ENDS_IN):
                wrong.append(f"it runs on {ENDS_IN:g} s later")
    text = errors.read_text()
    if "Traceback" in text:
        wrong.append("a traceback")
    program.kill()
    code = program.wait()
    return Outcome(kind, off_ms, code, text.strip().rpartition("\n")[2], tuple(wrong))


def _ends(program: subprocess.Popen[str], seconds: float) -> bool:
    try:
        program.wait(seconds)
    except subprocess.TimeoutExpired:
        return False
    return True


def _wait_for_off(emulator: Emulator) -> float:
    try:
        said = dict(re.findall(r"(\w+)=([-\d.]+)", emulator.expect_line("@off", 30.0)))
    except DriverError:
        return float("inf")
    return float(said["since_byte_ms"])


def run_as_usual() -> None:
    """A short run without limits."""
    command = [sys.executable, "-P", "-m", "haptorb", "run", "omni", "--headless", "--duration", "0.1"]
    subprocess.run(command, capture_output=True, check=True)


def list_left(before: frozenset[str]) -> list[str]:
    """What a run leaves among shared memory and temporary files."""
    return sorted(list_files() - before)


def list_files() -> frozenset[str]:
    """Shared memory and temporary folders of this program."""
    folders = (Path("/dev/shm"), Path(tempfile.gettempdir()))
    return frozenset(str(path) for folder in folders for path in folder.glob("haptorb-*"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, and print for people or machines; 1 if something is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=6)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    if not (BUILD / "emulator").exists():
        raise SystemExit(f"there is no {BUILD / 'emulator'}: make firmware && make -C firmware emulator")
    try:
        with memory_group(ENOUGH):
            pass
    except NoGroup as why:
        print(json.dumps({"not_run": str(why)}) if options.json else f"not run: {why}")
        return 0
    outcomes = []
    run_as_usual()  # what is compiled needs more memory than a run
    before = list_files()
    with tempfile.TemporaryDirectory(prefix="memory-limit-") as name:
        folder = Path(name)
        tracker = free_port(socket.SOCK_DGRAM)
        with Emulator(BUILD, folder / "board") as emulator, sending_poses(tracker):
            for number in range(options.runs):
                outcome = run_once(KINDS[number % len(KINDS)], emulator, tracker, folder)
                outcomes.append(outcome)
                if not options.json:
                    wrong = "".join("; WRONG: " + one for one in outcome.wrong)
                    print(
                        f"{outcome.kind:>8}: coils off {outcome.off_ms:.1f} ms after the last byte, exit code "
                        f"{outcome.code}: {outcome.said or 'nothing said'}{wrong}",
                        flush=True,
                    )
    run_as_usual()  # a start removes what killed processes left
    left = list_left(before)
    failed = bool(left) or any(outcome.wrong for outcome in outcomes)
    if options.json:
        print(json.dumps({"runs": [vars(one) for one in outcomes], "left": left, "kept": not failed}))
    else:
        print(f"left after the next run: {', '.join(left) or 'nothing'}")
        print("kept" if not failed else "NOT KEPT")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
