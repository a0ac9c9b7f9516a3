"""Thermal record of heating and cooling, from a recording of the loop or from a CSV table."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import Device
from haptorb.errors import CalibrationError, quote
from haptorb.estimation.calibration_file import MeasuredHeat
from haptorb.estimation.heat_calibration import (
    HeatRecord,
    NetworkIdentification,
    ThermalIdentification,
    network_identification,
    thermal_identification,
)
from haptorb.file_kind import FileKind
from haptorb.files import read_text
from haptorb.thermal import winding_temperature

__all__ = ["ThermalRecord", "thermal_record"]


# --------------------------------------------------------------------------------------------------
# A record of heating and cooling: from a recording of the loop, or from a CSV table.
#
# It holds all coupled coils, or one of several identical coils without coupling.


_COLUMNS = ("power_w", "winding_degc", "boundary_degc")  #: columns for one coil; for several power_NAME_w and so on
_MAX_TABLE_BYTES = 128 * 1024 * 1024  #: of a table
_BIN_S = 0.5  #: averaging window of a recording's readings
_MAX_DURATION_S = 30 * 24 * 3600.0  #: [s]
_MAX_VALUE = 1e6  #: largest accepted value in any unit
_MAX_READINGS = 1_000_000  #: readings in a table
_MIN_CURRENT_A = 0.5  #: current from which the resistance gives a usable temperature


@dataclass(frozen=True)
class ThermalRecord:
    """Temperatures and powers of all coils of `device`, or of one if they are not coupled.

    A winding temperature is NaN where the current was too small to measure the resistance.
    """

    measured: HeatRecord
    device: Device

    def identify(self) -> ThermalIdentification | NetworkIdentification:
        """Identify the thermal model; CalibrationError if the record is too short or cool, or drove coils together."""
        record, coils = self.measured, self.device.coils
        if coils.heat.coupling is not None:
            return network_identification(record, coils.names, coils.heat)
        power, winding, boundary = record.power[:, 0], record.winding[:, 0], record.boundary[:, 0]
        return thermal_identification(record.t, power, winding, boundary, record.ambient)

    def measure(self) -> MeasuredHeat:
        """Return the identified heat parameters as a calibration stores them."""
        found = self.identify()
        return MeasuredHeat(found.model, found.coupling if isinstance(found, NetworkIdentification) else None)


def thermal_record(path: str | Path, device: Device) -> ThermalRecord:
    """Read `path`: an MCAP recording of `device`, or CSV with the columns t_s, power_w, winding_degc (may be empty),
    boundary_degc; for coupled coils t_s, and power_NAME_w, winding_NAME_degc, boundary_NAME_degc of each coil. The
    ambient temperature is the boundary's at the start: begin cold."""
    place = Path(path).expanduser()
    table = place.suffix.lower() == ".csv"
    return ThermalRecord(_from_table(place, device) if table else _from_recording(place, device), device)


def _columns(device: Device) -> tuple[str, ...]:
    """Return the column names: t_s, then powers, windings and boundaries, each of all coils."""
    if device.coils.heat.coupling is None:
        return ("t_s", *_COLUMNS)
    named = (column.rsplit("_", 1) for column in _COLUMNS)
    return ("t_s", *(f"{what}_{name}_{unit}" for what, unit in named for name in device.coils.names))


def _from_table(path: Path, device: Device) -> HeatRecord:
    columns = _columns(device)
    text = read_text(path, "thermal record", CalibrationError, _MAX_TABLE_BYTES, FileKind.TABLE)
    rows = []
    try:
        reader = csv.DictReader(io.StringIO(text, newline=""))
        missing = [name for name in columns if name not in (reader.fieldnames or ())]
        if missing:
            raise CalibrationError(
                f"{path}: column {missing[0]} is missing; a thermal record of '{device.name}' has {', '.join(columns)}"
            )
        for line in reader:
            cells = [(line[name] or "").strip() for name in columns]
            try:
                rows.append([float(cell) if cell else np.nan for cell in cells])
            except ValueError as cause:
                raise CalibrationError(f"{path}, line {reader.line_num}: not numbers: {quote(cells)}") from cause
            if len(rows) > _MAX_READINGS:
                raise CalibrationError(f"{path}: a thermal record has at most {_MAX_READINGS} readings")
    except csv.Error as cause:
        raise CalibrationError(f"thermal record {path}: is not a table ({cause})") from cause
    if len(rows) < 20:
        raise CalibrationError(f"{path} has {len(rows)} readings; a thermal record needs at least 20")
    table = np.array(rows)
    k = (len(columns) - 1) // 3
    power, winding, boundary = table[:, 1 : 1 + k], table[:, 1 + k : 1 + 2 * k], table[:, 1 + 2 * k :]
    whole = np.isfinite(np.column_stack([table[:, 0], power, boundary])).all(axis=1)
    if not whole.all():
        first = int(np.flatnonzero(~whole)[0]) + 2
        raise CalibrationError(f"{path}, line {first}: t_s, power and boundary temperature must be numbers")
    _check_series(path, table[:, 0], np.nan_to_num(table[:, 1:], nan=0.0, posinf=np.inf, neginf=-np.inf))
    outside = boundary + 273.15
    return HeatRecord(table[:, 0], power, winding + 273.15, outside, float(outside[:3].mean()))


def _check_series(path: Path, t: Array, values: Array) -> None:
    """Raise CalibrationError unless time increases, for a month at most, and all values are plausible."""
    if not (np.abs(t) < _MAX_DURATION_S).all() or not (np.diff(t) >= 0).all():
        raise CalibrationError(f"{path}: time must be in seconds and increase, for {_MAX_DURATION_S:.3g} s at most")
    if not (np.abs(values) < _MAX_VALUE).all():
        raise CalibrationError(
            f"{path}: powers [W], currents [A], resistances [Ω] and temperatures [°C] must be below {_MAX_VALUE:g}"
        )


def _from_recording(path: Path, device: Device) -> HeatRecord:
    from haptorb.recording.recording import Recording

    recording = Recording(path)
    noted = recording.metadata.get("device", {})
    if noted.get("digest", device.digest) != device.digest:
        raise CalibrationError(
            f"{path} was recorded on device {quote(noted.get('name'))} with file {quote(noted['digest'][:12])[1:-1]}, "
            f"not on '{device.name}' with file {device.digest[:12]}"
        )
    if not len(recording) or recording.t.ndim != 1:
        raise CalibrationError(f"{path} has no readings; a thermal record needs at least 20")
    t, currents = recording.t, recording["current_measured"].reshape(len(recording), -1)
    resistance = recording["resistance"].reshape(len(recording), -1)
    boundary = recording["boundary"].reshape(len(recording), -1)
    whole = np.isfinite(np.column_stack([t, currents, resistance, boundary])).all(axis=1)
    t, currents, resistance, boundary = t[whole], currents[whole], resistance[whole], boundary[whole]
    if len(t) < 20:
        raise CalibrationError(f"{path} has {len(t)} complete readings; a thermal record needs at least 20")
    if currents.shape[1] != device.channels or not resistance.shape == boundary.shape == currents.shape:
        raise CalibrationError(f"{path} has {currents.shape[1]} coils, device '{device.name}' has {device.channels}")
    _check_series(path, t, np.column_stack([currents, resistance, boundary]))
    coupled = device.coils.heat.coupling is not None
    used = list(range(device.channels)) if coupled else [int(np.argmax((currents**2).mean(axis=0)))]
    bins = ((t - t[0]) / _BIN_S).astype(int)
    _, where, count = np.unique(bins, return_inverse=True, return_counts=True)

    def mean(values: Array) -> Array:
        averaged: Array = np.column_stack([np.bincount(where, column) / count for column in values[:, used].T])
        return averaged

    coils = device.coils
    ratio = mean(resistance) / coils.resistance[used]
    warm = winding_temperature(coils.temperature_coefficient, coils.reference_temperature, ratio)
    winding = np.where(np.sqrt(mean(currents**2)) > _MIN_CURRENT_A, warm, np.nan)
    temperature = mean(boundary)
    start = t[0] + _BIN_S * np.unique(bins)
    return HeatRecord(start, mean(currents**2 * resistance), winding, temperature, float(temperature[0].mean()))
