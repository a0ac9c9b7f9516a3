"""Second model of coils around a soft core: shares no code, formula or numbers with the package's models.

The package sums zonal harmonics of the winding and of what the core answers. Here a winding is a set of loops by
elliptic integrals (Smythe, Static and Dynamic Electricity, §7.10), and the core is charges on both sides of its surface
that make the field continuous there, as it is at a permeable sphere (the method of fundamental solutions).
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.special import ellipe, ellipk

from haptorb.arrays import Array, gauss_legendre
from haptorb.devices.electromagnet import SphericalElectromagnet

__all__ = ["charge_field", "compute_coil_fields", "list_loops", "loop_field", "make_coil", "spread_points"]

MU0 = 4e-7 * np.pi
_SURFACE, _CHARGES = 600, 300  #: points on the core's surface, and charges on either side of it


def loop_field(a: Array, height: Array, weights: Array, points: Array) -> Array:
    """(n, 3) [T/A] of circular loops about z, with `weights` turns each."""
    rho = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-9)[:, None]
    z = points[:, 2][:, None] - height
    square, near = (a + rho) ** 2 + z**2, (a - rho) ** 2 + z**2
    m = 4 * a * rho / square
    first, second = ellipk(m), ellipe(m)
    scale = MU0 / (2 * np.pi * np.sqrt(square))
    axial = scale * (first + (a * a - rho**2 - z**2) / near * second)
    across = scale * z / rho * (-first + (a * a + rho**2 + z**2) / near * second)
    radial, b_z = across @ weights, axial @ weights
    unit = points[:, :2] / rho
    return np.column_stack([radial[:, None] * unit, b_z])


def spread_points(count: int) -> Array:
    """(count, 3) unit vectors, evenly (Fibonacci)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    return np.column_stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])


def charge_field(places: Array, charges: Array, points: Array) -> Array:
    """(n, 3) Σ charge (x − place)/|x − place|³ at `points` (n, 3) [m]."""
    x, y, z = (points[:, None, axis] - places[None, :, axis] for axis in range(3))
    square = x * x + y * y + z * z
    share = charges / (square * np.sqrt(square))
    return np.stack([(share * part).sum(axis=1) for part in (x, y, z)], axis=1)


class MadeCoil(NamedTuple):
    """One coil about z with its core."""

    radii: Array  #: of its loops [m]
    heights: Array
    turns: Array  #: of each
    charges: Array  #: in the core, µ0/4π times them [T·m²/A]
    places: Array

    def field(self, points: Array) -> Array:
        """(n, 3) [T/A] outside the winding and the core."""
        own = loop_field(self.radii, self.heights, self.turns, points)
        found: Array = own + charge_field(self.places, self.charges, points)
        return found


@cache
def make_coil(inner: float, outer: float, length: float, turns: float, core: float, permeability: float) -> MadeCoil:
    """A winding of those radii and that length [m] around a sphere of radius `core` [m].

    On the sphere, the field along it is the same on both sides, and across it permeability times as great outside.
    The field is the coil's and that of charges: outside of charges within the sphere, inside of charges beyond it.
    """
    surface, points = core * spread_points(_SURFACE), spread_points(_CHARGES)
    normal, within, beyond = surface / core, 0.8 * core * points, core / 0.8 * points
    # many loops, evenly, where the core may be a millimetre away; a few at Gauss's nodes for what is farther
    even = (2 * np.arange(25) + 1) / 25 - 1
    own = loop_field(*list_loops(inner, outer, length, turns, even, np.full(25, 0.04)), surface)

    def unit(places: Array) -> Array:
        apart = surface[:, None] - places
        field: Array = apart / np.linalg.norm(apart, axis=2)[..., None] ** 3
        return field  # (p, n, 3)

    def split(field: Array) -> tuple[Array, Array]:
        across = np.einsum("...i,...i->...", field, normal.reshape(-1, *[1] * (field.ndim - 2), 3))
        return across, field - across[..., None] * normal.reshape(-1, *[1] * (field.ndim - 2), 3)

    inside, outside, (own_across, _) = split(unit(within)), split(unit(beyond)), split(own)
    share = 1.0 / permeability
    along = np.concatenate([np.moveaxis(one[1], 2, 1).reshape(3 * _SURFACE, -1) for one in (inside, outside)], axis=1)
    along[:, _CHARGES:] *= -1.0
    across = np.concatenate([share * inside[0], -outside[0]], axis=1)
    none = np.repeat([1e3 * np.abs(along).max(), 0.0], _CHARGES)[None]  # charges within the sphere add up to nothing
    wanted = np.concatenate([np.zeros(3 * _SURFACE), (1.0 - share) * own_across, [0.0]])
    matrix = np.vstack([along, across, none])
    charges = np.linalg.lstsq(matrix, wanted, rcond=1e-12)[0]
    if np.linalg.norm(matrix @ charges - wanted) > 1e-2 * np.linalg.norm(own):
        raise ValueError("no charges make a field that is continuous at the core")
    node, weight = gauss_legendre(4)
    loops = list_loops(inner, outer, length, turns, node, weight / 2)
    return MadeCoil(*loops, charges[:_CHARGES], within)


def list_loops(
    inner: float, outer: float, length: float, turns: float, node: Array, share: Array
) -> tuple[Array, Array, Array]:
    """Radii, heights and turns of loops at `node` (n,) each way over the section, from −1 to 1, with `share` (n,)."""
    radii, heights = np.meshgrid((inner + outer) / 2 + (outer - inner) / 2 * node, length / 2 * node)
    return radii.ravel(), heights.ravel(), turns * np.outer(share, share).ravel()


def compute_coil_fields(device: SphericalElectromagnet, points: Array, moments: Array | None = None) -> Array:
    """(n, 3, 3) [T/A] of each coil of `device`, or of the same coils with other `moments` per ampere (3, 3) [m²]."""
    w, per_ampere = device.windings, device.moment_per_current if moments is None else moments
    if w is None:
        raise ValueError("needs a device with [windings]")
    out = np.empty((len(points), 3, 3))
    for number in range(3):
        sizes = (float(one[number]) for one in (w.inner_radius, w.outer_radius, w.length, w.turns))
        coil = make_coil(*sizes, device.core_radius, device.core_permeability)
        size = float(np.linalg.norm(per_ampere[:, number]))
        axis = per_ampere[:, number] / size
        # the moment is that of the dipole with the coil's field on its axis where it was measured
        away = min(device.moments_at, 20.0)
        made = coil.field(np.array([[0.0, 0.0, away]]))[0, 2] * 2 * np.pi * away**3 / MU0
        first = np.cross(axis, [1.0, 2.0, 3.0])
        first /= np.linalg.norm(first)
        frame = np.column_stack([first, np.cross(axis, first), axis])
        out[:, :, number] = size / made * coil.field(points @ frame) @ frame.T
    return out
