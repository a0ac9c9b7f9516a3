"""The coils are off first however a run ends: measured from outside the program."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.errors import DriverError, RecordingError, ServoError
from haptorb.runtime.process_group import SignalStop
from haptorb.runtime.servo import Servo
from haptorb.runtime.shared_memory import SharedMemory, Word
from oracles.fork_server import ForkServer

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(600), pytest.mark.usefixtures("quick_starts")]

ROOT = Path(__file__).resolve().parents[3]
LIMIT = 0.020  #: from the signal to coils off [s]
#: a program with a servo, its coils on, that then does what argv[1] says
HOST = """
import signal, sys, time
from haptorb import Servo
signal.signal(signal.SIGINT, signal.default_int_handler)
for number in (signal.SIGHUP, signal.SIGQUIT):  # a shell without a terminal may have them ignored
    signal.signal(number, signal.SIG_DFL)
try:
    with Servo("omni", record=False) as servo:
        servo.hand.hold((0.0, 0.0, 0.051))
        servo.run(0.5)
        print(servo.memory_path, flush=True)
        exec(sys.argv[1])
finally:
    print("tidied", flush=True)
"""
#: for half a second and more, between two instructions of Python; the heart beats meanwhile. No call of the system: a
#: signal would end it.
IN_C = "import hashlib; hashlib.pbkdf2_hmac('sha256', b'', b'', 2_000_000); time.sleep(60)"
#: for a third of a second and more, one call of C, which lets no other thread of the program run
HOLDS = "print('holds', flush=True); sum(range(40_000_000))"
#: tidies up at length, and is interrupted in that
LEAVES = "servo._watcher = type('Slow', (), {'end': lambda self: time.sleep(1.0)})(); sys.stdin.readline()"
#: a finalizer runs when the signal comes: what the signal raises is lost there
FINALIZES = """
class Slow:
    def __del__(self):
        time.sleep(1.0)
check = servo.check
def check_once():
    servo.check = check
    Slow()
servo.check = check_once
servo.run(60)
"""
TWICE = "servo._watcher = type('Slow', (), {'end': lambda self: time.sleep(1.0)})(); time.sleep(60)"


class Host:
    """The program, and its servo's memory."""

    def __init__(self, server: ForkServer, does: str, program: str = HOST) -> None:
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        self.process = server.start_program("-c", program, does, text=True, **pipes)
        assert self.process.stdout is not None
        self.memory = SharedMemory(Path(self.process.stdout.readline().strip()))
        row = self.memory.ring.latest()
        assert row is not None
        assert row[self.memory.layout["duty_applied"]].any()

    def off_after(self, number: signal.Signals | None) -> float:
        """From the signal, or None: a line on its input, to the row after the first with coils off, or the last [s]."""
        at, cursor = self.memory.layout, self.memory.ring.read_since(0)[0]
        before = time.monotonic()
        if number is None:
            os.write(self.process.stdin.fileno(), b"\n")
        else:
            self.process.send_signal(number)
        while time.monotonic() < before + 10.0:
            ended = self.memory.phase > 1
            rows = self.memory.ring.read_since(cursor)[1]
            off = [n for n in range(len(rows)) if not rows[n, at["duty_applied"]].any()]
            if off and (off[0] + 1 < len(rows) or ended):
                return float(rows[min(off[0] + 1, len(rows) - 1), at["wall"]][0]) - before
            time.sleep(0.001)
        return float("inf")

    def end(self) -> None:
        """End the program, if it still runs, and read what is left of its output."""
        self.process.kill()
        with suppress(ValueError):  # read already
            self.process.communicate()

    def close(self) -> str:
        """What it printed; it has left nothing."""
        out, errors = self.process.communicate(timeout=60)
        assert not self.memory.path.exists(), errors
        return out


@pytest.mark.parametrize(
    "number", [signal.SIGINT, signal.SIGTERM, signal.SIGQUIT, pytest.param(signal.SIGHUP, marks=pytest.mark.slow)]
)
def test_a_signal_in_the_middle_of_other_code_is_a_stop_within_ticks(number, fork_server):
    """Python runs no handler before that code returns; SIGTERM, SIGHUP and SIGQUIT end a program that has none."""
    host = Host(fork_server, IN_C)
    try:
        assert host.off_after(number) <= LIMIT
        if number is signal.SIGINT:
            assert host.process.poll() is None  # still in there
            assert "tidied" in host.close()
    finally:
        host.end()


#: opened without `with`; another thread of the program goes on for long after the main thread has ended
ABANDONED = """
import sys, threading, time
from haptorb import Servo
servo = Servo("omni", record=False)
servo.open()
servo.hand.hold((0.0, 0.0, 0.051))
servo.run(0.5)
threading.Thread(target=time.sleep, args=(20.0,)).start()
print(servo.memory_path, flush=True)
sys.stdin.readline()
raise KeyError(sys.argv[1])
"""


def test_the_end_of_the_main_thread_is_the_end_of_the_loop_though_other_threads_go_on(fork_server):
    host = Host(fork_server, "nothing", ABANDONED)
    try:
        assert host.off_after(None) <= 0.1  # Python prints the exception first
        assert host.process.poll() is None
    finally:
        host.end()


#: started by a shell that permits dumps (`ulimit -c unlimited`): what it prints is the loop's own limit
PERMITS_DUMPS = """
import resource
from pathlib import Path
from haptorb import Servo
from haptorb.runtime.shared_memory import SharedMemory, Word
most = resource.getrlimit(resource.RLIMIT_CORE)[1]
resource.setrlimit(resource.RLIMIT_CORE, (most, most))
with Servo("omni", record=False) as servo:
    loop = SharedMemory(Path(servo.memory_path)).words[Word.PID]
    print(most, resource.prlimit(loop, resource.RLIMIT_CORE)[0])
"""


def test_a_crash_of_the_loop_waits_for_no_dump_of_its_memory():
    """A process of its own: the tests' fork server would pass on its own limit."""
    done = subprocess.run([sys.executable, "-c", PERMITS_DUMPS], capture_output=True, text=True, check=True)
    most, limit = map(int, done.stdout.split())
    if most == 0:
        pytest.skip("this account may not permit dumps: nothing to forbid")
    assert limit == 1


def test_a_signal_in_the_middle_of_code_that_lets_no_thread_run_is_a_stop(fork_server):
    """Not even the heart, which hears signals too: the loop itself reads them, long before it misses the heart."""
    host = Host(fork_server, HOLDS)
    try:
        assert host.process.stdout.readline() == "holds\n"
        time.sleep(0.02)
        assert host.off_after(signal.SIGINT) <= LIMIT
        assert "tidied" in host.close()
    finally:
        host.end()


#: a program with a handler of its own, as a profiler has: what it prints is how often Stop was requested
BESIDE_OTHER_SIGNALS = """
import os, signal, sys
from haptorb.devices.loader import load
from haptorb.recording.row import RowLayout
from haptorb.runtime import process_group
from haptorb.runtime.shared_memory import SharedMemory, find_end_signal

shared, stops = SharedMemory.create(RowLayout.of(load("omni"))), []
signal.signal(signal.SIGALRM, lambda number, frame: None)
signals = process_group.SignalStop(shared, lambda: stops.append(1))

def come(number, times=1):
    for _ in range(times):
        try:
            signal.raise_signal(number)
        except KeyboardInterrupt:
            pass

def find_while_ctrl_c_comes(side):
    found = find_end_signal(side)
    come(signal.SIGINT)
    return found

if sys.argv[1] == "read":
    come(signal.SIGALRM)
    process_group.find_end_signal = find_while_ctrl_c_comes
    signals.poll()
    process_group.find_end_signal = find_end_signal
else:
    come(signal.SIGALRM, 50)
    come(signal.SIGINT)
print("seen by the loop:", any(map(find_end_signal, shared.signals)))
signals.poll()
print("stops:", len(stops), "left:", any(map(any, shared.signals)))
signals.poll()
print("stops:", len(stops))
signals.close()
shared.unlink()
"""


@pytest.mark.parametrize("when", ["read", "many"])
def test_ctrl_c_beside_other_signals_is_not_lost(when, fork_server):
    """While one is read, and after fifty between two readings: a profiler sends a thousand a second."""
    done = fork_server.run_program("-c", BESIDE_OTHER_SIGNALS, when)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["seen by the loop: True", "stops: 1 left: False", "stops: 1"]


def test_leaving_the_block_switches_off_first(fork_server):
    host = Host(fork_server, LEAVES)
    try:
        assert host.off_after(None) <= LIMIT
        assert "tidied" in host.close()
    finally:
        host.end()


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_signal_whose_exception_is_lost_ends_the_run_nevertheless(number, fork_server):
    host = Host(fork_server, "from haptorb.runtime.linux import raise_termination\nwith raise_termination():\n"
                + "".join(f"    {line}\n" for line in FINALIZES.strip().splitlines()))  # fmt: skip
    try:
        time.sleep(0.3)
        assert host.off_after(number) <= LIMIT
        assert "tidied" in host.close()
    finally:
        host.end()


#: an event loop in which C code runs for half a second and more, with the coils on
ASYNC_HOST = """
import asyncio, hashlib
from haptorb import Servo
async def main():
    async with Servo("omni", record=False) as servo:
        servo.hand.hold((0.0, 0.0, 0.051))
        await servo.wait(0.5)
        print(servo.memory_path, flush=True)
        hashlib.pbkdf2_hmac('sha256', b'', b'', 2_000_000)
        await asyncio.sleep(60)
try:
    asyncio.run(main())
finally:
    print("tidied", flush=True)
"""


def test_a_signal_in_an_event_loop_that_stands_still_is_a_stop(fork_server):
    host = Host(fork_server, "", ASYNC_HOST)
    try:
        assert host.off_after(signal.SIGINT) <= LIMIT
        assert "tidied" in host.close()
    finally:
        host.end()


class UnreadRun:
    """`haptorb run` for a second, whose messages nobody reads."""

    def __init__(self, server: ForkServer, *words: str) -> None:
        self._out, into = os.pipe()
        filler = os.open(f"/proc/self/fd/{self._out}", os.O_WRONLY | os.O_NONBLOCK)
        with suppress(BlockingIOError):
            while True:
                os.write(filler, b"." * 4096)
        os.close(filler)
        self.process = server.start_haptorb(
            "run", "omni", "--duration", "1", *words, stdout=subprocess.DEVNULL, stderr=into
        )
        os.close(into)

    def find_memory(self) -> SharedMemory:
        end = time.monotonic() + 60.0
        while time.monotonic() < end:
            with suppress(OSError, ValueError):
                if found := re.search(r"/\S+\.shared", Path(f"/proc/{self.process.pid}/maps").read_text()):
                    return SharedMemory(Path(found[0]))
            time.sleep(0.01)
        raise AssertionError("no servo")

    def close(self) -> int:
        """Read on; the status of its end."""
        while os.read(self._out, 65536):
            pass
        os.close(self._out)
        return self.process.wait(30)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("words", [("--headless",), ("--port", "0")])
def test_a_terminal_that_does_not_read_delays_no_end(fork_server, words):
    """After Ctrl-S, or in a pager: the duration is over while a message waits for its reader."""
    run = UnreadRun(fork_server, *words)
    try:
        memory = run.find_memory()
        begun = end = time.monotonic()
        while not (memory.words[Word.QUIT] and memory.phase > 1) and end < begun + 20.0:
            time.sleep(0.01)
            end = time.monotonic()
        assert memory.words[Word.QUIT]
        assert memory.phase > 1
        assert run.process.poll() is None  # it waits for its reader, coils off
    finally:
        status = run.close()
    assert status == 0


def test_a_second_signal_while_it_tidies_up_leaves_nothing_behind(fork_server):
    host = Host(fork_server, TWICE)
    try:
        assert host.off_after(signal.SIGINT) <= LIMIT
        time.sleep(0.3)
        host.process.send_signal(signal.SIGINT)
        assert "tidied" in host.close()
    finally:
        host.end()


def test_ctrl_c_while_servers_end_leaves_no_servo_behind(monkeypatch, tmp_path):
    """Ending them takes seconds where one hangs; what is to be closed after them was once left out."""
    from haptorb.cli import main
    from haptorb.runtime import shared_memory
    from haptorb.runtime.linux import hold_signals
    from haptorb.serve.base import Serving

    def interrupted_end(serving):
        with hold_signals():
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(shared_memory, "folders", lambda: [tmp_path])
    monkeypatch.setattr(Serving, "end", interrupted_end)
    with pytest.raises(SystemExit) as ended:
        main(["run", "omni", "--headless", "--duration", "0.2", "--json"])
    assert ended.value.code == 130
    assert list(tmp_path.iterdir()) == []


def interrupt_at(monkeypatch, name):
    """Ctrl-C comes with the next call of a function of `signal`."""
    real, once = getattr(signal, name), [True]

    def interrupted(*given):
        if once:
            once.clear()
            signal.raise_signal(signal.SIGINT)
        return real(*given)

    monkeypatch.setattr(signal, name, interrupted)


def test_a_signal_just_before_the_end_holds_it_leaves_nothing(monkeypatch, tmp_path):
    from haptorb.runtime import shared_memory

    monkeypatch.setattr(shared_memory, "folders", lambda: [tmp_path])
    servo = Servo("omni", record=False)
    servo.open()
    interrupt_at(monkeypatch, "getsignal")
    with pytest.raises(KeyboardInterrupt):
        servo.close()
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("moment", ["getsignal", "signal"])
def test_what_is_completed_is_done_once_and_leaves_the_handlers_as_they_were(monkeypatch, moment):
    from haptorb.runtime.linux import END_SIGNALS, run_uninterrupted

    before, done = [signal.getsignal(number) for number in END_SIGNALS], []
    interrupt_at(monkeypatch, moment)
    with pytest.raises(KeyboardInterrupt):
        run_uninterrupted(lambda interrupted: done.append(interrupted.is_set()))
    assert done == [True]
    assert [signal.getsignal(number) for number in END_SIGNALS] == before


def test_a_signal_while_the_handlers_are_put_back_leaves_them_as_they_were(monkeypatch):
    from haptorb.runtime.linux import END_SIGNALS, run_uninterrupted

    before = [signal.getsignal(number) for number in END_SIGNALS]
    with pytest.raises(KeyboardInterrupt):
        run_uninterrupted(lambda _: interrupt_at(monkeypatch, "signal"))
    assert [signal.getsignal(number) for number in END_SIGNALS] == before


def test_what_fails_while_a_servo_is_closed_leaves_nothing(monkeypatch, tmp_path):
    from haptorb.runtime import shared_memory
    from haptorb.runtime.process_group import ProcessGroup

    end = ProcessGroup.end

    def failing_end(group, *given):
        end(group, *given)
        raise RuntimeError("broken")

    monkeypatch.setattr(shared_memory, "folders", lambda: [tmp_path])
    monkeypatch.setattr(ProcessGroup, "end", failing_end)
    with pytest.raises(RuntimeError, match="broken"), Servo("omni", record=False) as servo:
        servo.run(0.1)
    assert list(tmp_path.iterdir()) == []


def test_a_program_that_survives_its_signal_has_a_trip_and_engages_again():
    with Servo("omni", record=False) as servo:
        servo.hand.hold((0.0, 0.0, 0.051))
        servo.run(0.3)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        servo.run(0.5)
        assert servo.latest().guard == GuardState.TRIPPED
        assert [one["code"] for one in servo.report()["trips"]] == [Trip.STOPPED.name]
        servo.engage()
        servo.run(0.1)
        assert servo.latest().guard in (GuardState.RAMPING, GuardState.RUNNING)


def test_a_signal_that_was_caught_does_not_come_again_where_the_heartbeat_is_late(monkeypatch):
    """The thread that looks for signals waits for a processor: what it sees then came before this run."""
    poll = SignalStop.poll

    def wait_and_poll(signals):
        if threading.current_thread() is not threading.main_thread():
            time.sleep(0.1)
        poll(signals)

    with Servo("omni", record=False) as servo:
        servo.run(0.2)
        monkeypatch.setattr(SignalStop, "poll", wait_and_poll)
        time.sleep(0.15)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        servo.run(0.9)
        assert servo.latest().guard == GuardState.TRIPPED


def test_a_run_that_was_interrupted_reports_no_trip():
    servo = Servo("omni", record=False)

    def run_until_interrupted() -> None:
        with servo:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        run_until_interrupted()
    assert servo.report()["trips"] == []


def test_a_servo_that_was_stopped_for_a_second_waits_for_a_person():
    """As a board does, whose firmware latches a silence."""
    with Servo("omni", record=False) as servo:
        servo.hand.hold((0.0, 0.0, 0.051))
        servo.run(0.5)
        os.kill(servo.servo_pid, signal.SIGSTOP)
        time.sleep(1.1)
        os.kill(servo.servo_pid, signal.SIGCONT)
        servo.hand.hold((0.0, 0.0, 0.051))
        servo.run(0.6)
        assert servo.latest().guard == GuardState.TRIPPED
        assert servo.latest().trip == Trip.OVERRUN
        servo.engage()
        servo.run(0.1)
        assert servo.latest().guard == GuardState.RAMPING


@pytest.mark.slow  # two minutes; the others above try the same paths one by one
def test_every_end_beside_everything_that_hangs():
    """The benchmark, on the simulated device: one end of each way and each hanging process."""
    done = subprocess.run(
        [sys.executable, ROOT / "benchmarks/safety/ends.py", "--ends", "7", "--boards", "sim"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"7 of 7 within 20 ms", done.stdout)


def _stop_at_once(monkeypatch: pytest.MonkeyPatch, module: str) -> None:
    """Whoever starts `module` gets a process that is stopped before it does anything."""
    from haptorb.runtime import linux

    start = linux.start

    def start_stopped(command, **options):
        if module not in command:
            return start(command, **options)
        with monkeypatch.context() as patch:
            patch.setattr(linux, "subprocess", subprocess)  # a start that takes its time
            process = start(command, **options)
        os.kill(process.pid, signal.SIGSTOP)
        return process

    monkeypatch.setattr(linux, "start", start_stopped)


@pytest.mark.timeout(60)  # a start that waits for the server hangs
@pytest.mark.parametrize("device", ["omni", "pmsm"])
def test_a_server_that_hangs_while_it_starts_is_refused_in_time(monkeypatch, device):
    """What a motor's server is sent at its start, with the tables, is larger than a pipe."""
    from haptorb.child_process import pack
    from haptorb.serve.base import Serving, check_servers

    _stop_at_once(monkeypatch, "haptorb.serve.server_process")
    servo = Servo(device, record=False)
    if device == "pmsm":
        servo.device.prepare()
        assert len(pack(servo.device)) > 65536
    with Serving(check_servers(["osc:127.0.0.1:0"]), servo) as serving, servo:
        before = time.monotonic()
        with pytest.raises(DriverError, match="did nothing"):
            serving.start()
        assert time.monotonic() - before < 5.0
        servo.end_loop()
        before = time.monotonic()
        serving.end()
        assert time.monotonic() - before < 5.0


@pytest.mark.timeout(60)  # a start that is not refused hangs
@pytest.mark.parametrize("module", ["recorder_process", "servo_process"])
def test_a_process_that_hangs_while_it_starts_is_refused_in_time(monkeypatch, tmp_path, module):
    _stop_at_once(monkeypatch, f"haptorb.runtime.{module}")
    before = time.monotonic()
    with pytest.raises((ServoError, RecordingError), match="did nothing"), Servo("omni", record=tmp_path / "a.mcap"):
        pass
    assert time.monotonic() - before < 30.0  # its own 5 s, and loading on a busy computer
    assert list(tmp_path.iterdir()) == []


def test_a_full_memory_is_a_refusal_that_leaves_nothing(monkeypatch, tmp_path):
    """Neither /dev/shm nor the temporary folder has room for the shared memory."""
    from haptorb.runtime import shared_memory

    def no_room(descriptor: int, offset: int, size: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(shared_memory.os, "posix_fallocate", no_room)
    monkeypatch.setattr(shared_memory, "folders", lambda: [tmp_path])
    servo = Servo("omni", record=tmp_path / "a.mcap")
    before = time.monotonic()
    with pytest.raises(ServoError, match="no room for"):
        servo.open()
    assert time.monotonic() - before < 5.0
    assert list(tmp_path.iterdir()) == []
