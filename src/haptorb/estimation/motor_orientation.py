"""Orientation by least squares over the field tables, with the torque per ampere at it: `least-squares`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from haptorb.arrays import Array, Record, Records, StateArray, Stateful, fields, make_numbers, rotation, state_zeros
from haptorb.compiled import kernel, pack, part, tick_kernel
from haptorb.devices.base import State, WrenchMap
from haptorb.devices.motor import SphericalMotor
from haptorb.devices.tables import sensor_field, sensor_field_gradient, torque_characteristic
from haptorb.devices.weight_regulator import torque_over_sine
from haptorb.errors import InputError
from haptorb.estimation.types import Estimate, Estimator, KeptEstimate, Pose, Sample
from haptorb.rotations import correct_rotation, rotation_from_euler, turn_by

__all__ = [
    "FIT",
    "TRACK",
    "ColdStart",
    "FieldModel",
    "LeastSquaresOrientation",
    "OrientationFix",
    "field_model",
    "fit_orientation",
    "magnet_field",
    "nearest_branch",
    "reading_limit",
    "spin_period",
    "torque_per_ampere",
    "unpack",
]


# --------------------------------------------------------------------------------------------------
# Model of a motor's field sensors and coils for compiled code: one packed array.


class FieldModel(NamedTuple):
    """Parts of a motor's model, within compiled code."""

    field_cells: Array
    field_scale: float
    torque_cells: Array
    torque_scale: float
    magnets: Array  #: (p, 3) rotor frame
    polarity: Array  #: (p,)
    sensors: Array  #: (k, 3) stator frame
    coils: Array  #: (c, 3) stator frame
    groups: Array  #: (c, m)
    per_ampere: Array  #: (m, 3 k) the coils' field at the sensors [T/A]
    tilt_torque: Array  #: (n,) coefficients of weight and regulator, of `torque_over_sine` [N·m]
    least: float  #: minimum cosine of their range of validity


def field_model(motor: SphericalMotor) -> Array:
    """(n,) packed FieldModel, [T] and [N·m/A] from the motor's pair tables; `unpack` is the inverse."""
    field, torque = motor.tables.field_pair, motor.tables.torque_pair
    coefficients, least = motor.tilt_torque
    return pack(
        (field.scale, torque.scale, least),
        field.cells,
        torque.cells,
        motor.magnets.directions,
        motor.polarity,
        motor.sensor_layout.directions,
        motor.electromagnets.directions,
        motor.groups,
        motor.sensor_field_per_ampere,
        coefficients,
    )


@kernel
def unpack(model: Array) -> FieldModel:
    """Inverse of `field_model`, each field in its own unit."""
    one = part(model, 0)
    return FieldModel(
        part(model, 1), one[0, 0], part(model, 2), one[0, 1], part(model, 3), part(model, 4)[0], part(model, 5),
        part(model, 6), part(model, 7), part(model, 8), part(model, 9)[0], one[0, 2],
    )  # fmt: skip


@kernel
def torque_per_ampere(model: FieldModel, R: Array, strength: float, matrix: Array, passive: Array) -> None:
    """Fill matrix (6, m): no force, and [N·m/A] in every channel at R (3, 3); passive (6,): weight and regulator."""
    single = np.empty((1, 3, model.coils.shape[0]))
    torque_characteristic(
        model.torque_cells, model.torque_scale, model.magnets, model.polarity, model.coils, R.reshape(1, 3, 3), single
    )
    for i in range(3):
        for j in range(matrix.shape[1]):
            matrix[i, j], matrix[3 + i, j] = 0.0, 0.0
        for c in range(model.coils.shape[0]):
            K = strength * single[0, i, c]
            for j in range(matrix.shape[1]):
                matrix[3 + i, j] += K * model.groups[c, j]
    back = torque_over_sine(R[2, 2], model.tilt_torque, model.least)
    passive[0], passive[1], passive[2] = 0.0, 0.0, 0.0
    passive[3], passive[4], passive[5] = back * R[1, 2], -back * R[0, 2], 0.0


# --------------------------------------------------------------------------------------------------
# Orientation from the sensor readings by nonlinear least squares over the field tables, in one compiled kernel.
#
# Unknown are the rotation vector δ of a small rotation, R → exp(δ×) R, and the strength s of all magnets relative to
# the device file: the reading of a sensor is s B(R). Each step solves the 4 × 4 normal equations of
#
#     B_read − s B(R) ≈ s ∂B/∂δ δ + B ds
#
# with the tables' own derivatives. Those are reused while the rotor is near the orientation at which they were
# computed; only the field is evaluated again. A sensor whose residual after the step is many times that of the others
# is excluded and the step repeated; one that fits again is included again.


_OUTLIER_THRESHOLD_MEDIANS = 6.0  #: outlier threshold, in multiples of the median residual
_MAX_STEP_RAD = 0.06  #: maximum rotation of one step [rad]: the field changes over a few millimetres of 62
#: rotation [rad] after which the derivatives are a few percent off, and so is the remaining error of a step
_MAX_DERIVATIVE_ROTATION_RAD = 2e-3
_MIN_STRENGTH, _MAX_STRENGTH = 0.5, 2.0  #: bounds of the magnet strength for the same rotor
_MIN_AGREEING_SENSORS = 4  #: minimum number of agreeing three-axis sensors; fewer give no redundancy

#: State of one search for an orientation.
FIT = fields(
    ("noise", "f8"),  # of a reading [T]: residuals below it are not distinguished
    ("rotation", "f8", (3, 3)),  # R, in and out
    ("strength", "f8"),  # of the magnets, relative to the device file, in and out
    ("covariance", "f8", (3, 3)),  # of R as a rotation vector [rad²], out
    ("taken", "f8", (3, 3)),  # R at which the slopes were taken, NaN before the first
)


@kernel
def _inverse(N: Array) -> bool:
    """Invert the symmetric, positive 4 × 4 matrix N in place (Gauss–Jordan); False if it is singular."""
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
    """Fill N (4, 4) and step (4,): matrix and right-hand side of the normal equations over the trusted sensors."""
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
    """Invert N in place and solve for the step; False, and no step, if N is singular."""
    if not _inverse(N):
        return False
    a, b, c, d = step[0], step[1], step[2], step[3]
    for i in range(4):
        step[i] = N[i, 0] * a + N[i, 1] * b + N[i, 2] * c + N[i, 3] * d
    return True


@kernel
def _threshold(squares: Array, usable: Array, count: int, floor: float) -> float:
    """Squared residual above which a sensor is an outlier: a multiple of the median, with a margin for noise."""
    least = 3.0 * floor * floor
    greatest = 0.0
    for k in range(squares.shape[0]):
        greatest = max(greatest, usable[k] * squares[k])
    suspect = greatest / (_OUTLIER_THRESHOLD_MEDIANS * _OUTLIER_THRESHOLD_MEDIANS)
    if suspect <= least:
        return np.inf
    below = 0
    for k in range(squares.shape[0]):
        below += 1 if usable[k] > 0.0 and squares[k] < suspect else 0
    if below <= count // 2:  # the median itself is not below: no outlier
        return np.inf
    usable_squares = np.empty(count)
    n = 0
    for k in range(squares.shape[0]):
        if usable[k] > 0.0:
            usable_squares[n] = squares[k]
            n += 1
    usable_squares.sort()
    return float(_OUTLIER_THRESHOLD_MEDIANS * _OUTLIER_THRESHOLD_MEDIANS * max(usable_squares[count // 2], least))


@kernel
def _judge_sensors(
    field: Array, B: Array, J: Array, usable: Array, count: int, floor: float, strength: float, step: Array,
    squares: Array, trusted: Array,
) -> tuple[bool, int, float]:  # fmt: skip
    """Mark in `trusted` the sensors that fit after `step`; returns whether that changed, their number, and residual
    [T²]."""
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
    """Angle between two orientations close to each other [rad]."""
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
    outliers, in and out; slopes (k, 3, 3) [T/rad] are the derivatives at the linearisation point of `fit`, in and out.
    The strength is changed only on convergence. Returns (converged, residual rms [T], number of outliers).
    """
    R, taken, covariance, strength = fit.rotation, fit.taken, fit.covariance, fit.strength
    places = field.shape[0]
    B, N, step = np.empty((1, places, 3)), np.empty((4, 4)), np.empty(4)
    squares, turned = np.empty(places), np.empty((3, 3))
    rms, out_count = np.inf, 0
    if count < _MIN_AGREEING_SENSORS:
        return False, rms, out_count
    for _ in range(most):
        here = R.reshape(1, 3, 3)
        if _small_angle(R, taken) <= _MAX_DERIVATIVE_ROTATION_RAD:
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
        if inliers < _MIN_AGREEING_SENSORS:
            return False, rms, out_count
        rms = math.sqrt(total / (3.0 * inliers))
        length = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
        shorter = min(1.0, _MAX_STEP_RAD / length) if length > 0.0 else 1.0
        turn_by(shorter * step[0], shorter * step[1], shorter * step[2], R, turned)
        for i in range(3):
            for j in range(3):
                R[i, j] = turned[i, j]
        wanted = strength + shorter * step[3]
        strength = min(max(wanted, _MIN_STRENGTH), _MAX_STRENGTH)
        if length <= tolerance:
            # safety: dead-sensors
            if wanted != strength:  # unpowered sensors are consistent with magnets of zero strength
                return False, rms, out_count
            noise = max(total / max(3.0 * inliers - 4.0, 1.0), fit.noise * fit.noise)
            for a in range(3):
                for b in range(3):
                    covariance[a, b] = noise * N[a, b]
            fit.strength = strength
            return True, rms, out_count
    return False, rms, out_count


# --------------------------------------------------------------------------------------------------
# Plausibility of field sensor readings, and subtraction of the coils' field.


def reading_limit(motor: SphericalMotor, orientations: Array, field: Array) -> float:
    """Magnitude [T] above which a sensor is faulty: 1.5 times the maximum of magnets and coils.

    Over orientations (n, 3, 3), whose field (n, k, 3) [T] is given. Raises InputError if there are none.
    """
    if not len(orientations):
        raise InputError("the field's range needs at least one orientation; got none")
    most = float(np.sqrt((field**2).sum(axis=2).max()))
    coils = motor.coils.current_limit @ np.abs(motor.sensor_field_per_ampere)
    return 1.5 * (most + float(np.sqrt((coils.reshape(-1, 3) ** 2).sum(axis=1).max())))


@kernel
def magnet_field(field: Array, currents: Array, per_ampere: Array, limit: float, out: Array, usable: Array) -> int:
    """out (k, 3) [T] = field minus the coils' part; usable (k,) 1.0 or 0.0; returns the number of usable sensors.

    A reading that is not finite or exceeds `limit` [T] is not usable and becomes zero in `out`. A reading of zero may
    be true: between four magnets of a checkerboard there is no field.
    """
    read, rest = field.reshape(-1), out.reshape(-1)
    for r in range(rest.shape[0]):
        rest[r] = read[r]
    for j in range(currents.shape[0]):
        ampere = currents[j]
        for r in range(rest.shape[0]):
            rest[r] -= per_ampere[j, r] * ampere
    count = 0
    for k in range(field.shape[0]):
        square = field[k, 0] * field[k, 0] + field[k, 1] * field[k, 1] + field[k, 2] * field[k, 2]
        total = out[k, 0] + out[k, 1] + out[k, 2]
        # safety: readings-possible
        if square <= limit * limit and np.isfinite(total):  # NaN fails the first comparison
            usable[k] = 1.0
            count += 1
        else:
            usable[k] = 0.0
            out[k, 0], out[k, 1], out[k, 2] = 0.0, 0.0, 0.0
    return count


# --------------------------------------------------------------------------------------------------
# Ambiguity of the rotor's spin: multiples of the magnets' period cannot be observed from the field.


def spin_period(motor: SphericalMotor) -> float:
    """Smallest rotation about the rotor's own z axis that maps the magnets onto themselves [rad]; 0 if there is none.

    Orientations that differ by it have the same field everywhere: they are indistinguishable to field sensors.

    >>> import haptorb
    >>> float(np.degrees(spin_period(haptorb.load("pmsm"))).round(9))
    60.0
    """
    axes = motor.magnets.directions
    for fold in range(len(axes), 1, -1):
        turn = rotation_from_euler(0.0, 0.0, 2 * np.pi / fold)
        gaps = np.linalg.norm((axes @ turn.T)[:, None] - axes[None], axis=2)
        onto = gaps.argmin(axis=1)
        if gaps.min(axis=1).max() < 1e-6 and np.abs(motor.polarity[onto] - motor.polarity).max() < 1e-9:
            return float(2 * np.pi / fold)
    return 0.0


def nearest_branch(R_SR: Array, near: Array, period: float) -> Array:
    """R_SR (3, 3) rotated about its own z axis by the multiple of `period` [rad] that brings it nearest to `near`.

    >>> third = rotation_from_euler(0, 0, 2 * np.pi / 3)
    >>> bool(np.allclose(nearest_branch(third, np.eye(3), np.pi / 3), np.eye(3)))
    True
    """
    if period == 0.0:
        return R_SR
    relative = R_SR.T @ near
    # the trace of Rz(−a) relative is greatest at this angle
    angle = np.arctan2(relative[1, 0] - relative[0, 1], relative[0, 0] + relative[1, 1])
    return R_SR @ rotation_from_euler(0.0, 0.0, period * np.round(angle / period))


# --------------------------------------------------------------------------------------------------
# Cold start of the orientation: the grid node whose field matches the readings best, then least squares from there.


_STEP = np.radians(4.0)  #: node spacing: Gauss–Newton converges from half of that
_GRID_MARGIN_RAD = np.radians(4.0)  #: margin of the grid beyond the workspace
_MAX_CANDIDATES = 8  #: number of nodes tried, in order of similarity
#: minimum distance of two candidates: closer ones converge to the same orientation
_MIN_CANDIDATE_DISTANCE_RAD = np.radians(7.0)
#: convergence of a cold start [rad], and its maximum number of steps
_COLD_START_TOLERANCE, _COLD_START_STEPS = 1e-6, 25
_COLD_START_POOR = 0.1  #: residual over field above which no orientation of the rotor explains the readings
_MIN_COLD_START_SENSORS = 8  #: number of sensors below which several orientations may be indistinguishable


class OrientationFix(NamedTuple):
    """Orientation of the rotor, up to the period of its spin."""

    R_SR: Array
    strength: float
    covariance: Array  #: (3, 3) of R_SR as a rotation vector, stator frame [rad²]
    outliers: int


class ColdStart(Stateful):
    """Grid over the workspace and one period of spin, with the field at every node."""

    def __init__(self, motor: SphericalMotor, model: Array, noise: float) -> None:
        self._model = model
        self._slopes, self._fit = state_zeros((motor.sensors, 3, 3)), state_zeros(1, FIT)
        self._fit["noise"], self._fit["taken"] = noise, np.nan
        reach = motor.workspace_tilt + _GRID_MARGIN_RAD
        tilts = np.linspace(-reach, reach, 2 * int(np.ceil(reach / _STEP)) + 1)
        period = spin_period(motor) or 2 * np.pi
        turns = period * np.arange(int(np.ceil(period / _STEP))) / np.ceil(period / _STEP)
        angles = np.meshgrid(tilts, tilts, turns, indexing="ij")
        self._nodes = rotation_from_euler(*(angle.ravel() for angle in angles))
        field = motor.sensor_field(self._nodes, "table")
        self.limit = reading_limit(motor, self._nodes, field)  #: [T]
        self._largest = float(np.sqrt((field**2).sum(axis=2).max()))
        self._fields = np.ascontiguousarray(field.reshape(len(field), -1))

    def state_arrays(self) -> Mapping[str, StateArray]:
        """Last fit: the next one may start with its derivatives."""
        return {"slopes": self._slopes, "fit": self._fit}

    def search(self, field: Array, usable: Array, trusted: Array) -> OrientationFix | None:
        """Orientation that explains `field` (k, 3) [T], or None; arguments as for `fit_orientation`."""
        fit = self._fit
        trusted[:] = usable
        count = int(usable.sum())
        if count < _MIN_COLD_START_SENSORS:
            return None
        likeness = np.empty(len(self._nodes))
        _fill_cosines(self._fields, field, usable, self._largest, likeness)
        rms = float(np.sqrt((field**2).sum() / (3 * count)))
        tried: list[Array] = []
        for node in np.argsort(-likeness)[: 40 * _MAX_CANDIDATES]:
            R = self._nodes[node]
            if any(np.trace(R.T @ other) > 1 + 2 * np.cos(_MIN_CANDIDATE_DISTANCE_RAD) for other in tried):
                continue
            tried.append(R)
            trusted[:] = usable
            fit["rotation"], fit["strength"] = R, 1.0
            converged, residual, outliers = _try_node(fit, self._model, field, usable, count, trusted, self._slopes)
            if converged and residual <= _COLD_START_POOR * rms and 2 * outliers <= count:  # safety: start-explained
                found = fit.copy()[0]
                return OrientationFix(found["rotation"], float(found["strength"]), found["covariance"], outliers)
            if len(tried) == _MAX_CANDIDATES:
                break
        trusted[:] = usable
        return None


@kernel
def _try_node(
    fit: Records, model: Array, field: Array, usable: Array, count: int, trusted: Array, slopes: Array
) -> tuple[bool, float, int]:
    return fit_orientation(
        fit[0], unpack(model), field, usable, count, trusted, slopes, _COLD_START_TOLERANCE, _COLD_START_STEPS
    )


@kernel
def _fill_cosines(fields: Array, field: Array, usable: Array, largest: float, out: Array) -> None:
    """out (n,) cosine between the readings and every node's field, over the usable sensors.

    A reading is clipped to the maximum field of the rotor, so that one faulty sensor does not dominate.
    """
    places = field.shape[0]
    read, weight = np.empty(3 * places), np.empty(3 * places)
    for k in range(places):
        length = np.sqrt(field[k, 0] ** 2 + field[k, 1] ** 2 + field[k, 2] ** 2)
        share = 1.0 if length <= largest else largest / length
        for i in range(3):
            read[3 * k + i] = share * field[k, i] * usable[k]
            weight[3 * k + i] = usable[k]
    for n in range(fields.shape[0]):
        both, own = 0.0, 0.0
        for i in range(3 * places):
            node = fields[n, i] * weight[i]
            both += node * read[i]
            own += node * node
        out[n] = both / np.sqrt(max(own, 1e-30))


_TOLERANCE_RAD = 1e-4  #: convergence [rad]: the error after such a step is a hundredth of that squared, times ten
_MAX_STEPS = 6  #: per tick, from the last orientation
_MAX_RESIDUAL_SHARE = 0.1  #: residual over field above which the orientation is wrong
_MAX_SAMPLE_GAP_S = 0.05  #: gap without a sample [s] after which the angular velocity is stale

#: State of tracking between two ticks, with its settings.
TRACK = fields(
    ("limit", "f8"),  # reading above which a sensor is faulty [T]
    ("memory", "f8"),  # time constant of the filter [s]
    ("dt", "f8"),  # since the last orientation [s]; 0: the filter restarts
    ("rotation", "f8", (3, 3)),  # R as filtered
    ("w", "f8", (3,)),  # angular velocity, stator frame [rad/s]
    ("fit", FIT),  # strength 0: no last orientation
)


class LeastSquaresOrientation(Estimator):
    """Gauss–Newton on the rotations, from the last orientation; from a grid where there is none.

    motor           device with the field tables
    start           R_SR (3, 3) near which the spin is taken at first; the field leaves `spin_period` open (60° here)
    lag             of the angular velocity [s]; the orientation has none

    field, usable and trusted are results of the last update: (k, 3) of the magnets alone [T], and (k,) 1.0 for every
    sensor that is usable and fits the orientation, else 0.0.

    The estimate's `strength` is that of the rotor's magnets against the device file: the torque per ampere follows it.
    It is not valid while too few sensors are usable, or no orientation fits their readings.

    Raises InputError for a lag outside 0 to 1 s, or a start that is not a rotation.
    """

    state_kind = "least-squares"

    def __init__(self, motor: SphericalMotor, start: Array | None = None, lag: float = 5e-3) -> None:
        if not 0 < lag < 1:
            raise InputError(f"lag must be a time between 0 and 1 s; got {lag!r}")
        self._motor, self.lag = motor, lag
        self._model = field_model(motor)
        noise = float(np.hypot(max(motor.hall.noise, 1e-6), motor.hall.step / np.sqrt(12)))
        self._cold = ColdStart(motor, self._model, noise)
        self._track: Records = state_zeros(1, TRACK)
        self._track["limit"], self._track["memory"] = self._cold.limit, 0.5 * lag
        self._fit = self._track["fit"]
        self._fit["noise"], self._fit["taken"] = noise, np.nan
        # views of the one record, copied in every tick
        self._dt: Array = self._track["dt"]
        self._w: Array = self._track["w"][0]
        self._period = spin_period(motor)
        self._near = np.eye(3) if start is None else rotation(start, "start")
        if self._near.shape != (3, 3):
            raise InputError(f"start must be one rotation, shape (3, 3); got {self._near.shape}")
        self.field = state_zeros((motor.sensors, 3))
        self.usable = state_zeros(motor.sensors)
        self.trusted = state_zeros(motor.sensors)
        self._slopes, self._rest = state_zeros((motor.sensors, 3, 3)), np.zeros(3)
        self._kept, self._kept_near = KeptEstimate(motor.channels), state_zeros((3, 3))
        self._numbers = make_numbers("found", "t")
        self._reset(self._near)
        self._rehearse()

    def _reset(self, near: Array) -> None:
        """Reset the tracking state; the spin is assumed near that of `near` (3, 3)."""
        self._found, self._t, self._near = False, -np.inf, near
        self._w[:] = self._fit["strength"] = 0.0
        unknown = State(0.0, near, self._rest, self._rest, self._rest)
        nothing = WrenchMap(np.zeros((6, self._motor.channels)), np.zeros(6))
        self._last = Estimate(unknown, nothing, False, np.inf, spin_period=self._period)

    def _rehearse(self) -> None:
        """Search and track once, so that all kernels are compiled before the loop begins."""
        near, rest = self._near, np.zeros(3)
        upright = self._motor.sensor_field(np.eye(3)[None], "table")[0]
        for t in (0.0, 1e-3):
            pose = Pose(t, np.eye(3), rest, rest, rest, False)
            self.update(Sample(t, np.zeros(self._motor.channels), np.zeros(self._motor.channels), upright, pose))
        self._reset(near)

    def state_arrays(self) -> Mapping[str, StateArray]:
        """Filter, the magnets' field [T], sensors in use, and the last estimate."""
        own = {
            "track": self._track, "slopes": self._slopes, "field": self.field, "usable": self.usable,
            "trusted": self.trusted, "near": self._kept_near, "found": self._numbers[0],
        }  # fmt: skip
        return {**own, **self._kept.arrays}

    def state_parts(self) -> Mapping[str, Stateful]:
        """Cold start."""
        return {"cold": self._cold}

    def gather_state(self) -> None:
        """Copy the last estimate."""
        self._kept.store(self._last)
        self._kept_near[:] = self._near
        self._numbers[1][0], self._numbers[1][1] = self._found, self._t

    def apply_state(self) -> None:
        """Restore the last estimate."""
        self._last, self._near = self._kept.load(), self._kept_near.copy()
        found, self._t = self._numbers[1]
        self._found = bool(found)

    @property
    def model(self) -> str:
        """The tables: fit and torque per ampere use them."""
        return "table"

    def update(self, sample: Sample) -> Estimate:
        """Return the estimate after `sample`; its `pose` is ignored.

        Raises InputError if the number of sensors is not the device's.
        """
        if sample.field.shape != self.field.shape:
            raise InputError(
                f"device '{self._motor.name}' has {self._motor.sensors} field sensors; the sample has "
                f"{sample.field.shape[0]}"
            )
        t, last = sample.t, self._t if self._found else -np.inf
        dt = t - last
        if not 0.0 <= dt <= _MAX_SAMPLE_GAP_S:
            self._w[:] = 0.0
            dt = 0.0
        self._dt[0] = dt
        K, result = np.empty((6, self._motor.channels)), np.empty((9, 3))
        passive: Array = result[7:].reshape(6)
        found, strength, disbelieved = _track_orientation(
            self._track, self._model, sample.field, sample.currents, self.field, self.usable, self.trusted,
            self._slopes, K, result,
        )  # fmt: skip
        if found:
            R, covariance, w = result[:3], result[3:6], result[6]
        else:
            again = self._cold.search(self.field, self.usable, self.trusted)
            if again is None:
                self._found, self._fit["strength"] = False, 0.0
                before, left_out = self._last, self._motor.sensors - int(self.trusted.sum())
                return Estimate(
                    before.state, before.wrench_map, False, t - self._t, spin_period=self._period,
                    disbelieved=left_out,
                )  # fmt: skip
            strength, covariance, w = again.strength, again.covariance, np.zeros(3)
            disbelieved = self._motor.sensors - int(self.usable.sum()) + again.outliers
            R = nearest_branch(again.R_SR, self._near, self._period)
            _fill_wrench_map(self._model, R, strength, K, passive)
            self._track["rotation"], self._fit["strength"] = R, strength
            self._w[:] = 0.0
        self._found, self._t, self._near = True, t, R
        state = State(t, R, self._rest, w, self._rest)
        self._last = Estimate(
            state, WrenchMap(K, passive), True, 0.0, True, self._period, covariance, strength, disbelieved
        )  # fmt: skip
        return self._last


@kernel
def _fill_wrench_map(model: Array, R: Array, strength: float, matrix: Array, passive: Array) -> None:
    torque_per_ampere(unpack(model), R, strength, matrix, passive)


@tick_kernel
def _track_orientation(
    track: Records, packed: Array, read: Array, currents: Array, field: Array, usable: Array, trusted: Array,
    slopes: Array, matrix: Array, result: Array,
) -> tuple[bool, float, int]:  # fmt: skip
    """One tick: subtract the coils' field; then predict from the last orientation, fit, validate, filter.

    track is (1,) TRACK; packed a `field_model`; read (k, 3) [T] and currents (m,) [A] the sample's; field (k, 3),
    usable, trusted (k,) and slopes (k, 3, 3) are kept between ticks; matrix (6, m) is what the coils do there. Rows of
    result (9, 3): R, its covariance, w, then force and torque of weight and regulator. Returns (found, strength,
    sensors left out).
    """
    t, model = track[0], unpack(packed)
    fit, dt, R, w, smooth = t.fit, t.dt, t.fit.rotation[:], t.w[:], t.rotation[:]
    places = field.shape[0]
    count = magnet_field(read, currents, model.per_ampere, t.limit, field, usable)
    if fit.strength == 0.0:
        return False, 0.0, places - count
    square = 0.0
    for k in range(places):
        trusted[k] = min(trusted[k], usable[k])
        square += field[k, 0] * field[k, 0] + field[k, 1] * field[k, 1] + field[k, 2] * field[k, 2]
    predicted = result[3:6]  # until the covariance is known
    turn_by(dt * w[0], dt * w[1], dt * w[2], smooth, predicted)
    for i in range(3):
        for j in range(3):
            R[i, j] = predicted[i, j]
    found, rms, outliers = fit_orientation(
        fit, model, field, usable, count, trusted, slopes, _TOLERANCE_RAD, _MAX_STEPS
    )  # fmt: skip
    # safety: field-explained
    if (
        not found
        or 2 * outliers > count
        or not rms * rms <= _MAX_RESIDUAL_SHARE * _MAX_RESIDUAL_SHARE * square / (3.0 * count)
    ):
        return False, fit.strength, places - count + outliers
    if dt > 0.0:
        correct_rotation(predicted, R, w, dt, t.memory, smooth)
    else:
        for i in range(3):
            for j in range(3):
                smooth[i, j] = R[i, j]
    torque_per_ampere(model, R, fit.strength, matrix, result[7:].reshape(6))
    for i in range(3):
        result[6, i] = w[i]
        for j in range(3):
            result[i, j], result[3 + i, j] = R[i, j], fit.covariance[i, j]
    return True, fit.strength, places - count + outliers
