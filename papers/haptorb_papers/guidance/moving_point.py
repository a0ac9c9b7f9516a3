"""Guidance by the clock, for comparison: a spring to a point that goes along the path at a pace of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from haptorb.arrays import Array, Records
from haptorb.devices.base import State
from haptorb.worlds.dynamic import DynamicWorld, MemoryField
from haptorb.worlds.path import GuidancePath

__all__ = ["MovingPoint"]


@dataclass(frozen=True)
class MovingPoint(DynamicWorld):
    """A spring of strength/width [N/m] to a point that goes to and fro on an open path, round and round on a closed
    one. Its force is at most `strength`."""

    passive: ClassVar[bool] = False
    continuous: ClassVar[bool] = False

    path: GuidancePath | None = None
    pace: float = 0.03  #: [m/s]
    strength: float = 0.35  #: [N]
    width: float = 0.003  #: [m]

    @property
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """How far it has gone."""
        return (MemoryField("gone", "m", "length gone by the clock"),)

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) pull towards the point [N], `dt` [s] later."""
        assert self.path is not None
        memory["gone"] += self.pace * dt
        gone, length = float(memory["gone"][0]), self.path.length
        arc = gone % length if self.path.closed else length - abs(gone % (2 * length) - length)
        pull = -self.strength / self.width * (state.p - self.path.find_place(arc))
        size = float(np.linalg.norm(pull))
        wrench = np.zeros(6)
        wrench[:3] = pull * min(1.0, self.strength / size) if size > 0.0 else pull
        return wrench
