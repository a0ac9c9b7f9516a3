"""The abstract simulated world behind a driver: time goes on, a sample is taken, and the truth may be asked."""

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

    It has no clock of its own: who calls `advance` decides how much time passes.
    """

    device: Device

    @abstractmethod
    def advance(self, dt: float, duties: Array, goal_p: Array, goal_q: Array) -> None:
        """Let `dt` [s] pass with `duties` (m,) in −1…1 of the supply, already as the chopper gives them.

        goal_p (3,) [m] and goal_q (4,), quaternion (x, y, z, w) of R_SR, are where the simulated hand wants the mover.
        """

    @abstractmethod
    def sample(self, t: float, pose_stamp: float, pose_valid: bool) -> Sample:
        """What the sensors read now, told as time `t` [s], and the mover's pose as a tracker's word of `pose_stamp`."""

    @abstractmethod
    def truth(self) -> Array:
        """(6,) mean wrench of coils and core on the mover over the last `advance`: [N] and [N·m] about its origin,
        stator frame; neither contact, nor hand, nor gravity."""

    @abstractmethod
    def state(self) -> State:
        """The mover as it really is; t counts the seconds that have been simulated."""

    @abstractmethod
    def quantise(self, duties: Array) -> Array:
        """(m,) what the chopper makes of `duties` (m,): clipped to −1…1, in its steps; not a number: zero."""

    @abstractmethod
    def place(self, p: ArrayLike, q: ArrayLike) -> None:
        """Put the mover at `p` (3,) [m] with `q` (4,), at rest; currents and temperatures go on."""

    def cool(self) -> None:
        """Coils at the ambient temperature at once; currents go on. Here nothing, for coils whose heat is not known."""
        return

    @abstractmethod
    def reset(self, seed: int = 0) -> None:
        """Back to the start: cold coils, no currents, mover at rest above the dome or at zero, noise from `seed`."""
