"""A step of a scene as background work."""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.numerics.arrays import Array, Records
from haptorb.worlds.dynamic_world import WorldWork
from haptorb.worlds.scene.stepping import SceneStepper

__all__ = ["SceneWork"]


@final
class SceneWork(WorldWork):
    """The step from `state` (n,) with the wrench `share` (6,) on the held body [N, N·m]; copies of both."""

    def __init__(self, pad: SceneStepper, state: Array, share: Array) -> None:
        self._pad, self._state, self._share = pad, state.copy(), share.copy()

    def compute(self) -> Array:
        """(n,) the state after the step."""
        return self._pad.compute_step(self._state, self._share)

    def fits(self, memory: Records) -> bool:
        """Whether `memory` (1,) still waits for this step, from this state [m, m/s]."""
        one = memory[0]
        return bool(
            one["pending"] and np.array_equal(one["state"], self._state) and np.array_equal(one["share"], self._share)
        )
