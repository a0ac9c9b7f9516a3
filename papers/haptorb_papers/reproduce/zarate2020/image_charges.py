"""The wrench on an Omni's tool a second time: no code, no formula and no numbers of the package's models are used.

The package takes the tool's ring magnet for charges on its faces, and the core's answer for a series in spherical
harmonics. Here the ring is the current ±M that circulates on its two walls, F = ∮ I dl × B, in the field of the
electromagnet's dipole and of the core's image charges. A charge q at s outside a sphere of radius a and relative
permeability µ has the image −q k a/|s| at a²s/|s|², k = (µ−1)/(µ+1), and from there to the centre a line of as much
charge in all, with the opposite sign and the density x^(−µ/(µ+1)) (C. Neumann 1883; I. V. Lindell, Am. J. Phys. 61,
39, 1993). For µ → ∞ all of the line's charge is at the centre.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import State
from haptorb.devices.electromagnet import SphericalElectromagnet

__all__ = ["SecondWrench", "compute_second_wrench"]

_MU0 = 4e-7 * np.pi
_ACROSS, _ALONG, _AROUND, _LINE = 4, 10, 24, 8  #: nodes of the faces, along the walls, around both, of an image's line


class SecondWrench(NamedTuple):
    """Wrench on the tool about its magnet."""

    per_ampere: Array  #: (6, m) [N/A, N·m/A]
    passive: Array  #: (6,) from the core alone [N, N·m]


def compute_second_wrench(device: SphericalElectromagnet, state: State) -> SecondWrench:
    """The wrench of the dipole per ampere, and of the core's images, on the currents of the tool's magnet.

    >>> from haptorb.devices.loader import load
    >>> second = compute_second_wrench(load("omni"), State.at((0, 0, 0.05)))
    >>> round(1e3 * float(second.passive[2]), 1)     # erratum E18
    -52.9
    """
    points, elements = _wall_currents(device, state)

    def wrench(field: Array) -> Array:
        forces = np.cross(elements, field)
        return np.concatenate([forces.sum(axis=0), np.cross(points - state.p, forces).sum(axis=0)])

    per_moment = [wrench(_dipole_field(axis, points)) for axis in np.eye(3)]
    places, charges = _core_images(device, state)
    return SecondWrench(np.transpose(per_moment) @ device.moment_per_current, wrench(_field(places, charges, points)))


def _wall_currents(device: SphericalElectromagnet, state: State) -> tuple[Array, Array]:
    """Points (n, 3) [m] on both walls and I dl (n, 3) [A·m] there, stator frame."""
    tool = device.tool
    node, weight = np.polynomial.legendre.leggauss(_ALONG)
    height, current = 0.5 * tool.length * node, 0.5 * tool.length * weight * tool.remanence / _MU0
    angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
    points, elements = [], []
    for radius, sign in ((tool.outer_radius, 1.0), (tool.inner_radius, -1.0)):
        z, turn = (part.ravel() for part in np.meshgrid(height, angle, indexing="ij"))
        size = sign * np.repeat(current, _AROUND) * radius * 2 * np.pi / _AROUND
        points.append(np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1))
        elements.append(size[:, None] * np.stack([-np.sin(turn), np.cos(turn), np.zeros_like(turn)], axis=1))
    return np.concatenate(points) @ state.R_SR.T + state.p, np.concatenate(elements) @ state.R_SR.T


def _core_images(device: SphericalElectromagnet, state: State) -> tuple[Array, Array]:
    """Places (n, 3) [m] and charges (n,) [A·m] of the images in the core of what is on the magnet's faces."""
    tool, a, mu = device.tool, device.core_radius, device.core_permeability
    node, weight = np.polynomial.legendre.leggauss(_ACROSS)
    middle, half = 0.5 * (tool.outer_radius + tool.inner_radius), 0.5 * (tool.outer_radius - tool.inner_radius)
    rho, angle = middle + half * node, 2 * np.pi * (np.arange(_AROUND) + 0.5) / _AROUND
    charge = np.repeat(half * weight * rho, _AROUND) * 2 * np.pi / _AROUND * tool.remanence / _MU0
    x, y = np.outer(rho, np.cos(angle)).ravel(), np.outer(rho, np.sin(angle)).ravel()
    z = np.full_like(x, 0.5 * tool.length)
    faces = np.concatenate([np.stack([x, y, z], axis=1), np.stack([x, y, -z], axis=1)])
    at, q = faces @ state.R_SR.T + state.p, np.concatenate([charge, -charge])
    square = (at**2).sum(axis=1)
    kelvin = at * (a * a / square)[:, None]
    share = 1.0 if np.isinf(mu) else (mu - 1.0) / (mu + 1.0)
    image = share * q * a / np.sqrt(square)
    places, charges = [kelvin], [-image]
    for where, part in zip(*_line(mu), strict=True):
        places.append(where * kelvin)
        charges.append(part * image)
    return np.concatenate(places), np.concatenate(charges)


def _line(mu: float) -> tuple[Array, Array]:
    """Where the charge of an image's line is, from 0 at the centre to 1, and in what shares, which add up to 1."""
    if np.isinf(mu):
        return np.zeros(1), np.ones(1)
    from scipy.special import roots_jacobi

    node, weight = roots_jacobi(_LINE, 0.0, -mu / (mu + 1.0))
    return 0.5 * (node + 1.0), weight / weight.sum()


def _dipole_field(moment: Array, points: Array) -> Array:
    """(n, 3) [T] of a point dipole at the centre: B = ∇ × A with A = μ0/4π m × r/r³, the curl written out."""
    square = (points**2).sum(axis=1)[:, None]
    along = points @ moment
    field: Array = _MU0 / (4 * np.pi) * (3 * along[:, None] * points / square - moment) / square**1.5
    return field


def _field(places: Array, charges: Array, points: Array) -> Array:
    """(n, 3) [T] at `points` of point charges."""
    x, y, z = (points[:, None, axis] - places[None, :, axis] for axis in range(3))
    square = x * x + y * y + z * z
    strength = _MU0 / (4 * np.pi) * charges / (square * np.sqrt(square))
    return np.stack([(strength * part).sum(axis=1) for part in (x, y, z)], axis=1)
