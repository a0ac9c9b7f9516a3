"""Abstract simulation behind a driver: it advances in time, returns samples, and provides the actual wrench."""

from __future__ import annotations

from abc import ABC, abstractmethod
from math import ceil

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, Records
from haptorb.devices.base import Device, State
from haptorb.errors import InputError
from haptorb.estimation.types import Sample
from haptorb.simulation.coil_circuits import chop
from haptorb.simulation.gripper import SimulatedGripper

__all__ = ["CoilSimulation", "Simulation"]


class Simulation(ABC):
    """Device, mover and hand as differential equations; the base class of every simulated device.

    It has no clock: the caller of `advance` determines how much time passes. Deterministic: the same seed and calls
    give the same bits.

    Attributes
    ----------
    device : Device
        The simulated device.
    gripper : SimulatedGripper or None
        Its gripper, which is advanced separately.
    """

    device: Device
    gripper: SimulatedGripper | None = None

    @abstractmethod
    def advance(self, dt: float, duties: Array, goal_p: Array, goal_q: Array) -> None:
        """Advance the simulated time.

        Parameters
        ----------
        dt : float
            Time step [s].
        duties : ndarray, shape (m,)
            Duty cycle of each channel, −1 to 1 of the supply voltage [1], already quantised.
        goal_p : ndarray, shape (3,)
            Position to which the simulated hand moves the mover [m].
        goal_q : ndarray, shape (4,)
            Orientation to which it turns the mover: unit quaternion (x, y, z, w) of R_SR [1].
        """

    @abstractmethod
    def sample(self, t: float, pose_stamp: float, pose_valid: bool) -> Sample:
        """Read the simulated sensors.

        Parameters
        ----------
        t : float
            Time of the sample [s].
        pose_stamp : float
            Time of measurement of the mover's pose [s].
        pose_valid : bool
            Whether the pose is valid.

        Returns
        -------
        Sample
            The readings, with noise and quantisation.
        """

    @abstractmethod
    def wrench_actual(self) -> Array:
        """Return the mean wrench of coils and core on the mover over the last `advance`.

        Contact, hand and gravity are not part of it.

        Returns
        -------
        ndarray, shape (6,)
            Force [N] and torque about the mover's origin [N·m], in the stator frame.
        """

    @abstractmethod
    def state(self) -> State:
        """Return the true state of the mover.

        Returns
        -------
        State
            The state; t is the simulated time.
        """

    @abstractmethod
    def quantise(self, duties: Array) -> Array:
        """Clip and quantise duty cycles as the chopper does.

        Parameters
        ----------
        duties : ndarray, shape (m,)
            Duty cycles [1].

        Returns
        -------
        ndarray, shape (m,)
            Duty cycles within −1 to 1 [1]; zero for NaN.
        """

    @abstractmethod
    def place(self, p: ArrayLike, q: ArrayLike) -> None:
        """Place the mover, at rest; currents and temperatures do not change.

        Parameters
        ----------
        p : array_like, shape (3,)
            Position [m].
        q : array_like, shape (4,)
            Orientation: unit quaternion (x, y, z, w) of R_SR [1].
        """

    def cool(self) -> None:
        """Set the coils to the ambient temperature; currents do not change. The default does nothing."""
        return

    @abstractmethod
    def reset(self, seed: int = 0) -> None:
        """Reset to the initial state: cold coils, no currents, the mover at rest above the dome, or at zero.

        Parameters
        ----------
        seed : int
            Seed of the noise.
        """


# --------------------------------------------------------------------------------------------------
# Common part of the simulated kinds of device: coils behind a chopper, and integration in compiled steps.


_KEPT_HEAT_STEPS = 8  #: lengths of steps whose thermal step is kept


class CoilSimulation(Simulation):
    """Simulation with (m,) COIL and a state (1,) whose fields `dt` and `steps` control the compiled integration."""

    def __init__(self, state: Records, coils: Records, longest: float, duty_bits: int) -> None:
        """Initialise; longest: maximum step [s]."""
        self._state, self._coils, self._longest = state, coils, longest
        self._steps_of_duty = float(2**duty_bits)
        self._last_dt, self._t = 0.0, 0.0
        self._heat_steps: dict[float, Records] = {}  #: step [s] → the state's `heat`

    def cool(self) -> None:
        """Set the coils to the ambient temperature; currents do not change."""
        self._coils["winding"] = self._coils["body"] = self._coils["ambient"]

    def quantise(self, duties: Array) -> Array:
        """(m,) `duties` (m,) clipped to −1…1 and quantised by the chopper; NaN becomes zero."""
        out = np.empty(self.device.channels)
        chop(np.ascontiguousarray(duties, dtype=np.float64), self._steps_of_duty, out)
        return out

    @abstractmethod
    def _fill_heat(self, dt: float) -> None:
        """Update the state's thermal step for a step of `dt` [s]."""

    def _set_steps(self, dt: float) -> bool:
        """Set steps so that the next call of compiled code advances the state by `dt` [s]; False for zero time.

        Raises InputError for less than 0 or more than 10 s.
        """
        if not (0.0 <= dt < 10.0):
            raise InputError(f"the simulation can advance by 0 to 10 s at once; got {dt} s")
        if dt != self._last_dt and dt > 0.0:
            steps = max(ceil(dt / self._longest - 1e-9), 1)
            self._last_dt = dt
            self._state["dt"], self._state["steps"] = dt / steps, steps
            self._set_heat_step(dt / steps)
        return dt > 0.0

    def _set_heat_step(self, step: float) -> None:
        """Set the state's thermal step. Those of the last few lengths are kept: after a missed tick two periods pass at
        once, and to compute the step anew takes as long as a tick at 4 kHz, so that the next one would be missed too.
        """
        kept = self._heat_steps.pop(step, None)
        if kept is not None:
            self._heat_steps[step] = self._state["heat"] = kept  # the newest now: the regular one is never removed
            return
        self._fill_heat(step)
        if len(self._heat_steps) == _KEPT_HEAT_STEPS:
            del self._heat_steps[next(iter(self._heat_steps))]
        self._heat_steps[step] = self._state["heat"].copy()

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
