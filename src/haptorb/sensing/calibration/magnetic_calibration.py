"""What an ampere does to the electromagnet's moment, measured by the field sensors: Zárate 2020 eq. (5), Fig. 7.

Excite each coil over a schedule of currents, read currents and fields, and regress: B_s = U_s M i + b_s, with U_s the
field of a unit moment at sensor s. The off-diagonal terms of M are the coils' non-orthogonality; b_s takes up the
earth, a resting tool and the sensors' offsets.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError, InputError
from haptorb.numerics.arrays import Array, check_finite
from haptorb.physics.sources import dipole

__all__ = [
    "MagneticCalibration",
    "check_conduction",
    "check_switching",
    "excitation",
    "find_silent",
    "magnetic_calibration",
]

_DEAD = 0.2  #: share of the wanted current below which a coil counts as not connected
_AMISS = 0.5  #: share of the greatest wanted current by which the current of a coil that switches is never wrong
_SILENT = 0.2  #: share of the expected field below which a sensor does not answer
_MOST_SILENT = 4  #: one of so many sensors may be missing
_ALIKE = 0.8  #: cosine from which a coil's moment counts as being along another coil's axis


@dataclass(frozen=True)
class MagneticCalibration:
    """The regression's result, and how far it may be trusted.

    moment_per_current  (3, m) [m²]: m_e = moment_per_current @ currents
    uncertainty         (3, m) standard deviation of each entry [m²]
    offsets             (k, 3) field at zero current [T]
    residual            rms of what the model leaves unexplained [T]
    condition           of the regression: how much worse the worst-determined combination is than the best
    repeatability       greatest relative difference between the results of the odd and the even readings
    failed              sensors, from 0, that do not answer the coils at all: they are left out
    """

    moment_per_current: Array
    uncertainty: Array
    offsets: Array
    residual: float
    condition: float
    repeatability: float
    failed: tuple[int, ...] = ()

    def skew(self, names: tuple[str, ...]) -> dict[tuple[str, str], float]:
        """Angle between each two coils' axes, less 90° [rad]."""
        axes = self.moment_per_current / np.linalg.norm(self.moment_per_current, axis=0)
        return {
            (names[i], names[j]): -float(np.arcsin(np.clip(axes[:, i] @ axes[:, j], -1, 1)))
            for i, j in combinations(range(len(names)), 2)
        }

    def apply(self, device: SphericalElectromagnet) -> SphericalElectromagnet:
        """`device` with the measured moments in place of those of its file."""
        return replace(device, moment_per_current=self.moment_per_current, moments_from="calibration")


def excitation(device: SphericalElectromagnet, share: float = 0.25, levels: int = 5, repeats: int = 4) -> Array:
    """(n, m) [A] a schedule: each coil alone through ± `levels` up to `share` of its limit, with rests at zero between.

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
    odd, even = (_regress(device, visible, i[k::2], B[k::2]).moment_per_current for k in (1, 0))
    scale = np.linalg.norm(result.moment_per_current, axis=0)
    return replace(result, repeatability=float((np.abs(odd - even) / scale).max()), failed=failed)


def _project(axes: Array, places: int) -> Array:
    """(k, 3, 3) what a sensor makes of a field: its part along the sensor's axis."""
    if axes.shape != (places, 3) or not np.allclose(np.linalg.norm(axes, axis=1), 1.0):
        raise InputError(f"axes must be {places} unit vectors; got shape {axes.shape}")
    projection: Array = axes[:, :, None] * axes[:, None, :]
    return projection


def _regress(device: SphericalElectromagnet, visible: Array, i: Array, B: Array) -> MagneticCalibration:
    """Linear least squares for M and the offsets, in closed form: M = C⁻¹ D S⁻¹ from centred readings.

    `visible` (k, 3, 3) is what each sensor makes of a field.
    """
    at = device.hall.positions
    U = visible @ np.stack([dipole.field(np.broadcast_to(e, at.shape), at) for e in np.eye(3)], axis=2)  # (k, 3, 3)
    x, y = i - i.mean(axis=0), B - B.mean(axis=0)
    S = x.T @ x
    C = np.einsum("sji,sjk->ik", U, U)
    D = np.einsum("sji,nsj,nm->im", U, y, x)
    if np.linalg.cond(S) > 1e6:
        raise InputError("the currents do not excite every coil separately; use the schedule of `excitation`")
    M = np.linalg.solve(C, D) @ np.linalg.inv(S)
    rest = y - np.einsum("sij,jm,nm->nsi", U, M, x)
    directions = round(float(np.trace(visible, axis1=1, axis2=2).sum()))  # that are measured at all
    freedom = max(1, len(i) * directions - M.size - directions)
    variance = float((rest**2).sum() / freedom)
    spread = np.sqrt(variance * np.outer(np.diag(np.linalg.inv(C)), np.diag(np.linalg.inv(S))))
    offsets = B.mean(axis=0) - np.einsum("sij,jm,m->si", U, M, i.mean(axis=0))
    condition = float(np.linalg.cond(C) * np.linalg.cond(S)) ** 0.5
    return MagneticCalibration(M, spread, offsets, variance**0.5, condition, 0.0)


def find_silent(device: SphericalElectromagnet, currents: Array, fields: Array) -> tuple[int, ...]:
    """Sensors, from 0, whose readings (n, k, 3) [T] stay where they are while `currents` (n, m) [A] flow.

    Raises CalibrationError that names them where they are more than a quarter: then it is not the sensors.
    """
    at, x = device.hall.positions, currents - currents.mean(axis=0)
    swing = fields - fields.mean(axis=0)
    modelled = np.stack([dipole.field(device.moment_per_current @ row, at) for row in x])
    signal, answer = (np.sqrt((part**2).mean(axis=(0, 2))) for part in (modelled, swing))
    silent = tuple(int(s) for s in np.flatnonzero(answer < _SILENT * signal))
    if len(silent) > device.sensors // _MOST_SILENT:
        names = ", ".join(str(s + 1) for s in silent)
        raise CalibrationError(
            f"field sensors {names} of {device.sensors} do not respond to the coils: check their supply and "
            "connection; "
            f"one in {_MOST_SILENT} may be left out"
        )
    return silent


def check_conduction(device: SphericalElectromagnet, wanted: Array, measured: Array) -> None:
    """Every coil must carry its commanded current in both directions, and no other: `wanted`, `measured` (n, m) [A].

    Raises CalibrationError as `check_switching` does, InputError for a coil that was never asked to carry a current.
    """
    full = np.abs(wanted).max(axis=0)
    if not full.all():
        raise InputError(
            f"coil '{device.coils.names[int(np.argmin(full))]}' was never excited; use the schedule of `excitation`"
        )
    for want, flowing in zip(wanted, measured, strict=True):
        check_switching(device, want, flowing, full)


def check_switching(device: SphericalElectromagnet, wanted: Array, measured: Array, full: Array) -> None:
    """One reading: `wanted` and `measured` (m,) [A], `full` (m,) [A] the greatest currents that are wanted at all.

    Raises CalibrationError that names a coil which does not conduct, or carries an unwanted current.
    """
    for name, want, flowing, most in zip(device.coils.names, wanted, measured, full, strict=True):
        if abs(want) >= _AMISS * most and abs(flowing) < _DEAD * abs(want):
            raise CalibrationError(
                f"coil '{name}' carries {flowing:.2g} A instead of {want:.3g} A: the coil is unplugged, or its "
                "current sensor is; check the connector and the fuse"
            )
        if abs(flowing - want) > _AMISS * most:
            raise CalibrationError(
                f"coil '{name}' carries {flowing:.2g} A where {want:.3g} A should flow: it does not switch. "
                "Switch off the coils' supply, and check the coil's bridge, its driver and its wiring"
            )


def _check_wiring(device: SphericalElectromagnet, measured: Array) -> None:
    """Compare each coil's axis with those of the device file: the same, another's, or the other way round?"""
    names, nominal = device.coils.names, device.moment_per_current
    cosine = (measured / np.linalg.norm(measured, axis=0)).T @ (nominal / np.linalg.norm(nominal, axis=0))
    for coil, name in enumerate(names):
        like = int(np.abs(cosine[coil]).argmax())
        if like != coil and abs(cosine[coil, like]) > _ALIKE:
            raise CalibrationError(
                f"coil '{name}' produces the moment of coil '{names[like]}': swap their connectors back"
            )
        if cosine[coil, coil] < -_ALIKE:
            raise CalibrationError(f"coil '{name}' produces a reversed moment: swap its two wires")
        if cosine[coil, coil] < _ALIKE:
            off = np.degrees(np.arccos(np.clip(cosine[coil, coil], -1, 1)))
            raise CalibrationError(
                f"coil '{name}' points {off:.0f}° away from its direction in the device file; check that it is "
                "mounted correctly"
            )


def _check_sensors(
    device: SphericalElectromagnet, visible: Array, i: Array, B: Array, result: MagneticCalibration
) -> None:
    """Every sensor that has not failed must see what the others agree on."""
    at = device.hall.positions
    x, y = i - i.mean(axis=0), B - B.mean(axis=0)
    for s in range(len(at)):
        if not visible[s].any():
            continue
        modelled = np.array([visible[s] @ dipole.field(result.moment_per_current @ row, at[s]) for row in x])
        excess = float(((y[:, s] - modelled) ** 2).mean() ** 0.5)
        signal = float((modelled**2).mean() ** 0.5)
        if excess > 0.3 * signal + 6 * device.hall.noise:
            raise CalibrationError(
                f"field sensor {s + 1} of {len(at)}, at {np.round(1e3 * at[s], 1).tolist()} mm, does not follow the "
                f"coils (rms {1e3 * excess:.2g} mT off, {1e3 * signal:.2g} mT expected): check its connection and "
                "direction"
            )
