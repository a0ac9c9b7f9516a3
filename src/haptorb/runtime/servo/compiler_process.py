"""The process that compiles beside a servo, seen from its host: the controller at a first start, then the worlds."""

from __future__ import annotations

import os
import subprocess
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import final

from haptorb.errors import ServoError
from haptorb.runtime.exchange.shared_memory import SharedMemory, Word
from haptorb.runtime.processes.first_start import CATALOGUE, CONTROLLER
from haptorb.runtime.processes.prestart import WANTED, start_module
from haptorb.runtime.realtime.process_starter import end_process
from haptorb.runtime.realtime.stall_time import HangWatch

__all__ = ["CompilerProcess"]

_HUNG = 4.0  #: without processor time, after which it hangs [s]
_USUAL = 3.0  #: a start with compiled code; who needs longer has it compiled by two [s]


@final
class CompilerProcess:
    """For the servo of the `shared` memory, whose plan is in `folder`; its errors are appended to `errors`."""

    def __init__(self, folder: Path, shared: SharedMemory, errors: Path) -> None:
        self._folder, self._shared, self._errors = folder, shared, errors
        self._begin = monotonic()
        self.process: subprocess.Popen[bytes] | None = None
        self._watch: HangWatch | None = None

    def help_start(self) -> None:
        """Compile the controller beside the servo's process if that process compiles, or takes too long to prepare.

        Opening a device may take long; the servo's process no longer compiles then.
        """
        late = self._shared.words[Word.COMPILED] > 0 or monotonic() > self._begin + _USUAL
        if self.process is None and late and not self._shared.facts.read()[1]:
            self._run(CONTROLLER)

    def finish_start(self, *, running: bool) -> None:
        """The loop runs, or has failed: end this help, and compile the worlds whose code is missing."""
        self.end()
        if running and self._shared.words[Word.UNCOMPILED]:
            self._run(CATALOGUE)

    def compile_world(self, name: str) -> None:
        """Compile the world `name` next."""
        with suppress(OSError):  # a full disk: it has its turn nevertheless
            (self._folder / WANTED).write_text(name, encoding="utf-8")
        if self.process is None or self.process.poll() is not None:
            self._run(CATALOGUE)

    def check(self) -> None:
        """End it and raise ServoError if it hangs: a world that is waited for would never come."""
        process = self.process
        if process is None or process.poll() is not None or self._watch is None:
            return
        if (hung := self._watch.look()) > _HUNG:
            self.end()
            raise ServoError(
                f"the process that compiles the worlds did nothing for {hung:.0f} s and was ended; choose the world "
                "again"
            )

    def end(self) -> None:
        """Kill it if it is running."""
        if self.process is not None:
            end_process(self.process, 0.0)

    def _run(self, what: str) -> None:
        self.process = start_module(
            "haptorb.runtime.processes.first_start", what, str(self._folder), str(os.getpid()), errors=self._errors
        )
        self._watch = HangWatch(self.process.pid)
