"""Folder and shell of a new user: typed commands, and no processes left behind."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import time
import uuid
from pathlib import Path

#: another operating system, "win32" or "darwin", of which the commands shall be; empty: this one
SYSTEM = os.environ.get("HAPTORB_NEWCOMERS_SYSTEM", "")
_ELSEWHERE = [sys.executable, str(Path(__file__).parents[1] / "cli" / "other_system.py"), SYSTEM]
_HERE = [sys.executable, "-c", "import sys; from haptorb.cli import main; sys.exit(main(sys.argv[1:]))"]
HAPTORB = [*_ELSEWHERE, "-m", "haptorb"] if SYSTEM else _HERE
PYTHON = [*_ELSEWHERE, "-f"] if SYSTEM else [sys.executable, "-W", "error"]
#: of the commands; an account without a home has one for the browser's driver only
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != os.environ.get("HAPTORB_NEWCOMERS_WITHOUT")}
_PATIENCE = 120.0  #: for a command [s]
_GONE = 5.0  #: for what a command started, after it has ended [s]


class NewcomerShell:
    """Commands and scripts in `folder`; the processes that they start are known by a variable of their environment."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._mark = f"HAPTORB_NEWCOMER={uuid.uuid4()}"
        name, _, value = self._mark.partition("=")
        self._environment = ENVIRONMENT | {name: value, "XDG_STATE_HOME": str(folder / "state"), "MPLBACKEND": "Agg"}

    def run(self, line: str, code: int = 0) -> subprocess.CompletedProcess[str]:
        """`haptorb …` or `python NAME.py` as it is typed; it must end with `code`, a command without a traceback."""
        program, *words = shlex.split(line)
        script = program == "python"
        start = PYTHON if script else HAPTORB
        done = subprocess.run(
            [*start, *words], cwd=self.folder, env=self._environment, capture_output=True, text=True, check=False,
            timeout=_PATIENCE,
        )  # fmt: skip
        assert done.returncode == code, f"{line}: code {done.returncode}\n{done.stdout}{done.stderr}"
        assert script or "Traceback" not in done.stderr, done.stderr
        return done

    def list_running(self) -> list[str]:
        """What the commands have started and still runs; whatever needs a moment to end has it."""
        end = time.monotonic() + _GONE
        while (found := self._list_marked()) and time.monotonic() < end:
            time.sleep(0.05)
        return found

    def _list_marked(self) -> list[str]:
        found = []
        for process in Path("/proc").glob("[0-9]*"):
            try:
                if self._mark.encode() in (process / "environ").read_bytes().split(b"\0"):
                    found.append((process / "cmdline").read_bytes().replace(b"\0", b" ").decode())
            except OSError:  # it has just ended, or is another user's
                continue
        return found
