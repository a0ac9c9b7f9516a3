"""A world of our own: a groove along the x axis, over a dome."""

from dataclasses import dataclass

import numpy as np

from haptorb.worlds import World, parameter


@dataclass(frozen=True)
class Groove(World):
    """A spring across the groove, nothing along it."""

    stiffness: float = parameter(20.0, "N/m", 0, 200, "how hard it pulls back across the groove")

    def wrench(self, state):
        """(6,) force towards the plane y = 0 [N]."""
        wrench = np.zeros(6)
        wrench[1] = -self.stiffness * state.p[1]
        return wrench
