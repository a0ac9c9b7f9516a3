"""Time until the coils are off for every way in which a run can end, with everything that may hang.

    python benchmarks/safety/ends.py [--ends 168] [--lanes 2] [--boards sim emulated] [--faults NAME…]
                                     [--into FILE.jsonl] [--json]

Whole programs are run and ended: by SIGINT, SIGTERM, SIGHUP, SIGQUIT, `--duration`, an exception in the world, leaving
the `with` block of a Python program, a page's Stop; while nothing, the server, the recorder, the tracker or the
compiler is stopped by SIGSTOP, the recording is a pipe that nobody reads, or the terminal does not read while the
world prints and its file was saved with a mistake; on the simulated device and on the emulated board (which needs
`make firmware` and `make -C firmware emulator`). Each end begins with the coils on.

Measured from outside the program, from just before the signal is sent (flag made, line written, message sent, duration
over). Simulated device: until the wall time of the row after the first one with every duty zero, or of the last row.
Emulated board: by the emulator's log of its PWM chip's registers, in firmware time, as fast as time. A run in which the
coils went off before the end (a computer that is too busy for the board's watchdog of 15 ms) does not count and is
repeated. Exit code 1 if a single end took longer than 20 ms, or left a process or shared memory behind.

A late end says what the rows say of it: the trip, the longest gap between two rows and the time until the signal was
sent. A gap as long as the lateness is a computer that stood still; rows without a gap are a host that did not react.

With `--into`, every end is appended to a file with the commit and the time at which it was measured, and those that the
file has are not measured again: a thousand ends take two hours, and need not be measured in one go.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import select
import signal
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import cycle, islice, pairwise
from pathlib import Path
from typing import Any

from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.errors import DriverError
from haptorb.runtime.drivers.emulator_process import Emulator
from haptorb.runtime.linux import start
from haptorb.runtime.shared_memory import Phase, SharedMemory, Word

LIMIT = 20.0  #: [ms]
EARLY = 2.0  #: the board's clock and this program's agree so far about the end of a duration [ms]
BUILD = Path(__file__).resolve().parents[2] / "firmware" / "build"
SIGNALS = {"SIGINT": signal.SIGINT, "SIGTERM": signal.SIGTERM, "SIGHUP": signal.SIGHUP, "SIGQUIT": signal.SIGQUIT}
ENDS = (*SIGNALS, "duration", "exception", "with", "page")
FAULTS = ("nothing", "server", "recorder", "tracker", "compiler", "disk", "terminal")
BOARDS = ("sim", "emulated")
MODULES = {
    "server": "haptorb.serve.server_process",
    "recorder": "haptorb.runtime.recorder_process",
    "tracker": "haptorb.runtime.trackers.tracker_process",
    "compiler": "haptorb.runtime.first_start",
}
START = 90.0  #: for a program to have its coils on, on a busy computer [s]
LASTS = 1.0  #: the run of which --duration ends, from the first tick [s]
LASTS_BLOCKED = 4.0  #: the same with a terminal that does not read [s]
NOTICED = 1.2  #: until a program has printed of a world's file that was saved [s]
WORLD = """
import os
import numpy as np

def push(state):
    if os.path.exists({flag!r}):
        raise RuntimeError("the end of this run")
    if os.path.exists({loud!r}):
        print("something to read " * 50)
    return np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.0])
"""
#: The program: the command itself, or a `with` block. Beside that it only opens the pipe in place of the recording,
#: has a compiler run where none is needed, notes when its duration is over, and says where it hangs if it does not end.
HOST = """
import faulthandler, json, os, signal, sys, time
from pathlib import Path
faulthandler.register(signal.SIGUSR1)
given = json.loads(sys.argv[1])
from haptorb.runtime.linux import die_with_parent
die_with_parent(signal.SIGTERM)
from haptorb.recording import destination as recording_file
from haptorb.runtime import process_group as compiler_process
from haptorb.runtime.servo import Servo
if given["pipe"]:
    recording_file.create_recording = lambda path, **options: os.open(given["pipe"], os.O_WRONLY)
if given["compiler"]:
    def finish(self, *, running):
        self.end()
        self._run(compiler_process.CATALOGUE)
    compiler_process.CompilerProcess.finish_start = finish
run = Servo.run
def noted(self, seconds):
    part = Path(given["noted"]).with_suffix(".part")
    part.write_text(repr(time.monotonic() + seconds))
    part.replace(given["noted"])  # who waits for it never finds it empty
    run(self, seconds)
Servo.run = noted
if given["with"]:
    from haptorb.serve.base import check_servers
    from haptorb.serve.base import Serving
    from haptorb.worlds.user_world import parse_world_file
    servo = Servo("omni", parse_world_file(given["world"]), driver=given["driver"], tracker=given["tracker"],
                  record=given["record"], overwrite=True)
    with Serving(check_servers([given["serve"]]), servo) as serving, servo:
        serving.start()
        Path(given["noted"]).touch()
        sys.stdin.readline()
else:
    from haptorb.cli import main
    sys.exit(main(given["arguments"]))
"""


@dataclass(frozen=True)
class Case:
    """How a run ends, beside what, on which board."""

    end: str
    fault: str
    board: str


def cases(count: int, boards: Sequence[str], faults: Sequence[str]) -> Iterator[Case]:
    """`count` of them: all combinations in turn, the boards next to each other."""
    every = [Case(end, fault, board) for end in ENDS for fault in faults for board in boards]
    # A step that shares no factor with their number: few ends are a sample of all kinds, not the first of them.
    step = next(n for n in (8, 31, 37, 41) if math.gcd(n, len(every)) == 1)
    return islice(cycle(every[(k * step) % len(every)] for k in range(len(every))), count)


def free_port(kind: socket.SocketKind) -> int:
    """A port that was free just now."""
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@contextmanager
def sending_poses(port: int) -> Iterator[None]:
    """The tool at rest just above the dome, 200 times a second."""
    ended = threading.Event()
    text = b"/haptorb/pose\0\0\0,fffffff\0\0\0\0" + struct.pack(">7f", 0.0, 0.0, 0.052, 0.0, 0.0, 0.0, 1.0)

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            while not ended.wait(0.005):
                with suppress(OSError):
                    one.sendto(text, ("127.0.0.1", port))

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def text_frame(text: bytes) -> bytes:
    """A WebSocket's message of a client, of less than 126 bytes (RFC 6455, 5.2); masked with zeros."""
    return bytes((0x81, 0x80 | len(text), 0, 0, 0, 0)) + text


class LostRun(Exception):
    """The coils were not on when the run was to end: it is repeated."""


class Left(Exception):
    """A program did not end, or its memory stayed."""


class Lane:
    """One run after another, with a folder, a port and an emulated board of its own."""

    def __init__(self, folder: Path, boards: Sequence[str]) -> None:
        self.boards = boards
        self._stack = ExitStack()
        self._folder = folder
        folder.mkdir()
        self._flag = folder / "raise"
        self.emulator: Emulator | None = None
        if "emulated" in boards:
            self.emulator = self._stack.enter_context(Emulator(BUILD, folder / "board"))
        self._tracker = free_port(socket.SOCK_DGRAM)
        self._stack.enter_context(sending_poses(self._tracker))
        self._number = 0

    def close(self) -> None:
        """End the board."""
        self._stack.close()

    def run(self, case: Case, measuring: threading.Lock) -> tuple[float, dict[str, float | str]]:
        """From the signal to coils off [ms], and what the rows say of it. Raises LostRun."""
        self._number += 1
        self._flag.unlink(missing_ok=True)
        (self._folder / "loud").unlink(missing_ok=True)
        (self._folder / "world.py").write_text(WORLD.format(flag=str(self._flag), loud=str(self._folder / "loud")))
        program = Program(case, self._folder, self._number, self._tracker, self._flag, self.emulator)
        try:
            program.wait_until_on()
            with measuring:
                took = program.end()
        finally:
            if left := program.tidy():
                raise Left(f"{case}: left behind: {left}\n{program.said()}")
        return took, program.evidence


class Terminal:
    """Writes what a program prints to a file, except while it does not read."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._out, self.into = os.pipe()
        self._reads = threading.Event()
        self._reads.set()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with self._path.open("ab", buffering=0) as file:
            while True:
                self._reads.wait()
                if select.select([self._out], [], [], 0.02)[0] and self._reads.is_set():
                    if not (text := os.read(self._out, 65536)):
                        return
                    file.write(text)

    def block(self) -> None:
        """Read no more; there is no room for what is printed from now on."""
        self._reads.clear()
        time.sleep(0.05)
        filler = os.open(f"/proc/self/fd/{self._out}", os.O_WRONLY | os.O_NONBLOCK)
        with suppress(BlockingIOError):
            while True:
                os.write(filler, b"\n" * 4096)
        with suppress(BlockingIOError):
            while True:
                os.write(filler, b"\n")
        os.close(filler)

    def read_on(self) -> None:
        """Read again."""
        self._reads.set()

    def close(self) -> None:
        """The program has ended: read what is left."""
        self._reads.set()
        self._thread.join(10.0)
        os.close(self._out)


class Program:
    """A running program with its coils on, and what is known of it from outside."""

    def __init__(
        self, case: Case, folder: Path, number: int, tracker: int, flag: Path, emulator: Emulator | None
    ) -> None:
        self.case, self._flag, self._folder = case, flag, folder
        self._emulator = emulator if case.board == "emulated" else None
        self._noted, self._errors = folder / f"noted-{number}", folder / f"errors-{number}"
        self._pipe = -1
        self._stopped: list[int] = []
        self._hangs = False
        self._asked = False  #: to end, by what this case is about
        self._pages = ExitStack()
        self.memory: SharedMemory | None = None
        self.evidence: dict[str, float | str] = {}  #: of the end on the simulated device: see `_wait_for_row`
        pipe = folder / f"pipe-{number}"
        if case.fault == "disk":
            os.mkfifo(pipe)
            self._pipe = os.open(pipe, os.O_RDWR | os.O_NONBLOCK)
        driver = "sim" if self._emulator is None else f"serial:{self._emulator.port}"
        world, recording = f"{folder / 'world.py'}:push", str(folder / f"run-{number}.mcap")
        serve = f"osc:127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
        arguments = [
            "run", "omni", "--world", world, "--driver", driver, "--tracker", f"osc:{tracker}", "--serve", serve,
            "--record", recording, "--port", "0",
        ]  # fmt: skip
        self.page = case.end == "page" or (case.end in SIGNALS and number % 2 == 0)
        if not self.page:
            arguments.append("--headless")
        if case.end == "duration":
            arguments += ["--duration", f"{LASTS_BLOCKED if case.fault == 'terminal' else LASTS:g}"]
        given = {
            "pipe": str(pipe) if self._pipe >= 0 else "", "compiler": case.fault == "compiler",
            "with": case.end == "with", "noted": str(self._noted), "arguments": arguments, "world": world,
            "driver": driver, "tracker": f"osc:{tracker}", "record": recording, "serve": serve,
        }  # fmt: skip
        if self._emulator is not None:
            self._emulator.set_pace()  # it takes a processor at full pace, and nobody talks to it yet
            self._emulator.discard_lines()
        self._terminal = Terminal(self._errors)
        try:
            self.host = start(
                [sys.executable, "-P", "-c", HOST, json.dumps(given)], stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL, stderr=self._terminal.into, start_new_session=True,
            )  # fmt: skip
        finally:
            os.close(self._terminal.into)

    def wait_until_on(self) -> None:
        """The loop drives the coils, and what is to hang is there."""
        deadline = time.monotonic() + START
        while True:
            if self.host.poll() is not None:
                raise LostRun(self._errors.read_text()[-300:])
            if time.monotonic() > deadline:
                said = self._errors.read_text()[-300:]
                raise LostRun(f"no coils on after {START:g} s, guard {self._guard()}: {said}")
            if self.memory is None:
                self.memory = self._find_memory()
                if self.memory is not None and self._emulator is not None:
                    self._emulator.set_pace(1.0)  # the loop's process begins, and will open it
            elif self._on() and self._has_started():
                return
            elif self._is_tripped():
                raise LostRun(f"tripped ({self._guard()}) before the end")
            time.sleep(0.01)

    def _has_started(self) -> bool:
        """Server and page serve, the block or the duration has begun, and what is to hang is there."""
        assert self.memory is not None
        if self.page and b"http" not in self._errors.read_bytes():
            return False
        if self.case.end in ("with", "duration") and not self._noted.exists():
            return False
        if self.memory.words[Word.SERVERS] != Phase.RUNNING:
            return False
        if self.case.fault == "compiler" or (self.case.fault == "terminal" and self.case.end == "duration"):
            self._hang()  # now: it would be done, or the duration over, before
        elif self.case.fault in MODULES and not self._find(MODULES[self.case.fault]):
            raise LostRun(f"no {self.case.fault} any more")
        return True

    def _find_memory(self) -> SharedMemory | None:
        with suppress(OSError, Exception):
            found = re.search(r"/\S+\.shared", Path(f"/proc/{self.host.pid}/maps").read_text())
            return None if found is None else SharedMemory(Path(found[0]))
        return None

    def _on(self) -> bool:
        row = self.memory.ring.latest() if self.memory is not None else None
        if row is None or self.memory is None:
            return False
        at = self.memory.layout
        on = row[at["guard"]][0] not in (GuardState.OFF, GuardState.TRIPPED) and row[at["duty_applied"]].any()
        return bool(on) and (self._emulator is None or self._emulator.status()["on"] == "1")

    def _guard(self) -> str:
        """State and reason of the newest row."""
        row = None if self.memory is None else self.memory.ring.latest()
        if row is None or self.memory is None:
            return "unknown"
        at = self.memory.layout
        return f"{GuardState(int(row[at['guard']][0])).name}, {Trip(int(row[at['trip']][0])).name}"

    def _is_tripped(self) -> bool:
        return self._guard().startswith(GuardState.TRIPPED.name)

    def _find(self, module: str) -> int:
        """The host's child that runs `module`; 0 if there is none."""
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError, ValueError, IndexError):
                parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
                if parent == self.host.pid and module.encode() in (folder / "cmdline").read_bytes():
                    return int(folder.name)
        return 0

    def end(self) -> float:
        """Let it hang, end it; how long the coils stayed on [ms]."""
        act = self._prepare_end()
        if self.case.end == "duration":
            over = float(self._noted.read_text())
            time.sleep(max(over - 0.03 - time.monotonic(), 0.0))
        if not self._hangs:
            self._hang()
        if not self._on():
            raise LostRun("the coils were off already")
        if self._emulator is not None:
            self._emulator.discard_lines()
            self._emulator.execute("mark")
            if not self._on():  # its watchdog came between: what it said of it is discarded
                raise LostRun("the coils were off already")
        assert self.memory is not None
        cursor = self.memory.words[Word.ROWS]
        before, early = time.monotonic(), 0.0
        if self.case.end == "duration":
            if before > over:
                raise LostRun("its time was over already")
            before, early = over, over - before
        act()
        self.evidence["sent_ms"] = round(1e3 * (time.monotonic() - before), 2)
        self._asked = True
        took = self._wait_for_board(early) if self._emulator is not None else self._wait_for_row(before, cursor)
        if took < -EARLY:
            raise LostRun(f"the coils were off {-took:.1f} ms before the end")
        return took

    def _prepare_end(self) -> Callable[[], object]:
        if self.case.end in SIGNALS:
            return lambda: os.kill(self.host.pid, SIGNALS[self.case.end])
        if self.case.end == "exception":
            return self._flag.touch
        if self.case.end == "with":
            assert self.host.stdin is not None
            line = self.host.stdin.fileno()
            return lambda: os.write(line, b"leave\n")
        if self.case.end == "page":
            from websockets.sync.client import connect

            found = re.search(r"http://127\.0\.0\.1:(\d+)/#(\S+)", self._errors.read_text())
            assert found is not None
            page = self._pages.enter_context(
                connect(
                    f"ws://127.0.0.1:{found[1]}/ws", additional_headers={"Authorization": f"Bearer {found[2]}"},
                    open_timeout=30,
                )
            )  # fmt: skip
            # One write, like a signal: the client's own `send` waits for this program's other threads.
            return lambda: page.socket.sendall(text_frame(b'{"do": "stop"}'))
        return lambda: None

    def _hang(self) -> None:
        """What hangs from now on."""
        self._hangs = True
        if self.case.fault in MODULES:
            pid = self._find(MODULES[self.case.fault])
            if not pid:
                raise LostRun(f"no {self.case.fault} any more")
            os.kill(pid, signal.SIGSTOP)
            self._stopped.append(pid)
        elif self.case.fault == "disk":
            with suppress(BlockingIOError):
                while True:
                    os.write(self._pipe, bytes(65536))
        elif self.case.fault == "terminal":
            self._terminal.block()
            (self._folder / "loud").touch()
            with (self._folder / "world.py").open("a") as file:
                file.write("a mistake\n")
            time.sleep(NOTICED)

    def _wait_for_row(self, before: float, cursor: int) -> float:
        assert self.memory is not None
        at, words, deadline = self.memory.layout, self.memory.words, time.monotonic() + 10.0
        while time.monotonic() < deadline:
            over = words[Word.PHASE] > 1
            _, rows = self.memory.ring.read_since(cursor)
            off = [n for n in range(len(rows)) if not rows[n, at["duty_applied"]].any()]
            if off and (off[0] + 1 < len(rows) or over):
                last = min(off[0] + 1, len(rows) - 1)
                walls = [float(rows[n, at["wall"]][0]) for n in range(last + 1)]
                self.evidence["gap_ms"] = round(1e3 * max((b - a for a, b in pairwise(walls)), default=0.0), 2)
                self.evidence["trip"] = Trip(int(rows[last, at["trip"]][0])).name
                return 1e3 * (walls[-1] - before)
            time.sleep(0.0005)
        return float("inf")

    def _wait_for_board(self, early: float) -> float:
        """[ms] from the end, which came `early` [s] after the mark; the emulator may lag, so by its own time."""
        assert self._emulator is not None
        try:
            said = dict(re.findall(r"(\w+)=([-\d.]+)", self._emulator.expect_line("@off", 10.0)))
        except DriverError:
            return float("inf")
        return float(said["since_mark_ms"]) - 1e3 * early

    def said(self) -> str:
        """Beginning and end of what it printed; where it hung, if it did not end."""
        text = re.sub(r"\n{3,}", "\n\n", self._errors.read_text())
        return text if len(text) < 6000 else f"{text[:2000]}\n...\n{text[-4000:]}"

    def tidy(self) -> list[str]:
        """What hung continues; the program ends, by SIGINT if it still runs. What it left behind."""
        self._terminal.read_on()
        for pid in self._stopped:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
        draining = self.host.poll() is None or self._pipe >= 0
        end, asked = time.monotonic() + 30.0, 0.0
        while draining:
            with suppress(BlockingIOError):
                while self._pipe >= 0 and os.read(self._pipe, 65536):
                    pass
            if self.host.poll() is not None or time.monotonic() > end:
                break
            ends_itself = self._asked and self.case.end in (*SIGNALS, "duration")
            if time.monotonic() > asked + 1.0 and not ends_itself:
                self.host.send_signal(signal.SIGINT)
                asked = time.monotonic()
            time.sleep(0.01)
        left = []
        if self.host.poll() is None:
            left.append("the program")
            self.host.send_signal(signal.SIGUSR1)
            time.sleep(1.0)
            self.host.kill()
        self.host.wait()
        self._terminal.close()
        with suppress(Exception):  # a page's connection ends with its server
            self._pages.close()
        if self._pipe >= 0:
            os.close(self._pipe)
        if self.host.stdin is not None:
            self.host.stdin.close()
        if self.memory is not None and self.memory.path.exists():
            left.append(str(self.memory.path))
        return left


class Results:
    """Ends that were measured, in a file with one JSON object in each line; no `path`: in memory only."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.found: list[tuple[Case, float]] = []
        self.commits: set[str] = set()
        self._commit = subprocess.run(
            ["git", "describe", "--always", "--dirty"], cwd=Path(__file__).parent, capture_output=True, text=True,
            check=False,
        ).stdout.strip()  # fmt: skip
        if path is not None and path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                row = json.loads(line)
                self.commits.add(row["commit"])
                self.found.append((Case(row["end"], row["fault"], row["board"]), float(row["off_ms"])))

    def add(self, case: Case, took: float, evidence: dict[str, float | str]) -> None:
        """Add an end that took so long [ms], with what its rows say."""
        self.found.append((case, took))
        self.commits.add(self._commit)
        if self._path is not None:
            row = {**vars(case), "off_ms": round(took, 2), **evidence, "commit": self._commit}
            row["unix"] = round(time.time())
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")


def measure(
    count: int,
    lanes: int,
    boards: Sequence[str],
    faults: Sequence[str],
    results: Results,
    notify: Callable[[str], None],
) -> list[tuple[Case, float]]:
    """`count` ends with those of `results`: each with the time for which the coils stayed on [ms]."""
    todo, found = list(cases(count, boards, faults)), results.found
    for case, _ in found:
        with suppress(ValueError):
            todo.remove(case)
    lost, left = list[str](), list[str]()
    taking, measuring, failures = threading.Lock(), threading.Lock(), list[BaseException]()

    def work(lane: Lane) -> None:
        try:
            while not failures:
                with taking:
                    mine = (case for board in reversed(lane.boards) for case in todo if case.board == board)
                    case = next(mine, None)
                    if case is None:
                        return
                    todo.remove(case)
                try:
                    took, evidence = lane.run(case, measuring)
                except LostRun as why:
                    lost.append(str(why))
                    notify(f"lost: {case}: {str(why)[-200:]}")
                    if len(lost) > 20 + 2 * count:
                        raise SystemExit(f"this computer is too busy: {len(lost)} runs lost, the last: {why}") from why
                    with taking:
                        todo.append(case)
                    continue
                except Left as why:
                    left.append(str(why))
                    notify(f"LEFT BEHIND: {why}")
                    continue
                with taking:
                    results.add(case, took, evidence)
                if took > LIMIT or len(found) % 25 == 0:
                    kind = f"{case.end} beside {case.fault} on {case.board}"
                    notify(f"{len(found)} of {count}: {kind}: {took:.1f} ms {evidence}")
        except BaseException as cause:
            failures.append(cause)

    with tempfile.TemporaryDirectory() as folder:
        # Two emulated boards beside two loops starve each other on two processors: only the first lane has one.
        kinds = [boards, *([board for board in boards if board != "emulated"] for _ in range(1, lanes))]
        every = [Lane(Path(folder) / f"lane-{n}", kind) for n, kind in enumerate(kinds) if kind]
        threads = [threading.Thread(target=work, args=(lane,)) for lane in every]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for lane in every:
            lane.close()
    if failures:
        raise failures[0]
    notify(f"{len(lost)} runs repeated: their coils were off before the end")
    if left:
        notify(f"{len(left)} of {count} left something behind")
    return found


def describe(name: str, times: Sequence[float]) -> str:
    """One line."""
    ordered = sorted(times)
    nearly = ordered[min(int(0.99 * len(ordered)), len(ordered) - 1)]
    inside = sum(one <= LIMIT for one in times)
    return (
        f"{name:>24}: {inside} of {len(times)} within {LIMIT:g} ms; median {statistics.median(times):.1f}, "
        f"99 % {nearly:.1f}, at most {ordered[-1]:.1f} ms"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and print for people or machines; 1 if an end was late."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ends", type=int, default=168)
    parser.add_argument("--lanes", type=int, default=2, help="programs at the same time; one is measured at a time")
    parser.add_argument("--boards", nargs="*", default=BOARDS, choices=BOARDS)
    parser.add_argument("--faults", nargs="*", default=FAULTS, choices=FAULTS, help="what hangs or blocks meanwhile")
    parser.add_argument("--into", type=Path, help="file of the ends measured so far, which is continued")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    # What a shell starts in the background ignores Ctrl-C and Ctrl-\, and with nohup SIGHUP; so would the programs that
    # are to be ended by them. Handlers, unlike ignored signals, are not inherited.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in SIGNALS.values():
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, lambda number, frame: None)
    if "emulated" in options.boards and not (BUILD / "emulator").exists():
        raise SystemExit(f"there is no {BUILD / 'emulator'}: make firmware && make -C firmware emulator")
    results = Results(options.into)
    found = measure(
        options.ends, options.lanes, options.boards, options.faults, results,
        lambda text: print(text, file=sys.stderr, flush=True),
    )  # fmt: skip
    times = [took for _, took in found]
    good = len(found) >= options.ends and max(times) <= LIMIT
    if options.json:
        rows: list[dict[str, Any]] = [{**vars(case), "off_ms": took} for case, took in found]
        print(json.dumps({"good": good, "worst_ms": max(times), "ends": rows}))
        return 0 if good else 1
    for kinds, of in ((ENDS, "end"), (FAULTS, "fault"), (options.boards, "board")):
        for kind in kinds:
            if some := [took for case, took in found if getattr(case, of) == kind]:
                print(describe(kind, some))
    print(describe("all ends", times) + (": kept" if good else ": NOT KEPT"))
    if options.into is not None:
        print(f"measured at {len(results.commits)} commits: {options.into}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
