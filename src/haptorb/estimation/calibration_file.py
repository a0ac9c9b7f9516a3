"""Calibration of one device as a versioned JSON text with the device's digest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import Heat, HeatCoupling
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError, quote
from haptorb.estimation.sensor_calibration import SensorCalibration
from haptorb.estimation.tracker_frame import TrackerFrame
from haptorb.file_kind import FileKind
from haptorb.files import read_text, replace_file
from haptorb.json_file import numbers, parse_document
from haptorb.thermal import TwoNode

__all__ = [
    "FORMAT",
    "Calibration",
    "MeasuredHeat",
    "check_writable",
    "read_calibration",
    "read_frame",
    "write_calibration",
    "write_frame",
]


FORMAT = "haptorb-calibration-1"
_KEYS = {"format", "device", "digest", "moment_per_current_m2", "uncertainty_m2", "offsets_t", "resistance_ohm",
         "residual_t", "condition", "repeatability", "heat", "simulated"}  # fmt: skip
_MAX_COIL_OFFSET_M = 5e-3  #: maximum plausible offset of a coil [m]
_OPTIONAL = {
    "field_sensors", "coils", "centres_m", "centre_uncertainty_m", "magnet_strength", "magnet_strength_uncertainty",
}  # fmt: skip
_COUPLING = ("core_capacity", "winding_to_core")
_HEAT = ("winding_capacity", "body_capacity", "winding_to_body", "body_to_air")


@dataclass(frozen=True)
class MeasuredHeat:
    """Measured winding and body of each coil, and the coupling of the coils; None: not coupled."""

    model: TwoNode
    coupling: HeatCoupling | None = None

    def apply(self, device: SphericalElectromagnet) -> Heat:
        """Thermal model of `device` with the measured values; CalibrationError if it does not match the coils."""
        heat, coupling = device.coils.heat, self.coupling
        if (coupling is None) != (heat.coupling is None):
            measured, file = ("uncoupled", "couples them") if coupling is None else ("coupled", "does not couple them")
            raise CalibrationError(
                f"the calibration has the heat of {measured} coils, and the file of device '{device.name}' {file} "
                f"([thermal.coupling]); repeat the heat step: `haptorb calibrate {device.name} --restart`"
            )
        if coupling is not None and len(coupling.winding_to_core) != device.channels:
            raise CalibrationError(
                f"the calibration couples {len(coupling.winding_to_core)} coils, and device '{device.name}' has "
                f"{device.channels}; calibrate again"
            )
        return replace(heat, **{name: getattr(self.model, name) for name in _HEAT}, coupling=coupling)


@dataclass(frozen=True)
class Calibration:
    """Measured values of the device whose file has `digest`; they replace those of the file.

    moment_per_current  (3, m) [m²] and its standard deviations, uncertainty (3, m)
    offsets             (k, 3) [T] of the field sensors at zero current, without a tool
    resistance          (m,) [Ω] at the device file's reference temperature
    residual            rms that the magnetic regression leaves [T]; condition and repeatability as there
    heat                from a thermal record; None where none was given
    simulated           it was measured on a simulation
    sensors             offset, gain and place of every field sensor; None where the steps were not taken
    coils               what the moments are of: "points", or coils at their true size, "windings"
    centres             (m, 3) from where each coil's field comes [m], and centre_uncertainty (m, 3) its standard
                        deviations; None where they were not estimated
    strength            of the tool's magnet, relative to the file's remanence, and its standard deviation; None
                        without load-cell readings
    """

    device: str
    digest: str
    moment_per_current: Array
    uncertainty: Array
    offsets: Array
    resistance: Array
    residual: float
    condition: float
    repeatability: float
    heat: MeasuredHeat | None
    simulated: bool
    sensors: SensorCalibration | None = None
    coils: Literal["points", "windings"] = "windings"
    centres: Array | None = None
    centre_uncertainty: Array | None = None
    strength: float | None = None
    strength_uncertainty: float | None = None

    def apply(self, device: SphericalElectromagnet) -> SphericalElectromagnet:
        """Return `device` with the measured values; CalibrationError if the calibration belongs to another device."""
        if device.digest != self.digest:
            raise CalibrationError(
                f"the calibration belongs to device {quote(self.device)} with file {quote(self.digest[:12])}, not to "
                f"'{device.name}' with file {device.digest[:12]}; calibrate again with "
                f"`haptorb calibrate {device.name}`"
            )
        if self.coils == "points" and "exact" in device.models:
            sizes = np.linalg.norm(device.moment_per_current, axis=0)
            off = 100 * np.abs(np.linalg.norm(self.moment_per_current, axis=0) / sizes - 1).max()
            raise CalibrationError(
                f"the calibration treated each coil as a point, but the file of device '{device.name}' has [windings]: "
                f"its moments, up to {off:.0f} % from those of the file, do not hold for coils at their true size. "
                f"Calibrate again with `haptorb calibrate {device.name}`, or drop windings in the device file"
            )
        coils = replace(device.coils, resistance=self.resistance)
        if self.heat is not None:
            coils = replace(coils, heat=self.heat.apply(device))
        hall = device.hall if self.sensors is None else self.sensors.apply(device.hall)
        tool = device.tool
        if self.strength is not None:
            tool = replace(tool, remanence=self.strength * tool.remanence)
        return replace(
            device, moment_per_current=self.moment_per_current, moments_from="calibration", coils=coils, hall=hall,
            coil_centres=self.centres, tool=tool,
        )  # fmt: skip

    @property
    def id(self) -> bytes:
        """16 bytes that identify this calibration: the beginning of its text's SHA-256. A device may store them."""
        return hashlib.sha256(self.text().encode()).digest()[:16]

    def text(self) -> str:
        """As JSON, with full precision."""
        heat: dict[str, Any] | None = None
        if self.heat is not None:
            heat = {name: getattr(self.heat.model, name) for name in _HEAT}
            if self.heat.coupling is not None:
                heat |= {name: getattr(self.heat.coupling, name) for name in _COUPLING}
        content = {
            "format": FORMAT,
            "device": self.device,
            "digest": self.digest,
            "simulated": self.simulated,
            "coils": self.coils,
            "moment_per_current_m2": self.moment_per_current.tolist(),
            "uncertainty_m2": self.uncertainty.tolist(),
            "offsets_t": self.offsets.tolist(),
            "resistance_ohm": self.resistance.tolist(),
            "residual_t": self.residual,
            "condition": self.condition,
            "repeatability": self.repeatability,
            "heat": heat,
            "field_sensors": None if self.sensors is None else self.sensors.numbers(),
        }
        if self.centres is not None and self.centre_uncertainty is not None:
            content |= {"centres_m": self.centres.tolist(), "centre_uncertainty_m": self.centre_uncertainty.tolist()}
        if self.strength is not None:
            content |= {"magnet_strength": self.strength, "magnet_strength_uncertainty": self.strength_uncertainty}
        return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"

    @classmethod
    def parse(cls, text: str, name: str) -> Calibration:
        """Parse JSON; `name` is used in messages. CalibrationError if it is not a calibration."""
        raw = parse_document(text, name, "calibration", FORMAT, _KEYS, "calibrate again", _OPTIONAL)
        moments = numbers(raw, "moment_per_current_m2", name, (3, None))
        channels = moments.shape[1]
        if np.linalg.matrix_rank(moments) < min(3, channels):
            raise CalibrationError(
                f"{name}: moment_per_current_m2 is singular: its rows are linearly dependent; calibrate again"
            )
        if not isinstance(raw["simulated"], bool):
            raise CalibrationError(f"{name}: simulated must be true or false; got {quote(raw['simulated'])}")
        coils = raw.get("coils", "points")  # the model that earlier versions used
        if coils not in ("points", "windings"):
            raise CalibrationError(f'{name}: coils must be "points" or "windings"; got {quote(coils)}')
        resistance = numbers(raw, "resistance_ohm", name, (channels,))
        if not (resistance > 0).all():
            raise CalibrationError(f"{name}: resistance_ohm must be positive; got {resistance.tolist()}")
        offsets, sensors = numbers(raw, "offsets_t", name, (None, 3)), None
        if raw.get("field_sensors") is not None:
            sensors = SensorCalibration.parse(raw["field_sensors"], name, len(offsets), channels)
        centres, spread = None, None
        if raw.get("centres_m") is not None or raw.get("centre_uncertainty_m") is not None:
            raw = {"centres_m": None, "centre_uncertainty_m": None} | dict(raw)
            centres = numbers(raw, "centres_m", name, (channels, 3))
            spread = numbers(raw, "centre_uncertainty_m", name, (channels, 3))
            if np.abs(centres).max() > _MAX_COIL_OFFSET_M:
                raise CalibrationError(
                    f"{name}: centres_m says that a coil is {1e3 * np.abs(centres).max():.4g} mm off its place, more "
                    f"than {1e3 * _MAX_COIL_OFFSET_M:g} mm; calibrate again"
                )
        strength, unsure = None, None
        if raw.get("magnet_strength") is not None or raw.get("magnet_strength_uncertainty") is not None:
            raw = {"magnet_strength": None, "magnet_strength_uncertainty": None} | dict(raw)
            strength = float(numbers(raw, "magnet_strength", name, ()))
            unsure = float(numbers(raw, "magnet_strength_uncertainty", name, ()))
            if not (0.5 < strength < 2.0 and 0.0 <= unsure < 1.0):
                raise CalibrationError(
                    f"{name}: magnet_strength must lie between 0.5 and 2, its uncertainty between 0 and 1; got "
                    f"{strength:g} and {unsure:g}; calibrate again"
                )
        return cls(
            _check_text(raw, "device", name),
            _check_text(raw, "digest", name),
            moments,
            numbers(raw, "uncertainty_m2", name, moments.shape),
            offsets,
            resistance,
            float(numbers(raw, "residual_t", name, ())),
            float(numbers(raw, "condition", name, ())),
            float(numbers(raw, "repeatability", name, ())),
            _heat(raw["heat"], channels, name),
            raw["simulated"],
            sensors,
            coils,
            centres,
            spread,
            strength,
            unsure,
        )


def _check_text(raw: Mapping[str, Any], key: str, name: str) -> str:
    if not isinstance(raw[key], str):
        raise CalibrationError(f"{name}: {key} must be a text; got {quote(raw[key])}")
    return str(raw[key])


def _heat(raw: Any, channels: int, name: str) -> MeasuredHeat | None:
    if raw is None:
        return None
    if not isinstance(raw, Mapping) or set(raw) not in ({*_HEAT}, {*_HEAT, *_COUPLING}):
        raise CalibrationError(
            f"{name}: heat must be null or have exactly {', '.join(_HEAT)}; coupled coils have "
            f"{' and '.join(_COUPLING)} too"
        )
    values = [float(numbers(raw, key, name, ())) for key in _HEAT]
    coupling = None
    if _COUPLING[0] in raw:
        to_core = numbers(raw, "winding_to_core", name, (channels,)).tolist()
        coupling = HeatCoupling(float(numbers(raw, "core_capacity", name, ())), tuple(to_core))
        values += [coupling.core_capacity, *coupling.winding_to_core]
    if not all(value > 0 for value in values):
        raise CalibrationError(f"{name}: all values of heat must be positive; got {values}")
    return MeasuredHeat(TwoNode(*values[:4]), coupling)


# --------------------------------------------------------------------------------------------------
# Files of calibrations and tracker frames: written atomically, and never overwritten by accident.


_MAX_FILE_BYTES = 1024 * 1024  #: bytes


def read_calibration(path: str | Path) -> Calibration:
    """Read a calibration from a file; CalibrationError if it cannot be read or is not valid."""
    return Calibration.parse(
        read_text(path, "calibration", CalibrationError, _MAX_FILE_BYTES, FileKind.CALIBRATION), str(path)
    )


def read_frame(path: str | Path) -> TrackerFrame:
    """Read a tracker's frame from a file; CalibrationError if it cannot be read or is not valid."""
    return TrackerFrame.parse(read_text(path, "frame", CalibrationError, _MAX_FILE_BYTES, FileKind.FRAME), str(path))


def check_writable(path: str | Path, *, overwrite: bool) -> Path:
    """`path`, if a calibration or frame may be written there; checked before any measurement.

    Raises CalibrationError if the file exists and `overwrite` is not set, or if there is no folder for it.
    """
    try:
        place = Path(path).expanduser()
        if place.exists() and not overwrite:
            text = f"{path} exists; choose another name, or replace it"
            raise CalibrationError(f"{text} with overwrite=True", command=f"{text} with --force")
        if not place.parent.is_dir():
            raise CalibrationError(f"{path}: the folder '{place.parent}' does not exist")
    except OSError as cause:
        raise CalibrationError(f"cannot write {path}: {cause.strerror}") from cause
    except (ValueError, RuntimeError) as cause:  # a zero byte in its name, or the home folder of an unknown user
        raise CalibrationError(f"cannot write {str(path)!r}: not the name of a file") from cause
    return place


def write_calibration(calibration: Calibration, path: str | Path, *, overwrite: bool = False) -> None:
    """Write the file atomically.

    Raises CalibrationError for what `check_writable` does not allow, or if the system cannot write it.
    """
    _write(calibration.text(), path, overwrite)


def write_frame(frame: TrackerFrame, path: str | Path, *, overwrite: bool = False) -> None:
    """Write the file atomically. Raises CalibrationError as `write_calibration` does."""
    _write(frame.text(), path, overwrite)


def _write(text: str, path: str | Path, overwrite: bool) -> None:
    place = check_writable(path, overwrite=overwrite)
    try:
        with replace_file(place) as part:
            part.write_text(text, encoding="utf-8")
    except OSError as cause:
        raise CalibrationError(f"cannot write {path}: {cause.strerror}") from cause
