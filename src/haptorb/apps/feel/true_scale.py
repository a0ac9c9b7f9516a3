"""What a force at the part is in the hand: the motor's handle, its gains and the torque scale between them."""

from __future__ import annotations

from dataclasses import dataclass

from haptorb.control.clutch.gains import Gains
from haptorb.devices.device import Device, require
from haptorb.devices.motor.spherical_motor import SphericalMotor

__all__ = ["SMALLEST", "ScaleLimits", "TrueScale"]

SMALLEST = 0.05  #: of gains that a session offers


@dataclass(frozen=True)
class ScaleLimits:
    """How strong the designs of a session may be felt: gain times what the design file says.

    largest         gain
    reason          why not more, in words
    hand_per_part   force in the hand per force on the part at gain 1
    """

    largest: float = 1.0
    reason: str = "the stability check is still running"
    hand_per_part: float = 0.2


@dataclass(frozen=True)
class TrueScale:
    """The way from a force on the part along X' to the hand, in translation.

    >>> from haptorb.control.clutch.gains import MOTOR_GAINS
    >>> from haptorb.devices.loader import load
    >>> scale = TrueScale.of(load("pmsm"), MOTOR_GAINS)
    >>> scale.hand_per_part, scale.whole
    (0.2, 5.0)
    """

    lever: float  #: torque on the handle per force on the part [m]
    arm: float  #: from the motor's centre to the hand [m]
    limit: float  #: largest torque of the device [N·m]

    @classmethod
    def of(cls, device: Device, gains: Gains) -> TrueScale:
        """For `device` with `gains`. Raises InputError for a device without a handle."""
        rotor = require(device, SphericalMotor, "feeling designs").rotor
        return cls(gains.torques[0][1], rotor.handle_length, device.limits.torque)

    @property
    def hand_per_part(self) -> float:
        """Force in the hand per force on the part: 0.2 on the default handle with the default gains."""
        return round(self.lever / self.arm, 12)

    @property
    def whole(self) -> float:
        """The torque scale at which one newton at the part is one newton in the hand."""
        return round(self.arm / self.lever, 12) if self.lever else float("inf")

    @property
    def sentence(self) -> str:
        """The scale in words, without a full stop."""
        return (
            f"1 N at the part is {self.hand_per_part:.2g} N in the hand on the {1e3 * self.arm:.0f} mm handle at gain "
            f"1; gain {self.whole:.3g} is 1 : 1"
        )

    @property
    def unknown_limits(self) -> ScaleLimits:
        """The limits until they are computed."""
        return ScaleLimits(hand_per_part=self.hand_per_part)

    def find_saturation(self, peak: float) -> float:
        """The torque scale at which a force of `peak` [N] on the part reaches the device's torque limit."""
        return self.limit / (self.lever * peak) if peak * self.lever else float("inf")
