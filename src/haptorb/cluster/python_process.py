"""How this program starts Python: a child process imports nothing from the current folder.

`python -m` and `python -c` put the current folder first on the import path. Whoever may write there, or has a
`random.py` there for another purpose, would have it run inside the process that holds the coils. Every child is
therefore started with `-P`; one that needs nothing of the user's with `-I`, which leaves out PYTHONPATH too.
"""

from __future__ import annotations

import os
import site
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

__all__ = ["append_folders", "environment", "python_command"]

#: An isolated process finds this package, and what it needs, where this process found them.
_ISOLATED = (
    f"import sys; folders, module = sys.argv[1].split({os.pathsep!r}), sys.argv[2]; del sys.argv[1:3]; "
    "sys.path += [one for one in folders if one not in sys.path]; "
    "import runpy; runpy.run_module(module, run_name='__main__', alter_sys=True)"
)


def python_command(module: str, *arguments: str, isolated: bool = False) -> list[str]:
    """The command for `python -m module arguments` that imports nothing from the current folder.

    `isolated`: nor from PYTHONPATH, for what needs no code of the user's.
    """
    if not isolated:
        return [sys.executable, "-P", "-m", module, *arguments]  # safety: no-current-folder
    # safety: isolated-child
    return [sys.executable, "-I", "-c", _ISOLATED, os.pathsep.join(_own_folders()), module, *arguments]


def _own_folders() -> list[str]:
    """Where this package lies, and the account's own packages if this process uses them."""
    root = str(Path(__file__).resolve().parents[2])
    return [root, site.getusersitepackages()] if site.ENABLE_USER_SITE else [root]


def environment(more: Mapping[str, str] | None = None) -> dict[str, str]:
    """This process's environment for a child, and `more` that it has not set itself.

    An empty entry of PYTHONPATH, which an `export PYTHONPATH=$PYTHONPATH:...` leaves, means the current folder: it is
    left out.
    """
    found = {**(more or {}), **os.environ}
    if "PYTHONPATH" in found:
        # safety: no-empty-entry
        found["PYTHONPATH"] = os.pathsep.join(one for one in found["PYTHONPATH"].split(os.pathsep) if one)
    return found


def append_folders(folders: Iterable[str]) -> None:
    """Let modules be found in `folders` too: after everything else, so that they hide nothing."""
    for one in folders:
        folder = os.path.abspath(one)
        if folder not in sys.path:
            sys.path.append(folder)  # safety: folders-last
