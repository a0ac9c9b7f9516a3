"""Runs programs as a user starts them, without loading numba, matplotlib and others for each.

`ProgramRunner` starts this file as a process of its own, which loads them, and copies itself for every program.
"""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any, final

PACKAGES = ("matplotlib.pyplot", "numba", "pydantic", "mcap.writer", "mcap.reader", "cloudpickle", "asyncio", "ssl")


@final
class ProgramRunner:
    """A process with what every program loads first; only packages of others, so that no import of ours is spared."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-W", "error", __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=os.environ | {"MPLBACKEND": "Agg"}, start_new_session=True,
        )  # fmt: skip

    def run(self, file: Path, folder: Path) -> subprocess.CompletedProcess[str]:
        """Run the program `file` in `folder`, where every warning is an error; what it said is in the result."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        outputs = [str(folder / f".{file.stem}.{name}") for name in ("out", "err")]
        self._process.stdin.write(json.dumps({"file": str(file), "folder": str(folder), "outputs": outputs}) + "\n")
        self._process.stdin.flush()
        code = int(self._process.stdout.readline())
        said = [Path(name).read_text(encoding="utf-8") for name in outputs]
        return subprocess.CompletedProcess([str(file)], code, *said)

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def read_programs() -> dict[str, Any] | None:
    """Copy this process for every line of stdin; the copy gets what the line says, the original None at the end."""
    for line in sys.stdin:
        if (child := os.fork()) == 0:
            wanted: dict[str, Any] = json.loads(line)
            return wanted
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
    return None


def become(wanted: dict[str, Any]) -> None:
    """This process is the program from here on, and ends as it does."""
    for number, name in enumerate((os.devnull, *wanted["outputs"])):
        os.dup2(os.open(name, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600), number)
    os.chdir(wanted["folder"])
    sys.argv = [wanted["file"]]
    sys.path[0] = str(Path(wanted["file"]).parent)
    runpy.run_path(wanted["file"], run_name="__main__")


if __name__ == "__main__":
    for name in PACKAGES:
        import_module(name)
    if (program := read_programs()) is not None:
        become(program)
