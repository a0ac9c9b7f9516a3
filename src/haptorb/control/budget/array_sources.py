"""What is not known exactly about a coil array: one class for each source."""

from __future__ import annotations

import numpy as np

from haptorb.control.allocation.array.capability import array_capability
from haptorb.control.budget.array_errors import ArrayErrors, ArrayTrial
from haptorb.control.budget.asked_size import choose_size
from haptorb.control.budget.current_errors import current_sources, describe_share, find_origin
from haptorb.control.budget.error_model import ErrorSource
from haptorb.control.budget.magnet_sources import MagnetStrength, magnet_warmth
from haptorb.devices.coil_array.coil_array import CoilArray
from haptorb.display.quantity_text import format_quantity
from haptorb.errors import InputError, UnknownName
from haptorb.numerics.arrays import Array
from haptorb.sensing.calibration.calibration import Calibration

__all__ = ["array_errors"]

ESTIMATORS = ("tracker",)


class CoilPlaces(ErrorSource[ArrayTrial]):
    """Where each coil is."""

    def __init__(self, standard: float, origin: str, coils: int) -> None:
        super().__init__("positions of the coils", format_quantity(standard, "m"), origin, 3 * coils)
        self._standard = standard

    def perturb(self, deviates: Array, trial: ArrayTrial) -> None:
        """Move each coil."""
        trial.shift += self._standard * deviates.reshape(trial.shift.shape)


class CoilAxes(ErrorSource[ArrayTrial]):
    """Where each coil's axis points."""

    def __init__(self, standard: float, origin: str, coils: int) -> None:
        super().__init__("axes of the coils", f"{np.degrees(standard):.3g}°", origin, 3 * coils)
        self._standard = standard

    def perturb(self, deviates: Array, trial: ArrayTrial) -> None:
        """Tilt each coil."""
        trial.lean += self._standard * deviates.reshape(trial.lean.shape)


class CoilStrengths(ErrorSource[ArrayTrial]):
    """What each coil's field is per ampere."""

    def __init__(self, standard: float, origin: str, coils: int) -> None:
        super().__init__("field per ampere of the coils", describe_share(standard), origin, coils)
        self._standard = standard

    def perturb(self, deviates: Array, trial: ArrayTrial) -> None:
        """Change each coil."""
        trial.turns += self._standard * deviates


class ToolPlace(ErrorSource[ArrayTrial]):
    """The position from the tracker."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("tracked place", format_quantity(standard, "m"), origin, 3)
        self._standard = standard

    def perturb(self, deviates: Array, trial: ArrayTrial) -> None:
        """Move the estimated position."""
        trial.place += self._standard * deviates


class ToolOrientation(ErrorSource[ArrayTrial]):
    """The orientation from the tracker."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("tracked orientation", f"{np.degrees(standard):.3g}°", origin, 3)
        self._standard = standard

    def perturb(self, deviates: Array, trial: ArrayTrial) -> None:
        """Turn the estimated tool."""
        trial.turn += self._standard * deviates


def array_errors(
    device: CoilArray,
    asked: float | None = None,
    estimator: str | None = None,
    calibration: Calibration | None = None,
) -> ArrayErrors:
    """The error model of `device` for forces of `asked` [N]; None: half of the least peak force in its workspace.

    Raises InputError for a force that the coils cannot give everywhere, and for a calibration, which arrays do not
    have; UnknownName for another estimator than "tracker".
    """
    if calibration is not None:
        raise InputError(f"device '{device.name}' is a {device.kind.title}; a calibration is for electromagnets")
    if estimator not in (None, *ESTIMATORS):
        raise UnknownName(f"estimator of the error budget of '{device.name}'", str(estimator), ESTIMATORS)
    known, built, m = device.uncertainty, device.tolerance, device.channels

    def origin(key: str) -> str:
        return find_origin(device, known, key)

    def origin_of_build(key: str) -> str:
        return find_origin(device, known, key, "tolerance")

    sources: tuple[ErrorSource[ArrayTrial], ...] = (
        MagnetStrength("remanence", known.remanence, origin("remanence")),
        magnet_warmth("temperature of the magnets", device, known),
        CoilPlaces(built.position, origin_of_build("position"), m),
        CoilAxes(built.tilt, origin_of_build("tilt"), m),
        CoilStrengths(built.strength, origin_of_build("strength"), m),
        ToolPlace(known.place, origin("place")),
        ToolOrientation(known.axis, origin("axis")),
        *current_sources(device, known, known.current_offset),
    )
    most = min(layer.weakest for layer in array_capability(device))
    return ArrayErrors(device, choose_size(device.name, asked, most, "N"), sources)
