"""`haptorb view`: the console's page plays recordings; no servo runs.

Names are loaded when they are first used: the process that scans a long recording needs no web server.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

_HOME = {
    "PORT": "haptorb.apps.view.viewer",
    "Viewer": "haptorb.apps.view.viewer",
}

__all__ = ["PORT", "Viewer"]

if TYPE_CHECKING:
    from haptorb.apps.view.viewer import PORT, Viewer


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'haptorb.apps.view' has no attribute '{name}'")
    return getattr(import_module(_HOME[name]), name)
