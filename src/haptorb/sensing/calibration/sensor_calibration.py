"""What the self-calibration found of the field sensors, as a part of a calibration file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from haptorb.devices.field_sensors import FieldSensors, SensorCorrection
from haptorb.errors import CalibrationError, quote
from haptorb.files.json_file import numbers
from haptorb.numerics.arrays import Array

__all__ = ["SensorCalibration"]

_KEYS = ("positions_m", "gain", "offsets_t", "per_ampere_t", "used")


@dataclass(frozen=True)
class SensorCalibration:
    """What takes the place of the device file's sensors.

    positions   (k, 3) [m]; those of sensors that failed are the device file's
    correction  offset, gain, and reading per ampere of each
    place       rms lasting error of the tool's place over the shell that is left [m]
    axis        the same of its axis [rad]
    strength    of the tool's magnet, relative to the device file
    residual    of the fit, in standard deviations of a reading
    unobserved  what only the device file says, in words
    """

    positions: Array
    correction: SensorCorrection
    place: float
    axis: float
    strength: float
    residual: float
    unobserved: tuple[str, ...]

    @property
    def failed(self) -> tuple[int, ...]:
        """Numbers of the sensors that are left out, from 1."""
        return tuple(int(n) + 1 for n in np.flatnonzero(~self.correction.used))

    def apply(self, hall: FieldSensors) -> FieldSensors:
        """`hall` with what was found."""
        return replace(hall, positions=self.positions, correction=self.correction)

    def numbers(self) -> dict[str, Any]:
        """As JSON takes it, units in the keys."""
        found = self.correction
        return {
            "positions_m": self.positions.tolist(),
            "gain": found.gain.tolist(),
            "offsets_t": found.offset.tolist(),
            "per_ampere_t": found.per_ampere.tolist(),
            "used": [bool(one) for one in found.used],
            "uncertainty_t": found.uncertainty,
            "place_m": self.place,
            "axis_rad": self.axis,
            "strength": self.strength,
            "residual": self.residual,
            "unobserved": list(self.unobserved),
        }

    @classmethod
    def parse(cls, raw: Any, name: str, sensors: int, channels: int) -> SensorCalibration:
        """From what `numbers` gave, of so many sensors and channels; CalibrationError, under `name`, if it is none."""
        scalars = ("uncertainty_t", "place_m", "axis_rad", "strength", "residual")
        wanted = {*_KEYS, *scalars, "unobserved"}
        if not isinstance(raw, Mapping) or set(raw) != wanted:
            raise CalibrationError(f"{name}: field_sensors must be null or have exactly {', '.join(sorted(wanted))}")
        used = raw["used"]
        if not (isinstance(used, list) and len(used) == sensors and all(isinstance(one, bool) for one in used)):
            raise CalibrationError(
                f"{name}: used must be true or false for each of {sensors} sensors; got {quote(used)}"
            )
        lines = raw["unobserved"]
        if not (isinstance(lines, list) and all(isinstance(line, str) for line in lines)):
            raise CalibrationError(f"{name}: unobserved must be a list of texts; got {quote(lines)}")
        gain = numbers(raw, "gain", name, (sensors, 3, 3))
        if np.abs(np.linalg.det(gain)).min() < 0.1:
            raise CalibrationError(f"{name}: gain has a sensor that measures less than three directions")
        uncertainty, place, axis, strength, residual = (float(numbers(raw, key, name, ())) for key in scalars)
        correction = SensorCorrection(
            gain,
            numbers(raw, "offsets_t", name, (sensors, 3)),
            numbers(raw, "per_ampere_t", name, (sensors, 3, channels)),
            np.array(used, dtype=np.bool_),
            uncertainty,
        )
        at = numbers(raw, "positions_m", name, (sensors, 3))
        return cls(at, correction, place, axis, strength, residual, tuple(lines))
