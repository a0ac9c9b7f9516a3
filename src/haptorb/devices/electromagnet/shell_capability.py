"""What a spherical electromagnet can do over its shell: peak and lasting force, endurance, and its model's error.

Coils that warm each other last less. A lasting force is stated with one coil warm, where each coil carries what it
stands alone, and with all coils warm, where each carries what it stands while all carry as much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.electromagnet.remarks import FORCE_JND
from haptorb.devices.endurance import endurance
from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.numerics.directions import cap_directions

__all__ = ["Layer", "ShellCapability", "shell_capability"]


@dataclass(frozen=True)
class Layer:
    """Forces on a radial tool at one distance, least over the workspace [N]; exact model."""

    distance: float  #: of the tool's magnet from the centre [m]
    peak_radial: float
    peak_tangential: float
    lasting_radial: float  #: one coil warm
    lasting_tangential: float
    lasting_radial_all_warm: float
    lasting_tangential_all_warm: float
    passive_pull: float  #: towards the centre, with all currents off
    dipole_error: float  #: greatest relative error of the dipole model's force

    @property
    def dipole_error_jnd(self) -> float:
        """The dipole model's error in just-noticeable differences of force."""
        return self.dipole_error / FORCE_JND


@dataclass(frozen=True)
class ShellCapability:
    """The whole card: force by distance, and how long loads may last from room temperature."""

    layers: tuple[Layer, ...]
    endurance: tuple[tuple[float, float], ...]  #: (share of full current, seconds until derating or inf)


def shell_capability(
    device: SphericalElectromagnet, distances: Array | None = None, points: int = 60
) -> ShellCapability:
    """Card for `device` at `distances` [m] (five over the shell where none are given), `points` over the workspace."""
    if distances is None:
        distances = device.contact_distance + np.linspace(0, device.shell_thickness, 5)
    directions = cap_directions(device.workspace_half_angle, points)
    return ShellCapability(tuple(_layer(device, float(d), directions) for d in distances), endurance(device))


def _layer(device: SphericalElectromagnet, distance: float, directions: Array) -> Layer:
    most = np.array([device.coils.current_limit, device.sustained_current, device.sustained_current_together])
    radial, tangential, pulls, errors = [], [], [], []
    for direction in directions:
        state = State.at(distance * direction)
        exact = device.wrench_map(state, "exact")
        dipole = device.wrench_map(state, "published")
        per_newton = np.linalg.inv(exact.force)
        ways = state.R_SR.T  # rows: two tangents and the radial direction
        amperes = np.abs(ways @ per_newton.T)  # (3, m) for one newton each way
        radial.append(_greatest(device, amperes[2:], most))
        # The weakest direction in the tangent plane, on a circle of them
        circle = np.linspace(0, np.pi, 16, endpoint=False)
        around = np.cos(circle)[:, None] * ways[0] + np.sin(circle)[:, None] * ways[1]
        tangential.append(_greatest(device, np.abs(around @ per_newton.T), most))
        pulls.append(-exact.passive[:3] @ direction)
        errors.append(np.linalg.norm(exact.force @ np.linalg.inv(dipole.force) - np.eye(3), 2))
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
    )


def _greatest(device: SphericalElectromagnet, amperes: Array, most: Array) -> Array:
    """(k,) the greatest force [N] in every one of some directions, within each row of `most` (k, m) [A] and the supply.

    amperes (n, m) is what one newton takes in each direction.
    """
    within = (most[:, None, :] / amperes).min(axis=2)
    supplied = np.sqrt(device.supply.power / (device.greatest_resistance * amperes**2).sum(axis=1))
    greatest: Array = np.minimum(within, supplied).min(axis=1)
    return greatest
