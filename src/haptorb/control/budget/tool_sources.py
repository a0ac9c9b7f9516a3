"""What is not known exactly about a spherical electromagnet: one class for each source."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from haptorb.control.budget.asked_size import choose_size
from haptorb.control.budget.current_errors import current_sources, describe_share, find_origin
from haptorb.control.budget.error_model import ErrorSource
from haptorb.control.budget.magnet_sources import MagnetStrength, magnet_warmth
from haptorb.control.budget.sensor_errors import SensorPlacement, sensor_sources
from haptorb.control.budget.tool_errors import ToolErrors, ToolTrial
from haptorb.devices.electromagnet.core_dynamics import CoreDynamics
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.electromagnet.shell_capability import shell_capability
from haptorb.display.quantity_text import format_quantity
from haptorb.errors import UnknownName
from haptorb.numerics.arrays import Array
from haptorb.sensing.calibration.calibration import Calibration

__all__ = ["tool_errors"]

ESTIMATORS = ("tracker", "hall")
_AVERAGED = 3.3  #: readings that the Hall tracker's filter is worth, at 1 kHz: it leaves 0.55 of the noise
_SPAN = 3.0  #: standard uncertainties up to which the core's radius is looked up; beyond, the parabola continues


class Moments(ErrorSource[ToolTrial]):
    """The moments per ampere, every component of every coil."""

    def __init__(self, standard: Array, share: str, origin: str) -> None:
        super().__init__("moments per ampere", share, origin, standard.size)
        self._standard = standard  # (3, m) [m²]

    def perturb(self, deviates: Array, trial: ToolTrial) -> None:
        """Change the moments."""
        trial.moments += self._standard * deviates.reshape(self._standard.shape)


class TrackedPlace(ErrorSource[ToolTrial]):
    """The position from the tracker."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("tracked place", format_quantity(standard, "m"), origin, 3)
        self._standard = standard

    def perturb(self, deviates: Array, trial: ToolTrial) -> None:
        """Move the estimated position."""
        trial.place += self._standard * deviates


class TrackedAxis(ErrorSource[ToolTrial]):
    """The direction from the tracker."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("tracked axis", f"{np.degrees(standard):.3g}°", origin, 3)
        self._standard = standard

    def perturb(self, deviates: Array, trial: ToolTrial) -> None:
        """Turn the estimated axis."""
        trial.turn += self._standard * deviates


class CorePlace(ErrorSource[ToolTrial]):
    """Where core and coils are."""

    def __init__(self, standard: float, origin: str) -> None:
        super().__init__("position of core and coils", format_quantity(standard, "m"), origin, 3)
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


class CoreRemanence(ErrorSource[ToolTrial]):
    """The moment that stays in the core: along every axis anywhere between its greatest values."""

    def __init__(self, core: CoreDynamics, origin: str) -> None:
        super().__init__("remanence of the core", f"{1e3 * core.remanent_moment / np.sqrt(3):.2g} mA·m²", origin, 4)
        self._core = core

    def perturb(self, deviates: Array, trial: ToolTrial) -> None:
        """Add to the moment."""
        most = self._core.remanent_moment * np.exp(np.log1p(self._core.spread) * deviates[3])
        trial.remanent += most * (2 * ndtr(deviates[:3]) - 1)


class EddyLag(ErrorSource[ToolTrial]):
    """Eddy currents in the core, while the force turns at `frequency` [Hz] into any direction across it."""

    def __init__(self, core: CoreDynamics, frequency: float, origin: str) -> None:
        text = f"{100 * core.lag(frequency):.2g} % at {frequency:g} Hz"
        super().__init__("eddy currents in the core", text, origin, 5)
        self._core, self._turn = core, 2 * np.pi * frequency

    def perturb(self, deviates: Array, trial: ToolTrial) -> None:
        """Let the core be late."""
        share, time = np.exp(np.log1p(self._core.spread) * deviates[:2])
        x = 1j * self._turn * time * self._core.eddy_time
        trial.lag = complex(share * self._core.eddy_share * x / (1 + x))
        trial.turning = deviates[2:]


def tool_errors(
    device: SphericalElectromagnet,
    asked: float | None = None,
    estimator: str | None = None,
    calibration: Calibration | None = None,
    frequency: float = 10.0,
) -> ToolErrors:
    """The error model of `device` for forces of `asked` [N]; None: half of the least peak force in its shell.

    The force turns at `frequency` [Hz]; 0: it is at rest. With a `calibration` the moments are as uncertain as it says
    and as the field sensors are with which it was made; the gains of the current sensors cancel.

    Raises InputError for a force that the coils cannot give in every direction, UnknownName for another estimator than
    "tracker" and, where the device has field sensors enough, "hall".
    """
    known_estimators = ESTIMATORS if device.sensors > 1 else ESTIMATORS[:1]
    chosen = ESTIMATORS[0] if estimator is None else estimator
    if chosen not in known_estimators:
        raise UnknownName(f"estimator of the error budget of '{device.name}'", chosen, known_estimators)
    believed = device if calibration is None else calibration.apply(device)
    known, core = believed.uncertainty, believed.core_dynamics

    def origin(key: str, section: str = "uncertainty") -> str:
        return find_origin(device, known, key, section)

    sources: list[ErrorSource[ToolTrial]] = [
        MagnetStrength("remanence", known.remanence, origin("remanence")),
        magnet_warmth("temperature of the magnet", device, known),
        _moments(believed, calibration),
        *_pose_sources(believed, chosen, calibration),
        CorePlace(known.core_place, origin("core_place")),
        CoreRadius(known.core_radius, origin("core_radius")),
        *current_sources(device, known, known.current_offset),
    ]
    if core.remanent_moment:
        sources.append(CoreRemanence(core, origin("remanent_moment", "core_dynamics")))
    if core.eddy_share and frequency:
        sources.append(EddyLag(core, frequency, origin("eddy_share", "core_dynamics")))
    force = _check_force(believed, asked)
    return ToolErrors(
        believed, force, tuple(sources), chosen, _SPAN * known.core_radius, calibrated=calibration is not None,
        frequency=frequency,
    )  # fmt: skip


def _pose_sources(
    device: SphericalElectromagnet, estimator: str, calibration: Calibration | None
) -> tuple[ErrorSource[ToolTrial], ...]:
    """How the pose is known, and how well; and the field sensors, where the moments were measured with them."""
    known, found = device.uncertainty, None if calibration is None else calibration.sensors
    pose: tuple[ErrorSource[ToolTrial], ...] = ()
    if estimator == "tracker":
        pose = (
            TrackedPlace(known.place, find_origin(device, known, "place")),
            TrackedAxis(known.axis, find_origin(device, known, "axis")),
        )
    elif found is not None:  # what is stated are lengths of errors over all axes
        pose = (
            TrackedPlace(found.place / np.sqrt(3), "calibration"),
            TrackedAxis(found.axis / np.sqrt(2), "calibration"),
        )
    if estimator == "tracker" and calibration is None:
        return pose
    placement = SensorPlacement[ToolTrial](
        device.hall.errors.placement, find_origin(device, known, "placement", "hall"), device.sensors
    )
    return (*pose, *sensor_sources(device, device.hall, "hall", _AVERAGED), placement)


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
