"""The empty world: zero wrench."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.worlds.world import World

__all__ = ["Nothing"]


@dataclass(frozen=True)
class Nothing(World):
    """Zero wrench everywhere: only the device's own friction and passive pull remain."""

    asks = "force"

    @property
    def bound(self) -> float:
        """[N]"""
        return 0.0

    def wrench(self, state: State) -> Array:
        """(6,) zeros [N, N·m]."""
        return np.zeros(6)
