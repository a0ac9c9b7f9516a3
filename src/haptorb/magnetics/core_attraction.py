"""Attraction of a ring magnet to a soft core without current: one scalar energy of distance and tilt.

The core responds to the tool's magnet (`soft_sphere`) with currents on or off. By symmetry the energy W of that
depends on the distance d and the tilt τ between the magnet's axis and the radius only, and not on the magnet's
polarity: W = u⁶ g(u, s), u = 1/d, s = cos²τ, where g is smooth from contact to infinity. g is tabulated once as a
Chebyshev series; force and torque are its analytic derivatives. So the pull is conservative whatever the table's
error, and force and torque agree: about the sphere's centre they cancel, as a sphere cannot be turned.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from haptorb.arrays import Array, check_finite
from haptorb.compiled import kernel
from haptorb.errors import GeometryError, PrecisionError
from haptorb.magnetics.magnets import ChargedRing
from haptorb.magnetics.soft_sphere import SoftSphere, pair_sums

__all__ = ["PassivePull", "pull"]


_BY_DISTANCE, _BY_TILT = 24, 12  #: terms of the series
_TAIL = 3e-5  #: greatest share of the series' last terms: above it the magnet is too near for this table


@kernel
def _energies(rows: Array, u: Array, s: Array, radius: float, response: Array, scale: float, out: Array) -> None:
    placed = rows.copy()
    sums = np.empty(response.shape[0])
    for i in range(u.shape[0]):
        # Terms fall with (a/d_charge)²; from far away few are needed.
        for j in range(s.shape[0]):
            c, d = np.sqrt(s[j]), 1.0 / u[i]
            t = np.sqrt(1.0 - s[j])
            nearest = 1e300
            for n in range(rows.shape[1]):
                x, z = rows[0, n], rows[2, n]
                placed[0, n] = c * x + t * z
                placed[2, n] = c * z - t * x + d
                square = placed[0, n] ** 2 + rows[1, n] ** 2 + placed[2, n] ** 2
                nearest = min(nearest, square)
            ratio = radius * radius / nearest
            order = min(int(np.log(1e-9 * (1.0 - ratio)) / np.log(ratio)) + 2, response.shape[0])
            pair_sums(placed, radius, sums[:order])
            total = 0.0
            for l in range(order):
                total += response[l] * sums[l]
            out[i, j] = scale * total / u[i] ** 6


@kernel
def _chebyshev(x: float, values: Array, slopes: Array) -> None:
    """Chebyshev's polynomials at x, the first n of them, and their derivatives: (n,) each."""
    values[0], slopes[0], values[1], slopes[1] = 1.0, 0.0, x, 1.0
    for k in range(2, values.shape[0]):
        values[k] = 2.0 * x * values[k - 1] - values[k - 2]
        slopes[k] = 2.0 * values[k - 1] + 2.0 * x * slopes[k - 1] - slopes[k - 2]


@kernel
def _energy(table: Array, nearest: float, p: Array, axis: Array, out: Array) -> None:
    """out (3,): W, ∂W/∂d, ∂W/∂s at the magnet's centre p and unit axis."""
    square = p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
    d = np.sqrt(square)
    dot = p[0] * axis[0] + p[1] * axis[1] + p[2] * axis[2]
    s = min(dot * dot / square, 1.0)
    inside = d < nearest
    u = 1.0 / nearest if inside else 1.0 / d
    x, y = 2.0 * u * nearest - 1.0, 2.0 * s - 1.0
    rows, columns = table.shape
    across, turned = np.empty(columns), np.empty(columns)
    _chebyshev(y, across, turned)
    # The polynomials in x come one after the other; the sums over y do not wait for each other.
    now, before, d_now, d_before = 1.0, 0.0, 0.0, 0.0
    g, gx, gy = 0.0, 0.0, 0.0
    for i in range(rows):
        value, slope = 0.0, 0.0
        for j in range(columns):
            value += table[i, j] * across[j]
            slope += table[i, j] * turned[j]
        g += now * value
        gx += d_now * value
        gy += now * slope
        after, d_after = 2.0 * x * now - before, 2.0 * now + 2.0 * x * d_now - d_before
        if i == 0:
            after, d_after = x, 1.0
        now, before, d_now, d_before = after, now, d_after, d_now
    u5 = u**5
    out[0] = u5 * u * g
    out[1] = 0.0 if inside else -u * u * (6.0 * u5 * g + u5 * u * gx * 2.0 * nearest)
    out[2] = 2.0 * u5 * u * gy


@kernel
def pull(table: Array, nearest: float, p: Array, axis: Array, out: Array) -> None:
    """Add to out (6,) force [N] and torque about p [N·m] on the magnet at p with unit axis."""
    w = np.empty(3)
    _energy(table, nearest, p, axis, w)
    d = np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    rx, ry, rz = p[0] / d, p[1] / d, p[2] / d
    c = min(max(rx * axis[0] + ry * axis[1] + rz * axis[2], -1.0), 1.0)
    turn = 2.0 * c * w[2]
    # F = −∂W/∂p: along the radius, and across it where the tilt changes on the way. T = −n × ∂W/∂n.
    out[0] -= w[1] * rx + turn * (axis[0] - c * rx) / d
    out[1] -= w[1] * ry + turn * (axis[1] - c * ry) / d
    out[2] -= w[1] * rz + turn * (axis[2] - c * rz) / d
    out[3] -= turn * (axis[1] * rz - axis[2] * ry)
    out[4] -= turn * (axis[2] * rx - axis[0] * rz)
    out[5] -= turn * (axis[0] * ry - axis[1] * rx)


@dataclass(frozen=True, kw_only=True)
class PassivePull:
    """The pull of a soft sphere at the origin on a ring magnet, from `nearest` to infinity.

    core_radius, outer_radius, inner_radius, length [m]; core_permeability relative (inf allowed); remanence [T];
    nearest: the smallest distance of the magnet's centre that is tabulated [m]. Nearer than that the energy is held at
    its value there: the torque continues, the radial pull ends. It must leave air between magnet and core.

    >>> omni = PassivePull(core_radius=15e-3, core_permeability=np.inf, outer_radius=6e-3, inner_radius=2.5e-3,
    ...                    length=24e-3, remanence=1.348, nearest=32e-3)
    >>> [round(-1e3 * float(omni.wrench(np.array([0, 0, d]), np.array([0, 0, 1.0]))[2]), 1) for d in (0.05, 0.06, 0.07)]
    [52.9, 12.2, 3.7]
    """

    core_radius: float
    core_permeability: float
    outer_radius: float
    inner_radius: float
    length: float
    remanence: float
    nearest: float
    table: Array = field(init=False, repr=False, compare=False)  #: (24, 12) Chebyshev coefficients of g [J·m⁶]

    def __post_init__(self) -> None:
        # Near the core the faces' edges matter: more points than the ring far away needs.
        ring = ChargedRing(self.outer_radius, self.inner_radius, self.length, self.remanence, radial=3, azimuth=12)
        sphere = SoftSphere(self.core_radius, self.core_permeability)
        closest = self.core_radius + max(self.length / 2, self.outer_radius)
        if not float(check_finite(self.nearest, "nearest")) > closest:
            raise GeometryError(
                f"nearest must leave air between magnet and core, more than {closest * 1e3:.4g} mm from centre to "
                f"centre; got {self.nearest * 1e3:.4g} mm"
            )
        x = np.cos(np.pi * (np.arange(_BY_DISTANCE) + 0.5) / _BY_DISTANCE)
        y = np.cos(np.pi * (np.arange(_BY_TILT) + 0.5) / _BY_TILT)
        reach = min(self.nearest - self.length / 2, self.nearest - self.outer_radius)
        response = sphere.response(sphere.order(reach, precision=1e-9))
        values = np.empty((_BY_DISTANCE, _BY_TILT))
        scale = -1e-7 / (2 * self.core_radius)  # −μ0/8πa
        _energies(ring.rows, (x + 1) / 2 / self.nearest, (y + 1) / 2, self.core_radius, response, scale, values)
        table = _cosines(_BY_DISTANCE) @ values @ _cosines(_BY_TILT).T
        size = np.abs(table).max()
        tail = max(np.abs(table[-2:]).max(), np.abs(table[:, -2:]).max())
        if size > 0.0 and tail > _TAIL * size:
            raise PrecisionError(
                f"the pull from {self.nearest * 1e3:.4g} mm outwards is tabulated to {tail / size:.1g} only; use a "
                f"nearest distance further than {closest * 1e3:.4g} mm from the core"
            )
        object.__setattr__(self, "table", np.ascontiguousarray(table))

    def energy(self, p: Array, axis: Array) -> float:
        """W [J] of the magnet at p (3,) [m] with unit axis (3,) in the core's response to it."""
        out = np.empty(3)
        _energy(self.table, self.nearest, np.ascontiguousarray(p), np.ascontiguousarray(axis), out)
        return float(out[0])

    def wrench(self, p: Array, axis: Array) -> Array:
        """(6,) force [N] and torque about p [N·m] on the magnet at p (3,) [m] with unit axis (3,); inputs trusted."""
        out = np.zeros(6)
        pull(self.table, self.nearest, np.ascontiguousarray(p), np.ascontiguousarray(axis), out)
        return out


def _cosines(count: int) -> Array:
    """(count, count) turns values at the Chebyshev nodes of the first kind into coefficients."""
    index = np.arange(count)
    matrix: Array = 2.0 / count * np.cos(np.pi * np.outer(index, index + 0.5) / count)
    matrix[0] /= 2
    return matrix
