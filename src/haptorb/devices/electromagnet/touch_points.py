"""Places on a device that a person can touch with the tool's tip, and that somebody has measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from haptorb.numerics.arrays import Array

__all__ = ["Marks"]


@final
@dataclass(frozen=True)
class Marks:
    """Engraved dots, by name; what lies in one of them is at its place and can only turn."""

    names: tuple[str, ...]
    positions: Array  #: (k, 3) of each dot's bottom, stator frame [m]
