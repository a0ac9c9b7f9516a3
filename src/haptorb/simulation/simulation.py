"""The abstract simulation behind a driver: it advances in time, returns samples, and knows the true wrench."""

from __future__ import annotations

from abc import ABC, abstractmethod

from numpy.typing import ArrayLike

from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.sensing.sample import Sample

__all__ = ["Simulation"]


class Simulation(ABC):
    """A device, the mover and a hand as differential equations. Deterministic: the same seed and calls, the same bits.

    It has no clock: the caller of `advance` determines how much time passes.
    """

    device: Device

    @abstractmethod
    def advance(self, dt: float, duties: Array, goal_p: Array, goal_q: Array) -> None:
        """Advance by `dt` [s] with `duties` (m,) in −1…1 of the supply, already quantised.

        goal_p (3,) [m] and goal_q (4,), quaternion (x, y, z, w) of R_SR, are the target of the simulated hand.
        """

    @abstractmethod
    def sample(self, t: float, pose_stamp: float, pose_valid: bool) -> Sample:
        """The readings of the sensors now, with time `t` [s], and the mover's pose with the time stamp `pose_stamp`."""

    @abstractmethod
    def truth(self) -> Array:
        """(6,) mean wrench of coils and core on the mover over the last `advance`: [N] and [N·m] about its origin,
        stator frame; without contact, hand and gravity."""

    @abstractmethod
    def state(self) -> State:
        """The true state of the mover; t is the simulated time."""

    @abstractmethod
    def quantise(self, duties: Array) -> Array:
        """(m,) `duties` (m,) clipped to −1…1 and quantised by the chopper; NaN becomes zero."""

    @abstractmethod
    def place(self, p: ArrayLike, q: ArrayLike) -> None:
        """Put the mover at `p` (3,) [m] with `q` (4,), at rest; currents and temperatures do not change."""

    def cool(self) -> None:
        """Set the coils to the ambient temperature; currents do not change. By default it does nothing."""
        return

    @abstractmethod
    def reset(self, seed: int = 0) -> None:
        """Back to the start: cold coils, no currents, mover at rest above the dome or at zero, noise from `seed`."""
