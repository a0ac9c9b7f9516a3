"""What is not known exactly about a spherical electromagnet: one class for each source."""

from __future__ import annotations

import numpy as np

from haptorb.control.budget.asked_size import choose_size
from haptorb.control.budget.current_errors import current_sources, describe_share, find_origin
from haptorb.control.budget.error_model import ErrorSource
from haptorb.control.budget.tool_errors import ToolErrors, ToolTrial
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.electromagnet.shell_capability import shell_capability
from haptorb.display.quantity_text import format_quantity
from haptorb.errors import UnknownName
from haptorb.numerics.arrays import Array
from haptorb.sensing.calibration.calibration import Calibration

__all__ = ["tool_errors"]

_SPAN = 3.0  #: standard uncertainties up to which the core's radius is looked up; beyond, the parabola goes on


class Remanence(ErrorSource[ToolTrial]):
    """The strength of the tool's magnet."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("remanence", describe_share(standard), origin, 1)
        self._standard = standard

    def perturb(self, deviates: Array, trial: ToolTrial) -> None:
        """Change the strength."""
        trial.strength *= 1 + self._standard * float(deviates[0])


class MagnetWarmth(ErrorSource[ToolTrial]):
    """The temperature of the tool's magnet, in a hand and over warm coils."""

    def __init__(self, standard: float, drift: float, origin: str) -> None:
        super().__init__("temperature of the magnet", f"{standard:.3g} K", origin, 1)
        self._standard = standard * drift

    def perturb(self, deviates: Array, trial: ToolTrial) -> None:
        """Change the strength."""
        trial.strength *= 1 + self._standard * float(deviates[0])


class Moments(ErrorSource[ToolTrial]):
    """The moments per ampere, every component of every coil."""

    def __init__(self, standard: Array, share: str, origin: str) -> None:
        super().__init__("moments per ampere", share, origin, standard.size)
        self._standard = standard  # (3, m) [m²]

    def perturb(self, deviates: Array, trial: ToolTrial) -> None:
        """Change the moments."""
        trial.moments += self._standard * deviates.reshape(self._standard.shape)


class TrackedPlace(ErrorSource[ToolTrial]):
    """The place that the tracker tells."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("tracked place", format_quantity(standard, "m"), origin, 3)
        self._standard = standard

    def perturb(self, deviates: Array, trial: ToolTrial) -> None:
        """Move the believed place."""
        trial.place += self._standard * deviates


class TrackedAxis(ErrorSource[ToolTrial]):
    """The direction that the tracker tells."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("tracked axis", f"{np.degrees(standard):.3g}°", origin, 3)
        self._standard = standard

    def perturb(self, deviates: Array, trial: ToolTrial) -> None:
        """Turn the believed axis."""
        trial.turn += self._standard * deviates


class CorePlace(ErrorSource[ToolTrial]):
    """Where core and coils are."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("place of core and coils", format_quantity(standard, "m"), origin, 3)
        self._standard = standard

    def perturb(self, deviates: Array, trial: ToolTrial) -> None:
        """Move core and coils."""
        trial.shift += self._standard * deviates


class CoreRadius(ErrorSource[ToolTrial]):
    """How large the core is: its pull follows, the moments are measured with it."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("radius of the core", format_quantity(standard, "m"), origin, 1)
        self._standard = standard

    def perturb(self, deviates: Array, trial: ToolTrial) -> None:
        """Change the radius."""
        trial.core_radius += self._standard * float(deviates[0])


def tool_errors(
    device: SphericalElectromagnet,
    asked: float | None = None,
    estimator: str | None = None,
    calibration: Calibration | None = None,
) -> ToolErrors:
    """The error model of `device` for forces of `asked` [N]; None: half of the least peak force in its shell.

    `calibration`, already applied to `device` or not, replaces the uncertainty of the moments by its own.

    Raises InputError for a force that the coils cannot give in every direction, UnknownName for another estimator than
    "tracker".
    """
    if estimator not in (None, "tracker"):
        raise UnknownName(f"estimator of the error budget of '{device.name}'", str(estimator), ("tracker",))
    believed = device if calibration is None else calibration.apply(device)
    known = believed.uncertainty

    def origin(key: str) -> str:
        return find_origin(device, known, key)

    sources: tuple[ErrorSource[ToolTrial], ...] = (
        Remanence(known.remanence, origin("remanence")),
        MagnetWarmth(known.magnet_temperature, known.remanence_drift, origin("magnet_temperature")),
        _moments(believed, calibration),
        TrackedPlace(known.place, origin("place")),
        TrackedAxis(known.axis, origin("axis")),
        CorePlace(known.core_place, origin("core_place")),
        CoreRadius(known.core_radius, origin("core_radius")),
        *current_sources(device, known, known.current_offset),
    )
    force = _check_force(believed, asked)
    return ToolErrors(believed, force, sources, "tracker", _SPAN * known.core_radius)


def _moments(device: SphericalElectromagnet, calibration: Calibration | None) -> Moments:
    sizes = np.linalg.norm(device.moment_per_current, axis=0)
    if calibration is not None:
        share = float((calibration.uncertainty / sizes).max())
        return Moments(calibration.uncertainty, describe_share(share), "calibration")
    share = device.uncertainty.moments
    spread = np.broadcast_to(share * sizes, (3, device.channels))
    return Moments(spread, describe_share(share), find_origin(device, device.uncertainty, "moments"))


def _check_force(device: SphericalElectromagnet, asked: float | None) -> float:
    layers = shell_capability(device, points=24).layers
    most = min(min(layer.peak_radial, layer.peak_tangential) for layer in layers)
    return choose_size(device.name, asked, most, "N")
