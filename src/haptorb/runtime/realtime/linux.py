"""What only Linux can do, and the message on other systems."""

from __future__ import annotations

import sys

from haptorb.errors import PlatformError

__all__ = ["WORKS_ANYWHERE", "is_linux", "require_linux"]

WORKS_ANYWHERE = (
    "`haptorb` inspect, devices, worlds, show, info, export, replay, view, check --world, design (all but show), "
    "reproduce, fit-multipole, train, estimators, guidance, study (all but run), calibrate (simulated) and frame; in "
    "Python all but haptorb.Servo and real drivers"
)  #: printed on other systems, and true there
_NAMES = {"darwin": "macOS", "win32": "Windows"}


def is_linux() -> bool:
    """Whether this is Linux: it has the timers, priorities and signals that a real-time loop needs."""
    return sys.platform.startswith("linux")


def require_linux(what: str, instead: str = WORKS_ANYWHERE) -> None:
    """Raise PlatformError, one line, if this is not Linux.

    `what` is the subject of the sentence; `instead` names what works on any system.
    """
    if not is_linux():
        system = _NAMES.get(sys.platform, sys.platform)
        raise PlatformError(f"{what} needs Linux, and this is {system}. Available here: {instead}")
