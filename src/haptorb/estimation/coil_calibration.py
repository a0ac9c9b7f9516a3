"""Magnetic calibration: moment per ampere of the coils from the field sensors: Zárate 2020 eq. (5), Fig. 7.

Excite each coil over a schedule of currents, read currents and fields, and regress: B_s = U_s M i + H_s i + b_s, with
U_s the field of a unit moment at sensor s, and H_s what a coil of known size adds to its dipole's field. The
off-diagonal terms of M are the coils' non-orthogonality; b_s absorbs the earth's field, a resting tool and the sensors'
offsets. If the device file states placement tolerances of the windings ([tolerance]), each coil's centre is estimated
as well: the maximum a posteriori position, given the sensor errors of the file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.electromagnet_wrench_map import Windings
from haptorb.errors import CalibrationError, InputError
from haptorb.magnetics.dipole import point_field

__all__ = [
    "MagneticCalibration",
    "check_conduction",
    "check_switching",
    "excitation",
    "find_response",
    "find_silent",
    "magnetic_calibration",
]


_MIN_CURRENT_SHARE = 0.2  #: share of the commanded current below which a coil counts as not connected
_SWITCHING_TOLERANCE = 0.5  #: tolerance of the current of a switching coil, relative to the largest commanded current
_MIN_FIELD_SHARE = 0.2  #: share of the expected field below which a sensor does not respond
_SENSORS_PER_SILENT = 4  #: one in so many sensors may be missing
#: iteration limit of the regression of coils with finite size, and its relative tolerance
_MAX_ITERATIONS, _ITERATION_TOLERANCE = 30, 1e-9
_SAME_AXIS_COSINE = 0.8  #: cosine above which a coil's moment counts as being along another coil's axis


@dataclass(frozen=True)
class MagneticCalibration:
    """Result of the regression, with its uncertainty.

    moment_per_current  (3, m) [m²]: m_e = moment_per_current @ currents
    uncertainty         (3, m) standard deviation of each entry [m²]
    offsets             (k, 3) field at zero current [T]
    residual            rms of what the model leaves unexplained [T]
    condition           of the regression: how much worse the worst-determined combination is than the best
    repeatability       greatest relative difference between the results of the odd and the even readings
    failed              sensors, from 0, that do not respond to the coils; they are excluded
    centres             (m, 3) from where each coil's field comes [m], and centre_uncertainty (m, 3) its standard
                        deviations; None where they were not estimated
    """

    moment_per_current: Array
    uncertainty: Array
    offsets: Array
    residual: float
    condition: float
    repeatability: float
    failed: tuple[int, ...] = ()
    centres: Array | None = None
    centre_uncertainty: Array | None = None

    def skew(self, names: tuple[str, ...]) -> dict[tuple[str, str], float]:
        """Angle between each pair of coil axes, minus 90° [rad]."""
        axes = self.moment_per_current / np.linalg.norm(self.moment_per_current, axis=0)
        return {
            (names[i], names[j]): -float(np.arcsin(np.clip(axes[:, i] @ axes[:, j], -1, 1)))
            for i, j in combinations(range(len(names)), 2)
        }

    def apply(self, device: SphericalElectromagnet) -> SphericalElectromagnet:
        """Return `device` with the measured moments in place of those of its file."""
        return replace(
            device, moment_per_current=self.moment_per_current, moments_from="calibration", coil_centres=self.centres
        )


def excitation(device: SphericalElectromagnet, share: float = 0.25, levels: int = 5, repeats: int = 4) -> Array:
    """(n, m) [A] excitation: each coil alone through ± `levels` up to `share` of its limit, with zero current between.

    A quarter of full current heats a coil by less than a kelvin per step of 20 ms.

    Raises InputError for an empty schedule or a share outside 0 to 1.

    >>> from haptorb.devices.loader import load
    >>> excitation(load("omni"), levels=1, repeats=1).tolist()[1]
    [5.0, 0.0, 0.0]
    """
    if not 0.0 < share <= 1.0 or levels < 1 or repeats < 1:
        raise InputError(f"needs 0 < share ≤ 1 and at least one level and repeat; got {share}, {levels}, {repeats}")
    steps = np.arange(1, levels + 1) / levels * share
    rows = []
    for _ in range(repeats):
        for coil, limit in enumerate(device.coils.current_limit):
            for step in steps:
                for sign in (0.0, 1.0, -1.0):
                    row = np.zeros(device.channels)
                    row[coil] = sign * step * limit
                    rows.append(row)
    return np.array(rows)


def magnetic_calibration(
    device: SphericalElectromagnet,
    wanted: ArrayLike,
    currents: ArrayLike,
    fields: ArrayLike,
    axes: ArrayLike | None = None,
) -> MagneticCalibration:
    """Regress moments from `currents` (n, m) [A] and `fields` (n, k, 3) [T] measured under `wanted` (n, m) [A].

    `axes` (k, 3), unit vectors: each sensor measures along its own only, and its reading lies along it; None: they
    measure all three.

    Raises CalibrationError naming the coil that is unplugged, swapped or reversed, or the sensor that does not follow;
    InputError if the schedule does not excite every coil.
    """
    want, i = check_finite(wanted, "wanted currents"), check_finite(currents, "measured currents")
    B = check_finite(fields, "fields")
    count, channels, places = len(i), device.channels, device.sensors
    if want.shape != (count, channels) or i.shape != (count, channels) or B.shape != (count, places, 3):
        raise InputError(
            f"device '{device.name}' needs currents (n, {channels}) and fields (n, {places}, 3); "
            f"got {want.shape}, {i.shape} and {B.shape}"
        )
    visible = (
        np.broadcast_to(np.eye(3), (places, 3, 3)) if axes is None else _project(check_finite(axes, "axes"), places)
    )
    check_conduction(device, want, i)
    failed = find_silent(device, i, B)
    visible = np.where(np.isin(np.arange(places), failed)[:, None, None], 0.0, visible)
    result = _regress(device, visible, i, B)
    _check_wiring(device, result.moment_per_current)
    _check_sensors(device, visible, i, B, result)
    odd, even = (_regress(device, visible, i[k::2], B[k::2], centres=False).moment_per_current for k in (1, 0))
    scale = np.linalg.norm(result.moment_per_current, axis=0)
    return replace(result, repeatability=float((np.abs(odd - even) / scale).max()), failed=failed)


def _project(axes: Array, places: int) -> Array:
    """(k, 3, 3) projection of a field onto the measured axis of each sensor."""
    if axes.shape != (places, 3) or not np.allclose(np.linalg.norm(axes, axis=1), 1.0):
        raise InputError(f"axes must be {places} unit vectors; got shape {axes.shape}")
    projection: Array = axes[:, :, None] * axes[:, None, :]
    return projection


def _regress(
    device: SphericalElectromagnet, visible: Array, i: Array, B: Array, *, centres: bool = True
) -> MagneticCalibration:
    """Least squares for M and the offsets: M = C⁻¹ D S⁻¹ from centred readings, in closed form for point coils.

    centres: whether the coils' centres are estimated as well, within [tolerance].

    `visible` (k, 3, 3) is what each sensor makes of a field. What the field of a coil of known size has beyond its
    dipole's follows from the coil's moment, and is subtracted from the readings iteratively.
    """
    at = device.hall.positions
    U = visible @ point_field(at)  # (k, 3, 3)
    x, y = i - i.mean(axis=0), B - B.mean(axis=0)
    S = x.T @ x
    C = np.einsum("sji,sjk->ik", U, U)
    if np.linalg.cond(S) > 1e6:
        raise InputError("the currents do not excite every coil separately; use the schedule of `excitation`")
    per_ampere = np.einsum("nsi,nm->sim", y, x) @ np.linalg.inv(S)  # (k, 3, m) [T/A] as measured

    def solve(beyond: Array) -> Array:
        """(3, m) far-field moments, after subtracting `beyond` (k, 3, m) from the sensor readings."""
        found: Array = np.linalg.solve(C, np.einsum("sji,sjm->im", U, per_ampere - beyond))
        return found

    M = solve(np.zeros_like(per_ampere))
    beyond = np.zeros_like(per_ampere)
    if device.windings is not None and device.has_sizes:
        for _ in range(_MAX_ITERATIONS):
            before = M
            beyond = visible @ device.windings.field(device.core, M, np.inf, at) - U @ M
            M = solve(beyond)
            if np.abs(M - before).max() < _ITERATION_TOLERANCE * np.abs(M).max():
                break
        else:
            raise CalibrationError(
                "no moments explain the fields: the readings are not those of coils with the sizes in [windings]; "
                "check the sensors' places and the windings"
            )
    made, found, centre_uncertainty = U @ M + beyond, None, None
    if centres and device.windings is not None and device.has_sizes and device.tolerance is not None:
        left = y - np.einsum("sim,nm->nsi", made, x)
        noise = float((left**2).mean()) * np.diag(np.linalg.inv(S))
        M, found, centre_uncertainty = _find_centres(device, visible, per_ampere, M, noise)
        made = visible @ device.windings.field(device.core, M, np.inf, at, centres=found)
    rest = y - np.einsum("sim,nm->nsi", made, x)
    directions = round(float(np.trace(visible, axis1=1, axis2=2).sum()))  # number of measured field components
    freedom = max(1, len(i) * directions - M.size - directions)
    variance = float((rest**2).sum() / freedom)
    stated = np.linalg.norm(device.moment_per_current, axis=0) / np.linalg.norm(device.far_moments, axis=0)
    spread = stated * np.sqrt(variance * np.outer(np.diag(np.linalg.inv(C)), np.diag(np.linalg.inv(S))))
    offsets = B.mean(axis=0) - np.einsum("sim,m->si", made, i.mean(axis=0))
    condition = float(np.linalg.cond(C) * np.linalg.cond(S)) ** 0.5
    return MagneticCalibration(
        stated * M, spread, offsets, variance**0.5, condition, 0.0, (), found, centre_uncertainty
    )


_STEP_M = 1e-5  #: step of a difference quotient by position or size [m]
_RELATIVE_STEP = 1e-4  #: relative step of a difference quotient by a moment
_SHAPE = 1e-3  #: model error from the shape of an offset coil's field, relative to the field
_NEWTON_ITERATIONS = 3  #: Newton iterations for the most likely centres: the field is nearly linear in them


def _find_centres(
    device: SphericalElectromagnet, visible: Array, per_ampere: Array, M: Array, noise: Array
) -> tuple[Array, Array, Array]:
    """Most likely far-field moments (3, m) [m²] and centres (m, 3) [m], with the latter's standard deviations.

    per_ampere (k, 3, m) [T/A] was read, with variances `noise` (m,) [T²/A²]; M are moments without centres.
    """
    fit = _CentreFit(device, visible, M, noise)
    centres, normal = np.zeros((device.channels, 3)), np.empty(0)
    for _ in range(_NEWTON_ITERATIONS):
        design, normal = fit.linearize(M, centres)
        right = design.T @ fit.weight @ (fit.read(per_ampere) - fit.read(fit.model(M, centres)))
        right[M.size :] -= fit.inverse_prior @ centres.ravel()
        step = np.linalg.solve(normal, right)
        M = M + step[: M.size].reshape(M.shape)
        centres = centres + step[M.size :].reshape(centres.shape)
    spread = np.sqrt(np.diag(np.linalg.inv(normal))[M.size :]).reshape(centres.shape)
    return M, centres, spread


def find_response(device: SphericalElectromagnet, M: Array, centres: Array, noise: Array) -> tuple[Array, Array]:
    """Change of the far-field moments (3, m, 3 k m) [m²] and centres (m, 3, 3 k m) [m] that a calibration finds, per
    change of its readings (k, 3, m) [T/A].

    The calibration of `device` found moments M (3, m) [m²] and `centres` (m, 3) [m] from readings with variances
    `noise` (m,) [T²/A²]. Linear about these.
    """
    fit = _CentreFit(device, np.broadcast_to(np.eye(3), (device.sensors, 3, 3)), M, noise)
    design, normal = fit.linearize(M, centres)
    gain = np.asarray(np.linalg.solve(normal, design.T @ fit.weight), dtype=np.float64)
    return gain[: M.size].reshape(*M.shape, -1), gain[M.size :].reshape(*centres.shape, -1)


class _CentreFit:
    """Regression of moments and centres of the coils from fields at the sensors.

    Before anything is read, centres are as [tolerance] says: a winding's own part of the moment moves with the winding,
    the core's with the core. Sizes of windings, gains, axes and places of sensors are off, too, as the file says: what
    they can explain weighs less. Linear about the result, all normal (Gelman et al., Bayesian Data Analysis, §14.8).

    weight         (rows m, rows m) inverse covariance of the readings
    inverse_prior  (3 m, 3 m) of the centres
    """

    def __init__(self, device: SphericalElectromagnet, visible: Array, M: Array, noise: Array) -> None:
        known, hall, windings = device.tolerance, device.hall.errors, device.windings
        assert known is not None
        assert windings is not None
        self._device, self._windings, at = device, windings, device.hall.positions
        channels = device.channels
        values, vectors = np.linalg.eigh(visible)
        self._rows = [vectors[s][:, k] for s in range(len(at)) for k in range(3) if values[s, k] > 0.5]
        self._sensor = [s for s in range(len(at)) for k in range(3) if values[s, k] > 0.5]
        parts = windings.parts(device.core)
        own, answer = (parts / parts.sum(axis=1, keepdims=True)).T
        shift = windings.response_shift(device.core)
        by_core = (answer[:, None, None] * (np.eye(3) + shift)).reshape(-1, 3)
        prior = known.core_position**2 * by_core @ by_core.T + 1e-18 * np.eye(len(by_core))
        for number in range(channels):
            by_winding = own[number] * np.eye(3) - answer[number] * shift[number]
            block = slice(3 * number, 3 * number + 3)
            prior[block, block] += known.position**2 * by_winding @ by_winding.T
        centres, rest = np.zeros((channels, 3)), np.kron(np.eye(len(self._rows)), np.diag(noise))
        base = self.model(M, centres)
        lasting: list[Array] = []
        slopes = [(self.model(M, centres, at + _STEP_M * e) - base) / _STEP_M for e in np.eye(3)]
        for s in range(len(at)):
            for axis in np.eye(3):
                turned, moved = np.zeros_like(base), np.zeros_like(base)
                turned[s] = np.cross(axis, base[s].T).T
                moved[s] = sum(part * slope[s] for part, slope in zip(axis, slopes, strict=True))
                lasting += [hall.angle * self.read(turned), hall.placement * self.read(moved)]
                for other in np.eye(3):
                    mixed = np.zeros_like(base)
                    mixed[s] = np.outer(axis, other @ base[s])
                    lasting.append((hall.gain if axis @ other else hall.cross) * self.read(mixed))
        for name in ("inner_radius", "outer_radius", "length"):
            larger = replace(windings, **{name: getattr(windings, name) + _STEP_M})
            change = (self.model(M, centres, sizes=larger) - base) / _STEP_M
            for coil in np.eye(channels):
                lasting.append(known.winding * self.read(change * coil))
        shape = _SHAPE * np.linalg.norm(base, axis=1)  # (k, m)
        rest += np.diag(np.concatenate([shape[s] ** 2 for s in self._sensor]))
        columns = np.stack(lasting, axis=1)
        self.weight = np.asarray(np.linalg.inv(rest + columns @ columns.T), dtype=np.float64)
        self.inverse_prior = np.asarray(np.linalg.inv(prior), dtype=np.float64)

    def read(self, field: Array) -> Array:
        """(rows m,) readings of a field (k, 3, m)."""
        return np.stack([row @ field[s] for row, s in zip(self._rows, self._sensor, strict=True)]).ravel()

    def model(
        self, moments: Array, centres: Array, places: Array | None = None, sizes: Windings | None = None
    ) -> Array:
        """(k, 3, m) [T/A] field of coils with far-field `moments` (3, m) [m²] at `places` (k, 3) [m]."""
        device = self._device
        at, windings = device.hall.positions if places is None else places, sizes or self._windings
        return windings.field(device.core, moments, np.inf, at, centres=centres)

    def linearize(self, M: Array, centres: Array) -> tuple[Array, Array]:
        """(rows m, 6 m) derivative of the readings by moments and centres, and (6 m, 6 m) normal matrix."""
        base, design = self.model(M, centres), []
        for i in range(3):
            for j in range(len(centres)):
                more = M.copy()
                step = _RELATIVE_STEP * float(np.linalg.norm(M[:, j]))
                more[i, j] += step
                design.append(self.read(self.model(more, centres) - base) / step)
        for j in range(len(centres)):
            for axis in np.eye(3):
                moved = centres.copy()
                moved[j] += _STEP_M * axis
                design.append(self.read(self.model(M, moved) - base) / _STEP_M)
        A = np.stack(design, axis=1)
        normal: Array = A.T @ self.weight @ A
        normal[M.size :, M.size :] += self.inverse_prior
        return A, normal


def find_silent(device: SphericalElectromagnet, currents: Array, fields: Array) -> tuple[int, ...]:
    """Sensors, from 0, whose readings (n, k, 3) [T] do not respond while `currents` (n, m) [A] flow.

    Raises CalibrationError that names them if they are more than a quarter: then the cause is elsewhere.
    """
    at, x = device.hall.positions, currents - currents.mean(axis=0)
    swing = fields - fields.mean(axis=0)
    modelled = np.einsum("sim,nm->nsi", device.coil_fields(at), x)
    signal, answer = (np.sqrt((part**2).mean(axis=(0, 2))) for part in (modelled, swing))
    silent = tuple(int(s) for s in np.flatnonzero(answer < _MIN_FIELD_SHARE * signal))
    if len(silent) > device.sensors // _SENSORS_PER_SILENT:
        names = ", ".join(str(s + 1) for s in silent)
        raise CalibrationError(
            f"field sensors {names} of {device.sensors} do not respond to the coils: check their supply and "
            "connection; "
            f"one in {_SENSORS_PER_SILENT} may be left out"
        )
    return silent


def check_conduction(device: SphericalElectromagnet, wanted: Array, measured: Array) -> None:
    """Check that each coil carries its current in both directions, and no other: `wanted`, `measured` (n, m) [A].

    Raises CalibrationError as `check_switching` does, InputError for a coil that was never commanded a current.
    """
    full = np.abs(wanted).max(axis=0)
    if not full.all():
        raise InputError(
            f"coil '{device.coils.names[int(np.argmin(full))]}' was never excited; use the schedule of `excitation`"
        )
    for want, flowing in zip(wanted, measured, strict=True):
        check_switching(device, want, flowing, full)


def check_switching(device: SphericalElectromagnet, wanted: Array, measured: Array, full: Array) -> None:
    """Check one reading: `wanted` and `measured` (m,) [A], `full` (m,) [A] the largest commanded currents.

    Raises CalibrationError that names a coil which does not conduct, or carries an unwanted current.
    """
    for name, want, flowing, most in zip(device.coils.names, wanted, measured, full, strict=True):
        if abs(want) >= _SWITCHING_TOLERANCE * most and abs(flowing) < _MIN_CURRENT_SHARE * abs(want):
            raise CalibrationError(
                f"coil '{name}' carries {flowing:.2g} A instead of {want:.3g} A: the coil is unplugged, or its "
                "current sensor is; check the connector and the fuse"
            )
        if abs(flowing - want) > _SWITCHING_TOLERANCE * most:
            raise CalibrationError(
                f"coil '{name}' carries {flowing:.2g} A where {want:.3g} A should flow: it does not switch. "
                "Switch off the coils' supply, and check the coil's bridge, its driver and its wiring"
            )


def _check_wiring(device: SphericalElectromagnet, measured: Array) -> None:
    """Compare each coil's axis with those of the device file: the same, another coil's, or reversed."""
    names, nominal = device.coils.names, device.moment_per_current
    cosine = (measured / np.linalg.norm(measured, axis=0)).T @ (nominal / np.linalg.norm(nominal, axis=0))
    for coil, name in enumerate(names):
        like = int(np.abs(cosine[coil]).argmax())
        if like != coil and abs(cosine[coil, like]) > _SAME_AXIS_COSINE:
            raise CalibrationError(
                f"coil '{name}' produces the moment of coil '{names[like]}': swap their connectors back"
            )
        if cosine[coil, coil] < -_SAME_AXIS_COSINE:
            raise CalibrationError(f"coil '{name}' produces a reversed moment: swap its two wires")
        if cosine[coil, coil] < _SAME_AXIS_COSINE:
            off = np.degrees(np.arccos(np.clip(cosine[coil, coil], -1, 1)))
            raise CalibrationError(
                f"coil '{name}' points {off:.0f}° away from its direction in the device file; check that it is "
                "mounted correctly"
            )


def _check_sensors(
    device: SphericalElectromagnet, visible: Array, i: Array, B: Array, result: MagneticCalibration
) -> None:
    """Check that each sensor that has not failed agrees with the others."""
    at = device.hall.positions
    x, y = i - i.mean(axis=0), B - B.mean(axis=0)
    made = result.apply(device).coil_fields(at)
    for s in range(len(at)):
        if not visible[s].any():
            continue
        modelled = x @ (visible[s] @ made[s]).T
        excess = float(((y[:, s] - modelled) ** 2).mean() ** 0.5)
        signal = float((modelled**2).mean() ** 0.5)
        if excess > 0.3 * signal + 6 * device.hall.noise:
            raise CalibrationError(
                f"field sensor {s + 1} of {len(at)}, at {np.round(1e3 * at[s], 1).tolist()} mm, does not follow the "
                f"coils (rms {1e3 * excess:.2g} mT off, {1e3 * signal:.2g} mT expected): check its connection and "
                "direction"
            )
