"""Servo processes, and programs with a servo, that a test starts in a tenth of a second instead of one or three: copies
of a process that has loaded what all of them load.

`ForkServer` starts this file as a process of its own, which loads the packages once and copies itself for every
`python -m haptorb...`. A copy is a child of the test's process, as one that was started, and runs the module from its
first line. `start_program` copies it for a program, whose own processes are copies as well: the program has a process
like this one; at night (`LONG`) it starts the program itself, in the usual way, so that each of these tests also sees a
program that has loaded nothing before. What a start does is tested where nothing is copied, in every suite:
tests/runtime/test_first_start.py, two ends in tests/runtime/test_safety.py, the newcomers' tests, and what
documentation and examples run.
"""

from __future__ import annotations

import ctypes
import fcntl
import gc
import inspect
import json
import os
import runpy
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, final

PACKAGE = "haptorb"
PROCESSES = tuple(f"{PACKAGE}.runtime.{name}_process" for name in ("servo", "recorder", "trackers.tracker"))
#: what programs load: commands, servers, pages
PROGRAMS = ("cli.program", "cli.run", "serve.server_process", "web.console", "web.force_map_process")
DEVICES = ("omni", "pmsm")
HAPTORB = "import sys; from haptorb.cli import main; sys.exit(main())"
_PR_SET_CHILD_SUBREAPER = 36
_FREE = 1000  #: above all numbers of descriptors that a process is to have


def _adopt_orphans(on: bool) -> None:
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, int(on), 0, 0, 0)


def find_module(command: Sequence[str]) -> list[str]:
    """Module and arguments of a command of haptorb.child_process.python_command; empty if it is another one."""
    from haptorb.child_process import _ISOLATED

    words = list(command)
    if words[:3] == [sys.executable, "-P", "-m"]:
        words = words[3:]
    elif words[:4] == [sys.executable, "-I", "-c", _ISOLATED]:
        words = words[6:]
    else:
        return []
    return words if words[0].startswith(PACKAGE) else []


@final
class ForkServer:
    """Starts processes in place of `subprocess.Popen`; the first of them starts the process that is copied."""

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._server: subprocess.Popen[bytes] | None = None
        self._connection, self._other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    @classmethod
    def of_this_process(cls) -> ForkServer:
        """A server that copies what this process is now."""
        server = cls()
        if os.fork() == 0:
            server._connection.close()
            os.setsid()
            if (wanted := wait_for_requests(server._other)) is None:
                os._exit(0)
            become(wanted)
            raise SystemExit
        server._other.close()
        return server

    def start(self, command: Sequence[str], **options: Any) -> subprocess.Popen[Any]:
        """As `subprocess.Popen(command, **options)`; a copy if the command is a module of the package."""
        if words := find_module(command):
            return _ForkedProcess(self, {"module": words}, command, **options)
        return subprocess.Popen(command, **options)

    def start_program(self, *words: str, **options: Any) -> subprocess.Popen[Any]:
        """As `subprocess.Popen([sys.executable, *words], **options)`, a copy; `words`: `-c CODE ...`, `-m MODULE ...`
        or `FILE ...`. Its import path is that of this process, its session one of its own; no copy at night."""
        from oracles.repetitions import LONG  # here, as this file is a program as well

        options.setdefault("start_new_session", True)
        if LONG:
            return subprocess.Popen([sys.executable, *words], **options)
        return _ForkedProcess(self, {"program": words}, [sys.executable, *words], **options)

    def start_haptorb(self, *words: str, **options: Any) -> subprocess.Popen[Any]:
        """The command `haptorb` with these words."""
        return self.start_program("-c", HAPTORB, *words, **options)

    def run_program(self, *words: str, timeout: float = 60.0, **options: Any) -> subprocess.CompletedProcess[str]:
        """As `subprocess.run([sys.executable, *words], capture_output=True, text=True, timeout=timeout, **options)`, a
        copy."""
        pipes = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
        with self.start_program(*words, text=True, **pipes, **options) as process:
            try:
                out, errors = process.communicate(timeout=timeout)
            except BaseException:
                process.kill()
                raise
        return subprocess.CompletedProcess(process.args, process.returncode, out, errors)

    def fork(self, wanted: dict[str, Any], descriptors: list[int]) -> int:
        """The id of a copy that becomes what is `wanted`. It is this process's child once its parent has ended, as long
        as this process adopts orphans."""
        with self._turn:
            if self._server is None and self._other.fileno() >= 0:
                self._server = subprocess.Popen(
                    [sys.executable, __file__, str(self._other.fileno())], pass_fds=[self._other.fileno()],
                    start_new_session=True, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
                )  # fmt: skip
                self._other.close()
            _adopt_orphans(True)
            try:
                message = json.dumps(wanted | {"parent": os.getpid()}).encode()
                socket.send_fds(self._connection, [message], descriptors)
                return int(self._connection.recv(64))
            finally:
                _adopt_orphans(False)

    def close(self) -> None:
        """End the process that is copied; its copies go on."""
        self._connection.close()
        self._other.close()
        if self._server is not None:
            self._server.wait()


@cache
def get_fork_server() -> ForkServer:
    """That of this process."""
    return ForkServer()


class _ForkedProcess(subprocess.Popen[Any]):
    """A process that was not executed but copied."""

    def __init__(self, server: ForkServer, what: dict[str, Any], command: Sequence[str], **options: Any) -> None:
        self._fork_server, self._what = server, what
        super().__init__(command, **options)

    def _execute_child(self, *values: Any) -> None:
        """What `Popen` does after it has made the pipes."""
        bound = inspect.signature(subprocess.Popen._execute_child).bind(self, *values)  # type: ignore[attr-defined]
        given = bound.arguments
        ends = [(given[end], number) for number, end in enumerate(("p2cread", "c2pwrite", "errwrite"))]
        ends = [*((end, number) for end, number in ends if end >= 0), *((one, one) for one in given["pass_fds"])]
        wanted = {
            **self._what, "environment": dict(given["env"] or os.environ), "folder": str(given["cwd"] or os.getcwd()),
            "numbers": [number for _, number in ends], "session": given["start_new_session"],
        }  # fmt: skip
        self.pid = self._fork_server.fork(wanted, [end for end, _ in ends])
        self._child_created = True
        pipes = ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite")
        self._close_pipe_fds(*(given[end] for end in pipes))  # type: ignore[attr-defined]


def wait_for_requests(connection: socket.socket) -> dict[str, Any] | None:
    """Copy this process for every request; the copy gets what is wanted, the original None at the end."""
    while True:
        message, descriptors, *_ = socket.recv_fds(connection, 1 << 20, 64)
        if not message:
            return None
        if (between := os.fork()) == 0:
            if os.fork():
                os._exit(0)  # so the copy is an orphan, and the test's process adopts it
            wanted: dict[str, Any] = json.loads(message)
            while os.getppid() != wanted["parent"]:
                time.sleep(1e-4)
            connection.send(str(os.getpid()).encode())
            connection.close()
            for number, descriptor in zip(wanted["numbers"], _move_away(descriptors), strict=True):
                os.dup2(descriptor, number)
                os.close(descriptor)
            return wanted
        for descriptor in descriptors:
            os.close(descriptor)
        os.waitpid(between, 0)


def _move_away(descriptors: list[int]) -> list[int]:
    """The same descriptors with numbers that none is to have in the end."""
    moved = [fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, _FREE) for descriptor in descriptors]
    for descriptor in descriptors:
        os.close(descriptor)
    return moved


def become(wanted: dict[str, Any]) -> None:
    """This process is `python -m` with the wanted words, or the wanted program, from here on."""
    if wanted["session"]:
        os.setsid()
    os.chdir(wanted["folder"])
    os.environ.clear()
    os.environ.update(wanted["environment"])
    tempfile.tempdir = None
    if "program" in wanted:
        become_program(wanted["program"])
        return
    module, *arguments = wanted["module"]
    sys.argv = [module, *arguments]
    sys.path[0] = wanted["folder"]
    sys.modules.pop(module, None)
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def become_program(words: list[str]) -> None:
    """This process is `python` with these words, and starts copies of itself in place of servo processes."""
    from haptorb.runtime import linux

    # What it says goes through its own pipes, with their buffers.
    sys.stdin = open(0, closefd=False)  # noqa: SIM115
    sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, errors="backslashreplace", closefd=False)  # noqa: SIM115
    linux.subprocess = SimpleNamespace(Popen=ForkServer.of_this_process().start)  # type: ignore[assignment]
    if words[0] == "-m":
        sys.argv, sys.path[0] = words[1:], os.getcwd()
        sys.modules.pop(words[1], None)
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
        return
    sys.modules["__main__"] = main = ModuleType("__main__")
    if words[0] == "-c":
        sys.argv, sys.path[0] = ["-c", *words[2:]], ""
        exec(compile(words[1], "<string>", "exec"), main.__dict__)
    else:
        sys.argv, sys.path[0], main.__file__ = words, str(Path(words[0]).parent), words[0]
        exec(compile(Path(words[0]).read_text(encoding="utf-8"), words[0], "exec"), main.__dict__)


def load_devices() -> None:
    """Load the code of both devices, and of all worlds, as far as it is compiled: some ticks of each, as a start has
    them."""
    from haptorb import worlds
    from haptorb.runtime.pointer import PointerTracker
    from haptorb.runtime.servo import Servo
    from haptorb.runtime.warm_up import find_uncompiled

    for device in DEVICES:
        servo = Servo(device, record=False)
        chain, row = servo._make_plan().practice(PointerTracker()), servo.layout.empty()
        with chain.driver:
            for tick in range(10):
                chain.prepare(1e-3 * tick)
                chain.step(row, 1e-3 * tick)
            for kind in worlds.CATALOGUE.values():
                find_uncompiled(chain, kind(), row, 0.01)


if __name__ == "__main__":
    for name in (*PROCESSES, *(f"{PACKAGE}.{name}" for name in PROGRAMS)):
        import_module(name)
    load_devices()
    gc.collect()
    gc.freeze()
    if (request := wait_for_requests(socket.socket(fileno=int(sys.argv[1])))) is not None:
        become(request)
