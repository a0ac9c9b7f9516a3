"""Operating-system facilities of the loop: Linux's for real time, and what a simulated device uses on other systems.

A real device needs Linux: its scheduler, its timers and its signals switch the coils off in time. A simulated device
runs anywhere; only timing differs there.
"""

from __future__ import annotations

import ctypes
import errno
import faulthandler
import gc
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from subprocess import TimeoutExpired
from time import monotonic
from types import FrameType
from typing import Any, cast, final

from haptorb.child_process import environment, python_command
from haptorb.errors import PlatformError, ServoError

__all__ = [
    "END_SIGNALS",
    "WORKS_ANYWHERE",
    "AbsoluteSleep",
    "Facts",
    "KillTimer",
    "Termination",
    "TickTimeout",
    "claim",
    "describe_timing",
    "die_with_parent",
    "end_group",
    "end_process",
    "forbid_core_dumps",
    "hold_signals",
    "is_linux",
    "is_parent_gone",
    "is_running",
    "is_windows",
    "lower_priority",
    "lower_share",
    "prepare_thread",
    "raise_priority",
    "raise_termination",
    "repeat_signal",
    "request_exact_timers",
    "request_real_time",
    "require_linux",
    "run_uninterrupted",
    "send_beside",
    "start",
    "start_python",
    "wait_for_end",
]


WORKS_ANYWHERE = (
    "simulated devices, and `haptorb` run, feel, inspect, devices, worlds, keys, show, info, export, replay, view, "
    "check --world, design, reproduce, fit-multipole, train, estimators, guidance, study, calibrate and frame; in "
    "Python all but real drivers, trackers in a process of their own, and servers"
)  #: printed on other systems
_NAMES = {"darwin": "macOS", "win32": "Windows"}


def is_linux() -> bool:
    """Whether this is Linux: it has the timers, priorities and signals that a real-time loop needs."""
    return sys.platform.startswith("linux")


def require_linux(what: str, instead: str = WORKS_ANYWHERE) -> None:
    """Raise PlatformError, one line, if this is not Linux.

    `what` is the subject of the sentence; `instead` names what works on any system.
    """
    if not is_linux():
        system = _NAMES.get(sys.platform, sys.platform)
        raise PlatformError(f"{what} needs Linux, and this is {system}. Available here: {instead}")


def is_windows() -> bool:
    """Whether this is Windows: processes do not inherit descriptors there, and have no parent."""
    return sys.platform == "win32"


def describe_timing() -> str:
    """Describe the timing guarantees of this system in one line; empty on Linux, where the report states them."""
    if is_linux():
        return ""
    return (
        f"{_NAMES.get(sys.platform, sys.platform)} has no real-time scheduler for the loop: ticks may be late by "
        "milliseconds; the report states how many were on time. Real devices need Linux."
    )


# --------------------------------------------------------------------------------------------------
# One core for one servo: a process claims its core for as long as it runs, visible to all others on the computer.


_held: list[socket.socket] = []  # until the process ends


def claim(cores: Iterable[int]) -> int:
    """Claim the first of `cores` that no other servo has claimed; return it, or −1 if there is none.

    The claim is a name in the kernel's abstract socket namespace: no file, and released however the process ends.
    """
    for core in cores:
        mark = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            mark.bind(f"\0haptorb-servo-core-{core}")
        except OSError:
            mark.close()
            continue
        _held.append(mark)
        return core
    return -1


# --------------------------------------------------------------------------------------------------
# Real-time settings of a process; those that are not permitted are skipped and reported.
#
# Linux functions are loaded on use: programs without a loop import this module on other systems, too.


Facts = dict[str, str | bool | int]

_PR_SET_TIMERSLACK = 29
_CLOCK_MONOTONIC = 1
_TIMER_ABSTIME = 1
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_PRIORITY = 40  #: below the kernel's own interrupt threads (50)
_MAX_RT_TIME_US = 3_000_000  #: longest processor time under the real-time scheduler without a blocking call


@cache
def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def request_real_time(*, real_time: bool = True) -> Facts:
    """Request exact timers, a real-time scheduler and locked memory; return what was granted.

    Without a real-time scheduler the process is not bound to a core either: the kernel could then not migrate it from
    a busy one. Nor is it where other servos have claimed all cores: two real-time loops on one core delay each other.
    On other systems nothing is requested.
    """
    if not is_linux():
        cores = os.cpu_count() or 1
        return {
            "policy": "ordinary", "priority": 0, "memory_locked": False, "exact_timers": False, "core": -1,
            "cores": cores,
        }  # fmt: skip
    slack = request_exact_timers()
    fifo = real_time and _fifo(_PRIORITY)
    if fifo:
        # A process that computes this long without blocking is in an endless loop: the kernel kills it.
        import resource

        resource.setrlimit(resource.RLIMIT_RTTIME, (_MAX_RT_TIME_US, _MAX_RT_TIME_US))
    return {
        "policy": "SCHED_FIFO" if fifo else "SCHED_OTHER",
        "priority": _PRIORITY if fifo else 0,
        "memory_locked": _lock_memory(),
        "exact_timers": slack,
        "core": _bind() if fifo else -1,
        "cores": len(os.sched_getaffinity(0)) if not fifo else os.cpu_count() or 1,
    }


def request_exact_timers() -> bool:
    """Set the timer slack of this thread to its minimum; False if refused."""
    if not is_linux():
        return False
    # By default, timers may be up to 50 µs late so that wake-ups can be coalesced.
    return bool(_libc().prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0) == 0)


def raise_priority(number: int = 0) -> bool:
    """Raise the priority of this thread, or of the process `number`, above ordinary ones and below every loop.

    False if refused. For threads that sleep nearly always.
    """
    return _fifo(1, number)


def lower_priority() -> None:
    """Return this process to the ordinary scheduler."""
    if is_linux():
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def lower_share(by: int) -> None:
    """Give this process a smaller share of the processor, by `by` steps of nice, where the system has them."""
    if hasattr(os, "nice"):
        os.nice(by)


def _fifo(priority: int, number: int = 0) -> bool:
    if not is_linux():
        return False
    try:
        os.sched_setscheduler(number, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError:
        return False
    return True


def _lock_memory() -> bool:
    # With a finite limit, locking future pages would make later allocations fail: worse than a page fault.
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft != resource.RLIM_INFINITY and os.geteuid() != 0:
        return False
    # On fault: used pages stay in memory; the compiler's unused ones need not be loaded.
    return bool(_libc().mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) == 0)


def _bind() -> int:
    """Bind to the last allowed core that no other servo has claimed, except the first, which serves most interrupts.

    Return it; −1 if there is none: the kernel then chooses.
    """
    core = claim(sorted(os.sched_getaffinity(0))[:0:-1])
    if core < 0:
        return -1
    try:
        os.sched_setaffinity(0, {core})
    except OSError:
        return -1
    return core


# --------------------------------------------------------------------------------------------------
# Sleep until a time of the monotonic clock: it does not drift as sleeps of a duration do.


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


@final
class AbsoluteSleep:
    """Sleeps until a time of the monotonic clock, despite signals; on Linux only."""

    def __init__(self) -> None:
        self._nanosleep = ctypes.CDLL(None, use_errno=False).clock_nanosleep
        self._nanosleep.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
        self._nanosleep.restype = ctypes.c_int
        self._until = _Timespec()  # reused: no allocation per tick
        self._at = ctypes.addressof(self._until)

    def sleep(self, until: int) -> None:
        """Sleep until the monotonic time `until` [ns]."""
        self._until.seconds, self._until.nanoseconds = divmod(until, 1_000_000_000)
        while self._nanosleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, self._at, None) == errno.EINTR:
            pass


# --------------------------------------------------------------------------------------------------
# Kernel watchdog timer: kills this process unless it is set again in time, whatever runs inside it.
#
# No code of the process is involved: not its signal handlers, which Python runs only between two of its own
# instructions, and not a thread, which would wait for the interpreter's lock. SIGKILL can neither be caught, nor
# blocked, nor ignored, and the timer also runs while the process is stopped. A forked child does not inherit it.


_SIGEV_SIGNAL = 0


class _Event(ctypes.Structure):
    _fields_ = (
        ("value", ctypes.c_void_p), ("signal", ctypes.c_int), ("notify", ctypes.c_int), ("rest", ctypes.c_char * 48),
    )  # fmt: skip


class _Times(ctypes.Structure):
    _fields_ = (
        ("every_s", ctypes.c_long), ("every_ns", ctypes.c_long),
        ("first_s", ctypes.c_long), ("first_ns", ctypes.c_long),
    )  # fmt: skip


@final
class KillTimer:
    """Watchdog that ends this process by SIGKILL; started by the first `set`.

    Raises ServoError if the kernel has no such timers. On other systems a thread of C code, which needs no lock of the
    interpreter, ends the process instead.
    """

    def __init__(self) -> None:
        self._portable = not is_linux()
        if self._portable:
            self._nowhere = os.open(os.devnull, os.O_WRONLY)  # for the life of the process
            return
        libc = ctypes.CDLL(None, use_errno=True)
        if not hasattr(libc, "timer_create"):
            libc = ctypes.CDLL("librt.so.1", use_errno=True)  # where it was before glibc 2.34
        self._timer = ctypes.c_void_p()
        event = _Event(signal=int(signal.SIGKILL), notify=_SIGEV_SIGNAL)  # safety: servo-hung
        if libc.timer_create(_CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(self._timer)):
            why = os.strerror(ctypes.get_errno())
            raise ServoError(f"the kernel provides no timer to end a servo that hangs: timer_create failed ({why})")
        self._settime = libc.timer_settime
        self._settime.argtypes = (ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
        self._times = _Times()  # reused: no allocation per tick
        self._at = ctypes.addressof(self._times)

    def set(self, seconds: float) -> None:
        """Start or restart the timer: the process is killed `seconds` from now unless this is called again before."""
        if self._portable:
            faulthandler.dump_traceback_later(seconds, exit=True, file=self._nowhere)
            return
        self._times.first_s, self._times.first_ns = divmod(int(seconds * 1e9), 1_000_000_000)
        self._settime(self._timer, 0, self._at, None)


# --------------------------------------------------------------------------------------------------
# Parent death: a process that drives coils must not outlive the one that started it.


_PR_SET_PDEATHSIG = 1


def die_with_parent(number: signal.Signals | None = None) -> None:
    """Have the kernel send the signal `number` when the parent ends; None: SIGKILL.

    The kernel sends it when the *thread* ends that started this process. Processes are therefore started by a thread
    that lives as long as its program (`starter`); with another signal, check `is_parent_gone` as well. On other systems
    nothing is sent: there a process ends when it finds that its parent has.
    """
    if not is_linux():
        return
    _libc().prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL if number is None else number), 0, 0, 0)


def is_parent_gone(parent: int) -> bool:
    """Whether the process `parent`, which started this one, has ended."""
    return not is_running(parent) if is_windows() else os.getppid() != parent


def is_running(pid: int) -> bool:
    """Whether a process `pid` runs, on any system; one that has ended and was not waited for still counts elsewhere
    than on Windows."""
    if is_windows():
        return _runs_on_windows(pid)
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _runs_on_windows(pid: int) -> bool:
    synchronize, timed_out = 0x00100000, 0x102  # SYNCHRONIZE, WAIT_TIMEOUT
    kernel: Any = ctypes.CDLL("kernel32")
    kernel.OpenProcess.restype = ctypes.c_void_p
    kernel.OpenProcess.argtypes = (ctypes.c_uint32, ctypes.c_int, ctypes.c_uint32)
    kernel.WaitForSingleObject.argtypes = (ctypes.c_void_p, ctypes.c_uint32)
    kernel.CloseHandle.argtypes = (ctypes.c_void_p,)
    handle = kernel.OpenProcess(synchronize, 0, pid)
    if not handle:
        return False
    try:
        return bool(kernel.WaitForSingleObject(handle, 0) == timed_out)
    finally:
        kernel.CloseHandle(handle)


def end_group(leader: int) -> None:
    """Kill all processes of the group of `leader`, except the calling one; only Linux lists them."""
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, ValueError):
            group = int((folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()[2])
            if group == leader and (number := int(folder.name)) != os.getpid():
                os.kill(number, signal.SIGKILL)


# --------------------------------------------------------------------------------------------------
# Settings for programs that communicate with a firmware from an ordinary process: no delay of 15 ms or more.


_SWITCH_INTERVAL_S = 1e-4  #: longest time for which a thread holds the interpreter lock when another waits


def prepare_thread() -> bool:
    """Raise this thread's priority, and exclude all existing objects from garbage collection; False if refused.

    With all of the package loaded a full collection takes 40 ms, and a firmware switches its coils off after 15 ms of
    silence. Objects created from now on are still collected. A thread that draws a progress bar releases the
    interpreter after 0.1 ms: with Python's default of 5 ms at every reading, three in a row would exceed that limit.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()
    return raise_priority()


# --------------------------------------------------------------------------------------------------
# Starter thread: lives as long as the program, and starts its processes.
#
# The kernel sends the parent-death signal when the thread ends that started the process. A process that is started by
# this thread is therefore killed when the program ends, not when one of its other threads does.


_POLL_INTERVAL_S = 0.05  #: between two checks for an interruption
_CREATE_NEW_PROCESS_GROUP = 0x200  #: of Windows
_KILL_TIMEOUT_S = 2.0  #: for a killed process to end; the kernel may block one that waits for a disk

Job = tuple[Sequence[str], dict[str, Any], "Future[subprocess.Popen[bytes]]"]

_jobs: queue.SimpleQueue[Job] | None = None
_making = threading.Lock()


def start(command: Sequence[str], **options: Any) -> subprocess.Popen[bytes]:
    """Start a process in the starter thread, with the `options` of `subprocess.Popen`.

    If the caller is interrupted meanwhile, the process is killed.
    """
    future: Future[subprocess.Popen[bytes]] = Future()
    _queue().put((command, options, future))
    try:
        return future.result()
    except BaseException:
        future.add_done_callback(_kill)
        raise


def start_python(module: str, *arguments: str, isolated: bool = False, **options: Any) -> subprocess.Popen[bytes]:
    """Start `python -m module arguments` in a new session, with the `options` of `subprocess.Popen`; see
    `python_command` for what it can import.

    Ctrl-C in the terminal then reaches only the parent, which ends its children in order.
    """
    command = python_command(module, *arguments, isolated=isolated)
    # On Windows a process has no session, but a group.
    apart = {"creationflags": _CREATE_NEW_PROCESS_GROUP} if os.name == "nt" else {"start_new_session": True}
    return start(command, **{**apart, "env": environment(), **options})


def send_beside(process: subprocess.Popen[bytes], content: bytes, *, close: bool = True) -> threading.Thread:
    """Write `content` to the standard input of `process`, and close it unless told otherwise: in the thread that is
    returned, so that a process that does not read blocks nobody. If it has ended already, whoever watches it reports
    why."""
    stdin = process.stdin
    assert stdin is not None

    def send() -> None:
        with suppress(OSError, ValueError):  # ValueError: closed by who ended it
            stdin.write(content)
            stdin.close() if close else stdin.flush()

    sender = threading.Thread(target=send, name="haptorb-start", daemon=True)
    sender.start()
    return sender


def wait_for_end(process: subprocess.Popen[bytes], timeout: float, interrupted: threading.Event | None = None) -> bool:
    """Wait for the end of `process`; False if it has not ended within `timeout` [s], or when `interrupted`."""
    end = monotonic() + timeout
    while True:
        left = end - monotonic()
        try:
            process.wait(max(left if interrupted is None else min(left, _POLL_INTERVAL_S), 0.0))
            return True
        except TimeoutExpired:
            if left <= 0.0 or (interrupted is not None and interrupted.is_set()):
                return False


def end_process(
    process: subprocess.Popen[bytes] | None, timeout: float, interrupted: threading.Event | None = None
) -> bool:
    """Wait for `process`, if there is one, for `timeout` [s], then kill it; return whether it has ended.

    One that the kernel blocks, as on a disk that does not respond, cannot be killed and is not waited for.
    """
    if process is None or wait_for_end(process, timeout, interrupted):
        return True
    process.kill()
    return wait_for_end(process, _KILL_TIMEOUT_S)


def _queue() -> queue.SimpleQueue[Job]:
    global _jobs
    with _making:
        if _jobs is None:
            _jobs = queue.SimpleQueue()
            # A daemon thread: it ends only with the process.
            threading.Thread(target=_work, args=(_jobs,), name="haptorb-starter", daemon=True).start()
        return _jobs


def _work(jobs: queue.SimpleQueue[Job]) -> None:
    while True:
        command, options, future = jobs.get()
        try:
            process = cast("subprocess.Popen[bytes]", subprocess.Popen(command, **options))
            future.set_result(process)
        except BaseException as cause:
            future.set_exception(cause)
        del future  # so that only the caller has a reference to the process


def _kill(future: Future[subprocess.Popen[bytes]]) -> None:
    if future.exception() is None:
        process = future.result()
        process.kill()
        process.wait()


def _reset_after_fork() -> None:
    """Reset in a forked child, which has none of its parent's threads."""
    global _jobs, _making
    _jobs, _making = None, threading.Lock()


if hasattr(os, "register_at_fork"):  # elsewhere nothing forks
    os.register_at_fork(after_in_child=_reset_after_fork)


# --------------------------------------------------------------------------------------------------
# Timeout of a tick.


class TickTimeout(BaseException):
    """Raised by a signal's handler inside a tick that takes too long.

    Not an `Exception`: user code that continues after any exception would catch it, and hang again in the next tick.
    """


# --------------------------------------------------------------------------------------------------
# Termination signals: SIGINT (Ctrl-C), SIGTERM, SIGHUP of a closed terminal, and SIGQUIT (Ctrl-\).


END_SIGNALS = (
    signal.SIGINT, signal.SIGTERM, *((signal.SIGHUP, signal.SIGQUIT) if hasattr(signal, "SIGHUP") else ())
)  # fmt: skip


def forbid_core_dumps() -> None:
    """Let this process die at once of a crash: while its memory is dumped, seconds, nobody learns that it is dead."""
    with suppress(ImportError, OSError, ValueError):  # Windows has no such limit; the system may permit none
        import resource

        # 1, not 0: less than any dump, and the only limit that also forbids dumps into a program (core(5)).
        resource.setrlimit(resource.RLIMIT_CORE, (1, resource.getrlimit(resource.RLIMIT_CORE)[1]))


@final
class Termination(BaseException):
    """Raised for END_SIGNALS but SIGINT, as KeyboardInterrupt is for that: `with` blocks switch the coils off."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextmanager
def raise_termination() -> Iterator[None]:
    """Context in which SIGTERM, SIGHUP and SIGQUIT raise Termination, so that open resources are closed.

    An ignored signal (`nohup`) stays ignored. Main thread only; elsewhere it has no effect.
    """

    with _handle(dict.fromkeys(END_SIGNALS[1:], _terminate)):
        yield


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Termination(number)


def repeat_signal(number: int) -> None:
    """Raise the signal again, if its handler raises KeyboardInterrupt or Termination.

    For one that had no effect: Python drops exceptions that are raised within a finalizer.
    """
    if signal.getsignal(number) in (signal.default_int_handler, _terminate):
        signal.raise_signal(number)


@contextmanager
def hold_signals() -> Iterator[threading.Event]:
    """Context that defers termination signals during cleanup: a signal sets the event, and is raised afterwards.

    Main thread only; elsewhere it has no effect.
    """
    held: list[int] = []
    event = threading.Event()

    def hold(number: int, frame: FrameType | None) -> None:
        held.append(number)
        event.set()

    with _handle(dict.fromkeys(END_SIGNALS, hold)):
        yield event
    if held:
        signal.raise_signal(held[0])


def run_uninterrupted(act: Callable[[threading.Event], None]) -> None:
    """Run `act` to its end under `hold_signals`, with its event as the argument.

    A signal just before the deferral begins is raised afterwards, too. Main thread only; elsewhere `act` is just run.
    """
    early: BaseException | None = None
    held = False
    while not held:
        try:
            with hold_signals() as event:
                held = True
                if early is not None:
                    event.set()
                act(event)
        except BaseException as cause:
            if held:  # its own exception, or that of the deferred signal
                raise
            early = cause
    if early is not None:
        raise early


@contextmanager
def _handle(handlers: dict[signal.Signals, object]) -> Iterator[None]:
    before: dict[signal.Signals, object] = {}
    late: BaseException | None = None
    try:
        if threading.current_thread() is threading.main_thread():
            for number, handler in handlers.items():
                if (now := signal.getsignal(number)) not in (signal.SIG_IGN, None):  # None: not Python's
                    before[number] = now
                    signal.signal(number, handler)  # type: ignore[arg-type]
        yield
    finally:
        while before:
            try:
                for number in list(before):
                    signal.signal(number, before[number])  # type: ignore[arg-type]
                    del before[number]
            except BaseException as cause:  # raised by a handler that was restored already
                late = cause
        if late is not None:
            raise late
