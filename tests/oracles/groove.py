"""Example of a user's own world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.worlds import World
from haptorb.worlds.base import parameter


@dataclass(frozen=True)
class Groove(World):
    """A spring across y = 0."""

    stiffness: float = parameter(20.0, "N/m", 0, 200, "across the groove")

    def wrench(self, state):
        wrench = np.zeros(6)
        wrench[1] = -self.stiffness * state.p[1]
        return wrench


stiff = Groove(stiffness=50.0)


def push(state):
    return np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
