"""What is not known exactly about a spherical motor: one class for each source."""

from __future__ import annotations

import numpy as np

from haptorb.control.allocation.motor_capability import motor_capability
from haptorb.control.budget.asked_size import choose_size
from haptorb.control.budget.current_errors import current_sources, describe_share, find_origin
from haptorb.control.budget.error_model import ErrorSource
from haptorb.control.budget.magnet_sources import MagnetStrength, magnet_warmth
from haptorb.control.budget.motor_errors import MotorErrors, MotorTrial
from haptorb.control.budget.sensor_errors import sensor_sources
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import InputError, UnknownName
from haptorb.numerics.arrays import Array
from haptorb.sensing.calibration.calibration import Calibration

__all__ = ["motor_errors"]

ESTIMATORS = ("least-squares", "tracker")
_AVERAGED = 2.4  #: readings that the filter of the orientation is worth, at 1 kHz: 1/0.42, for its memory of 2.5 ms


class CoilStrength(ErrorSource[MotorTrial]):
    """What each coil gives per ampere."""

    def __init__(self, standard: float, origin: str, coils: int) -> None:
        super().__init__("torque per ampere of each coil", describe_share(standard), origin, coils)
        self._standard = standard

    def perturb(self, deviates: Array, trial: MotorTrial) -> None:
        """Change each coil."""
        trial.coils *= 1 + self._standard * deviates


class RegulatorTorque(ErrorSource[MotorTrial]):
    """What holds the rotor up."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("torque of the regulator", describe_share(standard), origin, 1)
        self._standard = standard

    def perturb(self, deviates: Array, trial: MotorTrial) -> None:
        """Change the regulator."""
        trial.regulator += self._standard * float(deviates[0])


class RotorWeight(ErrorSource[MotorTrial]):
    """What the rotor weighs, and where."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("weight of the rotor", describe_share(standard), origin, 1)
        self._standard = standard

    def perturb(self, deviates: Array, trial: MotorTrial) -> None:
        """Change the weight."""
        trial.weight += self._standard * float(deviates[0])


class TrackedOrientation(ErrorSource[MotorTrial]):
    """The orientation from a tracker."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("tracked orientation", f"{np.degrees(standard):.3g}°", origin, 3)
        self._standard = standard

    def perturb(self, deviates: Array, trial: MotorTrial) -> None:
        """Turn the estimated rotor."""
        trial.turn += self._standard * deviates


def motor_errors(
    device: SphericalMotor,
    asked: float | None = None,
    estimator: str | None = None,
    calibration: Calibration | None = None,
) -> MotorErrors:
    """The error model of `device` for torques of `asked` [N·m]; None: half of the least peak torque in its workspace.

    Raises InputError for a torque that the coils cannot give everywhere, and for a calibration, which motors do not
    have; UnknownName for another estimator.
    """
    if calibration is not None:
        raise InputError(f"device '{device.name}' is a {device.kind.title}; a calibration is for electromagnets")
    chosen = ESTIMATORS[0] if estimator is None else estimator
    if chosen not in ESTIMATORS:
        raise UnknownName(f"estimator of the error budget of '{device.name}'", chosen, ESTIMATORS)
    known = device.uncertainty

    def origin(key: str) -> str:
        return find_origin(device, known, key)

    sources: tuple[ErrorSource[MotorTrial], ...] = (
        MagnetStrength("polarization of all magnets", known.polarization, origin("polarization")),
        magnet_warmth("temperature of the magnets", device, known),
        MagnetStrength(
            "polarization from magnet to magnet",
            known.polarization_spread,
            origin("polarization_spread"),
            len(device.magnets),
        ),
        CoilStrength(known.coil, origin("coil"), len(device.electromagnets)),
        RegulatorTorque(known.regulator, origin("regulator")),
        RotorWeight(known.weight, origin("weight")),
        *_pose_sources(device, chosen),
        *current_sources(device, known, known.current_offset),
    )
    most = float(motor_capability(device, 5, 20).peak.min())
    return MotorErrors(device, choose_size(device.name, asked, most, "N·m"), sources, chosen)


def _pose_sources(device: SphericalMotor, estimator: str) -> tuple[ErrorSource[MotorTrial], ...]:
    """How the orientation is known, and how well."""
    if estimator == "tracker":
        known = device.uncertainty
        return (TrackedOrientation(known.axis, find_origin(device, known, "axis")),)
    return sensor_sources(device, device.hall, "sensors", _AVERAGED)
