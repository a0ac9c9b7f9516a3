"""Servo processes that a test starts in a tenth of a second instead of one: copies of a process that has loaded what
all of them load.

`ForkServer` starts this file as a process of its own, which loads the packages once and copies itself for every
`python -m haptorb...`. A copy is a child of the test's process, as one that was started, and runs the module from its
first line. What a start itself does is tested where nothing is copied: tests/runtime, and every program that
tests run.
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
import threading
import time
from collections.abc import Sequence
from importlib import import_module
from typing import Any, final

PACKAGE = "haptorb"
PROCESSES = tuple(f"{PACKAGE}.runtime.{name}_process" for name in ("servo", "recorder", "trackers.tracker"))
DEVICES = ("omni", "pmsm")
_PR_SET_CHILD_SUBREAPER = 36
_FREE = 1000  #: above all numbers of descriptors that a process is to have


def _adopt_orphans(on: bool) -> None:
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, int(on), 0, 0, 0)


@final
class ForkServer:
    """Starts processes in place of `subprocess.Popen`; the first of them starts the process that is copied."""

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._server: subprocess.Popen[bytes] | None = None
        self._connection, self._other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    def start(self, command: Sequence[str], **options: Any) -> subprocess.Popen[bytes]:
        """As `subprocess.Popen(command, **options)`; a copy if the command is a module of the package."""
        if list(command[:3]) == [sys.executable, "-P", "-m"] and command[3].startswith(PACKAGE):
            return _ForkedProcess(self, command, **options)
        return subprocess.Popen(command, **options)

    def fork(self, wanted: dict[str, Any], descriptors: list[int]) -> int:
        """The id of a copy that becomes what is `wanted`. It is this process's child once its parent has ended, as long
        as this process adopts orphans."""
        with self._turn:
            if self._server is None:
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


class _ForkedProcess(subprocess.Popen[bytes]):
    """A process that was not executed but copied."""

    def __init__(self, server: ForkServer, command: Sequence[str], **options: Any) -> None:
        self._fork_server = server
        super().__init__(command, **options)

    def _execute_child(self, *values: Any) -> None:
        """What `Popen` does after it has made the pipes."""
        bound = inspect.signature(subprocess.Popen._execute_child).bind(self, *values)  # type: ignore[attr-defined]
        given = bound.arguments
        pipes = {"p2cread": 0, "c2pwrite": 1, "errwrite": 2}
        numbers = {given[end]: number for end, number in pipes.items() if given[end] >= 0}
        wanted = {
            "words": list(given["args"])[3:], "environment": dict(given["env"] or os.environ), "folder": os.getcwd(),
            "numbers": [*numbers.values(), *given["pass_fds"]], "session": given["start_new_session"],
        }  # fmt: skip
        self.pid = self._fork_server.fork(wanted, [*numbers, *given["pass_fds"]])
        self._child_created = True
        ends = ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite")
        self._close_pipe_fds(*(given[end] for end in ends))  # type: ignore[attr-defined]


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
    """This process is `python -m` with the wanted words from here on."""
    if wanted["session"]:
        os.setsid()
    os.chdir(wanted["folder"])
    os.environ.clear()
    os.environ.update(wanted["environment"])
    module, *arguments = wanted["words"]
    sys.argv = [module, *arguments]
    sys.path[0] = wanted["folder"]
    sys.modules.pop(module, None)
    runpy.run_module(module, run_name="__main__", alter_sys=True)


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
    for name in PROCESSES:
        import_module(name)
    load_devices()
    gc.collect()
    gc.freeze()
    if (request := wait_for_requests(socket.socket(fileno=int(sys.argv[1])))) is not None:
        become(request)
