"""Noise of the positions that a tracker reports."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np

from haptorb.estimation.types import Pose
from haptorb.runtime.drivers.sim import PoseDistortion

__all__ = ["PoseNoise"]


@final
class PoseNoise(PoseDistortion):
    """An error of the position, new in every sample: `deviation` [m] rms in each direction, drawn with `seed`."""

    def __init__(self, deviation: float, seed: int) -> None:
        self._deviation, self._seed = deviation, seed
        self.reset()

    def reset(self) -> None:
        """The same errors from the beginning."""
        self._generator = np.random.default_rng(self._seed)

    def distort(self, now: float, pose: Pose) -> Pose:
        """`pose` with a noisy position."""
        return replace(pose, p=pose.p + self._deviation * self._generator.standard_normal(3))
