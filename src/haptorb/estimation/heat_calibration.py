"""Thermal calibration: heat capacities and conductances of coils, fitted to records of heating and cooling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from haptorb.arrays import Array, check_finite
from haptorb.devices.base import Heat, HeatCoupling
from haptorb.errors import CalibrationError, InputError
from haptorb.thermal import ThermalNetwork, TwoNode

__all__ = [
    "HeatRecord",
    "NetworkIdentification",
    "ThermalIdentification",
    "coil_identification",
    "network_identification",
    "thermal_identification",
]


# --------------------------------------------------------------------------------------------------
# Two-node thermal model of a coil, identified from one record of heating and cooling: Zárate 2020 Fig. 6.
#
# The winding is its own thermometer: its resistance gives its temperature while current flows. The boundary has a
# sensor.


#: relative standard deviation of a parameter above which the record does not determine it
_THERMAL_IDENTIFICATION_TRUST = 0.25


@dataclass(frozen=True)
class ThermalIdentification:
    """Identified model, relative standard deviation of each of its four values, and residual."""

    model: TwoNode
    uncertainty: Array  #: (4,) of winding capacity, body capacity, winding to body, body to air
    residual: float  #: rms [K]

    def endurance(self, rise: float, power: float, *, drive: str = "power", coefficient: float = 3.93e-3) -> float:
        """Time [s] from cold until the winding's rise is `rise` [K] under `power` [W]; inf if never."""
        return self.model.time_to(rise, power, drive=drive, coefficient=coefficient)


def thermal_identification(
    t: ArrayLike, power: ArrayLike, winding: ArrayLike, boundary: ArrayLike, ambient: float
) -> ThermalIdentification:
    """Fit two nodes to a record: times `t` (n,) [s], `power` (n,) [W] from each time to the next, temperatures [K].

    `winding` may hold NaN where no current flowed and its resistance could not be measured. Raises CalibrationError if
    the record is too short, or heats too little, to determine all four values; InputError for an invalid record.
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
        spread = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)) * variance)  # of a logarithm, hence relative
    except np.linalg.LinAlgError:
        spread = np.full(4, np.inf)
    if not fit.success or (spread > _THERMAL_IDENTIFICATION_TRUST).any():
        names = ("winding capacity", "body capacity", "conductance inside", "conductance to the air")
        weak = [name for name, s in zip(names, spread, strict=True) if not s <= _THERMAL_IDENTIFICATION_TRUST]
        raise CalibrationError(
            f"the record ({times[-1] - times[0]:.0f} s) does not determine the {' and the '.join(weak) or 'model'}: "
            "record heating until the boundary flattens, and the cooling after it"
        )
    return ThermalIdentification(TwoNode(*np.exp(fit.x).tolist()), spread, variance**0.5)


# --------------------------------------------------------------------------------------------------
# Thermal coupling of the coils, from one record in which each was driven alone and all were measured.
#
# The windings are their own thermometers: a resistance gives a temperature while a small current flows. Each boundary
# has a sensor. Coils are assumed equal except for their conductance to the core.


#: relative standard deviation of a value above which the record does not determine it
_NETWORK_IDENTIFICATION_TRUST = 0.25
_MIN_READINGS = 20  #: of a record
_DRIVEN_POWER_SHARE = 0.25  #: share of the record's maximum power above which a coil counts as driven
_MIN_ALONE_READINGS = 10  #: minimum number of readings in which a coil is driven alone
_COIL = ("winding capacity", "body capacity", "conductance from winding to body", "conductance to the air")
_MIN_BOUNDARY_RISE_K = 2.0  #: minimum temperature rise of each boundary [K]


@dataclass(frozen=True)
class HeatRecord:
    """Measurements of m coils at n times.

    t         (n,) [s]
    power     (n, m) [W] from each time to the next
    winding   (n, m) [K]; NaN where a resistance could not be measured
    boundary  (n, m) [K]
    ambient   temperature of the room, and of everything at the beginning but what was measured then [K]
    """

    t: Array
    power: Array
    winding: Array
    boundary: Array
    ambient: float


@dataclass(frozen=True)
class NetworkIdentification:
    """Identified values, their relative standard deviations, and residual."""

    model: TwoNode  #: of each coil
    coupling: HeatCoupling
    uncertainty: Array  #: (4,) of the model's values; then, where they were fitted too, of core and conductances to it
    residual: float  #: rms [K]

    @property
    def network(self) -> ThermalNetwork:
        """Thermal network of all coils."""
        return ThermalNetwork.of_coils(self.model, self.coupling.winding_to_core, self.coupling.core_capacity)

    def endurance(self, rise: float, power: float, coil: int = 0) -> float:
        """Time [s] from cold until the winding's rise is `rise` [K] under `power` [W] in `coil` alone; inf if never."""
        network = self.network
        return network.time_to(rise, power * np.eye(network.windings)[coil])

    def find_sustained_power(self, rise: float, coil: int = 0) -> float:
        """Power [W] in `coil` alone at which the steady-state rise of its winding is `rise` [K]."""
        return rise / float(self.network.rise_per_watt[coil, coil])


def network_identification(record: HeatRecord, names: Sequence[str], guess: Heat) -> NetworkIdentification:
    """Fit windings, bodies and a core to `record`; `names` (m,) of the coils are for messages, `guess` is the start.

    Raises InputError for an invalid record, CalibrationError if a coil is never driven alone or always on, or if the
    record is too short, or heats too little, to determine every value.
    """
    _check_record(record, len(names))
    _check_switching(record, names)
    coupling = guess.coupling or HeatCoupling(2.0 * guess.winding_capacity, (0.3 * guess.winding_to_body,) * len(names))
    begin = np.array([*_coil_values(guess), coupling.core_capacity, *coupling.winding_to_core])
    what = [*_COIL, "core's capacity", *(f"conductance from coil '{name}' to the core" for name in names)]
    values, spread, residual = _fit(record, begin, np.empty(0), what)
    found = HeatCoupling(float(values[4]), tuple(values[5:].tolist()))
    return NetworkIdentification(TwoNode(*values[:4].tolist()), found, spread, residual)


def coil_identification(record: HeatRecord, guess: Heat) -> NetworkIdentification:
    """Fit the coils' four values to `record` with the couplings of `guess` fixed.

    For a record of one coil that was driven: what was not measured of the others is NaN. Raises CalibrationError if it
    does not determine all four; InputError for an invalid record, or if `guess` has no couplings.
    """
    coupling = guess.coupling
    if coupling is None:
        raise InputError("the heat of coupled coils needs couplings; use thermal_identification for a single coil")
    _check_record(record, len(coupling.winding_to_core))
    fixed = np.array([coupling.core_capacity, *coupling.winding_to_core])
    values, spread, residual = _fit(record, np.array(_coil_values(guess)), fixed, list(_COIL))
    return NetworkIdentification(TwoNode(*values.tolist()), coupling, spread, residual)


def _coil_values(heat: Heat) -> tuple[float, ...]:
    return heat.winding_capacity, heat.body_capacity, heat.winding_to_body, heat.body_to_air


def _fit(record: HeatRecord, begin: Array, fixed: Array, what: Sequence[str]) -> tuple[Array, Array, float]:
    """Least-squares fit to `record`: values, their relative standard deviations, and the rms residual [K].

    `begin` is where the search starts, `fixed` what follows it among a network's values: four of each coil, the core's
    capacity, the conductances to it. `what` names those that are searched for.
    """
    n, m = record.power.shape
    measured = np.isfinite(record.winding), np.isfinite(record.boundary)
    outside = np.where(measured[1][0], record.boundary[0], record.ambient)
    inside = np.where(measured[0][0], record.winding[0], outside)
    start = np.concatenate([inside, outside, [outside.mean()]]) - record.ambient
    steps = np.round(np.diff(record.t), 9)

    def remainder(logs: Array) -> Array:
        values = np.concatenate([np.exp(logs), fixed])
        model = ThermalNetwork.of_coils(TwoNode(*values[:4].tolist()), values[5:], float(values[4]))
        step = {dt: model.step(dt) for dt in np.unique(steps).tolist()}
        rises = np.empty((n, 2 * m + 1))
        rises[0] = start
        for k, dt in enumerate(steps.tolist()):
            rises[k + 1] = step[dt] @ np.concatenate([rises[k], record.power[k]])
        gaps = [rises[:, :m] + record.ambient - record.winding, rises[:, m:-1] + record.ambient - record.boundary]
        return np.concatenate([gap[known] for gap, known in zip(gaps, measured, strict=True)])

    # Bounds of a factor of 50 around the start: beyond, a value is not determined, and its steps overflow.
    logs = np.log(begin)
    fit = least_squares(remainder, logs, bounds=(logs - np.log(50.0), logs + np.log(50.0)), x_scale="jac")
    variance = float(fit.fun @ fit.fun) / max(1, len(fit.fun) - len(begin))
    try:
        spread = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)) * variance)  # of a logarithm, hence relative
    except np.linalg.LinAlgError:
        spread = np.full(len(begin), np.inf)
    weak = [name for name, one in zip(what, spread, strict=True) if not one <= _NETWORK_IDENTIFICATION_TRUST]
    if not fit.success or weak:
        raise CalibrationError(
            f"the record ({record.t[-1] - record.t[0]:.0f} s) does not determine the "
            f"{' and the '.join(weak) or 'model'}: drive each coil alone until its boundary flattens (three minutes), "
            "and record the cooling after the last one for as long"
        )
    return np.exp(fit.x), spread, variance**0.5


def _check_record(record: HeatRecord, coils: int) -> None:
    """Raise InputError unless the array sizes match and times increase."""
    times = check_finite(record.t, "t")
    shapes = [np.shape(check_finite(record.power, "power")), np.shape(record.winding),
              np.shape(record.boundary)]  # fmt: skip
    if times.ndim != 1 or any(shape != (len(times), coils) for shape in shapes):
        raise InputError(f"power, winding and boundary must have shape ({len(times)}, {coils}); got {shapes}")
    if len(times) < _MIN_READINGS or not (np.diff(times) > 0).all():
        raise InputError(f"a thermal record needs at least {_MIN_READINGS} readings at rising times")


def _check_switching(record: HeatRecord, names: Sequence[str]) -> None:
    """Raise CalibrationError unless every coil is driven alone, is off at other times, warms and is measured."""
    how = "drive each coil alone for three minutes, the others with a small current only"
    most = float(record.power.max())
    if not most > 0.0:
        raise CalibrationError(f"no coil was heated: {how}")
    check_finite(record.boundary, "boundary temperatures")
    on = record.power > _DRIVEN_POWER_SHARE * most
    for k, name in enumerate(names):
        if on[:, k].all():
            raise CalibrationError(
                f"coil '{name}' is on in the whole record: its heat cannot be separated from that of the others; {how}"
            )
    for k, name in enumerate(names):
        alone = on[:, k] & (on.sum(axis=1) == 1)
        if not on[:, k].any():
            raise CalibrationError(f"coil '{name}' was never heated: {how}")
        if alone.sum() < _MIN_ALONE_READINGS:
            raise CalibrationError(f"coil '{name}' was driven alone in only {alone.sum()} readings: {how}")
        warmed = float(np.ptp(record.boundary[:, k]))
        if warmed < _MIN_BOUNDARY_RISE_K:
            raise CalibrationError(
                f"the boundary of coil '{name}' warmed by only {warmed:.1f} K: heat longer or with more power (the "
                "paper: 30 % duty for 3 minutes)"
            )
        if np.isfinite(record.winding[:, k]).sum() < _MIN_ALONE_READINGS:
            raise CalibrationError(
                f"the winding of coil '{name}' was measured fewer than {_MIN_ALONE_READINGS} times: "
                "keep a small current on"
            )
