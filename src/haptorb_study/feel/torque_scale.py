"""Torque scale: ratio between the force on the part and the force in the hand: handle, gains and torque scale."""

from __future__ import annotations

from dataclasses import dataclass

from haptorb.control.linkage import Gains
from haptorb.devices.base import Device, require
from haptorb.devices.motor import SphericalMotor

__all__ = ["MIN_SCALE", "ScaleLimits", "TrueScale"]


MIN_SCALE = 0.05  #: smallest torque scale that a session offers


@dataclass(frozen=True)
class ScaleLimits:
    """Limits of the torque scale in a session, which multiplies `force_scale` of the snap-fit file.

    largest         maximum scale
    reason          of the maximum, as text
    hand_per_part   force in the hand per force on the part at scale 1
    """

    largest: float = 1.0
    reason: str = "the stability check is still running"
    hand_per_part: float = 0.2


@dataclass(frozen=True)
class TrueScale:
    """Scale from a force on the part along X' to the force in the hand, in translation.

    >>> from haptorb.control.linkage import MOTOR_GAINS
    >>> from haptorb.devices.loader import load
    >>> scale = TrueScale.of(load("pmsm"), MOTOR_GAINS)
    >>> scale.hand_per_part, scale.whole
    (0.2, 5.0)
    """

    lever: float  #: torque on the handle per force on the part [m]
    arm: float  #: from the motor's centre to the hand [m]
    limit: float  #: maximum torque of the device [N·m]

    @classmethod
    def of(cls, device: Device, gains: Gains) -> TrueScale:
        """The scale of `device` with `gains`. Raises InputError for a device without a handle."""
        rotor = require(device, SphericalMotor, "feeling designs").rotor
        return cls(gains.torques[0][1], rotor.handle_length, device.limits.torque)

    @property
    def hand_per_part(self) -> float:
        """Force in the hand per force on the part: 0.2 for the default handle with the default gains."""
        return round(self.lever / self.arm, 12)

    @property
    def whole(self) -> float:
        """Torque scale at which the force in the hand equals that on the part."""
        return round(self.arm / self.lever, 12) if self.lever else float("inf")

    @property
    def sentence(self) -> str:
        """Summary of the scale, without a full stop."""
        return (
            f"1 N at the part is {self.hand_per_part:.2g} N in the hand on the {1e3 * self.arm:.0f} mm handle at "
            f"torque scale 1; at {self.whole:.3g} the hand feels the part's full force"
        )

    @property
    def unknown_limits(self) -> ScaleLimits:
        """Limits before they are computed."""
        return ScaleLimits(hand_per_part=self.hand_per_part)

    def find_saturation(self, peak: float) -> float:
        """Torque scale at which a force of `peak` [N] on the part reaches the device's torque limit."""
        return self.limit / (self.lever * peak) if peak * self.lever else float("inf")
