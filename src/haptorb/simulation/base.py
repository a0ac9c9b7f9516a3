"""The abstract simulation behind a driver: it advances in time, returns samples, and knows the true wrench."""

from __future__ import annotations

from abc import ABC, abstractmethod
from math import ceil

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, Records
from haptorb.devices.base import Device, State
from haptorb.errors import DeviceError, InputError
from haptorb.estimation.types import Sample
from haptorb.simulation.parts import chop

__all__ = ["CoilSimulation", "Simulation", "simulate"]


class Simulation(ABC):
    """Device, mover and hand as differential equations; the base class of every simulated device.

    It has no clock: the caller of `advance` determines how much time passes. Deterministic: the same seed and calls
    give the same bits.

    Attributes
    ----------
    device : Device
        The simulated device.
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


# --------------------------------------------------------------------------------------------------
# What the simulated kinds of device share: coils behind a chopper, and time in compiled steps.


class CoilSimulation(Simulation):
    """A simulation with (m,) COIL and a state (1,) whose fields `dt` and `steps` say how compiled code advances it."""

    def __init__(self, state: Records, coils: Records, longest: float, duty_bits: int) -> None:
        """longest: of a step [s]."""
        self._state, self._coils, self._longest = state, coils, longest
        self._steps_of_duty = float(2**duty_bits)
        self._last_dt, self._t = 0.0, 0.0

    def cool(self) -> None:
        """Coils at the ambient temperature at once; currents continue."""
        self._coils["winding"] = self._coils["body"] = self._coils["ambient"]

    def quantise(self, duties: Array) -> Array:
        """(m,) `duties` (m,) clipped to −1…1 and quantised by the chopper; NaN becomes zero."""
        out = np.empty(self.device.channels)
        chop(np.ascontiguousarray(duties, dtype=np.float64), self._steps_of_duty, out)
        return out

    @abstractmethod
    def _fill_heat(self, dt: float) -> None:
        """Make the state's heat that of a step of `dt` [s]."""

    def _set_steps(self, dt: float) -> bool:
        """Let the state advance by `dt` [s] with the next call of compiled code; False if that is no time at all.

        Raises InputError for less than 0 or more than 10 s.
        """
        if not (0.0 <= dt < 10.0):
            raise InputError(f"the simulation can advance by 0 to 10 s at once; got {dt} s")
        if dt != self._last_dt and dt > 0.0:
            steps = max(ceil(dt / self._longest - 1e-9), 1)
            self._last_dt = dt
            self._state["dt"], self._state["steps"] = dt / steps, steps
            self._fill_heat(dt / steps)
        return dt > 0.0

    @property
    def currents(self) -> Array:
        """(m,) the true currents [A]."""
        currents: Array = self._coils["current"].copy()
        return currents

    @property
    def winding(self) -> Array:
        """(m,) the windings' true temperatures [K]."""
        winding: Array = self._coils["winding"].copy()
        return winding


# --------------------------------------------------------------------------------------------------
# From a device to the simulation that its kind names.


def simulate(device: Device, seed: int = 0) -> Simulation:
    """A simulation of `device` whose noise is that of `seed`; DeviceError if there is none for its kind.

    >>> from haptorb.devices.loader import load
    >>> simulate(load("omni")).device.name
    'omni'
    """
    make = device.kind.part("simulation")
    if make is None:
        raise DeviceError(
            f"device '{device.name}' is a {device.kind.title}, which cannot be simulated; choose a driver for the real "
            "device"
        )
    simulation: Simulation = make(device, seed)
    return simulation
