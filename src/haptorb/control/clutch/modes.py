"""The names of the two modes: the handle moves the object, or turns it."""

from __future__ import annotations

from typing import Literal

__all__ = ["MODES", "Mode"]

Mode = Literal["translate", "rotate"]
MODES: tuple[Mode, ...] = ("translate", "rotate")
