"""Supervises the processes of servo, recorder and tracker: start, monitor, send heartbeats, end.

The parent checks every 20 ms, and copies the ticks before a trip. A servo that has ended is detected within 0.1 s. A
servo whose tick does not end gets a signal after 1 s; the code in the tick can ignore it, and 0.5 s later the process
is killed. A stalled recorder is reported, and the loop continues.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from time import monotonic, monotonic_ns, sleep, time_ns
from types import FrameType
from typing import Any, final

from haptorb.compiled import has_cached_code
from haptorb.control.protection import protect_wrench
from haptorb.errors import DriverError, RecordingError, ServoError
from haptorb.estimation.tracker_frame import TrackerFrame
from haptorb.runtime.black_box import BlackBox
from haptorb.runtime.linux import (
    END_SIGNALS,
    end_process,
    is_linux,
    raise_priority,
    repeat_signal,
    send_beside,
    wait_for_end,
)
from haptorb.runtime.liveness import HangWatch, MemoryGrowth, StallTime, StarvedTime, state_of
from haptorb.runtime.prestart import CATALOGUE, CONTROLLER, WANTED, PrestartedProcess, start_module
from haptorb.runtime.report import count_recorded
from haptorb.runtime.shared_memory import Phase, SharedMemory, Word, find_end_signal
from haptorb.runtime.trackers.registry import Preparation
from haptorb.runtime.world_output import OutputReader, show

__all__ = ["CompilerProcess", "ProcessGroup", "SignalStop"]


# --------------------------------------------------------------------------------------------------
# A termination signal of the host is a Stop of the servo, whatever the host is doing at that moment.
#
# Python runs the handler of a signal in the main thread, between two of its own instructions. A host that is inside C
# code (a matrix, a database, an import) reacts when that returns. But the first thing that Python's own handler in C
# does is to write the signal's number to a file descriptor, `signal.set_wakeup_fd`. Here this is the file of the shared
# memory: the loop finds the number there in its next tick, without a thread, a lock or the interpreter's lock in
# between.


_SIGNAL_TIMEOUT_S = 0.5  #: after a signal: its exception must have ended every wait of the servo by then


@final
class SignalStop:
    """Turns termination signals of the host into a Stop, from its creation in the main thread until `close`.

    Created in another thread, it does so from `install` in the main thread. Without it, and where the program uses the
    descriptor for another purpose (an event loop with its own handlers), a Stop waits for the program's own handler.

    stop  called after the loop has stopped: it makes earlier engage requests void
    """

    def __init__(self, shared: SharedMemory, stop: Callable[[], None]) -> None:
        self._shared, self._stop = shared, stop
        self._descriptor = -1
        self._last = (0, -math.inf)  #: signal, time at which it was read [s]
        self._closed = False
        self._side = 0  #: of `shared.signals`, where signals are written now
        self._polling = threading.Lock()
        self.install()

    def install(self) -> None:
        """Begin, in the main thread; no effect in another one, nor a second time, nor after `close`."""
        if self._descriptor >= 0 or self._closed:
            return
        shared = self._shared
        if threading.current_thread() is not threading.main_thread() or not is_linux():
            return
        descriptor = os.open(shared.path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        os.lseek(descriptor, shared.signals_at[self._side], os.SEEK_SET)
        before = signal.set_wakeup_fd(descriptor, warn_on_full_buffer=False)  # safety: signal-stop
        if before == -1:
            self._descriptor = descriptor
            for number in END_SIGNALS:
                if signal.getsignal(number) is signal.SIG_DFL:  # else Python's C handler does not run either
                    signal.signal(number, _end_by_signal)
        else:
            signal.set_wakeup_fd(before, warn_on_full_buffer=False)
            os.close(descriptor)

    def poll(self) -> None:
        """Read and clear the received signals; call it several times a second, from any thread."""
        if self._descriptor < 0 or self._closed or not any(side[0] for side in self._shared.signals):
            return
        seen = monotonic()  # before the number is read: too early rather than too late
        if not self._polling.acquire(blocking=False):
            return  # another thread does it
        try:
            # What comes from here on is written to the other side: nothing is cleared that was not read.
            received = self._shared.signals[self._side]
            self._side = 1 - self._side
            os.lseek(self._descriptor, self._shared.signals_at[self._side], os.SEEK_SET)  # safety: signal-sides
            if number := find_end_signal(received):
                self._stop()  # first: the loop must always find the stop or the signal
                self._last = number, seen
            received[:] = bytes(len(received))
        finally:
            self._polling.release()

    def repeat_lost(self, since: float) -> None:
        """Repeat a signal that came after `since` [s] and whose exception was lost; in the main thread."""
        number, seen = self._last
        if since < seen < monotonic() - _SIGNAL_TIMEOUT_S and threading.current_thread() is threading.main_thread():
            self._last = 0, -math.inf
            repeat_signal(number)

    def close(self) -> None:
        """Restore the program's own signal handling. May be called twice, from any thread.

        Only the main thread may reset it: after a call from another one, written signals are discarded until then.
        """
        descriptor, discards, self._closed = self._descriptor, self._closed, True
        if descriptor < 0:
            return
        if threading.current_thread() is threading.main_thread():
            self._descriptor = -1
            for number in END_SIGNALS:
                if signal.getsignal(number) is _end_by_signal:
                    signal.signal(number, signal.SIG_DFL)
            now = signal.set_wakeup_fd(-1)
            if now not in (descriptor, -1):  # another part of the program has set it meanwhile
                signal.set_wakeup_fd(now, warn_on_full_buffer=False)
            os.close(descriptor)
        elif not discards:
            nowhere = os.open(os.devnull, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
            os.dup2(nowhere, descriptor, inheritable=False)
            os.close(nowhere)


def _end_by_signal(number: int, frame: FrameType | None) -> None:
    """Default action: a program without its own handler ends by the signal."""
    signal.signal(number, signal.SIG_DFL)
    signal.raise_signal(number)


# --------------------------------------------------------------------------------------------------
# The compiler process beside a servo: the controller at a first start, then the worlds.


_COMPILER_TIMEOUT_S = 4.0  #: time without processor use after which it counts as hung
_USUAL_START_S = 3.0  #: duration of a start with compiled code; after that a second process helps to compile


@final
class CompilerProcess:
    """Compiler process for the servo of `shared`, whose plan is in `folder`; its errors are appended to `errors`."""

    def __init__(self, folder: Path, shared: SharedMemory, errors: Path) -> None:
        self._folder, self._shared, self._errors = folder, shared, errors
        self._begin = monotonic()
        self._is_first = not has_cached_code(protect_wrench)  # every device needs this one
        self.process: subprocess.Popen[bytes] | None = None
        self._watch: HangWatch | None = None

    def help_start(self) -> None:
        """Start compiling the controller if its code is not cached, if the servo's process compiles, or takes long.

        Not while it opens a device: that may take long, but nothing is compiled then.
        """
        late = self._is_first or self._shared.words[Word.COMPILED] > 0
        late = late or monotonic() > self._begin + _USUAL_START_S
        if self.process is None and late and not self._shared.facts.read()[1]:
            self._run(CONTROLLER)

    def finish_start(self, *, running: bool) -> None:
        """End the help when the loop runs or has failed; if it runs, compile the worlds whose code is missing."""
        self.end()
        if running and self._shared.words[Word.UNCOMPILED]:
            self._run(CATALOGUE)

    def compile_world(self, name: str) -> None:
        """Compile the world `name` next."""
        with suppress(OSError):  # a full disk: it is compiled in its usual order
            (self._folder / WANTED).write_text(name, encoding="utf-8")
        if self.process is None or self.process.poll() is not None:
            self._run(CATALOGUE)

    def check(self) -> None:
        """End it and raise ServoError if it hangs: a requested world would never be compiled."""
        process = self.process
        if process is None or process.poll() is not None or self._watch is None:
            return
        if (hung := self._watch.update()) > _COMPILER_TIMEOUT_S:
            self.end()
            raise ServoError(
                f"the process that compiles the worlds did nothing for {hung:.0f} s and was ended; choose the world "
                "again"
            )

    def end(self) -> None:
        """Kill the process if it runs."""
        if self.process is not None:
            end_process(self.process, 0.0)

    def _run(self, what: str) -> None:
        self.process = start_module(
            "haptorb.runtime.first_start", what, str(self._folder), str(os.getpid()), errors=self._errors
        )
        self._watch = HangWatch(self.process.pid)


_HEARTBEAT_INTERVAL_S = 0.02  #: between two heartbeats
_STUCK_TIMEOUT_S = 1.0  #: time without a tick after which the servo gets a signal that ends the tick
_KILL_TIMEOUT_S = 1.5  #: time without a tick after which the servo is killed
_MAX_EXTENSION = 3.0  #: largest extension of a timeout of the start by processor starvation [multiple of the timeout]
_RECORDER_TIMEOUT_S = 1.0  #: time without a poll after which the recorder counts as stalled
_STARTUP_TIMEOUT_S = 180.0  #: of a start: the first one on a computer compiles the kernels
_FIRST_CALL_TIMEOUT_S = 20.0  #: of the first call of a user's world, which may compile its own code
_START_HANG_TIMEOUT_S = 4.0  #: time without processor use after which a starting process counts as hung
_END_TIMEOUT_S = 1.5  #: to end on request, before a signal is sent
_DRAIN_TIMEOUT_S = 20.0  #: for the recorder to write its remaining rows
_EXPLAIN_AFTER_S = 2.0  #: of that, before a message explains the delay
_DRAINING = "the recorder still writes, for {:g} s at most; Ctrl-C ends it at once, and the recording is truncated\n"
_HUNG_START = "the {} did nothing for {:g} s while it started and was ended; check for a disk that does not respond"
_HANG = (
    "world '{}' hangs: the last tick began {:.1f} s ago and did not end; the process was killed. A world must "
    "return from every call at once, and must not catch every exception"
)
_ENDLESS = (
    "world '{}' has not returned from its first call for {:g} s; the process was ended. A world must return from every "
    "call at once"
)
_STALL = (
    "the recorder has not written for {:.1f} s, and rows are lost if it does not continue; check for a full or slow "
    "disk"
)


@final
class ProcessGroup:
    """Starts the servo in `standby`, whose plan is written; call `record` and `track` for further processes, then
    `wait_until_running`."""

    def __init__(
        self, standby: PrestartedProcess, shared: SharedMemory, black_box: BlackBox, signals: SignalStop
    ) -> None:
        self._shared, self._signals = shared, signals
        self._black_box = black_box
        self._errors = standby.errors
        self._ending = threading.Event()
        self._end_sent = False
        shared.words[Word.HEARTBEAT] = monotonic_ns()
        self._servo = standby.process
        self._hang = self._stall = ""
        self._asked = False  # whether the signal that ends a stuck tick was sent
        self.memory = MemoryGrowth(standby.process.pid)
        self._starved, self._waited_before = StarvedTime(standby.process.pid), 0.0
        standby.activate(shared.path)
        self._output = OutputReader(standby.process.stdout)
        self._recorder: subprocess.Popen[bytes] | None = None
        self._tracker: subprocess.Popen[bytes] | None = None
        self.compiler = CompilerProcess(standby.folder, shared, standby.errors)
        self._in_main = threading.current_thread() is threading.main_thread()
        # A thread of its own: user code may block the caller's.
        self._heart = threading.Thread(target=self._beat, name="haptorb-heartbeat", daemon=True)
        self._heart.start()

    @property
    def servo_pid(self) -> int:
        """Process id of the servo."""
        return self._servo.pid

    @property
    def recorder_pid(self) -> int:
        """Process id of the recorder; 0 without one."""
        return self._recorder.pid if self._recorder else 0

    @property
    def alive(self) -> bool:
        """Whether the loop runs: the process exists and has neither ended nor failed."""
        return self._shared.phase is Phase.RUNNING and self._servo.poll() is None

    def record(
        self, descriptor: int | None, file: Path, rate: float, notes: Mapping[str, Any], *, temporary: bool
    ) -> None:
        """Start the recorder, which writes `notes` and the rows of a loop at `rate` [Hz] to `file`, open as
        `descriptor`.

        It may delete a `temporary` file.
        """
        spec = {
            "shared": str(self._shared.path),
            "file": descriptor,
            "servo": self.servo_pid,
            "parent": os.getpid(),
            "rate": rate,
            "unix_minus_monotonic": time_ns() - monotonic_ns(),
            "temporary": str(file) if temporary else None,
            "notes": notes,
        }
        path = self._errors.with_name("recorder.json")  # it may exceed the length limit of a command line
        if os.name != "posix":  # descriptors are not inherited
            spec["file"], descriptor = str(file), None
        path.write_text(json.dumps(spec), encoding="utf-8")
        with path.open("rb") as settings:
            self._recorder = start_module(
                "haptorb.runtime.recorder_process",
                errors=self._errors, stdin=settings.fileno(), descriptor=descriptor, isolated=True,
            )  # fmt: skip

    def track(self, tracker: Preparation, frame: TrackerFrame | None) -> None:
        """Start the process of the prepared `tracker`; `frame` transforms its poses to the stator frame, if given."""
        spec = {
            "shared": str(self._shared.path),
            "descriptor": tracker.descriptor,
            "parent": os.getpid(),
            "feed": tracker.spec,
            "frame": "" if frame is None else frame.text(),
        }
        descriptor = tracker.descriptor if tracker.descriptor >= 0 else None
        # safety: secret-by-pipe
        self._tracker = start_module(
            "haptorb.runtime.trackers.tracker_process",
            errors=self._errors, stdin=subprocess.PIPE, descriptor=descriptor, isolated=True,
        )  # fmt: skip
        # By a pipe because it contains a token: every account of this computer can read the arguments of a process.
        send_beside(self._tracker, json.dumps(spec).encode())

    def wait_until_running(self) -> None:
        """Wait for the first tick and until recorder and tracker are ready.

        Raises ServoError, RecordingError or DriverError if one of them fails.
        """
        try:
            self._wait()
        finally:
            self.compiler.finish_start(running=self.alive)
        self.check()

    def _wait(self) -> None:
        start = monotonic()
        words = self._shared.words
        # A tracker may wait for its sender, a servo for its device: those that only wait do not count as hung.
        group = {"servo": self._servo, "recorder": self._recorder, "tracker": self._tracker}
        watches = [(name, one, HangWatch(one.pid)) for name, one in group.items() if one is not None]
        starved, before_first = StarvedTime(self._servo.pid), 0.0
        while (
            not (self.alive and words[Word.TICKS])
            or (self._recorder and words[Word.RECORDER] == Phase.STARTING)
            or (self._tracker and words[Word.TRACKER] == Phase.STARTING)
        ):
            self.check()
            if trouble := self.tracker_trouble:
                raise DriverError(trouble)
            waited = starved.read()
            if not (first := words[Word.FIRST_CALL]):
                before_first = waited
            elif 1e-9 * (monotonic_ns() - first) > _FIRST_CALL_TIMEOUT_S + min(
                waited - before_first, _MAX_EXTENSION * _FIRST_CALL_TIMEOUT_S
            ):
                raise ServoError(_ENDLESS.format(self._shared.world_now(), _FIRST_CALL_TIMEOUT_S))
            if monotonic() > start + _STARTUP_TIMEOUT_S + min(waited, _MAX_EXTENSION * _STARTUP_TIMEOUT_S):
                raise ServoError(
                    f"the servo did not start within {monotonic() - start:.0f} s ({waited:.0f} s of it without a "
                    "processor); close other programs, and try again"
                )
            for name, process, watch in watches:
                hangs = watch.update() > _START_HANG_TIMEOUT_S  # safety: start-hangs
                if hangs and (name == "recorder" or state_of(process.pid)() == "T"):
                    raise (RecordingError if name == "recorder" else ServoError)(
                        _HUNG_START.format(name, _START_HANG_TIMEOUT_S)
                    )
            self.compiler.help_start()
            sleep(0.005)

    def check(self) -> None:
        """Raise ServoError if the servo ended, RecordingError if the recorder did."""
        # The servo first: its end also ends the recorder.
        recorder = self._recorder
        over = recorder and (self._shared.words[Word.RECORDER] >= Phase.ENDED or recorder.poll() is not None)
        code = self._servo.poll()
        if self._shared.phase >= Phase.ENDED or code is not None:
            raise ServoError(f"the servo ended: {self._explain_end(code)}")
        if over:
            raise RecordingError(f"the recording ended: {self.recorder_trouble}")

    @property
    def recorder_trouble(self) -> str:
        """Reason why the recording has ended; empty if there is no problem."""
        if self._recorder is None:
            return ""
        reason = self._shared.recorder_reason.read()[1]
        code = self._recorder.poll()
        if reason or not code:
            return reason or self._stall
        return (
            f"its process was killed ({_signal(code)})" if code < 0 else f"its process failed: {self._describe_end()}"
        )

    @property
    def recorder_counts(self) -> dict[str, int]:
        """Rows in the recording, and lost rows: see `report.count_recorded`."""
        return count_recorded(self._shared, over=self._recorder is not None and self._recorder.poll() is not None)

    @property
    def tracker_trouble(self) -> str:
        """Reason why the tracker's process has ended, in one clause; empty without a problem or such a process."""
        if self._tracker is None:
            return ""
        reason = self._shared.tracker_reason.read()[1]
        code = self._tracker.poll()
        if reason or not code:
            return reason
        return (
            f"the tracker's process was killed ({_signal(code)})" if code < 0 else f"it failed: {self._describe_end()}"
        )

    @property
    def ended_on_request(self) -> bool:
        """Whether the loop was requested to end, and has not failed before."""
        failed = self._shared.phase is Phase.FAILED or bool(self._hang)
        return bool(self._shared.words[Word.QUIT]) and not failed and self._servo.poll() in (None, 0)

    def end(self, interrupted: threading.Event) -> None:
        """End all processes: on request, else by force; at once by force when `interrupted`. May be called twice.

        The loop must have been requested to end before: see `Servo.end_loop`.
        """
        if self._end_sent:
            return
        self._end_sent = True
        for timeout, force in (
            (_END_TIMEOUT_S, self._servo.terminate), (_END_TIMEOUT_S / 2, self._servo.kill),
        ):  # fmt: skip
            if wait_for_end(self._servo, timeout):
                break
            force()
        else:
            wait_for_end(self._servo, _END_TIMEOUT_S)  # killed: soon, unless the kernel blocks it
        self._end_group()
        self.compiler.end()
        self._output.end()
        end_process(self._tracker, _END_TIMEOUT_S)
        if self._shared.words[Word.RECORDER] == Phase.STARTING:
            end_process(self._recorder, 0.0)  # there are no rows to store
        if self._recorder and not wait_for_end(self._recorder, _EXPLAIN_AFTER_S):
            show(_DRAINING.format(_DRAIN_TIMEOUT_S))
            interrupted.clear()
            end_process(self._recorder, _DRAIN_TIMEOUT_S, interrupted)
        self._ending.set()
        self._heart.join()
        self._black_box.finish()

    def _beat(self) -> None:
        raise_priority()  # on an overloaded computer an ordinary thread may be delayed by 0.5 s
        words = self._shared.words
        ticking, recording = StallTime(2 * _HEARTBEAT_INTERVAL_S), StallTime(2 * _HEARTBEAT_INTERVAL_S)
        while not self._ending.wait(_HEARTBEAT_INTERVAL_S):
            words[Word.HEARTBEAT] = monotonic_ns()
            self._signals.poll()
            # The program's main thread has ended, by an exception perhaps, without `close`; the interpreter waits for
            # other threads of the program, and this one would keep the coils on for as long.
            if self._in_main and not threading.main_thread().is_alive():  # safety: main-ended
                words[Word.QUIT] = 1
            self._black_box.collect()
            now = monotonic()
            self._watch_servo(now, ticking)
            still = recording.update(now, words[Word.RECORDER_LOOKS])
            writing = words[Word.RECORDER] == Phase.RUNNING
            self._stall = (
                _STALL.format(still) if writing and still > _RECORDER_TIMEOUT_S else ""
            )  # safety: recorder-stalled

    def _watch_servo(self, now: float, ticking: StallTime) -> None:
        """End a servo whose tick does not end, and measure its memory."""
        if not self.alive or self._end_sent:
            ticking.update(now, -1)
            return
        self.memory.update(now)
        still = ticking.update(now, self._shared.words[Word.TICKS])
        waited = self._starved.read()
        if still <= 2 * _HEARTBEAT_INTERVAL_S:
            self._waited_before = waited
        still -= min(waited - self._waited_before, _KILL_TIMEOUT_S)  # a starved servo does not hang
        if still > _KILL_TIMEOUT_S:
            world = self._shared.world_now()
            self._hang = _HANG.format(world, still)  # safety: world-hung
            self._servo.kill()
            self._end_group()
        elif still > _STUCK_TIMEOUT_S and not self._asked and hasattr(signal, "SIGUSR2"):
            self._servo.send_signal(signal.SIGUSR2)
        self._asked = still > _STUCK_TIMEOUT_S  # once: a second signal could interrupt the handling of the first

    def _end_group(self) -> None:
        """End the remaining processes of the servo's group: those that a world has started."""
        if not hasattr(os, "killpg"):  # Windows: they live on
            return
        with suppress(OSError):
            os.killpg(self._servo.pid, signal.SIGKILL)  # safety: world-children

    def _explain_end(self, code: int | None) -> str:
        reason = self._hang or self._shared.reason.read()[1]
        if reason or self._shared.phase is Phase.ENDED:
            return reason or "on command"
        if code is not None and code < 0:
            return f"its process was killed ({_signal(code)})"
        if text := self._describe_end():
            return text
        if self._shared.phase is Phase.RUNNING:
            return f"its process ended with code {code} during a run, as if a world had called os._exit"
        return f"its process failed with code {code}"

    def _describe_end(self) -> str:
        try:
            return self._errors.read_text(encoding="utf-8", errors="replace")[-2000:].strip()
        except OSError:
            return ""


def _signal(code: int) -> str:
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"
