"""Offset, gain and place of every field sensor from the coils and from a tool that a person led: bundle adjustment.

The tool's pose is not measured. Each reading of k sensors has 3 k numbers and 5 unknowns of its own, the tool's
place and axis; what is left over, some hundred times, determines the 15 errors of each sensor (`sensor_parameters`) and
the strength of the tool's magnet. The coils, driven in turn, tell in addition what each sensor reads of fields of known
directions. Gauss–Newton on all unknowns together, where the poses are eliminated reading by reading (Schur complement);
Huber's weights, so that a reading that something disturbed does not pull; the device file's distributions as prior, so
that what cannot be observed stays where the data sheet has it, and is named.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import rotation_to_axis
from haptorb.errors import CalibrationError
from haptorb.numerics.arrays import Array
from haptorb.numerics.so3 import turn_by
from haptorb.physics.sources import dipole
from haptorb.sensing.sensors.sensor_parameters import (
    DISPLACEMENT,
    MIXING,
    OFFSET,
    PARAMETERS,
    prior_covariance,
    sensitivity,
    tool_readings,
)
from haptorb.sensing.sensors.tool_tour import ToolTour
from haptorb.sensing.tool.tool_field import ToolModel

__all__ = ["CoilReadings", "SensorFit", "fit_sensors", "predict_covariance"]

_MOST = 30  #: steps
_DONE = 1e-2  #: of a standard deviation of the prior, a step after which no other is made
_HUBER = 2.5  #: standard deviations beyond which a reading pulls no more strongly
_MODEL = 1e-6  #: standard deviation of what the model of the tool's field gets wrong [T]
_STRENGTH = 0.03  #: standard deviation of the magnet's strength, relative
_MOMENT = 0.01  #: standard deviation of the moment map's entries, of their column: the same sensors measured it
_NOT_DIPOLE = 0.005  #: standard deviation of the coils' field that is no dipole's, as a share
_SMALL = 1e-12  #: variance of a prior that is zero, so that it has an inverse


@dataclass(frozen=True)
class CoilReadings:
    """What every sensor reads of the coils, tool away.

    per_ampere  (k, 3, m) [T/A]
    deviation   (m,) standard deviation of its entries, by coil [T/A]
    at_rest     (k, 3) readings without currents [T], deviation_at_rest their standard deviation [T]
    used        (k,) False: this sensor does not follow the coils
    """

    per_ampere: Array
    deviation: Array
    at_rest: Array
    deviation_at_rest: float
    used: NDArray[np.bool_]


@dataclass(frozen=True)
class SensorFit:
    """What the bundle adjustment found.

    theta       (k, 15) errors of each sensor, as in `sensor_parameters`
    covariance  (15 k, 15 k) of them
    strength    of the tool's magnet, relative to the device file
    residual    rms of the whitened residuals per degree of freedom: about 1 where the model explains the readings
    by_sensor   (k,) the same of each sensor
    places      (n, 3) [m] and axes (n, 3): where the tool was
    """

    theta: Array
    covariance: Array
    strength: float
    residual: float
    by_sensor: Array
    places: Array
    axes: Array


def fit_sensors(
    device: SphericalElectromagnet, coils: CoilReadings, tour: ToolTour, used: NDArray[np.bool_]
) -> SensorFit:
    """The errors of the sensors `used` (k,) of `device` from what they read of the coils and of the tool.

    Errors of the others stay zero. Raises CalibrationError where no errors of a likely size explain the readings.
    """
    return _Bundle(device, coils, tour, used).solve()


def predict_covariance(device: SphericalElectromagnet, coils: CoilReadings, tour: ToolTour) -> Array:
    """(15 k, 15 k) covariance of the errors θ [T, 1, m] that `fit_sensors` would find from such readings: the inverse
    information, that of the device file's distributions included."""
    H, _, _ = _Bundle(device, coils, tour, coils.used).normal()
    count = PARAMETERS * device.sensors
    return np.asarray(np.linalg.inv(H)[:count, :count], dtype=np.float64)


class _Bundle:
    """The unknowns as they are now: theta, strength, moment map, and a pose for each reading."""

    def __init__(
        self, device: SphericalElectromagnet, coils: CoilReadings, tour: ToolTour, used: NDArray[np.bool_]
    ) -> None:
        self._device, self._coils, self._tour, self._used = device, coils, tour, used
        self._model = ToolModel.of(device, azimuth=8)
        k, m = device.sensors, device.channels
        self._k, self._size = k, PARAMETERS * k + 1 + 3 * m
        self._theta, self._strength = np.zeros((k, PARAMETERS)), 1.0
        self._theta[:, OFFSET] = coils.at_rest * used[:, None]
        self._moments = np.array(device.moment_per_current, dtype=np.float64)
        self._places = tour.places.copy()
        self._turns = np.array([rotation_to_axis(axis) for axis in tour.axes])
        variance = np.concatenate(
            [np.zeros(PARAMETERS * k), [_STRENGTH**2], np.repeat(self._moment_deviation() ** 2, 3)]
        )
        self.prior = np.diag(variance)
        for sensor in range(k):
            at = slice(PARAMETERS * sensor, PARAMETERS * (sensor + 1))
            self.prior[at, at] = prior_covariance(device.hall.errors) + _SMALL * np.eye(PARAMETERS) * _scales()
        self._weight0: Array = np.asarray(np.linalg.inv(self.prior), dtype=np.float64)

    def _moment_deviation(self) -> Array:
        """(m,) [m²] standard deviation of the entries of each column of the moment map."""
        deviation: Array = _MOMENT * np.linalg.norm(self._device.moment_per_current, axis=0)
        return deviation

    def solve(self) -> SensorFit:
        """Steps until nothing moves."""
        scale = np.sqrt(np.diag(self.prior))
        for _ in range(_MOST):
            H, g, back = self.normal()
            step: Array = np.asarray(np.linalg.solve(H, g), dtype=np.float64)
            if not np.isfinite(step).all():
                raise CalibrationError("the readings are not numbers, or all equal; see `haptorb hardware monitor`")
            self._step(step, back)
            if np.abs(step / scale).max() < _DONE:
                break
        else:
            raise CalibrationError(
                "no sensor errors explain the readings of the tool: keep other magnets and iron away, and "
                "check that the tool is the one of the device file"
            )
        H, _, _ = self.normal()
        whitened = self._whiten()
        weights = _weights(whitened)
        each = np.sqrt((weights * whitened**2).sum(axis=(0, 2)) / np.maximum(weights.sum(axis=(0, 2)), 1e-9))
        n, readings = len(whitened), 3 * int(self._used.sum())
        freedom = max(n * (readings - 5) - PARAMETERS * int(self._used.sum()), 1)
        residual = float(np.sqrt((weights * whitened**2)[:, self._used].sum() / freedom))
        count = PARAMETERS * self._k
        covariance: Array = np.asarray(np.linalg.inv(H)[:count, :count], dtype=np.float64)
        axes = self._turns[:, :, 2].copy()
        return SensorFit(self._theta, covariance, self._strength, residual, each, self._places, axes)

    def _predict(self, n: int) -> tuple[Array, Array, Array, Array]:
        """Residual r (k, 3), its Jacobians by the pose (3 k, 5), by the sensors (k, 3, 15) and by the strength (k, 3)
        of reading n."""
        theta = self._theta
        mixing = np.eye(3) + theta[:, MIXING].reshape(-1, 3, 3)
        model = self._model._replace(sensors=np.ascontiguousarray(self._model.sensors + theta[:, DISPLACEMENT]))
        B, J, gradient = tool_readings(model, self._places[n], self._turns[n])
        B, J, gradient = self._strength * B, self._strength * J, self._strength * gradient
        read = np.einsum("kij,kj->ki", mixing, B)
        r = self._tour.fields[n] - read - theta[:, OFFSET]
        by_pose = np.einsum("kij,kja->kia", mixing, J)
        return r, by_pose.reshape(-1, 5), sensitivity(B, gradient, mixing), read / self._strength

    def _deviation(self) -> float:
        return float(np.hypot(self._tour.noise, _MODEL))

    def _whiten(self) -> Array:
        """(n, k, 3) residuals by their standard deviation."""
        return np.array([self._predict(n)[0] for n in range(len(self._places))]) / self._deviation()

    def normal(self) -> tuple[Array, Array, list[tuple[Array, Array]]]:
        """H and g of the sensors' normal equations, poses eliminated; and for each pose what finds its own step."""
        H, g = self._weight0.copy(), self._weight0 @ self._find_departure()
        self._add_coils(H, g)
        back, sigma = [], self._deviation()
        P, k = PARAMETERS, self._k
        used = np.repeat(self._used, 3)
        for n in range(len(self._places)):
            r, by_pose, by_sensor, by_strength = self._predict(n)
            w = _weights(r[None] / sigma)[0].ravel() * used / sigma**2
            full = np.zeros((3 * k, P * k + 1))
            for sensor in range(k):
                full[3 * sensor : 3 * sensor + 3, P * sensor : P * sensor + P] = by_sensor[sensor]
            full[:, -1] = by_strength.ravel()
            weighted = by_pose * w[:, None]
            scale = 1.0 / np.sqrt((by_pose * weighted).sum(axis=0))
            inner = np.linalg.inv((by_pose.T @ weighted) * np.outer(scale, scale)) * np.outer(scale, scale)
            cross = weighted.T @ full
            own = weighted.T @ r.ravel()
            H[: P * k + 1, : P * k + 1] += full.T @ (full * w[:, None]) - cross.T @ inner @ cross
            g[: P * k + 1] += full.T @ (w * r.ravel()) - cross.T @ (inner @ own)
            back.append((inner @ own, inner @ cross))
        return H, g, back

    def _find_departure(self) -> Array:
        """(size,) how far the unknowns are from what was known of them beforehand, with the sign of a residual."""
        moments = (self._device.moment_per_current - self._moments).T.ravel()
        away: Array = np.concatenate([-self._theta.ravel(), [1.0 - self._strength], moments])
        return away

    def _add_coils(self, H: Array, g: Array) -> None:
        """What the sensors read of the coils."""
        self._add_rest(H, g)
        coils, P, theta = self._coils, PARAMETERS, self._theta
        m = self._device.channels
        for sensor in np.flatnonzero(self._used):
            at = slice(P * sensor, P * sensor + P)
            place = self._model.sensors[sensor] + theta[sensor, DISPLACEMENT]
            mixing = np.eye(3) + theta[sensor, MIXING].reshape(3, 3)
            unit, by_place = _unit_field(place)
            for coil in range(m):
                B = unit @ self._moments[:, coil]
                gradient = np.einsum("iaj,a->ij", by_place, self._moments[:, coil])
                full = np.zeros((3, self._size))
                full[:, at] = sensitivity(B[None], gradient[None], mixing[None])[0]
                full[:, P * sensor : P * sensor + 3] = 0.0  # an offset is no answer to a current
                first = P * self._k + 1 + 3 * coil
                full[:, first : first + 3] = mixing @ unit
                r = coils.per_ampere[sensor, :, coil] - mixing @ B
                w = 1.0 / (coils.deviation[coil] ** 2 + (_NOT_DIPOLE * np.linalg.norm(B)) ** 2)
                H += w * (full.T @ full)
                g += w * (full.T @ r)

    def _add_rest(self, H: Array, g: Array) -> None:
        """What the sensors read at rest: their offsets, and a moment that the coils left in the core."""
        coils, working = self._coils, np.flatnonzero(self._used)
        rows = (PARAMETERS * working[:, None] + np.arange(3)).ravel()
        unit = np.concatenate([_unit_field(place)[0] for place in self._model.sensors[working]])
        left = self._device.core_dynamics.remanent_moment
        covariance = coils.deviation_at_rest**2 * np.eye(len(rows)) + left**2 * unit @ unit.T
        weight = np.linalg.inv(covariance)
        H[np.ix_(rows, rows)] += weight
        g[rows] += weight @ (coils.at_rest - self._theta[:, OFFSET])[working].ravel()

    def _step(self, step: Array, back: list[tuple[Array, Array]]) -> None:
        count = PARAMETERS * self._k
        self._theta = self._theta + step[:count].reshape(-1, PARAMETERS)
        self._strength += float(step[count])
        self._moments = self._moments + step[count + 1 :].reshape(-1, 3).T
        device = self._device
        nearest = device.contact_distance - 5e-3
        furthest = device.contact_distance + device.shell_thickness + 15e-3
        for n, (own, cross) in enumerate(back):
            delta = own - cross @ step[: count + 1]
            p = self._places[n] + np.clip(delta[:3], -5e-3, 5e-3)
            distance = float(np.linalg.norm(p))
            self._places[n] = p * np.clip(distance, nearest, furthest) / distance  # on the dome or in the shell
            turn = self._turns[n]
            w = turn[:, 0] * np.clip(delta[3], -0.2, 0.2) + turn[:, 1] * np.clip(delta[4], -0.2, 0.2)
            turn_by(w[0], w[1], w[2], turn.copy(), self._turns[n])


def _weights(whitened: Array) -> Array:
    """Huber's weight of each sensor's reading (…, k, 3): all three axes alike."""
    size = np.linalg.norm(whitened, axis=-1, keepdims=True) / np.sqrt(3)
    weights: Array = np.broadcast_to(np.minimum(1.0, _HUBER / np.maximum(size, 1e-12)), whitened.shape)
    return weights


def _scales() -> Array:
    """(15, 15) unit of each parameter's variance, on the diagonal: for a prior that says nothing can differ."""
    scale = np.eye(PARAMETERS)
    scale[OFFSET, OFFSET] *= 1e-4
    scale[DISPLACEMENT, DISPLACEMENT] *= 1e-4
    return scale


def _unit_field(place: Array) -> tuple[Array, Array]:
    """(3, 3) field [T/(A·m²)] at `place` (3,) [m] of unit moments along x, y, z at the centre; (3, 3, 3) [i, a, j] its
    derivative by place, of moment a."""
    h = 1e-5

    def unit(at: Array) -> Array:
        field: Array = np.stack([dipole.field(e, at[None])[0] for e in np.eye(3)], axis=1)
        return field

    by_place = np.stack([(unit(place + h * e) - unit(place - h * e)) / (2 * h) for e in np.eye(3)], axis=2)
    return unit(place), by_place
