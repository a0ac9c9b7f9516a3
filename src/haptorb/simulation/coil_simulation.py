"""What the simulated kinds of device share: coils behind a chopper, and time in compiled steps."""

from __future__ import annotations

from abc import abstractmethod
from math import ceil

import numpy as np

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, Records
from haptorb.simulation.parts.coils import chop
from haptorb.simulation.simulation import Simulation

__all__ = ["CoilSimulation"]


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
