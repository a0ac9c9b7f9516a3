"""A round winding's field to a wanted precision: current sheets, integrated over the wall by bisected Gauss rules."""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.physics.sources.current_sheet import sheet, sheet_gradient
from haptorb.physics.sources.round_body import tensor
from haptorb.physics.sources.zonal import zonal, zonal_gradient

__all__ = ["winding_field", "winding_gradient"]

_DEPTH = 48  #: bisections of one piece of the wall's thickness
_PIECES = 1000  #: pieces for one point before a precision is given up
_COARSE_X, _COARSE_W = np.polynomial.legendre.leggauss(8)
_FINE_X, _FINE_W = np.polynomial.legendre.leggauss(13)


@kernel
def _panel(left: float, right: float, h: float, rho: float, z: float, order: int, gradient: bool) -> tuple[float, ...]:
    """∫ of the sheets' components over the radius from `left` to `right` by the coarse (0) or fine (1) Gauss rule."""
    x, w = (_FINE_X, _FINE_W) if order else (_COARSE_X, _COARSE_W)
    half, middle = 0.5 * (right - left), 0.5 * (right + left)
    over, axial, shear = 0.0, 0.0, 0.0
    for i in range(x.shape[0]):
        if gradient:
            o, a, s = sheet_gradient(middle + half * x[i], h, rho, z)
            shear += half * w[i] * s
        else:
            o, a = sheet(middle + half * x[i], h, rho, z)
        over += half * w[i] * o
        axial += half * w[i] * a
    return over, axial, shear


@kernel
def _integral(
    inner: float, outer: float, h: float, rho: float, z: float, wanted: float, gradient: bool
) -> tuple[float, float, float, float, float]:
    """Components over the whole wall, how far the two Gauss rules differ (bisected until small), and Σ|panels|.

    The wall is cut where the point's own radius crosses it, as the sheets' field is not smooth there.
    """
    left, right, level = np.empty(_DEPTH + 4), np.empty(_DEPTH + 4), np.empty(_DEPTH + 4, np.int64)
    left[0], right[0], level[0] = inner, outer, 0
    count = 1
    if inner < rho < outer:
        right[0] = rho
        left[1], right[1], level[1] = rho, outer, 0
        count = 2
    lever = max(rho, 0.1 * outer)  # what turns B_ρ/ρ into a field to compare errors with
    total_over, total_axial, total_shear, error, gross = 0.0, 0.0, 0.0, 0.0, 0.0
    spent = 0
    while count:
        count -= 1
        spent += 1
        a, b, deep = left[count], right[count], level[count]
        o0, z0, s0 = _panel(a, b, h, rho, z, 0, gradient)
        o1, z1, s1 = _panel(a, b, h, rho, z, 1, gradient)
        if gradient:
            off = max(abs(o1 - o0), abs(z1 - z0), lever * abs(s1 - s0))
            size = max(abs(o1), abs(z1), lever * abs(s1))
        else:
            off = max(lever * abs(o1 - o0), abs(z1 - z0))
            size = max(lever * abs(o1), abs(z1))
        # a share of the tolerance in proportion to width or to size: whichever forgives more
        share = max((b - a) / (outer - inner) * (gross + size), size)
        if off > 0.2 * wanted * share and deep < _DEPTH and spent < _PIECES and b - a > 1e-11 * outer:
            middle = 0.5 * (a + b)
            left[count], right[count], level[count] = a, middle, deep + 1
            left[count + 1], right[count + 1], level[count + 1] = middle, b, deep + 1
            count += 2
            continue
        total_over += o1
        total_axial += z1
        total_shear += s1
        error += off
        gross += size
    return total_over, total_axial, total_shear, error, gross


@kernel
def winding_field(
    points: Array, shape: Array, c: Array, density: float, wanted: float, far2: float, out: Array, bound: Array,
    gross: Array,
) -> None:  # fmt: skip
    """Fill out (n, 3) [T] with the field at points (n, 3) [m], bound (n,) with its error, gross (n,) before cancelling.

    shape (3,): inner and outer radius, half length [m]; c, far2: the zonal series for points beyond √far2; density:
    [T/m] of one ampere; wanted: relative precision.
    """
    inner, outer, h = shape
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        rho2 = x * x + y * y
        if rho2 + z * z > far2:
            over, b_z = zonal(c, rho2, z)
            whole = abs(b_z) + np.sqrt(rho2) * abs(over)
            error = 1e-14 * whole
        else:
            over, b_z, _, error, whole = _integral(inner, outer, h, np.sqrt(rho2), z, wanted, False)
            over, b_z, error, whole = density * over, density * b_z, density * error, density * whole
        out[n, 0], out[n, 1], out[n, 2], bound[n], gross[n] = over * x, over * y, b_z, error, whole


@kernel
def winding_gradient(
    points: Array, shape: Array, c: Array, density: float, wanted: float, far2: float, out: Array, bound: Array,
    gross: Array,
) -> None:  # fmt: skip
    """As `winding_field`, of the gradient: out (n, 3, 3) [T/m], bound and gross [T/m]."""
    inner, outer, h = shape
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        rho2 = x * x + y * y
        if rho2 + z * z > far2:
            over, stretch, shear = zonal_gradient(c, rho2, z)
            whole = abs(stretch) + abs(over)
            error = 1e-14 * whole
        else:
            over, stretch, shear, error, whole = _integral(inner, outer, h, np.sqrt(rho2), z, wanted, True)
            over, stretch, shear = density * over, density * stretch, density * shear
            error, whole = density * error, density * whole
        tensor(x, y, over, stretch, shear, out[n])
        if inner * inner < rho2 < outer * outer and abs(z) < h:  # in the wire curl B = μ0 J: ∂B_z/∂ρ lacks it so far
            out[n, 2, 0] -= density * x / np.sqrt(rho2)
            out[n, 2, 1] -= density * y / np.sqrt(rho2)
        bound[n], gross[n] = error, whole
