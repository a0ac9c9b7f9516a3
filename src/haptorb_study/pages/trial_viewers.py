"""Players of recorded trials: `haptorb view` in processes of their own, beside a running study.

The study's process controls a device, so recordings are read by `haptorb view` in another process.
"""

from __future__ import annotations

import json
import os
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path
from typing import final

from haptorb.errors import InputError
from haptorb.runtime.linux import start_python
from haptorb.web.server import PageAddress

__all__ = ["TrialViewers"]


_MAX_VIEWERS = 3  #: viewers at the same time; another one ends the oldest
_END_TIMEOUT_S = 2.0  #: timeout for the end of a viewer [s]


@final
class TrialViewers:
    """Viewers by part of a recording; `urls`: part → URL, "" while its viewer starts.

    where  listening and public address of the page that leads to them
    """

    def __init__(self, where: PageAddress = PageAddress()) -> None:
        self._where = where
        self.urls: dict[str, str] = {}
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._changing = threading.Lock()
        self._closed = False

    def open(self, part: str, report: Callable[[str], None]) -> None:
        """Start to play `part` (FILE#t=FROM,TO) unless it plays; a thread calls `report` with a failure.

        Raises InputError if the file does not exist, or if the page has a public address: each viewer has a port of its
        own, to which that does not lead.
        """
        path = Path(part.partition("#t=")[0])
        if self._where.address:
            raise InputError(
                f"behind a proxy this page plays no recording: run `haptorb view '{part}'` on the study's computer, "
                "with an --address of its own"
            )
        if not path.exists():
            raise InputError(f"the recording {path} no longer exists")
        with self._changing:
            if self._closed or (part in self._running and self._running[part].poll() is None):
                return
            while len(self._running) >= _MAX_VIEWERS:
                self._end(next(iter(self._running)))
            process = start_python(
                "haptorb", "view", part, "--port", "0", "--host", self._where.host, "--json",
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )  # fmt: skip
            if hasattr(os, "setpriority"):
                os.setpriority(os.PRIO_PROCESS, process.pid, 10)
            self._running[part] = process
            self.urls = self.urls | {part: ""}
        threading.Thread(target=self._listen, args=(part, process, report), daemon=True).start()

    def _listen(self, part: str, process: subprocess.Popen[bytes], report: Callable[[str], None]) -> None:
        assert process.stdout is not None
        assert process.stderr is not None
        with process.stdout as answers, process.stderr as errors:
            line = answers.readline()
            if line.startswith(b"{"):
                with self._changing:
                    if part in self._running:
                        self.urls = self.urls | {part: str(json.loads(line)["url"])}
            answers.read()
            mistake = errors.read().decode(errors="replace")
        process.wait()
        with self._changing:
            if self._running.get(part) is process:
                del self._running[part]
                self.urls = {one: url for one, url in self.urls.items() if one != part}
                if not line:
                    report(f"the recording cannot be played: {mistake.strip()[-400:]}")

    def _end(self, part: str) -> None:
        process = self._running.pop(part)
        self.urls = {one: url for one, url in self.urls.items() if one != part}
        process.terminate()

    def close(self) -> None:
        """End all viewers."""
        with self._changing:
            self._closed = True
            processes = list(self._running.values())
            for part in list(self._running):
                self._end(part)
        for process in processes:
            try:
                process.wait(_END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
