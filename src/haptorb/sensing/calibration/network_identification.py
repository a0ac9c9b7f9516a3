"""How coils warm each other, from one record in which each was driven alone and all were watched.

The windings are their own thermometers: a resistance gives a temperature while a small current flows. Each boundary has
a sensor. Coils are taken to be alike but for their conductance to the core.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from haptorb.devices.device import Heat, HeatCoupling
from haptorb.errors import CalibrationError, InputError
from haptorb.numerics.arrays import Array, check_finite
from haptorb.physics.thermal import TwoNode
from haptorb.physics.thermal_network import ThermalNetwork

__all__ = ["HeatRecord", "NetworkIdentification", "coil_identification", "network_identification"]

_TRUST = 0.25  #: relative standard deviation of a value above which the record does not determine it
_FEWEST = 20  #: readings of a record
_ON = 0.25  #: share of the record's greatest power from which on a coil counts as driven
_ALONE = 10  #: readings at least in which a coil is driven and no other is
_COIL = ("winding capacity", "body capacity", "conductance from winding to body", "conductance to the air")
_WARM = 2.0  #: by which each boundary must warm [K]


@dataclass(frozen=True)
class HeatRecord:
    """What was measured of m coils at n times.

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
    """The values found, how sure each is (relative standard deviation), and what they leave unexplained."""

    model: TwoNode  #: of each coil
    coupling: HeatCoupling
    uncertainty: Array  #: (4,) of the model's values; then, where they were fitted too, of core and conductances to it
    residual: float  #: rms [K]

    @property
    def network(self) -> ThermalNetwork:
        """All coils together."""
        return ThermalNetwork.of_coils(self.model, self.coupling.winding_to_core, self.coupling.core_capacity)

    def endurance(self, rise: float, power: float, coil: int = 0) -> float:
        """Seconds from cold until the winding's rise is `rise` [K] under `power` [W] in `coil` alone; inf if never."""
        network = self.network
        return network.time_to(rise, power * np.eye(network.windings)[coil])

    def find_sustained_power(self, rise: float, coil: int = 0) -> float:
        """The power [W] in `coil` alone at which its winding's rise settles at `rise` [K]."""
        return rise / float(self.network.rise_per_watt[coil, coil])


def network_identification(record: HeatRecord, names: Sequence[str], guess: Heat) -> NetworkIdentification:
    """Fit windings, bodies and a core to `record`; `names` (m,) of the coils are for messages, `guess` is the start.

    Raises InputError if it is no record, CalibrationError if a coil is never driven alone or always on, or if the
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
    """Fit the coils' four values to `record` with the couplings of `guess` as they are.

    For a record of one coil that was driven: what was not measured of the others is NaN. Raises CalibrationError if it
    does not determine all four; InputError if it is no record, or `guess` has no couplings.
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
    """Values that explain `record`, their relative standard deviations, and the rms of what is left [K].

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

    # Within a factor of 50 of the start: what runs further away is not determined, and its steps overflow.
    logs = np.log(begin)
    fit = least_squares(remainder, logs, bounds=(logs - np.log(50.0), logs + np.log(50.0)), x_scale="jac")
    variance = float(fit.fun @ fit.fun) / max(1, len(fit.fun) - len(begin))
    try:
        spread = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)) * variance)  # of a logarithm: relative
    except np.linalg.LinAlgError:
        spread = np.full(len(begin), np.inf)
    weak = [name for name, one in zip(what, spread, strict=True) if not one <= _TRUST]
    if not fit.success or weak:
        raise CalibrationError(
            f"the record ({record.t[-1] - record.t[0]:.0f} s) does not determine the "
            f"{' and the '.join(weak) or 'model'}: drive each coil alone until its boundary flattens (three minutes), "
            "and record the cooling after the last one for as long"
        )
    return np.exp(fit.x), spread, variance**0.5


def _check_record(record: HeatRecord, coils: int) -> None:
    """InputError unless the arrays fit each other and time runs forward."""
    times = check_finite(record.t, "t")
    shapes = [np.shape(check_finite(record.power, "power")), np.shape(record.winding),
              np.shape(record.boundary)]  # fmt: skip
    if times.ndim != 1 or any(shape != (len(times), coils) for shape in shapes):
        raise InputError(f"power, winding and boundary must have shape ({len(times)}, {coils}); got {shapes}")
    if len(times) < _FEWEST or not (np.diff(times) > 0).all():
        raise InputError(f"a thermal record needs at least {_FEWEST} readings at rising times")


def _check_switching(record: HeatRecord, names: Sequence[str]) -> None:
    """CalibrationError unless every coil is driven alone, is off at other times, warms and is measured."""
    how = "drive each coil alone for three minutes, the others with a small current only"
    most = float(record.power.max())
    if not most > 0.0:
        raise CalibrationError(f"no coil was heated: {how}")
    check_finite(record.boundary, "boundary temperatures")
    on = record.power > _ON * most
    for k, name in enumerate(names):
        if on[:, k].all():
            raise CalibrationError(
                f"coil '{name}' is on in the whole record: its heat cannot be separated from that of the others; {how}"
            )
    for k, name in enumerate(names):
        alone = on[:, k] & (on.sum(axis=1) == 1)
        if not on[:, k].any():
            raise CalibrationError(f"coil '{name}' was never heated: {how}")
        if alone.sum() < _ALONE:
            raise CalibrationError(f"coil '{name}' was driven alone in only {alone.sum()} readings: {how}")
        warmed = float(np.ptp(record.boundary[:, k]))
        if warmed < _WARM:
            raise CalibrationError(
                f"the boundary of coil '{name}' warmed by only {warmed:.1f} K: heat longer or with more power (the "
                "paper: 30 % duty for 3 minutes)"
            )
        if np.isfinite(record.winding[:, k]).sum() < _ALONE:
            raise CalibrationError(
                f"the winding of coil '{name}' was measured fewer than {_ALONE} times: keep a small current on"
            )
