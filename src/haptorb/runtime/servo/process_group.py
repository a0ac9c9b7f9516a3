"""The processes of servo, recorder and tracker, seen from their parent: start, monitor, send heartbeats, end.

The parent checks every 20 ms, and copies the ticks before a trip. A servo that has ended is detected within a tenth
of a second. A servo whose tick does not end gets a signal after a second; the code in the tick can ignore it, and
half a second later the process is killed. A stalled recorder is reported, and the loop continues.
"""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from contextlib import suppress
from time import monotonic, monotonic_ns, sleep
from typing import final

from haptorb.errors import DriverError, RecordingError, ServoError
from haptorb.runtime.exchange.black_box import BlackBox
from haptorb.runtime.exchange.report import count_recorded
from haptorb.runtime.exchange.shared_memory import Phase, SharedMemory, Word
from haptorb.runtime.processes.prestart import PrestartedProcess, start_module
from haptorb.runtime.realtime.host_heartbeat import state_of
from haptorb.runtime.realtime.kernel_requests import raise_priority
from haptorb.runtime.realtime.memory_growth import MemoryGrowth
from haptorb.runtime.realtime.process_starter import end_process, wait_for_end
from haptorb.runtime.realtime.stall_time import HangWatch, StallTime
from haptorb.runtime.servo.compiler_process import CompilerProcess
from haptorb.runtime.servo.output_reader import OutputReader, show
from haptorb.runtime.servo.signal_stop import SignalStop

__all__ = ["ProcessGroup"]

_EVERY = 0.02  #: between two heartbeats [s]
_STUCK = 1.0  #: without a tick the servo is notified that it is stuck [s]
_HUNG = 1.5  #: and so long without one it is killed [s]
_STALLED = 1.0  #: without a look for rows the recorder counts as stalled [s]
_START = 180.0  #: the first start on a machine compiles the kernels [s]
_FIRST_CALL = 20.0  #: a world that compiles code of its own may take long, once [s]
_NOTHING = 4.0  #: without processor time, after which a process that starts hangs [s]
_FINISH = 1.5  #: to end on request before a signal is sent [s]
_DRAIN = 20.0  #: for the recorder to write what it has [s]
_SOON = 2.0  #: of that, before a person is told why it takes long [s]
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
    """Starts the servo in `standby`, whose plan is written; `record` and `track` may add others, then
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
        self._asked = False  # whether the servo was notified that it is stuck
        self.memory = MemoryGrowth(standby.process.pid)
        standby.give(shared.path)
        self._output = OutputReader(standby.process.stdout)
        self._recorder: subprocess.Popen[bytes] | None = None
        self._tracker: subprocess.Popen[bytes] | None = None
        self.compiler = CompilerProcess(standby.folder, shared, standby.errors)
        # Not the thread that may be blocked by a user's code: it has nothing else to do.
        self._heart = threading.Thread(target=self._beat, name="haptorb-heartbeat", daemon=True)
        self._heart.start()

    @property
    def servo_pid(self) -> int:
        """Process id of the servo."""
        return self._servo.pid

    @property
    def recorder_pid(self) -> int:
        """Process id of the recorder; 0 if there is none."""
        return self._recorder.pid if self._recorder else 0

    @property
    def alive(self) -> bool:
        """Whether the loop runs: the process exists and has neither ended nor failed."""
        return self._shared.phase is Phase.RUNNING and self._servo.poll() is None

    def record(self, spec: str, descriptor: int) -> None:
        """Start the recorder with `spec` (JSON), which a command line could be too short for, and the open file
        `descriptor`."""
        path = self._errors.with_name("recorder.json")
        path.write_text(spec, encoding="utf-8")
        with path.open("rb") as file:
            self._recorder = start_module(
                "haptorb.runtime.processes.recorder_process",
                errors=self._errors, stdin=file.fileno(), descriptor=descriptor, isolated=True,
            )  # fmt: skip

    def track(self, spec: str, descriptor: int | None) -> None:
        """Start the tracker's process with `spec` (JSON) and its open socket `descriptor`, if it has one."""
        # safety: secret-by-pipe
        self._tracker = start_module(
            "haptorb.runtime.processes.tracker_process",
            errors=self._errors, stdin=subprocess.PIPE, descriptor=descriptor, isolated=True,
        )  # fmt: skip
        assert self._tracker.stdin is not None
        # A token is in it: no argument, which every account of this computer can read.
        with suppress(BrokenPipeError), self._tracker.stdin as stdin:  # ended already: `check` reports why
            stdin.write(spec.encode())

    def wait_until_running(self) -> None:
        """Return when the loop has ticked, and recorder and tracker are ready. Raises ServoError, RecordingError or
        DriverError otherwise."""
        try:
            self._wait()
        finally:
            self.compiler.finish_start(running=self.alive)
        self.check()

    def _wait(self) -> None:
        start = monotonic()
        words = self._shared.words
        # A tracker may wait for its sender, a servo for its device: they hang only if they are stopped.
        group = {"servo": self._servo, "recorder": self._recorder, "tracker": self._tracker}
        watches = [(name, one, HangWatch(one.pid)) for name, one in group.items() if one is not None]
        while (
            not (self.alive and words[Word.TICKS])
            or (self._recorder and words[Word.RECORDER] == Phase.STARTING)
            or (self._tracker and words[Word.TRACKER] == Phase.STARTING)
        ):
            self.check()
            if trouble := self.tracker_trouble:
                raise DriverError(trouble)
            if (first := words[Word.FIRST_CALL]) and monotonic_ns() - first > 1e9 * _FIRST_CALL:
                raise ServoError(_ENDLESS.format(self._shared.world_now(), _FIRST_CALL))
            if monotonic() > start + _START:
                raise ServoError(f"the servo did not start within {_START:g} s; close other programs, and try again")
            for name, process, watch in watches:
                hangs = watch.look() > _NOTHING  # safety: start-hangs
                if hangs and (name == "recorder" or state_of(process.pid)() == "T"):
                    raise (RecordingError if name == "recorder" else ServoError)(_HUNG_START.format(name, _NOTHING))
            self.compiler.help_start()
            sleep(0.005)

    def check(self) -> None:
        """Raise ServoError if the servo ended, RecordingError if the recorder did."""
        # Looked at first: the servo's end is the recorder's, too.
        recorder = self._recorder
        over = recorder and (self._shared.words[Word.RECORDER] >= Phase.ENDED or recorder.poll() is not None)
        code = self._servo.poll()
        if self._shared.phase >= Phase.ENDED or code is not None:
            raise ServoError(f"the servo ended: {self._explain_end(code)}")
        if over:
            raise RecordingError(f"the recording ended: {self.recorder_trouble}")

    @property
    def recorder_trouble(self) -> str:
        """Why the recording has ended; empty if there is no problem."""
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
        """Why there are no more poses, in one clause; empty if there is no problem or no such process."""
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
        """Whether the loop was asked to end, and has not failed before it did."""
        failed = self._shared.phase is Phase.FAILED or bool(self._hang)
        return bool(self._shared.words[Word.QUIT]) and not failed and self._servo.poll() in (None, 0)

    def end(self, interrupted: threading.Event) -> None:
        """End all processes: by request, else by force; at once by force when `interrupted` while this takes long. May
        be called twice. The loop was asked to end before: see `Servo.end_loop`."""
        if self._end_sent:
            return
        self._end_sent = True
        for patience, force in ((_FINISH, signal.SIGTERM), (_FINISH / 2, signal.SIGKILL)):
            if wait_for_end(self._servo, patience):
                break
            self._servo.send_signal(force)
        self._end_group()
        self.compiler.end()
        self._output.end()
        end_process(self._tracker, _FINISH)
        if self._shared.words[Word.RECORDER] == Phase.STARTING:
            end_process(self._recorder, 0.0)  # there are no rows to be kept
        if self._recorder and not wait_for_end(self._recorder, _SOON):
            show(_DRAINING.format(_DRAIN))
            interrupted.clear()
            end_process(self._recorder, _DRAIN, interrupted)
        self._ending.set()
        self._heart.join()
        self._black_box.finish()

    def _beat(self) -> None:
        raise_priority()  # on an overloaded computer half a second may pass before an ordinary thread has its turn
        words = self._shared.words
        ticking, recording = StallTime(2 * _EVERY), StallTime(2 * _EVERY)
        while not self._ending.wait(_EVERY):
            words[Word.HEARTBEAT] = monotonic_ns()
            self._signals.look()
            self._black_box.look()
            now = monotonic()
            self._watch_servo(now, ticking)
            still = recording.look(now, words[Word.RECORDER_LOOKS])
            writing = words[Word.RECORDER] == Phase.RUNNING
            self._stall = _STALL.format(still) if writing and still > _STALLED else ""  # safety: recorder-stalled

    def _watch_servo(self, now: float, ticking: StallTime) -> None:
        """End a servo whose tick does not end, and look how much memory it takes."""
        if not self.alive or self._end_sent:
            ticking.look(now, -1)
            return
        self.memory.look(now)
        still = ticking.look(now, self._shared.words[Word.TICKS])
        if still > _HUNG:
            world = self._shared.world_now()
            self._hang = _HANG.format(world, still)  # safety: world-hung
            self._servo.kill()
            self._end_group()
        elif still > _STUCK and not self._asked:
            self._servo.send_signal(signal.SIGUSR2)
        self._asked = still > _STUCK  # once: a second one could meet what the first one has begun

    def _end_group(self) -> None:
        """End what the servo's process left behind in its group: what a world has started."""
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
            return self._errors.read_text(errors="replace")[-2000:].strip()
        except OSError:
            return ""


def _signal(code: int) -> str:
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"
