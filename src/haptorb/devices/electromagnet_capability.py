"""Performance of a spherical electromagnet over its shell: peak and continuous force, endurance, and model error.

Coils that warm each other last less. A continuous force is stated with one coil warm, where each coil carries what it
stands alone, and with all coils warm, where each carries what it stands while all carry as much.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from haptorb.arrays import Array, cap_directions
from haptorb.devices.api import electromagnet
from haptorb.devices.base import (
    Device,
    State,
    endurance,
)
from haptorb.devices.electromagnet import FORCE_JND, SphericalElectromagnet
from haptorb.earlier_names import warn_earlier

__all__ = ["Layer", "ShellCapability", "shell_capability"]


@dataclass(frozen=True)
class Layer:
    """Forces on a radial tool at one distance, least over the workspace [N]; the device's first model."""

    distance: float  #: of the tool's magnet from the centre [m]
    peak_radial: float
    peak_tangential: float
    continuous_radial: float  #: one coil warm
    continuous_tangential: float
    continuous_radial_all_warm: float
    continuous_tangential_all_warm: float
    passive_pull: float  #: towards the centre, with all currents off
    dipole_error: (
        float  #: greatest relative error of the coils' force if the tool's magnet is a point dipole; its shape
    )
    coil_error: float | None  #: relative error of the force, rms over directions, as coils are points; None: unknown

    def __getattr__(self, name: str) -> float:
        """Value by the name it had before: lasting_radial and the like."""
        now = name.replace("lasting_", "continuous_", 1)
        if now == name or now not in type(self).__annotations__:
            raise AttributeError(f"'Layer' has no attribute '{name}'")
        warn_earlier(f"Layer.{name} is now called Layer.{now}")
        return float(getattr(self, now))

    @property
    def dipole_error_jnd(self) -> float:
        """The same in just-noticeable differences of force."""
        return self.dipole_error / FORCE_JND


@dataclass(frozen=True)
class ShellCapability:
    """Force over the shell above the dome by height, and how long loads last.

    Parameters
    ----------
    layers : tuple of Layer
        Peak and continuous force [N] at each distance from the centre, from contact outward.
    endurance : tuple of (float, float)
        Share of full current [1], and time from cold to derating [s] or inf.
    """

    layers: tuple[Layer, ...]
    endurance: tuple[tuple[float, float], ...]


def shell_capability(device: Device | str | Path, distances: Array | None = None, points: int = 60) -> ShellCapability:
    """Compute the peak and continuous force of a spherical electromagnet over its shell.

    Parameters
    ----------
    device : Device, str or Path
        Spherical electromagnet, or its name in the catalogue, or path of its file.
    distances : ndarray, shape (n,), optional
        Distances of the tool's magnet from the centre [m]; None: five from contact to the top of the shell.
    points : int
        Number of directions over the workspace.

    Returns
    -------
    ShellCapability
        Forces [N] in the weakest direction at each distance, and times [s] from cold to derating.

    Raises
    ------
    InputError
        If the device is not a spherical electromagnet.

    Notes
    -----
    By the device's first model, within the current limits, the continuous currents and the power of the supply, with
    windings at the stop temperature.

    Examples
    --------
    >>> contact = shell_capability("omni", points=20).layers[0]
    >>> contact.continuous_radial_all_warm < contact.peak_radial
    True
    """
    known = electromagnet(device, "the capability of a shell")
    if distances is None:
        distances = known.contact_distance + np.linspace(0, known.shell_thickness, 5)
    directions = cap_directions(known.workspace_half_angle, points)
    return ShellCapability(tuple(_layer(known, float(d), directions) for d in distances), endurance(known))


def _layer(device: SphericalElectromagnet, distance: float, directions: Array) -> Layer:
    most = np.array([device.driven_current, device.sustained_current, device.sustained_current_together])
    radial, tangential, pulls, errors = [], [], [], []
    wound: list[float] | None = [] if device.has_sizes else None
    for direction in directions:
        state = State.at(distance * direction)
        exact, points = device.wrench_map(state, device.models[0]), device.wrench_map(state, "point-coils")
        dipole = device.wrench_map(state, "published")
        per_newton = np.linalg.inv(exact.force)
        ways = state.R_SR.T  # rows: two tangents and the radial direction
        amperes = ways @ per_newton.T  # (3, m) for one newton each way
        outward = float(device.greatest_resistance @ amperes[2] ** 2)
        radial.append(_greatest(device, np.abs(amperes[2]), outward, most))
        # The weakest direction in the tangent plane: for a coil's limit, along its own gradient; for the supply, along
        # the axis of the greatest power.
        power = (device.greatest_resistance * amperes[:2]) @ amperes[:2].T
        across = np.linalg.norm(amperes[:2], axis=0)
        tangential.append(_greatest(device, across, float(np.linalg.eigvalsh(power)[-1]), most))
        pulls.append(-exact.passive[:3] @ direction)
        errors.append(np.linalg.norm(points.force @ np.linalg.inv(dipole.force) - np.eye(3), 2))
        if wound is not None:
            given = exact.force @ np.linalg.inv(points.force)
            wound.append(float(np.linalg.norm(given - np.eye(3)) ** 2 / 3))
    peak, lasting, warm = np.min(radial, axis=0)
    peak_t, lasting_t, warm_t = np.min(tangential, axis=0)
    return Layer(
        distance,
        float(peak),
        float(peak_t),
        float(lasting),
        float(lasting_t),
        float(warm),
        float(warm_t),
        float(np.mean(pulls)),
        float(np.max(errors)),
        None if wound is None else float(np.sqrt(np.mean(wound))),
    )


def _greatest(device: SphericalElectromagnet, amperes: Array, watts: float, most: Array) -> Array:
    """(k,) the maximum force [N] within each row of `most` (k, m) [A] and the supply, where one newton takes at most
    `amperes` (m,) in each coil and `watts` in all."""
    within: Array = (most / np.maximum(amperes, 1e-30)).min(axis=1)
    supplied = np.sqrt(device.supply.power / watts)
    return np.minimum(within, supplied)
