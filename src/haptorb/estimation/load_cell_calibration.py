"""Calibration with a load cell: moments per ampere, centres of the coils, strength of the magnet.

The tool is fixed to the cell, anywhere in its workspace, while currents flow; each row of the table has its pose, the
currents, and the force and torque on it. The most likely values follow by least squares from these and from the prior:
the field sensors' calibration, and the tolerances of the device file. The fit includes the effect of a misplaced core
on its pull, and a constant wrench of the cell (its zero, the tool's weight).
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import State
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError, quote
from haptorb.estimation.calibration_file import Calibration
from haptorb.file_kind import FileKind
from haptorb.files import read_text
from haptorb.rotations import rotate

__all__ = ["LoadRecord", "calibrate_by_loads", "check_loads", "list_columns", "read_loads"]

_MOST_BYTES = 16 * 1024 * 1024
_MAX_VALUE = 1e6  #: of any value, in its unit
_MIN_READINGS = 12  #: per record
_MIN_POSITIONS, _MIN_DISTANCE_M = 6, 5e-3  #: minimum number of tool positions, and their minimum distance [m]
_MIN_CURRENT_SHARE = 0.1  #: minimum current relative to a coil's limit
_MIN_DRIVEN_READINGS = 3  #: with that current
_MAX_DISTANCE_M = 1.0  #: maximum plausible distance [m]
_MOMENT_SIGMA = 0.005  #: relative uncertainty of moments measured by field sensors, in addition to their noise
_ZERO_SIGMA = (0.2, 0.01)  #: standard deviations of the cell's zero offset: force [N] and torque [N·m]
_MIN_NOISE = (1e-4, 1e-6)  #: minimum noise of a reading [N, N·m]
_ROUNDS, _STEP = 6, 1e-4
_MAX_RESIDUAL_SHARE = 0.2  #: maximum residual relative to the forces' rms


@dataclass(frozen=True)
class LoadRecord:
    """Readings of a load cell, the tool's pose and the currents."""

    p: Array  #: (n, 3) the magnet's centre [m]
    R: Array  #: (n, 3, 3) the tool's orientation
    currents: Array  #: (n, m) [A]
    wrench: Array  #: (n, 6) on the tool, torque about the magnet's centre [N, N·m]

    def __len__(self) -> int:
        return len(self.p)


def list_columns(device: SphericalElectromagnet) -> tuple[str, ...]:
    """Columns of a table of loads on `device`.

    >>> from haptorb.devices.loader import load
    >>> list_columns(load("omni"))[7:10]
    ('current_x_a', 'current_y_a', 'current_z_a')
    """
    currents = tuple(f"current_{name}_a" for name in device.coils.names)
    return ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", *currents, "fx_n", "fy_n", "fz_n", "tx_nm", "ty_nm", "tz_nm")


def read_loads(path: str | Path, device: SphericalElectromagnet) -> LoadRecord:
    """Read the table from a file; CalibrationError with the invalid line or the missing column."""
    columns, place = list_columns(device), Path(path).expanduser()
    text = read_text(place, "table of loads", CalibrationError, _MOST_BYTES, FileKind.TABLE)
    try:
        rows = np.array(list(_list_rows(text, place, columns, device.name)), dtype=np.float64)
    except csv.Error as cause:
        raise CalibrationError(f"table of loads {place}: is not a table ({cause})") from cause
    rows = rows.reshape(-1, len(columns))
    m = device.channels
    lengths = np.linalg.norm(rows[:, 3:7], axis=1)
    if (np.abs(lengths - 1) > 0.01).any():
        line = int(np.argmax(np.abs(lengths - 1))) + 2
        raise CalibrationError(f"{place}, line {line}: qx, qy, qz, qw have length {lengths[line - 2]:.3g} instead of 1")
    R = np.empty((len(rows), 3, 3))
    for n, q in enumerate(rows[:, 3:7] / lengths[:, None]):
        R[n] = np.stack([rotate(q, axis) for axis in np.eye(3)], axis=1)
    record = LoadRecord(rows[:, :3], R, rows[:, 7 : 7 + m], rows[:, 7 + m :])
    check_loads(record, device, str(place))
    return record


def _list_rows(text: str, path: Path, columns: tuple[str, ...], name: str) -> Iterator[list[float]]:
    reader = csv.DictReader(io.StringIO(text))
    missing = [column for column in columns if column not in (reader.fieldnames or ())]
    if missing:
        raise CalibrationError(
            f"{path}: column {missing[0]} is missing; a table of loads on '{name}' has {', '.join(columns)}"
        )
    for line in reader:
        cells = [(line[column] or "").strip() for column in columns]
        try:
            row = [float(cell) for cell in cells]
        except ValueError as cause:
            raise CalibrationError(f"{path}, line {reader.line_num}: not numbers: {quote(cells)}") from cause
        if not (np.abs(row) < _MAX_VALUE).all():
            raise CalibrationError(
                f"{path}, line {reader.line_num}: numbers must be below {_MAX_VALUE:g}: {quote(cells)}"
            )
        yield row


def check_loads(record: LoadRecord, device: SphericalElectromagnet, name: str) -> None:
    """Raise CalibrationError unless the readings determine the unknowns."""
    if len(record) < _MIN_READINGS:
        raise CalibrationError(f"{name} has {len(record)} readings; at least {_MIN_READINGS} are needed")
    away = np.linalg.norm(record.p, axis=1)
    if not (away < _MAX_DISTANCE_M).all():
        raise CalibrationError(f"{name}: the tool is up to {away.max():.3g} m away; x_m, y_m and z_m are in metres")
    least = device.core_radius + device.tool.length / 2
    if (away <= least).any():
        raise CalibrationError(
            f"{name}: the magnet's centre is {1e3 * away.min():.1f} mm from the device's centre, within its core; "
            "x_m, y_m and z_m are of the magnet's centre, in the device's frame"
        )
    places: list[Array] = []
    for p in record.p:
        if all(np.linalg.norm(p - one) >= _MIN_DISTANCE_M for one in places):
            places.append(p)
    if len(places) < _MIN_POSITIONS:
        raise CalibrationError(
            f"{name}: the tool was at {len(places)} places that are {1e3 * _MIN_DISTANCE_M:g} mm apart; measure at "
            f"{_MIN_POSITIONS} or more, near and far, on all sides"
        )
    for number, coil in enumerate(device.coils.names):
        limit = float(device.coils.current_limit[number])
        enough = int((np.abs(record.currents[:, number]) >= _MIN_CURRENT_SHARE * limit).sum())
        if enough < _MIN_DRIVEN_READINGS:
            raise CalibrationError(
                f"{name}: coil '{coil}' carries {_MIN_CURRENT_SHARE * limit:.3g} A or more in {enough} readings; "
                "measure at least "
                f"{_MIN_DRIVEN_READINGS} with it"
            )
    centred = record.currents - record.currents.mean(axis=0)
    if np.linalg.matrix_rank(centred, tol=1e-3 * np.abs(record.currents).max()) < device.channels:
        raise CalibrationError(f"{name}: the coils' currents change together; measure with each coil alone, too")


@dataclass(frozen=True)
class _Unknown:
    """Current values of the unknowns."""

    moments: Array  #: (3, m) [m²]
    centres: Array  #: (m, 3) [m]
    strength: float
    core: Array  #: (3,) [m]
    zero: Array  #: (6,) [N, N·m]

    def step(self, x: Array) -> _Unknown:
        """The unknowns plus the increment `x`."""
        k = self.moments.size
        return _Unknown(
            self.moments + x[:k].reshape(self.moments.shape), self.centres + x[k : 2 * k].reshape(self.centres.shape),
            self.strength + float(x[2 * k]), self.core + x[2 * k + 1 : 2 * k + 4], self.zero + x[2 * k + 4 :],
        )  # fmt: skip


def calibrate_by_loads(
    device: SphericalElectromagnet, known: Calibration, record: LoadRecord
) -> tuple[Calibration, Array]:
    """Update `known` by the loads; also returns (2,) the rms residuals [N, N·m].

    Gauss–Newton, with the residual as each reading's noise (Bayesian least squares with the standard deviations of
    `known` and of the file). CalibrationError if the forces do not fit the device.
    """
    believed, tolerance = known.apply(device), device.tolerance
    channels, sizes = device.channels, np.linalg.norm(known.moment_per_current, axis=0)
    centres = np.zeros((channels, 3)) if known.centres is None else known.centres
    off = 0.0 if tolerance is None or not device.has_sizes else tolerance.position
    spread = np.full((channels, 3), off) if known.centre_uncertainty is None else known.centre_uncertainty
    prior = np.concatenate([
        np.hypot(known.uncertainty, _MOMENT_SIGMA * sizes).ravel(), spread.ravel(), [device.uncertainty.remanence],
        np.full(3, 0.0 if tolerance is None else tolerance.core_position),
        np.full(3, _ZERO_SIGMA[0]), np.full(3, _ZERO_SIGMA[1]),
    ]) + 1e-15  # fmt: skip
    start = _Unknown(known.moment_per_current, centres, 1.0, np.zeros(3), np.zeros(6))
    scales = np.concatenate([np.tile(sizes, 3), np.full(centres.size, 0.1), [1.0], np.full(3, 0.1)])
    now, gone = start, np.zeros(len(prior))
    noise = np.array([0.02, 0.02]) * np.sqrt([(record.wrench[:, :3] ** 2).mean(), (record.wrench[:, 3:] ** 2).mean()])
    noise = np.maximum(noise, _MIN_NOISE)
    for _ in range(_ROUNDS):
        base = _predict(believed, now, record)
        left = record.wrench - base
        columns = []
        for number, scale in enumerate(scales):
            x = np.zeros(len(prior))
            x[number] = _STEP * scale
            columns.append((_predict(believed, now.step(x), record) - base).ravel() / x[number])
        columns += [np.tile(unit, len(record)) for unit in np.eye(6)]
        A, weight = np.stack(columns, axis=1), np.tile(np.repeat(noise**-2, 3), len(record))
        normal = A.T @ (weight[:, None] * A) + np.diag(prior**-2)
        x = np.linalg.solve(normal, A.T @ (weight * left.ravel()) - gone / prior**2)
        now, gone = now.step(x), gone + x
        left = record.wrench - _predict(believed, now, record)
        rms = np.sqrt([(left[:, :3] ** 2).mean(), (left[:, 3:] ** 2).mean()])
        noise = np.maximum(rms, _MIN_NOISE)
    size = float(np.sqrt((record.wrench[:, :3] ** 2).mean()))
    if not np.isfinite(rms).all() or rms[0] > _MAX_RESIDUAL_SHARE * size:
        raise CalibrationError(
            f"the loads are not those of device '{device.name}': {1e3 * rms[0]:.3g} mN rms of {1e3 * size:.3g} mN are "
            "left; check the frame of the poses (metres, magnet's centre), the signs of the forces (on the tool) and "
            "the order of the coils"
        )
    deviation, k = np.sqrt(np.diag(np.linalg.inv(normal))), known.moment_per_current.size
    placed = known.centres is not None or off > 0
    return replace(
        known,
        moment_per_current=now.moments,
        uncertainty=deviation[:k].reshape(known.uncertainty.shape),
        centres=now.centres if placed else None,
        centre_uncertainty=deviation[k : 2 * k].reshape(now.centres.shape) if placed else None,
        strength=now.strength,
        strength_uncertainty=float(deviation[2 * k]),
    ), rms


def _predict(device: SphericalElectromagnet, x: _Unknown, record: LoadRecord) -> Array:
    """(n, 6) predicted wrenches of the readings."""
    made = replace(device, moment_per_current=x.moments, coil_centres=x.centres if device.has_sizes else None)
    found, still = np.empty((len(record), 6)), np.zeros(3)
    for n in range(len(record)):
        wrench_map = made.wrench_map(State(0.0, record.R[n], record.p[n], still, still), device.models[0])
        pulled = device.passive_pull.wrench(record.p[n] - x.core, np.ascontiguousarray(record.R[n][:, 2]))
        found[n] = x.strength * wrench_map.matrix @ record.currents[n] + x.strength**2 * pulled + x.zero
    return found
