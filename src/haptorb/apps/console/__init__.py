"""The console: one page on this computer, to put a hand on the device and see every number of it."""

from __future__ import annotations

from haptorb.apps.console.application import application
from haptorb.apps.console.console import PORT, Console

__all__ = ["PORT", "Console", "application"]
