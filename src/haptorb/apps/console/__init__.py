"""The console: one page on this computer, to put a hand on the device and see every number of it.

Names are loaded when they are first used: the process that computes the force map needs no web server.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

_HOME = {
    "PORT": "haptorb.apps.console.console",
    "Console": "haptorb.apps.console.console",
    "application": "haptorb.apps.console.site",
}

__all__ = ["PORT", "Console", "application"]

if TYPE_CHECKING:
    from haptorb.apps.console.console import PORT, Console
    from haptorb.apps.console.site import application


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'haptorb.apps.console' has no attribute '{name}'")
    return getattr(import_module(_HOME[name]), name)
