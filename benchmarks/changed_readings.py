"""Simulated device with modified sensor readings: errors, or an external field."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

from numpy.typing import ArrayLike

from haptorb.arrays import Array
from haptorb.devices.base import State
from haptorb.estimation.types import Sample
from haptorb.simulation.base import Simulation


@final
class ChangedReadings(Simulation):
    """`simulation`, each of whose samples goes through `change`; `prepare` follows each reset, with its seed."""

    def __init__(
        self, simulation: Simulation, change: Callable[[Sample], Sample], prepare: Callable[[int], None] | None = None
    ) -> None:
        self.device, self._simulation, self._change, self._prepare = simulation.device, simulation, change, prepare

    def sample(self, t: float, pose_stamp: float, pose_valid: bool) -> Sample:
        """What is read."""
        return self._change(self._simulation.sample(t, pose_stamp, pose_valid))

    def advance(self, dt: float, duties: Array, goal_p: Array, goal_q: Array) -> None:
        """As the true one."""
        self._simulation.advance(dt, duties, goal_p, goal_q)

    def wrench_actual(self) -> Array:
        """As the true one."""
        return self._simulation.wrench_actual()

    def state(self) -> State:
        """As the true one."""
        return self._simulation.state()

    def quantise(self, duties: Array) -> Array:
        """As the true one."""
        return self._simulation.quantise(duties)

    def place(self, p: ArrayLike, q: ArrayLike) -> None:
        """As the true one."""
        self._simulation.place(p, q)

    def cool(self) -> None:
        """As the true one."""
        self._simulation.cool()

    def reset(self, seed: int = 0) -> None:
        """As the true one, and what `prepare` does after it."""
        self._simulation.reset(seed)
        if self._prepare is not None:
            self._prepare(seed)
