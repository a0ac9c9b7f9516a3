"""Frame of a tracker: transforms its poses to poses of the tool in the stator's frame, and is a versioned JSON text."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import hypot
from typing import TYPE_CHECKING, final

import numpy as np

from haptorb.arrays import Array, rotation
from haptorb.devices.base import Device, rotation_to_axis
from haptorb.errors import CalibrationError, quote
from haptorb.json_file import numbers, parse_document
from haptorb.rotations import product, quaternion, rotate

if TYPE_CHECKING:
    from haptorb.estimation.frame_registration import FrameRegistration

__all__ = ["FORMAT", "TrackerFrame"]


FORMAT = "haptorb-tracker-frame-1"
_VECTORS = {"shift_m": (3,), "tip_m": (3,), "magnet_m": (3,), "axis": (3,), "turn": (3, 3)}
_NUMBERS = ("residual_m", "condition", "position_m", "direction_rad")
_KEYS = {"format", "device", "digest", "tracker", "simulated", *_VECTORS, *_NUMBERS}
_MAX_DISTANCE_M = 1e3  #: maximum plausible distance from the tracker [m]
_MAX_ARM_M = 1.0  #: maximum plausible distance of a rigid body from the tool's magnet [m]


@final
@dataclass(frozen=True)
class TrackerFrame:
    """Transforms poses of a rigid body in a tracker's frame to poses of the tool in the stator's.

    digest     of the device's file
    tracker    name of the tracker at the registration
    simulated  it was registered in a rehearsal
    R, t       (3, 3), (3,) [m] tracker into stator: x_S = R x_T + t
    tip, magnet  (3,) of the tool, in the body [m]
    axis       (3,) unit vector of the tool's moment, in the body
    residual, condition, position, direction: as in `FrameRegistration`
    """

    device: str
    digest: str
    tracker: str
    simulated: bool
    R: Array
    t: Array
    tip: Array
    magnet: Array
    axis: Array
    residual: float
    condition: float
    position: float
    direction: float

    @classmethod
    def of(
        cls, found: FrameRegistration, device: Device, tip_distance: float, tracker: str, *, simulated: bool
    ) -> TrackerFrame:
        """From the registration `found` of `device` and `tracker`; the magnet is tip_distance [m] up the axis from the
        tip."""
        return cls(
            device.name, device.digest, tracker, simulated, found.R, found.t, found.tip,
            found.tip + tip_distance * found.axis, found.axis, found.residual, found.condition, found.position,
            found.direction,
        )  # fmt: skip

    def check_for(self, device: Device, tracker: str) -> TrackerFrame:
        """Returns itself; CalibrationError if it belongs to another device or tracker."""
        if self.digest != device.digest:
            raise CalibrationError(
                f"the tracker's frame belongs to device {quote(self.device)} with file {quote(self.digest[:12])}, not "
                f"to '{device.name}' with file {device.digest[:12]}; register again with `haptorb frame {device.name}`"
            )
        if self.tracker != tracker:  # safety: frame-tracker
            raise CalibrationError(
                f"the frame belongs to tracker {quote(self.tracker)}, not to '{tracker}': use that one, or register "
                f"this one with `haptorb frame {device.name} --tracker {tracker}`"
            )
        return self

    def transform_pose(self, p: Sequence[float], q: Sequence[float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """(p (3,) [m], q (4,)) of the tool's magnet, stator frame, for a body at p (3,), q (4,) in the tracker's.

        Invalid poses are passed on, and a quaternion keeps its norm: the pose filter checks them afterwards.
        """
        length = hypot(*q)
        if len(p) != 3 or len(q) != 4 or not hypot(*p) < _MAX_DISTANCE_M or not 0.5 < length < 2.0:
            return tuple(p), tuple(q)
        place = self.R @ (np.array(p) + rotate(np.array(q) / length, self.magnet)) + self.t
        before, after = self._quaternions
        turn = product(product(before, np.array(q)), after)
        return tuple(place.tolist()), tuple(turn.tolist())

    @cached_property
    def _quaternions(self) -> tuple[Array, Array]:
        """(4,) each: of R, and of the rotation from the tool's z to the axis in the body."""
        return quaternion(self.R), quaternion(rotation_to_axis(self.axis))

    def text(self) -> str:
        """As JSON, with full precision."""
        content = {
            "format": FORMAT,
            "device": self.device,
            "digest": self.digest,
            "tracker": self.tracker,
            "simulated": self.simulated,
            "turn": self.R.tolist(),
            "shift_m": self.t.tolist(),
            "tip_m": self.tip.tolist(),
            "magnet_m": self.magnet.tolist(),
            "axis": self.axis.tolist(),
            "residual_m": self.residual,
            "condition": self.condition,
            "position_m": self.position,
            "direction_rad": self.direction,
        }
        return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"

    @classmethod
    def parse(cls, text: str, name: str) -> TrackerFrame:
        """Parse JSON; `name` is used in messages. CalibrationError if it is not a tracker frame."""
        raw = parse_document(text, name, "tracker's frame", FORMAT, _KEYS, "register again with `haptorb frame`")
        for key in ("device", "digest", "tracker"):
            if not isinstance(raw[key], str):
                raise CalibrationError(f"{name}: {key} must be a text; got {quote(raw[key])}")
        if not isinstance(raw["simulated"], bool):
            raise CalibrationError(f"{name}: simulated must be true or false; got {quote(raw['simulated'])}")
        arrays = {key: numbers(raw, key, name, shape) for key, shape in _VECTORS.items()}
        grades = [float(numbers(raw, key, name, ())) for key in _NUMBERS]
        try:
            turn = rotation(arrays["turn"], "turn")
        except ValueError as cause:
            raise CalibrationError(f"{name}: {cause}") from cause
        if abs(np.linalg.norm(arrays["axis"]) - 1.0) > 1e-6:
            raise CalibrationError(f"{name}: axis must have length 1; got {arrays['axis'].tolist()}")
        if np.linalg.norm(arrays["magnet_m"]) > _MAX_ARM_M or np.linalg.norm(arrays["tip_m"]) > _MAX_ARM_M:
            raise CalibrationError(
                f"{name}: the tool is more than {_MAX_ARM_M:g} m from its rigid body; register again"
            )
        return cls(
            raw["device"], raw["digest"], raw["tracker"], raw["simulated"],
            turn, arrays["shift_m"], arrays["tip_m"], arrays["magnet_m"], arrays["axis"], *grades,
        )  # fmt: skip
