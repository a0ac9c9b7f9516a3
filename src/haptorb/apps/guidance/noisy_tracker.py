"""A tracker whose places are noisy, in front of a driver that knows the pose exactly."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.driver import Driver
from haptorb.sensing.sample import Sample

__all__ = ["NoisyTracker"]


@final
class NoisyTracker(Driver):
    """Reports the pose of `inner` with an error of the position, new in every sample: `noise` [m] rms in each
    direction."""

    name, simulated = "noisy", False

    def __init__(self, inner: Driver, noise: float, seed: int) -> None:
        self._inner, self._noise, self._generator = inner, noise, np.random.default_rng(seed)

    def open(self) -> None:
        """Open what is behind."""
        self._inner.open()

    def close(self) -> None:
        """Coils off."""
        self._inner.close()

    def read(self, now: float) -> Sample:
        """The sample of `inner` with a noisy place."""
        sample = self._inner.read(now)
        error = self._noise * self._generator.standard_normal(3)
        return replace(sample, pose=replace(sample.pose, p=sample.pose.p + error))

    def write(self, duties: Array) -> Array:
        """As `inner` does."""
        return self._inner.write(duties)

    def truth(self) -> Array:
        """As `inner` knows it."""
        return self._inner.truth()

    def target(self) -> Array:
        """As `inner` knows it."""
        return self._inner.target()
