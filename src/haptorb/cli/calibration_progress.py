"""Progress file of a guided calibration, beside the calibration file."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from time import time
from typing import Any, final

import numpy as np

from haptorb.cli.calibration_measurement import is_plausible_resistance
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError, quote
from haptorb.files import parse_json, read_bytes, replace_file
from haptorb.json_file import numbers

__all__ = ["ProgressFile"]


FORMAT = "haptorb-calibration-steps-1"
_MAX_FILE_BYTES = 4 * 1024 * 1024
_STALE_AFTER_S = 24 * 3600.0  #: older progress is discarded: the device may have been rewired
_COILS, _SENSORS = -1, -2  #: placeholders of the device's numbers of coils and sensors in the shapes below
#: step → keys of its result and their shapes (None: any length)
_SHAPES: dict[str, dict[str, tuple[int | None, ...]]] = {
    "rest": {"temperatures_k": (_COILS,)},
    "currents": {"resistance_ohm": (_COILS,)},
    "magnetic": {
        "moment_per_current_m2": (3, _COILS),
        "uncertainty_m2": (3, _COILS),
        "offsets_t": (_SENSORS, 3),
        "residual_t": (),
        "condition": (),
        "repeatability": (),
        "failed": (None,),
    },
    "fields": {
        "per_ampere_t": (_SENSORS, 3, _COILS),
        "deviation_t": (_COILS,),
        "at_rest_t": (_SENSORS, 3),
        "deviation_at_rest_t": (),
        "failed": (None,),
    },
    "heat": {
        **dict.fromkeys(("winding_capacity", "body_capacity", "winding_to_body", "body_to_air", "residual_k"), ()),
        "uncertainty": (None,),
    },
    "tool": {"likeness": (), "strength": ()},
    "sensors": {
        "positions_m": (_SENSORS, 3),
        "gain": (_SENSORS, 3, 3),
        "offsets_t": (_SENSORS, 3),
        "per_ampere_t": (_SENSORS, 3, _COILS),
        **dict.fromkeys(("uncertainty_t", "place_m", "axis_rad", "strength", "residual"), ()),
    },
}
#: keys of a result for coupled coils: all of them or none
_OPTIONAL: dict[str, dict[str, tuple[int | None, ...]]] = {
    "heat": {"core_capacity": (), "winding_to_core": (_COILS,)},
    "magnetic": {"centres_m": (_COILS, 3), "centre_uncertainty_m": (_COILS, 3)},
}


@final
class ProgressFile:
    """Results by step, in a file that is replaced atomically after each step.

    `left` describes a progress file that was found but not used, in one sentence; otherwise empty.
    """

    def __init__(
        self, out: Path, device: SphericalElectromagnet, driver: str, clock: Callable[[], float] = time
    ) -> None:
        self.path = out.with_name(out.name + ".steps")
        self._head = {"format": FORMAT, "device": device.name, "digest": device.digest, "driver": driver}
        self._lengths: dict[int | None, int | None] = {_COILS: device.channels, _SENSORS: device.sensors}
        self._resistance = device.coils.resistance
        self._clock = clock
        self.results: dict[str, dict[str, Any]] = {}
        self.left = ""
        if self.path.exists():
            self.left = self._resume()

    def _resume(self) -> str:
        try:
            raw = parse_json(read_bytes(self.path, _MAX_FILE_BYTES, "progress", CalibrationError))
            head = {key: raw[key] for key in self._head}
            written, results = float(raw["written"]), _check_steps(raw["steps"], self._lengths)
            # Duties of later steps are computed from it: a false value of another person's file is a false current.
            if "currents" in results and not is_plausible_resistance(  # safety: resumed-resistance
                results["currents"]["resistance_ohm"], self._resistance
            ):
                raise ValueError("a resistance that no coil of the device has")
        except (CalibrationError, ValueError, KeyError, TypeError, OverflowError):
            return f"{self.path} is damaged and is ignored"
        if head != self._head:
            return f"{self.path} is for driver {quote(raw['driver'])} or another device file, and is ignored"
        if not 0.0 <= self._clock() - written <= _STALE_AFTER_S:
            return f"{self.path} is older than a day and is ignored"
        self.results = results
        return ""

    def store(self, name: str, result: dict[str, Any]) -> None:
        """Store the result of a step; CalibrationError if it cannot be written."""
        self.results[name] = result
        content = {**self._head, "written": self._clock(), "steps": self.results}
        try:
            with replace_file(self.path, sync=True) as part:
                part.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        except OSError as cause:
            raise CalibrationError(f"cannot write {self.path}: {cause.strerror}") from cause

    def delete(self) -> None:
        """Delete the progress, to start again or after completion."""
        self.results = {}
        self.path.unlink(missing_ok=True)


def _check_steps(steps: Any, lengths: Mapping[int | None, int | None]) -> dict[str, dict[str, Any]]:
    """Return `steps` if each has the keys that later steps and its report use; ValueError otherwise."""
    for name, result in dict(steps).items():
        if name not in _SHAPES or not isinstance(result, dict):
            raise ValueError(f"{name} is not a step")
        optional = _OPTIONAL.get(name, {})
        shapes = _SHAPES[name] | (optional if optional.keys() & result.keys() else {})
        for key, shape in shapes.items():
            numbers(result, key, name, tuple(lengths.get(one, one) for one in shape))
        if name == "magnetic" and not np.linalg.norm(result["moment_per_current_m2"], axis=0).all():
            raise ValueError("a coil without a moment has no axis")
    return dict(steps)
