"""What a spherical electromagnet can do over its shell: peak and lasting force, endurance, and its model's error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.electromagnet.remarks import FORCE_JND
from haptorb.devices.endurance import endurance
from haptorb.devices.state import State
from haptorb.numerics.arrays import Array

__all__ = ["Layer", "ShellCapability", "shell_capability"]


@dataclass(frozen=True)
class Layer:
    """Forces on a radial tool at one distance, least over the workspace [N]; exact model."""

    distance: float  #: of the tool's magnet from the centre [m]
    peak_radial: float
    peak_tangential: float
    lasting_radial: float
    lasting_tangential: float
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
    directions = _cap(device.workspace_half_angle, points)
    return ShellCapability(tuple(_layer(device, float(d), directions) for d in distances), endurance(device))


def _cap(half_angle: float, points: int) -> Array:
    """(points, 3) unit vectors spread evenly (a Fibonacci spiral) over the cap about +z."""
    n = np.arange(points) + 0.5
    z = 1 - n / points * (1 - np.cos(half_angle))
    turn = np.pi * (1 + np.sqrt(5)) * n
    s = np.sqrt(1 - z * z)
    return np.column_stack([s * np.cos(turn), s * np.sin(turn), z])


def _layer(device: SphericalElectromagnet, distance: float, directions: Array) -> Layer:
    limit, sustained = device.coils.current_limit, device.sustained_current
    radial, tangential, pulls, errors = [], [], [], []
    for direction in directions:
        state = State.at(distance * direction)
        exact = device.wrench_map(state, "exact")
        dipole = device.wrench_map(state, "published")
        per_newton = np.linalg.inv(exact.force)
        ways = state.R_SR.T  # rows: two tangents and the radial direction
        amperes = np.abs(ways @ per_newton.T)  # (3, m) for one newton each way
        most = np.array([(limit / amperes).min(axis=1), (sustained / amperes).min(axis=1)])
        radial.append(most[:, 2])
        # The weakest direction in the tangent plane, on a circle of them
        circle = np.linspace(0, np.pi, 16, endpoint=False)
        around = np.cos(circle)[:, None] * ways[0] + np.sin(circle)[:, None] * ways[1]
        amperes = np.abs(around @ per_newton.T)
        tangential.append([(limit / amperes).min(), (sustained / amperes).min()])
        pulls.append(-exact.passive[:3] @ direction)
        errors.append(np.linalg.norm(exact.force @ np.linalg.inv(dipole.force) - np.eye(3), 2))
    peak, lasting = np.min(radial, axis=0)
    peak_t, lasting_t = np.min(tangential, axis=0)
    return Layer(
        distance,
        float(peak),
        float(peak_t),
        float(lasting),
        float(lasting_t),
        float(np.mean(pulls)),
        float(np.max(errors)),
    )
