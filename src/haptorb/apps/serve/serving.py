"""The servers of a run as the program holds them that runs the servo: prepare, start, watch, end."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from time import monotonic, sleep
from types import TracebackType
from typing import Any, Self, final

from haptorb.apps.serve.preparation import ServerPreparation
from haptorb.apps.serve.server_choice import ServerChoice
from haptorb.apps.serve.server_kinds import load_kind
from haptorb.errors import DriverError, HaptorbError
from haptorb.runtime.exchange.plan import pack
from haptorb.runtime.exchange.shared_memory import Phase, SharedMemory, Word
from haptorb.runtime.memory.text_slot import TextSlot
from haptorb.runtime.processes.prestart import start_module
from haptorb.runtime.realtime.end_signals import hold_signals
from haptorb.runtime.realtime.process_starter import end_process
from haptorb.runtime.realtime.stall_time import HangWatch
from haptorb.runtime.servo.output_reader import show
from haptorb.runtime.servo.servo import Servo
from haptorb.version import __version__

__all__ = ["Serving"]

_START = 30.0  #: longest wait for a server's process [s]
_HUNG = 4.0  #: without processor time, after which a server that starts hangs [s]
_FINISH = 1.5  #: for all of them to end on request before they are killed [s]
_ABOVE = 0.002  #: the dome, where a tool that is not held otherwise is held [m]
_LOOK = 0.02  #: between two looks for what servers request [s]


@final
class _Server:
    def __init__(self, choice: ServerChoice, number: int) -> None:
        self.choice, self.number = choice, number
        self.preparation: ServerPreparation = load_kind(choice.kind).prepare(choice.where)
        self.process: subprocess.Popen[bytes] | None = None
        self.request_version = 0  # version of the last request
        self.reported_end = False  # that its process has ended


@final
class Serving:
    """The servers `choices` for `servo`. Their ports are opened at once; `start` follows when the servo runs.

    Raises InputError for an address that cannot be had, DriverError for a package that is not installed.
    """

    def __init__(self, choices: Sequence[ServerChoice], servo: Servo) -> None:
        self._servo, self._servers = servo, list[_Server]()
        self._ending = threading.Event()
        self._watcher: threading.Thread | None = None
        self._folder: Path | None = None
        try:
            for number, choice in enumerate(choices):
                self._servers.append(_Server(choice, number))
        except BaseException:
            self.end()
            raise

    @property
    def lines(self) -> list[str]:
        """Where programs find each server, one line each, and what people must know beside."""
        return [
            line
            for one in self._servers
            for line in (f"{one.choice.kind}: {one.preparation.address}", *one.preparation.remarks)
        ]

    def start(self) -> None:
        """Start the servers' processes; returns when all of them serve. Raises DriverError with the reason if one
        does not."""
        if not self._servers:
            return
        self._folder = Path(tempfile.mkdtemp(prefix="haptorb-serve-"))
        shared = SharedMemory(self._servo.memory_path)
        for one in self._servers:
            self._start_process(one)
        deadline = monotonic() + _START
        for one in self._servers:
            assert one.process is not None
            watch, hung = HangWatch(one.process.pid), 0.0
            while shared.words[Word.SERVERS + one.number] == Phase.STARTING:
                hung = watch.look()
                if one.process.poll() is not None or monotonic() > deadline or hung > _HUNG:
                    break
                sleep(0.002)
            if shared.words[Word.SERVERS + one.number] != Phase.RUNNING:
                why = f"its process did nothing for {hung:.0f} s and was ended" if hung > _HUNG else ""
                raise DriverError(f"--serve {one.choice.kind} did not start: {why or self._explain_end(one)}")
            one.preparation.close()
        self._watcher = threading.Thread(target=self._watch, args=(shared,), name="haptorb-servers", daemon=True)
        self._watcher.start()

    def hold_tool(self) -> None:
        """Without a console no hand holds a simulated tool: it is held at rest, so that clients have a cursor."""
        servo = self._servo
        if self._servers and servo.driver == "sim" and servo.tracker in ("pointer", "hall"):
            shell = servo.device.shell
            servo.hold((0.0, 0.0, 0.05 if shell is None else shell.contact_distance + _ABOVE))

    def _start_process(self, one: _Server) -> None:
        servo, prepared = self._servo, one.preparation
        spec = {
            "shared": str(servo.memory_path),
            "slot": one.number,
            "parent": os.getpid(),
            "kind": one.choice.kind,
            "given": prepared.spec,
            "descriptors": prepared.descriptors,
            "device": servo.device,
            "facts": describe_run(servo),
        }
        one.process = start_module(
            "haptorb.apps.serve.server_process",
            errors=self._errors(one), stdin=subprocess.PIPE, descriptors=tuple(prepared.descriptors),
        )  # fmt: skip
        assert one.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it has ended already: `start` reports why
            one.process.stdin.write(pack(spec))
            one.process.stdin.close()

    def _errors(self, one: _Server) -> Path:
        assert self._folder is not None
        return self._folder / f"{one.choice.kind}.txt"

    def _explain_end(self, one: _Server) -> str:
        text = ""
        with contextlib.suppress(OSError):
            text = self._errors(one).read_text(errors="replace")[-2000:].strip()
        code = None if one.process is None else one.process.poll()
        return text or ("no answer" if code is None else f"its process ended with code {code}")

    def _watch(self, shared: SharedMemory) -> None:
        """Do what servers request, and tell people of one that ended."""
        while not self._ending.wait(_LOOK):
            for one in self._servers:
                self._take_request(one, shared.server_requests[one.number])
                over = one.process is not None and one.process.poll() is not None
                if over and self._servo.alive and not one.reported_end:
                    one.reported_end = True
                    show(f"--serve {one.choice.kind} ended, the servo continues: {self._explain_end(one)}\n")

    def _take_request(self, one: _Server, requests: TextSlot) -> None:
        if requests.version == one.request_version:
            return
        one.request_version, text = requests.read()
        if not text:
            return
        try:
            request = json.loads(text)
            self._servo.set_world(request["name"], request["values"])
        except HaptorbError as cause:
            show(f"--serve {one.choice.kind}: a client's command was refused: {cause}\n")

    def end(self) -> None:
        """End all servers, by force if they do not end by themselves. May be called twice."""
        self._ending.set()
        with hold_signals():
            if self._watcher is not None:
                self._watcher.join(_FINISH)
                self._watcher = None
            running = [one for one in self._servers if one.process is not None and one.process.poll() is None]
            for one in running:
                one.process.terminate()  # type: ignore[union-attr]
            deadline = monotonic() + _FINISH
            for one in running:
                if not end_process(one.process, max(deadline - monotonic(), 0.0)):
                    kind, number = one.choice.kind, one.process.pid  # type: ignore[union-attr]
                    show(f"--serve {kind} cannot be ended: the kernel holds its process {number}\n")
            for one in self._servers:
                one.preparation.close()
            if self._folder is not None:
                shutil.rmtree(self._folder, ignore_errors=True)
                self._folder = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end()


def describe_run(servo: Servo) -> dict[str, Any]:
    """What a server's process needs to know of the run, plain JSON types."""
    return {
        "driver": servo.driver,
        "tracker": servo.tracker,
        "estimator": servo.estimator,
        "model": servo.model,
        "rate_hz": servo.rate,
        "modes": list(servo.modes),
        "haptorb": __version__,
    }
