"""A coil's two-node heat model from one record of heating and cooling: Zárate 2020 Fig. 6, turned into numbers.

The winding is its own thermometer: its resistance gives its temperature while current flows. The boundary has a sensor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from haptorb.errors import CalibrationError, InputError
from haptorb.numerics.arrays import Array, check_finite
from haptorb.physics.thermal import TwoNode

__all__ = ["ThermalIdentification", "thermal_identification"]

_TRUST = 0.25  #: relative standard deviation of a parameter above which the record does not determine it


@dataclass(frozen=True)
class ThermalIdentification:
    """The model, how sure each of its four values is (relative standard deviation), and what it leaves unexplained."""

    model: TwoNode
    uncertainty: Array  #: (4,) of winding capacity, body capacity, winding to body, body to air
    residual: float  #: rms [K]

    def endurance(self, rise: float, power: float, *, drive: str = "power", coefficient: float = 3.93e-3) -> float:
        """Seconds from cold until the winding's rise is `rise` [K] under `power` [W]; inf if never."""
        return self.model.time_to(rise, power, drive=drive, coefficient=coefficient)


def thermal_identification(
    t: ArrayLike, power: ArrayLike, winding: ArrayLike, boundary: ArrayLike, ambient: float
) -> ThermalIdentification:
    """Fit two nodes to a record: times `t` (n,) [s], `power` (n,) [W] from each time to the next, temperatures [K].

    `winding` may hold NaN where no current flowed and its resistance could not be measured. Raises CalibrationError if
    the record is too short, or heats too little, to determine all four values; InputError if it is no record.
    """
    times, load = check_finite(t, "t"), check_finite(power, "power")
    body = check_finite(boundary, "boundary temperatures")
    copper = np.asarray(winding, dtype=np.float64)
    if not times.ndim == 1 or not times.shape == load.shape == body.shape == copper.shape:
        raise InputError(
            f"t, power, winding and boundary must have one length; got {times.shape}, {load.shape}, {copper.shape}, "
            f"{body.shape}"
        )
    if len(times) < 20 or not (np.diff(times) > 0).all():
        raise InputError("a thermal record needs at least 20 readings at rising times")
    finite = np.isfinite(copper)
    if finite.sum() < 10:
        raise CalibrationError("the winding's temperature was measured fewer than 10 times: keep a small current on")
    if body.max() - body.min() < 2.0:
        raise CalibrationError(
            f"the boundary warmed by only {body.max() - body.min():.1f} K: heat longer or with more power (the paper: "
            "30 % duty for 3 minutes)"
        )
    start = np.array([copper[finite][0] if finite[0] else body[0], body[0]]) - ambient

    def course(logs: Array) -> Array:
        model = TwoNode(*np.exp(logs).tolist())
        rises = np.empty((len(times), 2))
        rises[0] = start
        steps: dict[float, Array] = {}
        for n, dt in enumerate(np.diff(times).tolist()):
            key = round(dt, 9)
            if key not in steps:
                steps[key] = model.step(dt)
            rises[n + 1] = steps[key] @ np.array([rises[n, 0], rises[n, 1], load[n]])
        return rises

    def rest(logs: Array) -> Array:
        rises = course(logs)
        return np.concatenate([(rises[:, 0] + ambient - copper)[finite], rises[:, 1] + ambient - body])

    warm = max(float(body.max() - ambient), 1.0)
    mean = max(float(load.max()), 1e-3)
    guess = np.log([20.0, 80.0, 4 * mean / warm, mean / warm])
    fit = least_squares(rest, guess, method="lm", x_scale="jac")
    freedom = max(1, len(fit.fun) - 4)
    variance = float(fit.fun @ fit.fun) / freedom
    try:
        spread = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)) * variance)  # of a logarithm: relative
    except np.linalg.LinAlgError:
        spread = np.full(4, np.inf)
    if not fit.success or (spread > _TRUST).any():
        names = ("winding capacity", "body capacity", "conductance inside", "conductance to the air")
        weak = [name for name, s in zip(names, spread, strict=True) if not s <= _TRUST]
        raise CalibrationError(
            f"the record ({times[-1] - times[0]:.0f} s) does not determine the {' and the '.join(weak) or 'model'}: "
            "record heating until the boundary flattens, and the cooling after it"
        )
    return ThermalIdentification(TwoNode(*np.exp(fit.x).tolist()), spread, variance**0.5)
