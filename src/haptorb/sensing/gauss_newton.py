"""The orientation at which the field tables explain what the sensors read, by least squares, in one compiled kernel.

Unknown are the rotation vector δ of a small turn, R → exp(δ×) R, and the strength s of all magnets relative to the
device file: the reading of a sensor is s B(R). Each step solves the 4 × 4 normal equations of

    B_read − s B(R) ≈ s ∂B/∂δ δ + B ds

with the tables' own derivatives. A sensor whose residual after the step is many times that of the others is left out
and the step taken again; one that fits again comes back.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from haptorb.devices.spherical_motor import SphericalMotor
from haptorb.devices.table_kernels import sensor_field_gradient, torque_characteristic
from haptorb.physics.arrays import Array
from haptorb.physics.compiled import kernel
from haptorb.sensing.turning import turn_by

__all__ = ["FieldModel", "explained", "torque_per_ampere"]

_OUTLYING = 6.0  #: a residual so many times the middle one is no accident
_LONGEST = 0.06  #: longest turn of one step [rad]: the field changes over a few millimetres of 62
_WEAKEST, _STRONGEST = 0.5, 2.0  #: what is called the same rotor
_FEWEST = 4  #: three-axis sensors that must agree; fewer leave no doubt to be had


class FieldModel(NamedTuple):
    """The tables of a motor as kernels take them."""

    field_cells: Array
    field_scale: float
    torque_cells: Array
    torque_scale: float
    magnets: Array  #: (p, 3) rotor frame
    polarity: Array  #: (p,)
    sensors: Array  #: (k, 3) stator frame
    coils: Array  #: (c, 3) stator frame
    groups: Array  #: (c, m)

    @classmethod
    def of(cls, motor: SphericalMotor) -> FieldModel:
        """Built from the motor's pair tables."""
        field, torque = motor.tables.field_pair, motor.tables.torque_pair
        return cls(
            field.cells,
            field.scale,
            torque.cells,
            torque.scale,
            np.ascontiguousarray(motor.magnets.directions),
            np.ascontiguousarray(motor.polarity, dtype=np.float64),
            np.ascontiguousarray(motor.sensor_layout.directions),
            np.ascontiguousarray(motor.electromagnets.directions),
            np.ascontiguousarray(motor.groups, dtype=np.float64),
        )


@kernel
def torque_per_ampere(model: FieldModel, R: Array, strength: float, out: Array) -> None:
    """out (3, m) [N·m/A]: torque per ampere in every channel at R (3, 3)."""
    single = np.empty((1, 3, model.coils.shape[0]))
    torque_characteristic(
        model.torque_cells, model.torque_scale, model.magnets, model.polarity, model.coils, R.reshape(1, 3, 3), single
    )
    for i in range(3):
        for j in range(out.shape[1]):
            total = 0.0
            for c in range(model.coils.shape[0]):
                total += single[0, i, c] * model.groups[c, j]
            out[i, j] = strength * total


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
def _middle(squares: Array, usable: Array, count: int) -> float:
    kept = np.empty(count)
    n = 0
    for k in range(squares.shape[0]):
        if usable[k] > 0.0:
            kept[n] = squares[k]
            n += 1
    kept.sort()
    return float(kept[count // 2])


@kernel
def explained(
    model: FieldModel, field: Array, usable: Array, count: int, floor: float, tolerance: float, most: int,
    R: Array, strength: float, trusted: Array, covariance: Array,
) -> tuple[bool, float, float, float, int]:  # fmt: skip
    """Improve R (3, 3), in its place, until a step is below `tolerance` [rad], at most `most` steps.

    field (k, 3) [T] of the magnets alone, usable (k,) 1.0 or 0.0, `count` of them; trusted (k,) is usable less the
    outliers, in and out; floor [T] is the noise below which residuals are not told apart; covariance (3, 3) [rad²] out.
    Returns (converged, strength, residual rms [T], length of the last step [rad], number of outliers).
    """
    places = field.shape[0]
    B, J = np.empty((1, places, 3)), np.empty((1, places, 3, 3))
    N, gradient, squares = np.empty((4, 4)), np.empty(4), np.empty(places)
    row, step = np.empty(4), np.zeros(4)
    rms, length, out_count = np.inf, np.inf, 0
    if count < _FEWEST:
        return False, strength, rms, length, out_count
    turned = np.empty((3, 3))
    for _ in range(most):
        sensor_field_gradient(
            model.field_cells, model.field_scale, model.magnets, model.polarity, model.sensors,
            R.reshape(1, 3, 3), B, J,
        )  # fmt: skip
        for _again in range(4):
            N[:] = 0.0
            gradient[:] = 0.0
            for k in range(places):
                if trusted[k] > 0.0:
                    for i in range(3):
                        for a in range(3):
                            row[a] = strength * J[0, k, i, a]
                        row[3] = B[0, k, i]
                        r = field[k, i] - strength * row[3]
                        for a in range(4):
                            gradient[a] += row[a] * r
                            for b in range(4):
                                N[a, b] += row[a] * row[b]
            if not _inverse(N):
                return False, strength, rms, length, out_count
            for a in range(4):
                step[a] = N[a, 0] * gradient[0] + N[a, 1] * gradient[1] + N[a, 2] * gradient[2] + N[a, 3] * gradient[3]
            for k in range(places):
                squares[k] = 0.0
                for i in range(3):
                    r = field[k, i] - (strength + step[3]) * B[0, k, i]
                    r -= strength * (J[0, k, i, 0] * step[0] + J[0, k, i, 1] * step[1] + J[0, k, i, 2] * step[2])
                    squares[k] += r * r
            threshold = _OUTLYING * _OUTLYING * max(_middle(squares, usable, count), 3.0 * floor * floor)
            changed = False
            kept, total = 0, 0.0
            for k in range(places):
                trust = 1.0 if usable[k] > 0.0 and squares[k] <= threshold else 0.0
                changed = changed or trust != trusted[k]
                trusted[k] = trust
                if trust > 0.0:
                    kept += 1
                    total += squares[k]
            out_count = count - kept
            if not changed:
                break
        if kept < _FEWEST:
            return False, strength, rms, length, out_count
        rms = math.sqrt(total / (3.0 * kept))
        length = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
        shorter = min(1.0, _LONGEST / length) if length > 0.0 else 1.0
        turn_by(shorter * step[0], shorter * step[1], shorter * step[2], R, turned)
        R[:] = turned
        wanted = strength + shorter * step[3]
        strength = min(max(wanted, _WEAKEST), _STRONGEST)
        if length <= tolerance:
            if wanted != strength:  # sensors without supply agree well with magnets without strength
                return False, strength, rms, length, out_count
            noise = max(total / max(3.0 * kept - 4.0, 1.0), floor * floor)
            for a in range(3):
                for b in range(3):
                    covariance[a, b] = noise * N[a, b]
            return True, strength, rms, length, out_count
    return False, strength, rms, length, out_count
