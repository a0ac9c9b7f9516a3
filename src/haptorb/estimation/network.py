"""Torque per ampere from small neural networks over each coil's own sensors: the `network` estimator, Bai 2012 §2.3.

Coils with the same arrangement of sensors around them share one network. Each network has one hidden layer; its inputs
are the readings of the sensors within 35° of the coil, in the coil's own frame, its outputs the two components of K
perpendicular to the coil's axis.
"""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray

from haptorb.arrays import Array, StateArray, Stateful, check_finite, make_numbers, state_zeros
from haptorb.cache_folder import cache_folder
from haptorb.compiled import kernel
from haptorb.devices.base import State, WrenchMap
from haptorb.devices.motor import SphericalMotor
from haptorb.devices.motor_layout import Layout
from haptorb.errors import InputError, quote
from haptorb.estimation.motor_orientation import LeastSquaresOrientation, magnet_field, reading_limit, spin_period
from haptorb.estimation.types import Estimate, Estimator, Sample
from haptorb.file_kind import FileKind
from haptorb.files import parse_json, read_bytes, replace_file
from haptorb.rotations import rotation_from_euler

__all__ = [
    "GRID",
    "REACH",
    "FieldToTorque",
    "LinearTorque",
    "Neighbourhood",
    "NetworkTorque",
    "Numbers",
    "Perceptron",
    "Scaling",
    "TorqueMap",
    "TrainedNetworks",
    "TrainingResult",
    "check_networks",
    "fit_weights",
    "neighbourhoods",
    "networks_path",
    "parse_networks",
    "read_networks",
    "squash",
    "train",
    "train_network",
    "workspace_grid",
    "write_networks",
]


# --------------------------------------------------------------------------------------------------
# Network with one hidden layer, y = V tanh(W x + b) + d, with standardised inputs and outputs; Bai 2012 fig. 3.


@dataclass(frozen=True, slots=True)
class Scaling:
    """Standardisation of each column: (value − mean) / spread.

    mean     (n,)
    spread   (n,) standard deviations

    Mean and spread are in the values' own unit; scaled values are standardised.
    """

    mean: Array
    spread: Array

    @classmethod
    def of(cls, values: Array, what: str) -> Scaling:
        """Fit to `values` (samples, n); InputError naming `what` where a column is constant."""
        spread = values.std(axis=0)
        still = np.flatnonzero(~(spread > 1e-12 * np.abs(values).max()))
        if still.size:
            raise InputError(
                f"{what} {', '.join(str(i + 1) for i in still[:8])} do not change over the training set; "
                "take more orientations, or leave them out"
            )
        return cls(values.mean(axis=0), spread)

    def to_standard(self, values: Array) -> Array:
        """(…, n) → mean 0, spread 1."""
        out: Array = (values - self.mean) / self.spread
        return out

    def from_standard(self, values: Array) -> Array:
        """Inverse of `to_standard`."""
        out: Array = values * self.spread + self.mean
        return out


@dataclass(frozen=True, slots=True)
class Perceptron:
    """Weights of the network; `hidden` (h, n + 1) with the biases b last, `output` (m, h + 1) with d last.

    Inputs and outputs are in their own units, such as [T] and [N·m/A]; inside they are standardised.
    """

    hidden: Array
    output: Array
    inputs: Scaling
    outputs: Scaling

    @property
    def nodes(self) -> int:
        """Number of hidden nodes."""
        return int(self.hidden.shape[0])

    def __call__(self, x: Array) -> Array:
        """(…, m) for inputs (…, n).

        >>> one = Scaling(np.zeros(1), np.ones(1))
        >>> Perceptron(np.array([[2.0, 0.0]]), np.array([[3.0, 1.0]]), one, one)(np.array([[0.0], [10.0]])).tolist()
        [[1.0], [4.0]]
        """
        if x.shape[-1] != self.hidden.shape[1] - 1:
            raise InputError(f"the network takes {self.hidden.shape[1] - 1} inputs; got {x.shape[-1]}")
        h = np.tanh(self.inputs.to_standard(check_finite(x, "inputs")) @ self.hidden[:, :-1].T + self.hidden[:, -1])
        return self.outputs.from_standard(h @ self.output[:, :-1].T + self.output[:, -1])

    def fold_scalings(self) -> tuple[Array, Array]:
        """(hidden, output) weights for inputs and outputs in their own units: both scalings multiplied in.

        Weights are standardised numbers over the inputs' units.
        """
        hidden, output = self.hidden.copy(), self.output.copy()
        hidden[:, :-1] /= self.inputs.spread
        hidden[:, -1] -= hidden[:, :-1] @ self.inputs.mean
        output *= self.outputs.spread[:, None]
        output[:, -1] += self.outputs.mean
        return hidden, output


# --------------------------------------------------------------------------------------------------
# Levenberg–Marquardt for a network with one hidden layer; the normal matrix is assembled from blocks.
#
# The Jacobian of all samples would take gigabytes, so it is not formed: with h = tanh(W x̃), x̃ = (x, 1), h̃ = (h, 1)
# and g = 1 − h²,
#
#     ∂y_o/∂V_p = δ_op h̃,    ∂y_o/∂W_j = V_oj g_j x̃,
#
# so JᵀJ has the blocks δ_op Σ h̃ h̃ᵀ, Σ V_oj g_j x̃ h̃ᵀ and (VᵀV)_jk Σ g_j g_k x̃ x̃ᵀ: three matrix products over the
# samples with the size of the parameters, whatever the number of outputs.


_MAX_TRAINING_DAMPING = 1e12  #: damping above which the search stops

Report = Callable[[float], None]  #: callback with the progress, 0 … 1


@dataclass(frozen=True)
class TrainingResult:
    """Trained network with its learning curve."""

    network: Perceptron
    rms: float  #: root mean square error of the standardised outputs
    iterations: int
    course: Array  #: (iterations + 1,) rms after each iteration of the best start
    starts: Array  #: (starts,) rms of every start at selection


def train_network(
    x: Array,
    y: Array,
    nodes: int = 10,
    *,
    starts: int = 4,
    iterations: int = 60,
    seed: int = 0,
    report: Report | None = None,
) -> TrainingResult:
    """Train a network with `nodes` hidden nodes for y (samples, m) at x (samples, n), the best of several starts.

    Every start runs on every eighth sample, the best continues with all of them: results of single starts differ by a
    factor of two. Raises InputError for a training set that cannot determine the weights.

    >>> x = np.linspace(-2, 2, 400)[:, None]
    >>> result = train_network(x, np.sin(2 * x), nodes=6)
    >>> bool(np.abs(result.network(x) - np.sin(2 * x)).max() < 1e-2)
    True
    """
    x, y = check_finite(x, "x"), check_finite(y, "y")
    if x.ndim != 2 or y.ndim != 2 or len(x) != len(y):
        raise InputError(f"x and y must be (samples, n) and (samples, m); got shapes {x.shape} and {y.shape}")
    for value, what in ((nodes, "nodes"), (starts, "starts"), (iterations, "iterations")):
        if value < 1:
            raise InputError(f"{what} must be at least 1; got {value}")
    weights = nodes * (x.shape[1] + 1) + y.shape[1] * (nodes + 1)
    if x.shape[0] * y.shape[1] < 2 * weights:
        raise InputError(
            f"{weights} weights need at least {-(-2 * weights // y.shape[1])} samples; the training set has {len(x)}"
        )
    inputs, outputs = Scaling.of(x, "inputs"), Scaling.of(y, "outputs")
    u, v = inputs.to_standard(x), outputs.to_standard(y)
    thin = max(1, min(8, len(x) * y.shape[1] // (4 * weights)))
    rng = np.random.default_rng(seed)
    scouting, runs = max(iterations // 2, 10), []
    share = 0.3
    for start in range(starts):
        first = _start(rng, u.shape[1], v.shape[1], nodes)
        runs.append(fit_weights(u[::thin], v[::thin], *first, iterations=scouting))
        if report is not None:
            report(share * (start + 1) / starts)
    best = min(runs, key=lambda run: run[2][-1])

    def rest(done: float) -> None:
        if report is not None:
            report(share + (1 - share) * done)

    hidden, output, course = fit_weights(u, v, best[0], best[1], iterations=iterations, report=rest)
    return TrainingResult(
        Perceptron(hidden, output, inputs, outputs),
        float(course[-1]),
        len(course) - 1,
        course,
        np.array([run[2][-1] for run in runs]),
    )


def _start(rng: np.random.Generator, n: int, m: int, nodes: int) -> tuple[Array, Array]:
    """Initial weights for which the hidden nodes are neither linear nor saturated."""
    hidden = rng.normal(0.0, 1.0, (nodes, n + 1)) / np.sqrt(n)
    return hidden, rng.normal(0.0, 0.3, (m, nodes + 1))


def fit_weights(
    x: Array, y: Array, hidden: Array, output: Array, *, iterations: int, report: Report | None = None
) -> tuple[Array, Array, Array]:
    """(hidden, output, course): weights after at most `iterations` steps from the given ones, and the rms of each step.

    x (samples, n), y (samples, m), hidden (h, n + 1), output (m, h + 1) as in `Perceptron`, all standardised. A step
    that increases the error is rejected; the damping grows until one is accepted.
    """
    ones = np.ones((len(x), 1))
    x1 = np.concatenate([x, ones], axis=1)
    damping, course = 1e-2, []
    h1 = np.concatenate([np.tanh(x1 @ hidden.T), ones], axis=1)
    residual = y - h1 @ output.T
    error = float((residual**2).mean())
    course.append(np.sqrt(error))
    for step in range(iterations):
        normal, downhill = _normal_equations(x1, h1, output, residual)
        diagonal = np.diag(normal).copy()
        while damping < _MAX_TRAINING_DAMPING:
            new_hidden, new_output = _step_weights(normal, diagonal, downhill, damping, hidden, output)
            new_h1 = np.concatenate([np.tanh(x1 @ new_hidden.T), ones], axis=1)
            new_residual = y - new_h1 @ new_output.T
            new_error = float((new_residual**2).mean())
            if new_error < error:
                break
            damping *= 4.0
        else:
            break
        gain = 1.0 - new_error / error
        hidden, output, h1, residual, error = new_hidden, new_output, new_h1, new_residual, new_error
        damping = max(damping / 5.0, 1e-12)
        course.append(np.sqrt(error))
        if report is not None:
            report((step + 1) / iterations)
        if gain < 1e-6:
            break
    if report is not None:
        report(1.0)
    return hidden, output, np.array(course)


def _step_weights(
    normal: Array, diagonal: Array, downhill: Array, damping: float, hidden: Array, output: Array
) -> tuple[Array, Array]:
    from scipy.linalg import cho_factor, cho_solve  # imported here: it takes 0.2 s, which only training should pay

    damped = normal.copy()
    damped[np.diag_indices(len(damped))] += damping * np.maximum(diagonal, 1e-9 * diagonal.max())
    try:
        step = cho_solve(cho_factor(damped, lower=False, overwrite_a=True), downhill)
    except LinAlgError:
        return hidden, output  # no descent: the caller increases the damping
    return hidden + step[: hidden.size].reshape(hidden.shape), output + step[hidden.size :].reshape(output.shape)


def _normal_equations(x1: Array, h1: Array, output: Array, residual: Array) -> tuple[Array, Array]:
    """JᵀJ (upper triangle) and Jᵀ r, hidden weights first, in the order of the nodes."""
    from scipy.linalg.blas import dsyrk  # imported here, as above

    samples, width = x1.shape
    outputs, nodes = output.shape[0], output.shape[1] - 1
    g = 1.0 - h1[:, :-1] ** 2
    gx = (g[:, :, None] * x1[:, None, :]).reshape(samples, nodes * width)
    many = nodes * width
    normal = np.zeros((many + outputs * (nodes + 1),) * 2)
    v = output[:, :-1]
    # (VᵀV)_jk multiplies the whole block (j, k)
    normal[:many, :many] = dsyrk(1.0, gx.T, lower=0) * np.kron(v.T @ v, np.ones((width, width)))
    mixed, plain = gx.T @ h1, h1.T @ h1
    for o in range(outputs):
        here = slice(many + o * (nodes + 1), many + (o + 1) * (nodes + 1))
        normal[:many, here] = mixed * np.repeat(v[o], width)[:, None]
        normal[here, here] = plain
    back = (residual @ v) * g
    downhill = np.concatenate([(back.T @ x1).ravel(), (residual.T @ h1).ravel()])
    return normal, downhill


# --------------------------------------------------------------------------------------------------
# Sensors used for each coil, and groups of coils with the same sensor arrangement, which share one network.
#
# A network maps the field around a coil to that coil's torque per ampere, both in the coil's own frame (ϑ̂ southward,
# φ̂ eastward, r̂ outward). Coils with the same sensor arrangement in their own frames, up to half a turn about r̂,
# share it: on one parallel of latitude by rotation about the motor's axis, north and south by half a turn (Bai 2012
# §2.3).


Numbers: TypeAlias = NDArray[np.intp]

REACH = float(np.radians(35.0))  #: of a coil's sensors from its axis: includes the nearest ring around it

_HALF_TURN = np.diag([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Neighbourhood:
    """Coils that share one network.

    coils     (c,) their numbers, from 0
    frames    (c, 3, 3) columns: each coil's own axes in the stator frame, turned so that all arrangements agree
    sensors   (c, s) numbers of each coil's sensors, from 0, in the order of the arrangement
    """

    coils: Numbers
    frames: Array
    sensors: Numbers

    def inputs(self, field: Array, member: int) -> Array:
        """(n, 3 s) inputs of member number `member` from `field` (n, sensors, 3) [T], in its own frame."""
        own: Array = field[:, self.sensors[member]] @ self.frames[member]
        return own.reshape(len(field), -1)

    def outputs(self, K: Array, member: int) -> Array:
        """(n, 2) K (n, 3, coils) [N·m/A] of that member along its ϑ̂ and φ̂; along its axis it is zero for a round
        coil."""
        own = np.einsum("nij,ia->nja", K, self.frames[member])
        out: Array = own[:, self.coils[member], :2]
        return out


def neighbourhoods(motor: SphericalMotor, reach: float = REACH) -> tuple[Neighbourhood, ...]:
    """Partition of the coils; InputError where a coil has no sensor within `reach` [rad] of its axis."""
    found: list[tuple[Array, list[tuple[int, Array, Numbers]]]] = []
    coils: Layout = motor.electromagnets
    for coil, frame in enumerate(coils.frames):
        near = np.flatnonzero(motor.sensor_layout.directions @ coils.directions[coil] >= np.cos(reach))
        if near.size == 0:
            raise InputError(
                f"device '{motor.name}': electromagnet {coil + 1} has no sensor within {np.degrees(reach):g}° of its "
                "axis: its torque cannot be estimated"
            )
        for turn in (np.eye(3), _HALF_TURN):
            own = frame @ turn
            order, pattern = _sort_directions(motor.sensor_layout.directions[near] @ own)
            match = next((i for i, (known, _) in enumerate(found) if _are_equal(known, pattern)), None)
            if match is not None:
                found[match][1].append((coil, own, near[order]))
                break
        else:
            order, pattern = _sort_directions(motor.sensor_layout.directions[near] @ frame)
            found.append((pattern, [(coil, frame, near[order])]))
    return tuple(
        Neighbourhood(
            np.array([coil for coil, _, _ in members]),
            np.array([frame for _, frame, _ in members]),
            np.array([sensors for _, _, sensors in members]),
        )
        for _, members in found
    )


def _sort_directions(pattern: Array) -> tuple[Numbers, Array]:
    """Canonical order of the directions (s, 3), and the directions in it."""
    order = np.lexsort(np.round(pattern, 6).T + 0.0)
    return order, pattern[order]


def _are_equal(one: Array, other: Array) -> bool:
    return one.shape == other.shape and bool(np.abs(one - other).max() < 1e-6)


# --------------------------------------------------------------------------------------------------
# Vectorised tanh: the library's version is scalar, and takes longer than the network's sums.
#
# tanh x = 1 − 2/(e²ˣ + 1), with e²ˣ = 2ᵏ eʳ, k an integer and |r| ≤ ½ ln 2, and a polynomial for eʳ. Absolute error of
# a few 10⁻¹⁶; not relative to small values, which a sum over nodes does not need. The simulation's noise has its own
# series (`simulation.noise_generator`) for logarithm, sine and cosine, so that no code is shared.


_MAX_ARGUMENT = 20.0  #: argument above which tanh is one in double precision
_LOG2E, _LN2 = float(1.0 / np.log(2.0)), float(np.log(2.0))


@kernel
def squash(values: Array) -> None:
    """Replace every entry of `values` (n,) by its tanh; NaN remains NaN."""
    powers = np.empty(values.shape[0], np.int64)
    for i in range(values.shape[0]):
        double = 2.0 * _LOG2E * min(max(values[i], -_MAX_ARGUMENT), _MAX_ARGUMENT)
        whole = np.rint(double)
        powers[i] = (np.int64(np.int32(whole)) + 1023) << 52  # bit pattern of 2ᵏ
        r = _LN2 * (double - whole)
        # Taylor series to r¹³: the next term is below 10⁻¹⁷
        p = 1.0 / 479001600.0 + r * (1.0 / 6227020800.0)
        p = 1.0 / 39916800.0 + r * p
        p = 1.0 / 3628800.0 + r * p
        p = 1.0 / 362880.0 + r * p
        p = 1.0 / 40320.0 + r * p
        p = 1.0 / 5040.0 + r * p
        p = 1.0 / 720.0 + r * p
        p = 1.0 / 120.0 + r * p
        p = 1.0 / 24.0 + r * p
        p = 1.0 / 6.0 + r * p
        p = 0.5 + r * p
        p = 1.0 + r * p
        values[i] = 1.0 + r * p
    scale = powers.view(np.float64)
    for i in range(values.shape[0]):
        values[i] = 1.0 - 2.0 / (values[i] * scale[i] + 1.0)


# --------------------------------------------------------------------------------------------------
# Training orientations of a motor's estimators: a grid over the workspace, Bai 2012 §2.3.


GRID = (15, 15, 72)  #: of ψ, λ and φ: 16 200 orientations


def workspace_grid(motor: SphericalMotor, counts: tuple[int, int, int] = GRID) -> Array:
    """(n, 3, 3) R_SR over |ψ|, |λ| ≤ the workspace's tilt and one period of spin.

    Spin repeats with the magnets' period (60°): 72 values around the circle are 12 different ones. Here they are spread
    over one period, so that every orientation adds information.

    Raises InputError for a count below one. Rotations have no unit: [1].

    >>> import haptorb
    >>> workspace_grid(haptorb.load("pmsm")).shape
    (16200, 3, 3)
    """
    if any(count < 1 for count in counts):
        raise InputError(f"a training grid needs at least one value of each angle; got {counts}")
    tilt, period = motor.workspace_tilt, spin_period(motor) or 2 * np.pi
    psi, lam = (np.linspace(-tilt, tilt, count) if count > 1 else np.zeros(1) for count in counts[:2])
    phi = period * np.arange(counts[2]) / counts[2]
    angles = np.meshgrid(psi, lam, phi, indexing="ij")
    return rotation_from_euler(*(angle.ravel() for angle in angles))


# --------------------------------------------------------------------------------------------------
# Torque per ampere of each coil directly from the magnet field at the sensors: abstract map, and its estimator.


_RANGE_GRID = (7, 7, 24)  #: orientations for the range of the field
_WORKSPACE_MARGIN_RAD = np.radians(1.0)  #: margin outside the workspace within which a map may be evaluated


class TorqueMap(ABC):
    """Map from magnet field to torque per ampere, without the orientation."""

    @abstractmethod
    def torque(self, field: Array, usable: Array, out: Array, known: Array) -> None:
        """Fill out (3, coils) [N·m/A], stator frame, and known (coils,) 1.0 where it is determined, else 0.0.

        field (k, 3) [T] of the magnets alone, stator frame; usable (k,) 1.0 where a sensor is usable, else 0.0.
        """


class FieldToTorque(Estimator):
    """Torque per ampere by `torque_map`; orientation by least squares in parallel, or reported as not estimated.

    motor         device with the sensors
    torque_map    `NetworkTorque` or `LinearTorque`
    orientation   estimates the orientation, and rejects sensors that do not fit it; None: the state is NaN, the
                  estimate is not `oriented`, and only implausible readings are rejected

    A channel with an undetermined coil has zero torque per ampere, so that it receives no current; with fewer than half
    of the channels, or fewer than three, the estimate is not valid. A map does not detect its own errors: outside the
    workspace on which it was trained, the estimate is not valid.
    """

    state_kind = "torque-map"

    def __init__(
        self, motor: SphericalMotor, torque_map: TorqueMap, orientation: LeastSquaresOrientation | None = None
    ) -> None:
        self._motor, self._map, self._orientation = motor, torque_map, orientation
        self._per_ampere = motor.sensor_field_per_ampere
        coarse = workspace_grid(motor, _RANGE_GRID)
        self._limit = reading_limit(motor, coarse, motor.sensor_field(coarse, "table"))
        edge = motor.workspace_tilt + _WORKSPACE_MARGIN_RAD
        self._sine, self._tangent = float(np.sin(edge)), float(np.tan(edge))
        self._groups = np.ascontiguousarray(motor.groups, dtype=np.float64)
        self._field = state_zeros((motor.sensors, 3))
        self._usable = state_zeros(motor.sensors)
        coils = len(motor.electromagnets)
        self._single, self._known = state_zeros((3, coils)), state_zeros(coils)
        self._enough = max(3, motor.channels // 2)
        self._t, self._numbers = -np.inf, make_numbers("t")
        self._turn, self._turning = np.full((3, 3), np.nan), np.full(3, np.nan)
        self._rest, self._nothing = np.zeros(3), np.zeros(6)
        magnet_field(self._field, np.zeros(motor.channels), self._per_ampere, self._limit, self._field, self._usable)
        self._torque(self._field, self._usable)  # compiled at construction, not in the loop

    def state_arrays(self) -> Mapping[str, StateArray]:
        """The magnets' field [T] and the output of the map."""
        return {
            "field": self._field, "usable": self._usable, "single": self._single, "known": self._known,
            "last": self._numbers[0],
        }  # fmt: skip

    def state_parts(self) -> Mapping[str, Stateful]:
        """The estimator of the orientation."""
        return {} if self._orientation is None else {"orientation": self._orientation}

    def gather_state(self) -> None:
        """Copy the time of the last valid output into the state arrays."""
        self._numbers[1][0] = self._t

    def apply_state(self) -> None:
        """Restore the time of the last valid output."""
        self._t = self._numbers[1][0]

    def update(self, sample: Sample) -> Estimate:
        """Return the estimate after `sample`; its `pose` is ignored.

        Raises InputError if the number of sensors is not the device's.
        """
        motor = self._motor
        if sample.field.shape != self._field.shape:
            raise InputError(
                f"device '{motor.name}' has {motor.sensors} field sensors; the sample has {sample.field.shape[0]}"
            )
        beside = self._orientation
        if beside is None:
            count = magnet_field(
                sample.field, sample.currents, self._per_ampere, self._limit, self._field, self._usable
            )  # fmt: skip
            matrix, valid = self._torque(self._field, self._usable)
            if valid:
                self._t = sample.t
            state = State(sample.t, self._turn, self._rest, self._turning, self._rest)
            known = WrenchMap(matrix, self._nothing)
            return Estimate(state, known, valid, sample.t - self._t, False, disbelieved=motor.sensors - count)
        pose = beside.update(sample)
        matrix, valid = self._torque(beside.field, beside.trusted if pose.valid else beside.usable)
        z = pose.state.R_SR[:, 2].tolist()  # (sin λ, −sin ψ cos λ, cos ψ cos λ)
        inside = abs(z[0]) <= self._sine and abs(z[1]) <= self._tangent * z[2]
        return Estimate(
            pose.state, WrenchMap(matrix, pose.wrench_map.passive), valid and pose.valid and inside, pose.age,
            pose.oriented, pose.spin_period, pose.covariance, pose.strength, pose.disbelieved,
        )  # fmt: skip

    def _torque(self, field: Array, usable: Array) -> tuple[Array, bool]:
        """(6, m) per channel, and whether enough channels are determined."""
        matrix = np.empty((6, self._groups.shape[1]))
        self._map.torque(field, usable, self._single, self._known)
        return matrix, _group_torques(self._single, self._known, self._groups, matrix) >= self._enough


@kernel
def _group_torques(single: Array, known: Array, groups: Array, out: Array) -> int:
    """out (6, m): no force, and torque per ampere of every channel, zero where one of its coils is undetermined;
    returns the number of determined channels."""
    count = 0
    for j in range(out.shape[1]):
        sure, x, y, z = 1.0, 0.0, 0.0, 0.0
        for c in range(groups.shape[0]):
            share = groups[c, j]
            if share != 0.0:
                sure = min(sure, known[c])
                x += share * single[0, c]
                y += share * single[1, c]
                z += share * single[2, c]
        if sure > 0.0 and np.isfinite(x + y + z):
            count += 1
        else:
            x, y, z = 0.0, 0.0, 0.0
        out[0, j], out[1, j], out[2, j], out[3, j], out[4, j], out[5, j] = 0.0, 0.0, 0.0, x, y, z
    return count


_LANES = 16  #: inputs summed in parallel


@dataclass(frozen=True)
class TrainedNetworks:
    """One network per neighbourhood of a device, with the training record."""

    device: str  #: name
    digest: str  #: of the device file
    reach: float  #: of each coil's sensors from its axis [rad]
    networks: tuple[Perceptron, ...]
    record: Mapping[str, Any] = field(default_factory=dict)

    def select_neighbourhoods(self, motor: SphericalMotor) -> tuple[Neighbourhood, ...]:
        """Neighbourhoods of `motor` in the networks' order; InputError if they were trained for another device."""
        if self.digest != motor.digest:  # safety: network-device
            raise InputError(
                f"these networks were trained for device {quote(self.device)} (digest {quote(self.digest[:12])}), not "
                f"for '{motor.name}' ({motor.digest[:12]}): its magnetics differ; run `haptorb train {motor.name}`"
            )
        found = neighbourhoods(motor, self.reach)
        sizes = [3 * near.sensors.shape[1] for near in found]
        if [network.hidden.shape[1] - 1 for network in self.networks] != sizes:
            raise InputError(f"these networks do not have the inputs of device '{motor.name}': {sizes}; train again")
        return found


def train(
    motor: SphericalMotor,
    *,
    nodes: int = 10,
    starts: int = 16,
    iterations: int = 120,
    seed: int = 0,
    grid: tuple[int, int, int] = GRID,
    reach: float = REACH,
    report: Callable[[float], None] | None = None,
) -> TrainedNetworks:
    """Train networks for all coils of `motor`, from its own tables over the workspace's `grid` of (ψ, λ, φ).

    Each orientation is a sample for one coil of each neighbourhood, in turn: 16 200 samples for each network by
    default. `report` is called with the completed fraction. Raises InputError for a grid that cannot determine the
    weights.
    """
    R = workspace_grid(motor, grid)
    if len(R) < 2 * len(motor.electromagnets):
        raise InputError(f"a training grid of {len(R)} orientations is too small; the default is {GRID}")
    B, K = motor.sensor_field(R, "table"), motor.torque_characteristic(R, "table")
    groups = neighbourhoods(motor, reach)
    order = np.random.default_rng(seed).permutation(len(R))  # assignment of orientations to coils
    networks, records = [], []
    for number, near in enumerate(groups):
        many = len(near.coils)
        x = np.concatenate([near.inputs(B[order[i::many]], i) for i in range(many)])
        y = np.concatenate([near.outputs(K[order[i::many]], i) for i in range(many)])
        # shuffled: the validation part must be representative
        mixed = np.random.default_rng(seed + 1).permutation(len(x))

        def share(done: float, number: int = number) -> None:
            if report is not None:
                report((number + done) / len(groups))

        result = train_network(
            x[mixed], y[mixed], nodes, starts=starts, iterations=iterations, seed=seed, report=share
        )  # fmt: skip
        networks.append(result.network)
        records.append(
            {
                "electromagnets": (near.coils + 1).tolist(),
                "inputs": int(x.shape[1]),
                "samples": len(x),
                "rms_of_standardised_outputs": result.rms,
                "iterations": result.iterations,
                "course": result.course.round(6).tolist(),
                "starts": result.starts.round(6).tolist(),
            }
        )
    record = {"nodes": nodes, "grid": list(grid), "iterations": iterations, "seed": seed, "networks": records}
    return TrainedNetworks(motor.name, motor.digest, reach, tuple(networks), record)


class NetworkTorque(TorqueMap):
    """All networks of a device in one kernel: scalings are multiplied into the weights beforehand.

    A coil with an unusable sensor is undetermined: a network needs all inputs.
    """

    def __init__(self, motor: SphericalMotor, networks: TrainedNetworks) -> None:
        groups = networks.select_neighbourhoods(motor)
        coils, nodes = len(motor.electromagnets), max(network.nodes for network in networks.networks)
        most = max(near.sensors.shape[1] for near in groups)
        inputs = _LANES * -(-(3 * most + 1) // _LANES)  # full vectors; the last input is always 1, for the biases
        self._sensors = np.full((coils, most), -1, dtype=np.int64)
        self._frames = np.zeros((coils, 3, 3))
        self._hidden = np.zeros((len(groups), nodes, inputs))
        self._output = np.zeros((len(groups), 2, nodes + 1))
        batches = []
        for number, (near, network) in enumerate(zip(groups, networks.networks, strict=True)):
            hidden, output = network.fold_scalings()
            many, some = near.sensors.shape[1], network.nodes
            self._sensors[near.coils, :many] = near.sensors
            self._frames[near.coils] = near.frames
            self._hidden[number, :some, : 3 * many], self._hidden[number, :some, -1] = hidden[:, :-1], hidden[:, -1]
            self._output[number, :, :some], self._output[number, :, -1] = output[:, :-1], output[:, -1]
            for first in range(0, len(near.coils), 4):  # the last four may repeat a coil
                batches.append((number, *np.resize(near.coils[first : first + 4], 4).tolist()))
        self._batches = np.array(batches, dtype=np.int64)

    def torque(self, field: Array, usable: Array, out: Array, known: Array) -> None:
        """Evaluate the networks, as `TorqueMap.torque`. (3, coils) [N·m/A]."""
        _forward(
            self._batches, self._sensors, self._frames, self._hidden, self._output, field, usable, out, known
        )  # fmt: skip


@kernel
def _fill_coil_inputs(sensors: Numbers, F: Array, field: Array, usable: Array, out: Array) -> float:
    """Fill out (inputs,) with the field in the axes F (3, 3) of the coil; returns 1.0 if all of it is usable, else
    0."""
    sure = 1.0
    for s in range(sensors.shape[0]):
        k = sensors[s]
        if k >= 0:
            sure *= usable[k]
            x, y, z = field[k, 0], field[k, 1], field[k, 2]
            out[3 * s] = F[0, 0] * x + F[1, 0] * y + F[2, 0] * z
            out[3 * s + 1] = F[0, 1] * x + F[1, 1] * y + F[2, 1] * z
            out[3 * s + 2] = F[0, 2] * x + F[1, 2] * y + F[2, 2] * z
    return sure


@kernel
def _forward(
    batches: Numbers, sensors: Numbers, frames: Array, hidden: Array, output: Array, field: Array, usable: Array,
    out: Array, known: Array,
) -> None:  # fmt: skip
    """batches (b, 5): a network and four coils that share it; sensors (c, s), −1 where a coil has fewer; frames
    (c, 3, 3); hidden (networks, nodes, inputs), output (networks, 2, nodes + 1) along ϑ̂ and φ̂, biases last."""
    nodes, inputs = hidden.shape[1], hidden.shape[2]
    h = np.empty((frames.shape[0], nodes))
    x = np.zeros((4, inputs))
    for b in range(batches.shape[0]):
        batch = batches[b]
        for q in range(4):
            c = batch[1 + q]
            known[c] = _fill_coil_inputs(sensors[c], frames[c], field, usable, x[q])
            x[q, inputs - 1] = 1.0
        weights, x0, x1, x2, x3 = hidden[batch[0]], x[0], x[1], x[2], x[3]
        for n in range(nodes):  # four coils at once: each weight is loaded once for them
            row = weights[n]
            h0, h1, h2, h3 = 0.0, 0.0, 0.0, 0.0
            for i in range(inputs):
                h0 += row[i] * x0[i]
                h1 += row[i] * x1[i]
                h2 += row[i] * x2[i]
                h3 += row[i] * x3[i]
            h[batch[1], n], h[batch[2], n], h[batch[3], n], h[batch[4], n] = h0, h1, h2, h3
    squash(h.reshape(-1))
    for b in range(batches.shape[0]):
        weights = output[batches[b, 0]]
        for q in range(4):
            c = batches[b, 1 + q]
            F, node = frames[c], h[c]
            south, east = weights[0, nodes], weights[1, nodes]
            for n in range(nodes):
                south += weights[0, n] * node[n]
                east += weights[1, n] * node[n]
            for i in range(3):
                out[i, c] = F[i, 0] * south + F[i, 1] * east


# --------------------------------------------------------------------------------------------------
# Torque per ampere as a linear map of all readings: the `linear` estimator, fast and simple.
#
# K ≈ M (B, 1), with M the least-squares map over the workspace for readings with noise σ: ridge regression with σ². The
# sensors are a few millimetres from the magnets, where the field has more spatial detail than 48 sensors resolve; so
# the best linear map has an error of about a tenth of K, whatever the noise (spatial aliasing).


_MAX_MISSING_SHARE = 0.25  #: maximum share of the sensors that may be replaced by estimates


class LinearTorque(TorqueMap):
    """Replace an unusable sensor by its most likely value given the others, by the same least squares.

    motor          device with the field tables
    noise          of one reading [T]; the device's own if not given
    orientations   (n, 3, 3) training set; the workspace's grid if not given

    Raises InputError for an invalid noise, and for readings without variation.
    """

    def __init__(self, motor: SphericalMotor, *, noise: float | None = None, orientations: Array | None = None) -> None:
        sigma = motor.hall.noise if noise is None else noise
        if not 0 <= sigma < 1:
            raise InputError(f"noise must be a flux density from 0 to 1 T; got {noise!r}")
        R = workspace_grid(motor) if orientations is None else orientations
        x = motor.sensor_field(R, "table").reshape(len(R), -1)
        y = motor.torque_characteristic(R, "table").reshape(len(R), -1)
        if len(R) < 2 * x.shape[1]:
            raise InputError(f"{x.shape[1]} readings need at least {2 * x.shape[1]} orientations; got {len(R)}")
        self._mean = x.mean(axis=0)
        offset = y.mean(axis=0)
        x, y = x - self._mean, y - offset
        covariance = x.T @ x / len(x)
        spread = float(np.trace(covariance)) / x.shape[1]
        if not spread > 1e-12 * float((self._mean**2).mean()):
            raise InputError("the readings do not change over the training set: give more orientations")
        covariance[np.diag_indices(len(covariance))] += max(sigma**2, 1e-9 * spread)
        self._precision = np.linalg.inv(covariance)
        self._map = np.ascontiguousarray((self._precision @ (x.T @ y / len(x))).T)
        self._offset = offset
        self._sensors = motor.sensors
        self._completed = np.empty(3 * motor.sensors)

    def torque(self, field: Array, usable: Array, out: Array, known: Array) -> None:
        """Evaluate the map, as `TorqueMap.torque`: all coils are determined, or none where too many sensors are
        missing."""
        missing = np.flatnonzero(usable == 0.0)
        if missing.size > _MAX_MISSING_SHARE * self._sensors:
            known[:] = 0.0
            return
        np.subtract(field.ravel(), self._mean, out=self._completed)
        if missing.size:
            self._complete(missing)
        _map_readings(self._map, self._offset, self._completed, out.reshape(-1))
        known[:] = 1.0

    def _complete(self, missing: Numbers) -> None:
        """Most likely readings given the others: x_m = −P_mm⁻¹ P_mo x_o, with P the inverse of their covariance."""
        numbers = (3 * missing[:, None] + np.arange(3)).ravel()
        self._completed[numbers] = 0.0
        known = self._precision[numbers] @ self._completed
        self._completed[numbers] = -np.linalg.solve(self._precision[np.ix_(numbers, numbers)], known)


@kernel
def _map_readings(M: Array, offset: Array, x: Array, out: Array) -> None:
    for i in range(M.shape[0]):
        total = offset[i]
        for j in range(M.shape[1]):
            total += M[i, j] * x[j]
        out[i] = total


# --------------------------------------------------------------------------------------------------
# File of trained networks: one line of JSON (device, digest, training record, shapes, hash) and the weights.
#
# The file belongs to one device by its digest, and is rejected for another one. It is written atomically.


_KIND = "haptorb networks 1"
_MAX_FILE_BYTES = 64 * 1024 * 1024  #: bytes


def networks_path(motor: SphericalMotor) -> Path:
    """Default path of the networks of `motor`: in the user's cache folder, by digest."""
    return cache_folder() / "networks" / f"{motor.name}-{motor.digest[:16]}.network"


def check_networks(motor: SphericalMotor) -> TrainedNetworks:
    """Read the networks of `motor` from the default path; InputError with the training command if there are none."""
    path = networks_path(motor)
    if not path.is_file():
        raise InputError(f"no network has been trained for device '{motor.name}' yet: run `haptorb train {motor.name}`")
    return read_networks(path)


def write_networks(networks: TrainedNetworks, path: Path) -> None:
    """Write the file atomically; InputError where it cannot be written."""
    parts = [part for network in networks.networks for part in _arrays(network)]
    numbers = b"".join(np.ascontiguousarray(part, dtype="<f8").tobytes() for part in parts)
    head = {
        "kind": _KIND,
        "device": networks.device,
        "digest": networks.digest,
        "reach": networks.reach,
        "shapes": [list(part.shape) for part in parts],
        "record": dict(networks.record),
    }
    head["sha256"] = _digest(head, numbers)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(path) as part:
            part.write_bytes(json.dumps(head, ensure_ascii=False).encode() + b"\n" + numbers)
    except OSError as cause:
        raise InputError(f"the networks cannot be written to '{path}': {cause.strerror}") from cause


def read_networks(path: Path) -> TrainedNetworks:
    """Read a file of `write_networks`; InputError where it is absent, truncated, altered or of another kind."""
    try:
        content = read_bytes(path, _MAX_FILE_BYTES, "network file", InputError, FileKind.NETWORK)
    except InputError as cause:
        raise InputError(f"{cause}; run `haptorb train`") from cause
    return parse_networks(content, f"network file '{path}'")


def parse_networks(content: bytes, where: str) -> TrainedNetworks:
    """Parse the networks of a file's `content`; `where` is its name in the InputError for a truncated, altered or other
    file."""
    line, _, numbers = content.partition(b"\n")
    try:
        head: dict[str, Any] = parse_json(line)
        if head.get("kind") != _KIND:
            raise InputError(f"{where} is not one of this version; run `haptorb train`")
        digest = head.pop("sha256")
        if digest != _digest(head, numbers):
            raise InputError(f"{where} has been changed or truncated: its hash does not match; train again")
        weights = np.frombuffer(numbers, dtype="<f8").astype(np.float64)
        ends = np.cumsum([0, *(int(np.prod(shape)) for shape in head["shapes"])])
        parts = [weights[ends[i] : ends[i + 1]].reshape(shape) for i, shape in enumerate(head["shapes"])]
        if len(parts) % 6 or not np.isfinite(weights).all() or ends[-1] != len(weights):
            raise ValueError("weights that are not numbers, too many or too few")
        networks = tuple(
            Perceptron(parts[i], parts[i + 1], Scaling(parts[i + 2], parts[i + 3]), Scaling(parts[i + 4], parts[i + 5]))
            for i in range(0, len(parts), 6)
        )
        for network in networks:
            _check_sizes(network)
        if not all(isinstance(head[key], kind) for key, kind in (("device", str), ("digest", str), ("record", dict))):
            raise TypeError("device, digest and record")
        return TrainedNetworks(head["device"], head["digest"], float(head["reach"]), networks, head["record"])
    except InputError:
        raise
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError) as cause:
        raise InputError(f"{where} is not a network file of haptorb; run `haptorb train`") from cause


def _check_sizes(network: Perceptron) -> None:
    """Raise ValueError unless the sizes of weights and scalings match."""
    inputs, outputs = len(network.inputs.mean), len(network.outputs.mean)
    nodes = len(network.hidden)
    wanted = ((nodes, inputs + 1), (outputs, nodes + 1), (inputs,), (inputs,), (outputs,), (outputs,))
    if any(part.shape != shape for part, shape in zip(_arrays(network), wanted, strict=True)):
        raise ValueError("sizes that do not match")
    if not ((network.inputs.spread > 0).all() and (network.outputs.spread > 0).all()):
        raise ValueError("a spread that is not positive")


def _arrays(network: Perceptron) -> tuple[Array, ...]:
    inputs, outputs = network.inputs, network.outputs
    return network.hidden, network.output, inputs.mean, inputs.spread, outputs.mean, outputs.spread


def _digest(head: dict[str, Any], numbers: bytes) -> str:
    return hashlib.sha256(json.dumps(head, sort_keys=True).encode() + numbers).hexdigest()
