"""Misbehaving worlds, programs killed or stopped meanwhile, and what they leave behind.

    python tests/fuzz/hostile_worlds.py [--worlds NAME…] [--crashes 100] [--stops 20] [--busy 60]

Every world × {nothing, the host is killed, the host is told to end}: after how many seconds the host was told why, the
servo was gone with all that the world had started, and the serial port that the servo's process held was free. Every
start is also the next start after the one before: nothing of the dead may be left then. `crashes`: all processes of a
run are killed at once, so that none tidies up behind another. `stops`: the host is stopped (SIGSTOP); after how many
milliseconds the coils are off. `busy`: seconds for which a host computes, with the interpreter's lock for 0.3 s at a
time, beside one busy process for each core; it must not be taken for dead.

The coils themselves are off 15 ms after the loop fell silent: that is the firmware's, and tests/firmware shows it.
"""

from __future__ import annotations

import argparse
import os
import pty
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from haptorb.errors import DriverError
from haptorb.runtime.drivers.serial import SerialPort
from haptorb.runtime.shared_memory import Phase, SharedMemory, Word

GONE, REPORT_TIME = 3.0, 2.0  #: limits [s]
UNDER_WAY = 0.3  #: from the world's misbehaviour to the host's end [s]
STOPPED = 0.1 + 0.02  #: limit: the promise, and what a look at the memory takes [s]

#: what a world does as soon as it may
WORLDS = {
    "loops": "while True: pass",
    "sleeps": "while True: time.sleep(1e6)",
    "swallows every exception": """while True:
        try:
            while True: time.sleep(1e-4)
        except BaseException: pass""",
    "computes in C": "pow(3, 10**9)",
    "waits in C with the interpreter's lock": "while True: ctypes.PyDLL(None).usleep(10**6)",
    "blocks all signals": """signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    while True: ctypes.PyDLL(None).sleep(60)""",
    "ignores all signals": """for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}:
        signal.signal(number, signal.SIG_IGN)
    while True: pass""",
    "leaves by sys.exit": "sys.exit(3)",
    "leaves by os._exit": "os._exit(0)",
    "aborts": "os.abort()",
    "crashes": "ctypes.string_at(0)",
    "raises": "raise KeyError('x')",
    "forks": "os.fork()",
    "starts a program": "started or started.append(subprocess.Popen(['sleep', '1000']))",
    "makes circles of garbage": "circle = [bytearray(300_000)]; circle.append(circle)",
}
#: whose ticks do not end: the host must be told which world it was
HANGING = tuple(WORLDS)[: tuple(WORLDS).index("ignores all signals") + 1]
QUIET = ("forks", "starts a program")  #: nothing is wrong with the loop; what was started must not outlive it

HOST = """
import ctypes, os, signal, subprocess, sys, time
from dataclasses import dataclass
import numpy as np
import haptorb
from haptorb.errors import HaptorbError
from haptorb.runtime.drivers.serial import SerialPort
from haptorb.worlds import World

held, started = [], []

def misbehave():
    MISBEHAVE

@dataclass(frozen=True)
class Mine(World):
    def wrench(self, state):
        if not held and sys.modules["__main__"].__spec__.name == "haptorb.runtime.servo_process":
            held.append(SerialPort(PORT))  # as the driver of a real device does
        if os.path.exists(FLAG):
            misbehave()
        return np.zeros(6)

with haptorb.Servo("omni", Mine()) as servo:
    shared, recording = servo._shared.path, servo._recording._path
    print(servo.servo_pid, servo._children.recorder_pid, shared, servo._folder, recording, flush=True)
    begun = time.monotonic()
    while time.monotonic() < begun + COMPUTE:
        until = time.monotonic() + 0.3
        while time.monotonic() < until:
            pass
        ctypes.PyDLL(None).usleep(300_000)
    while True:
        try:
            servo.run(0.02)
        except HaptorbError as cause:
            print("told", cause, flush=True)
            break
        report = servo.report()
        if report["trips"] or report["warning"]:
            try:
                servo.run(0.3)  # the end that follows the trip says more
            except HaptorbError as cause:
                print("told", cause, flush=True)
            else:
                print("told", report["warning"] or report["trips"], flush=True)
            break
        if COMPUTE or (QUIET and os.path.exists(FLAG) and time.time() > os.stat(FLAG).st_mtime + 1.0):
            print("told nothing", flush=True)
            break
"""


def is_gone(pid: int) -> bool:
    """Whether a process ended; one that only waits to be collected counts."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


def session(leader: int) -> list[int]:
    """The processes of a session that have not ended."""
    found = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError):
            state, _, _, number = entry.joinpath("stat").read_text().rsplit(")", 1)[1].split()[:4]
            if int(number) == leader and state != "Z":
                found.append(int(entry.name))
    return found


def seconds_until(condition: Callable[[], bool], start: float, patience: float = 15.0) -> float:
    """From `begun` until it is true; infinite if it never is."""
    while not condition():
        if time.monotonic() > start + patience:
            return float("inf")
        time.sleep(0.002)
    return time.monotonic() - start


class Run:
    """One host in `folder`, its world quiet until `misbehave`; `compute`: how long it computes first [s]."""

    def __init__(self, folder: Path, world: str, compute: float = 0.0) -> None:
        self._flag = folder / "misbehave"
        self._flag.unlink(missing_ok=True)
        self._board, self._line = pty.openpty()
        self._port = os.ttyname(self._line)
        text = HOST.replace("MISBEHAVE", WORLDS[world])
        for name, value in (
            ("PORT", self._port), ("FLAG", str(self._flag)), ("QUIET", world in QUIET), ("COMPUTE", compute),
        ):  # fmt: skip
            text = text.replace(name, repr(value))
        script = folder / "host.py"
        script.write_text(text)
        self.host = subprocess.Popen(
            [sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env={**os.environ, "TMPDIR": str(folder)}
        )
        assert self.host.stdout is not None
        self._output = self.host.stdout
        servo, recorder, *files = self._output.readline().split()
        self.servo, self.recorder, self.files = int(servo), int(recorder), [Path(file) for file in files]

    def trigger(self) -> float:
        """The world may; returns when."""
        self._flag.touch()
        return time.monotonic()

    def read_report(self) -> str:
        """What the host was told, as soon as it was."""
        return self._output.readline().removeprefix("told").strip()

    def free(self) -> bool:
        """Whether another program can have the port."""
        try:
            SerialPort(self._port).close()
        except DriverError:
            return False
        return True

    def count_files(self) -> int:
        """How many of its files are still there."""
        return sum(file.exists() for file in self.files)

    def close(self) -> None:
        """Nothing of it runs on."""
        for pid in (self.host.pid, self.servo, self.recorder, *session(self.servo)):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.host.communicate()
        os.close(self._board)
        os.close(self._line)


@contextmanager
def running(folder: Path, world: str, compute: float = 0.0) -> Iterator[Run]:
    """A `Run`, and its end."""
    run = Run(folder, world, compute)
    try:
        yield run
    finally:
        run.close()


class Tally:
    """Counts starts after which something of an earlier run was left, and limits that were not kept."""

    def __init__(self) -> None:
        self.dead: list[Run] = []
        self.starts = self.unclean = self.failed = 0

    def start_run(self) -> None:
        """A run has started: nothing of the dead may be there."""
        if self.dead:
            self.starts += 1
            self.unclean += any(run.count_files() for run in self.dead)
        self.dead.clear()


def hostile(folder: Path, world: str, event: str, tally: Tally) -> None:
    """One world, one end of the host; prints a line."""
    with running(folder, world) as run:
        tally.start_run()
        start = run.trigger()
        delay, report = 0.0, ""
        if event == "nothing":
            report = run.read_report()
            delay = time.monotonic() - start
            start = start if report != "nothing" else time.monotonic()
        else:
            time.sleep(UNDER_WAY)
            start = time.monotonic()
            run.host.send_signal(signal.SIGKILL if event == "killed" else signal.SIGTERM)
        ended = seconds_until(lambda: is_gone(run.servo) and not session(run.servo), start)
        free = seconds_until(run.free, start)
        well = max(ended, free) <= GONE and delay <= (REPORT_TIME if report != "nothing" else GONE)
        if event == "nothing" and world in HANGING:
            well = well and "'mine'" in report
        tally.failed += not well
        tally.dead.append(run)
        text = f"told {delay:.2f} s" if report not in ("", "nothing") else ""
        print(
            f"{'' if well else 'FAILED ':>7}{world:<40} {event:<8} gone {ended:5.2f} s  port free {free:5.2f} s  "
            f"{text:<12} {report[:70]}",
            flush=True,
        )


def crash(folder: Path, tally: Tally) -> None:
    """All processes of a run killed at once."""
    with running(folder, "raises") as run:
        tally.start_run()
        everyone = (run.host.pid, run.servo, run.recorder)
        for number in (signal.SIGSTOP, signal.SIGKILL):
            for pid in everyone:
                os.kill(pid, number)
        tally.dead.append(run)


def stop(folder: Path, tally: Tally) -> float:
    """The host stopped; milliseconds until the loop has closed the driver and said so."""
    with running(folder, "raises") as run:
        tally.start_run()
        shared = SharedMemory.attach(run.files[0])
        time.sleep(0.5)
        start = time.monotonic()
        run.host.send_signal(signal.SIGSTOP)
        after = seconds_until(lambda: bool(shared.words[Word.TRIPS]) or shared.phase >= Phase.ENDED, start)
        tally.dead.append(run)
        return 1e3 * after


def run_busy(folder: Path, seconds: float, tally: Tally) -> str:
    """What a host was told that computes for so long beside busy processes; empty for nothing."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 1)]
    try:
        with running(folder, "raises", seconds) as run:
            tally.start_run()
            report = run.read_report()
            tally.dead.append(run)
            return "" if report == "nothing" else report
    finally:
        for other in others:
            other.kill()
            other.wait()


def main() -> int:
    """Run what is asked for; 1 if a limit was not kept."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", nargs="*", default=list(WORLDS), choices=list(WORLDS), metavar="NAME")
    parser.add_argument("--crashes", type=int, default=100)
    parser.add_argument("--stops", type=int, default=20)
    parser.add_argument("--busy", type=float, default=60.0)
    options = parser.parse_args()
    tally = Tally()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for world in options.worlds:
            for event in ("nothing", "killed", "ended"):
                hostile(folder, world, event, tally)
        for _ in range(options.crashes):
            crash(folder, tally)
        times = sorted(stop(folder, tally) for _ in range(options.stops))
        if times:
            late = sum(time > 1e3 * STOPPED for time in times)
            tally.failed += late
            print(f"host stopped {len(times)} times: coils off after {times[len(times) // 2]:.0f} ms, at most "
                  f"{times[-1]:.0f} ms; {late} later than {1e3 * STOPPED:.0f} ms")  # fmt: skip
        if options.busy:
            report = run_busy(folder, options.busy, tally)
            # The computer is too busy on purpose: a loop that misses its deadlines says so.
            tally.failed += bool(report) and "OVERRUN" not in report
            print(f"host computing for {options.busy:g} s beside busy processes: told {report or 'nothing'}")
        with running(folder, "raises"):
            tally.start_run()
    well = not tally.failed and not tally.unclean
    print(
        f"{'Kept' if well else 'NOT kept'}: {tally.failed} limits broken; after {tally.starts - tally.unclean} of "
        f"{tally.starts} starts nothing of the dead was left"
    )
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
