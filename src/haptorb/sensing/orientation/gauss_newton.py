"""The orientation at which the field tables explain what the sensors read, by least squares, in one compiled kernel.

Unknown are the rotation vector δ of a small turn, R → exp(δ×) R, and the strength s of all magnets relative to the
device file: the reading of a sensor is s B(R). Each step solves the 4 × 4 normal equations of

    B_read − s B(R) ≈ s ∂B/∂δ δ + B ds

with the tables' own derivatives. Those serve as long as the rotor is near where they were taken; only the field is
looked up again. A sensor whose residual after the step is many times that of the others is left out and the step taken
again; one that fits again comes back.
"""

from __future__ import annotations

import math

import numpy as np

from haptorb.devices.tables.table_kernels import sensor_field, sensor_field_gradient
from haptorb.numerics.arrays import Array, Record, fields
from haptorb.numerics.compiled import kernel
from haptorb.numerics.so3 import turn_by
from haptorb.sensing.orientation.field_model import FieldModel

__all__ = ["FIT", "fit_orientation"]

_OUTLYING = 6.0  #: a residual so many times the middle one is no accident
_LONGEST = 0.06  #: longest turn of one step [rad]: the field changes over a few millimetres of 62
_NEAR = 2e-3  #: after such a turn [rad] the derivatives are some hundredths off, and so is what a step ends short of
_WEAKEST, _STRONGEST = 0.5, 2.0  #: what is called the same rotor
_FEWEST = 4  #: three-axis sensors that must agree; fewer leave no doubt to be had

#: One search for an orientation: from where, and where it has come.
FIT = fields(
    ("noise", "f8"),  # of a reading [T]: below it residuals are not distinguished
    ("rotation", "f8", (3, 3)),  # R, in and out
    ("strength", "f8"),  # of the magnets, relative to the device file, in and out
    ("covariance", "f8", (3, 3)),  # of R as a rotation vector [rad²], out
    ("taken", "f8", (3, 3)),  # R at which the slopes were taken, NaN before the first
)


@kernel
def _inverse(N: Array) -> bool:
    """The inverse of the symmetric, positive 4 × 4 matrix N in its place (Gauss–Jordan); False if it has none."""
    size = N[0, 0] + N[1, 1] + N[2, 2]
    for p in range(4):
        pivot = N[p, p]
        if not pivot > 1e-9 * size:
            return False
        N[p, p] = 1.0
        for j in range(4):
            N[p, j] /= pivot
        for i in range(4):
            if i != p:
                factor = N[i, p]
                N[i, p] = 0.0
                for j in range(4):
                    N[i, j] -= factor * N[p, j]
    return True


@kernel
def _normal(field: Array, B: Array, J: Array, trusted: Array, strength: float, N: Array, step: Array) -> None:
    """N (4, 4) and step (4,) become matrix and right side of the normal equations over the trusted sensors."""
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    xb, yb, zb, bb = 0.0, 0.0, 0.0, 0.0
    gx, gy, gz, gb = 0.0, 0.0, 0.0, 0.0
    for k in range(field.shape[0]):
        share = trusted[k]
        for i in range(3):
            x, y, z, b = J[k, i, 0], J[k, i, 1], J[k, i, 2], B[k, i]
            r = share * (field[k, i] - strength * b)
            gx += x * r
            gy += y * r
            gz += z * r
            gb += b * r
            u, v, w, c = share * x, share * y, share * z, share * b
            xx += u * x
            xy += u * y
            xz += u * z
            yy += v * y
            yz += v * z
            zz += w * z
            xb += c * x
            yb += c * y
            zb += c * z
            bb += c * b
    two = strength * strength
    N[0, 0], N[0, 1], N[0, 2], N[0, 3] = two * xx, two * xy, two * xz, strength * xb
    N[1, 0], N[1, 1], N[1, 2], N[1, 3] = two * xy, two * yy, two * yz, strength * yb
    N[2, 0], N[2, 1], N[2, 2], N[2, 3] = two * xz, two * yz, two * zz, strength * zb
    N[3, 0], N[3, 1], N[3, 2], N[3, 3] = strength * xb, strength * yb, strength * zb, bb
    step[0], step[1], step[2], step[3] = strength * gx, strength * gy, strength * gz, gb


@kernel
def _solve(N: Array, step: Array) -> bool:
    """N becomes its inverse, step the solution; False, and no step, where there is none."""
    if not _inverse(N):
        return False
    a, b, c, d = step[0], step[1], step[2], step[3]
    for i in range(4):
        step[i] = N[i, 0] * a + N[i, 1] * b + N[i, 2] * c + N[i, 3] * d
    return True


@kernel
def _threshold(squares: Array, usable: Array, count: int, floor: float) -> float:
    """Square of a residual above which a sensor is an outlier: many times the middle one's, noise allowed for."""
    least = 3.0 * floor * floor
    greatest = 0.0
    for k in range(squares.shape[0]):
        greatest = max(greatest, usable[k] * squares[k])
    suspect = greatest / (_OUTLYING * _OUTLYING)
    if suspect <= least:
        return np.inf
    below = 0
    for k in range(squares.shape[0]):
        below += 1 if usable[k] > 0.0 and squares[k] < suspect else 0
    if below <= count // 2:  # the middle one itself is not below: no outlier
        return np.inf
    usable_squares = np.empty(count)
    n = 0
    for k in range(squares.shape[0]):
        if usable[k] > 0.0:
            usable_squares[n] = squares[k]
            n += 1
    usable_squares.sort()
    return float(_OUTLYING * _OUTLYING * max(usable_squares[count // 2], least))


@kernel
def _judge_sensors(
    field: Array, B: Array, J: Array, usable: Array, count: int, floor: float, strength: float, step: Array,
    squares: Array, trusted: Array,
) -> tuple[bool, int, float]:  # fmt: skip
    """Say in `trusted` which sensors fit after `step`: whether that is new, how many, their sum of squares [T²]."""
    a, b, c, s = strength * step[0], strength * step[1], strength * step[2], strength + step[3]
    for k in range(field.shape[0]):
        x = field[k, 0] - s * B[k, 0] - (a * J[k, 0, 0] + b * J[k, 0, 1] + c * J[k, 0, 2])
        y = field[k, 1] - s * B[k, 1] - (a * J[k, 1, 0] + b * J[k, 1, 1] + c * J[k, 1, 2])
        z = field[k, 2] - s * B[k, 2] - (a * J[k, 2, 0] + b * J[k, 2, 1] + c * J[k, 2, 2])
        squares[k] = x * x + y * y + z * z
    threshold = _threshold(squares, usable, count, floor)
    changed, inliers, total = False, 0, 0.0
    for k in range(field.shape[0]):
        trust = 1.0 if usable[k] > 0.0 and squares[k] <= threshold else 0.0
        changed = changed or trust != trusted[k]
        trusted[k] = trust
        if trust > 0.0:
            inliers += 1
            total += squares[k]
    return changed, inliers, total


@kernel
def _small_angle(A: Array, B: Array) -> float:
    """The angle between two orientations near to each other [rad]."""
    square = 0.0
    for i in range(3):
        for j in range(3):
            square += (A[i, j] - B[i, j]) * (A[i, j] - B[i, j])
    return math.sqrt(0.5 * square)


@kernel
def fit_orientation(
    fit: Record, model: FieldModel, field: Array, usable: Array, count: int, trusted: Array, slopes: Array,
    tolerance: float, most: int,
) -> tuple[bool, float, int]:  # fmt: skip
    """Improve rotation and strength of `fit`, a FIT, until a step is below `tolerance` [rad], at most `most` steps.

    field (k, 3) [T] of the magnets alone, usable (k,) 1.0 or 0.0, `count` of them; trusted (k,) is usable less the
    outliers, in and out; slopes (k, 3, 3) [T/rad] are the derivatives where `fit` has taken them, in and out. The
    strength is changed where it converges only. Returns (converged, residual rms [T], number of outliers).
    """
    R, taken, covariance, strength = fit.rotation, fit.taken, fit.covariance, fit.strength
    places = field.shape[0]
    B, N, step = np.empty((1, places, 3)), np.empty((4, 4)), np.empty(4)
    squares, turned = np.empty(places), np.empty((3, 3))
    rms, out_count = np.inf, 0
    if count < _FEWEST:
        return False, rms, out_count
    for _ in range(most):
        here = R.reshape(1, 3, 3)
        if _small_angle(R, taken) <= _NEAR:
            sensor_field(
                model.field_cells, model.field_scale, model.magnets, model.polarity, model.sensors, here, B
            )  # fmt: skip
        else:
            sensor_field_gradient(
                model.field_cells, model.field_scale, model.magnets, model.polarity, model.sensors, here, B,
                slopes.reshape(1, places, 3, 3),
            )  # fmt: skip
            for i in range(3):
                for j in range(3):
                    taken[i, j] = R[i, j]
        inliers, total = 0, 0.0
        for _again in range(4):
            _normal(field, B[0], slopes, trusted, strength, N, step)
            if not _solve(N, step):
                return False, rms, out_count
            changed, inliers, total = _judge_sensors(
                field, B[0], slopes, usable, count, fit.noise, strength, step, squares, trusted
            )  # fmt: skip
            out_count = count - inliers
            if not changed:
                break
        if inliers < _FEWEST:
            return False, rms, out_count
        rms = math.sqrt(total / (3.0 * inliers))
        length = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
        shorter = min(1.0, _LONGEST / length) if length > 0.0 else 1.0
        turn_by(shorter * step[0], shorter * step[1], shorter * step[2], R, turned)
        for i in range(3):
            for j in range(3):
                R[i, j] = turned[i, j]
        wanted = strength + shorter * step[3]
        strength = min(max(wanted, _WEAKEST), _STRONGEST)
        if length <= tolerance:
            # safety: dead-sensors
            if wanted != strength:  # sensors without supply agree well with magnets without strength
                return False, rms, out_count
            noise = max(total / max(3.0 * inliers - 4.0, 1.0), fit.noise * fit.noise)
            for a in range(3):
                for b in range(3):
                    covariance[a, b] = noise * N[a, b]
            fit.strength = strength
            return True, rms, out_count
    return False, rms, out_count
