"""Self-calibration of the field sensors: result, uncertainty, unobservable combinations, and failed sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.arrays import Array, check_finite
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.core_parameters import CoreDynamics
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.field_sensors import FieldSensors, SensorCorrection, SensorErrors
from haptorb.errors import CalibrationError, quote
from haptorb.estimation.hall_pose_fit import ToolModel, coil_field, moment_field, tool_field
from haptorb.json_file import numbers
from haptorb.magnetics import dipole
from haptorb.magnetics.dipole import MU0_OVER_4PI, point_field
from haptorb.magnetics.magnets import ChargedRing
from haptorb.magnetics.soft_sphere import SoftSphere
from haptorb.rotations import turn_by

__all__ = [
    "DISPLACEMENT",
    "MIXING",
    "OFFSET",
    "PARAMETERS",
    "CoilReadings",
    "SensorCalibration",
    "SensorFit",
    "SensorKnowledge",
    "ToolTour",
    "calibrate_sensors",
    "check_tour",
    "choose_readings",
    "find_observed_share",
    "fit_sensors",
    "list_unobserved",
    "pose_covariance",
    "predict_coils",
    "predict_covariance",
    "predict_knowledge",
    "prior_covariance",
    "sensitivity",
    "shell_sample",
    "spread_tour",
    "tool_readings",
    "uncertainty_over_shell",
    "without_errors",
]


# --------------------------------------------------------------------------------------------------
# Result of the self-calibration of the field sensors, as a part of a calibration file.


_KEYS = ("positions_m", "gain", "offsets_t", "per_ampere_t", "used")


@dataclass(frozen=True)
class SensorCalibration:
    """Calibrated values that replace the device file's sensors.

    positions   (k, 3) [m]; those of sensors that failed are the device file's
    correction  offset, gain, and reading per ampere of each
    place       remaining rms constant error of the tool's position over the shell [m]
    axis        the same for its axis [rad]
    strength    of the tool's magnet, relative to the device file
    residual    of the fit, in standard deviations of a reading
    unobserved  quantities known only from the device file, in words
    """

    positions: Array
    correction: SensorCorrection
    place: float
    axis: float
    strength: float
    residual: float
    unobserved: tuple[str, ...]

    @property
    def failed(self) -> tuple[int, ...]:
        """Numbers of the excluded sensors, from 1."""
        return tuple(int(n) + 1 for n in np.flatnonzero(~self.correction.used))

    def apply(self, hall: FieldSensors) -> FieldSensors:
        """`hall` with the calibrated values."""
        return replace(hall, positions=self.positions, correction=self.correction)

    def numbers(self) -> dict[str, Any]:
        """As JSON, units in the keys."""
        found = self.correction
        return {
            "positions_m": self.positions.tolist(),
            "gain": found.gain.tolist(),
            "offsets_t": found.offset.tolist(),
            "per_ampere_t": found.per_ampere.tolist(),
            "used": [bool(one) for one in found.used],
            "uncertainty_t": found.uncertainty,
            "place_m": self.place,
            "axis_rad": self.axis,
            "strength": self.strength,
            "residual": self.residual,
            "unobserved": list(self.unobserved),
        }

    @classmethod
    def parse(cls, raw: Any, name: str, sensors: int, channels: int) -> SensorCalibration:
        """Parse the result of `numbers`, for that many sensors and channels; CalibrationError, under `name`, if it is
        invalid."""
        scalars = ("uncertainty_t", "place_m", "axis_rad", "strength", "residual")
        wanted = {*_KEYS, *scalars, "unobserved"}
        if not isinstance(raw, Mapping) or set(raw) != wanted:
            raise CalibrationError(f"{name}: field_sensors must be null or have exactly {', '.join(sorted(wanted))}")
        used = raw["used"]
        if not (isinstance(used, list) and len(used) == sensors and all(isinstance(one, bool) for one in used)):
            raise CalibrationError(
                f"{name}: used must be true or false for each of {sensors} sensors; got {quote(used)}"
            )
        lines = raw["unobserved"]
        if not (isinstance(lines, list) and all(isinstance(line, str) for line in lines)):
            raise CalibrationError(f"{name}: unobserved must be a list of texts; got {quote(lines)}")
        gain = numbers(raw, "gain", name, (sensors, 3, 3))
        if np.abs(np.linalg.det(gain)).min() < 0.1:
            raise CalibrationError(f"{name}: gain has a sensor that measures less than three directions")
        uncertainty, place, axis, strength, residual = (float(numbers(raw, key, name, ())) for key in scalars)
        correction = SensorCorrection(
            gain,
            numbers(raw, "offsets_t", name, (sensors, 3)),
            numbers(raw, "per_ampere_t", name, (sensors, 3, channels)),
            np.array(used, dtype=np.bool_),
            uncertainty,
        )
        at = numbers(raw, "positions_m", name, (sensors, 3))
        return cls(at, correction, place, axis, strength, residual, tuple(lines))


# --------------------------------------------------------------------------------------------------
# Sensitivity of a reading to the constant errors of its sensor: 15 parameters each, with their prior covariance.
#
# A sensor with errors θ = (b, E, d) reads r = (1 + E) B(x + d) + b where an ideal one at x reads B(x): offset b (3)
# [T], matrix E (3, 3) of gain, cross-axis sensitivity and rotation, and displacement d (3) [m].


PARAMETERS: Final = 15  #: per sensor
OFFSET: Final = slice(0, 3)
MIXING: Final = slice(3, 12)  #: rows of E in sequence
DISPLACEMENT: Final = slice(12, 15)

_STEP_M = 5e-5  #: step of a difference quotient [m]


def tool_readings(model: ToolModel, p: Array, R: Array) -> tuple[Array, Array, Array]:
    """B (k, 3) [T] of the tool at p (3,) [m] and R (3, 3) with the core's response; J (k, 3, 5) as `tool_field`; and
    ∂B/∂x (k, 3, 3) [T/m] by each sensor's place x."""
    k = len(model.sensors)
    B, J = np.empty((k, 3)), np.empty((k, 3, 5))
    gradient, unused = np.empty((k, 3, 3)), np.empty((k, 3, 5))
    above, below = np.empty((k, 3)), np.empty((k, 3))
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = _STEP_M
        tool_field(model._replace(sensors=model.sensors + shift), p, R, above, unused)
        tool_field(model._replace(sensors=model.sensors - shift), p, R, below, unused)
        gradient[:, :, axis] = (above - below) / (2 * _STEP_M)
    tool_field(model, p, R, B, J)
    return B, J, gradient


def sensitivity(B: Array, gradient: Array, mixing: Array | None = None) -> Array:
    """(k, 3, 15) ∂r/∂θ of readings of the field B (k, 3) [T] with position derivative gradient (k, 3, 3) [T/m].

    mixing (k, 3, 3): 1 + E of each sensor; None: that of ideal ones.
    """
    count = len(B)
    S = np.zeros((count, 3, PARAMETERS))
    S[:, :, OFFSET] = np.eye(3)
    for axis in range(3):
        S[:, axis, 3 + 3 * axis : 6 + 3 * axis] = B
    S[:, :, DISPLACEMENT] = gradient if mixing is None else mixing @ gradient
    return S


def prior_covariance(errors: SensorErrors) -> Array:
    """(15, 15) prior covariance of θ of one sensor, from the device file's distributions alone.

    >>> prior = prior_covariance(SensorErrors(gain=0.01, offset=5e-5, placement=2e-4))
    >>> np.sqrt(np.diag(prior))[[0, 3, 4, 12]].round(6).tolist()
    [5e-05, 0.01, 0.0, 0.0002]
    """
    C = np.zeros((PARAMETERS, PARAMETERS))
    C[OFFSET, OFFSET] = errors.offset**2 * np.eye(3)
    C[DISPLACEMENT, DISPLACEMENT] = errors.placement**2 * np.eye(3)
    for i in range(3):
        for j in range(3):
            at = 3 + 3 * i + j
            if i == j:
                C[at, at] = errors.gain**2
            else:  # a rotation is antisymmetric
                C[at, at] = errors.cross**2 + errors.angle**2
                C[at, 3 + 3 * j + i] = -(errors.angle**2)
    return C


# --------------------------------------------------------------------------------------------------
# Position accuracy with real field sensors: of the tracker, and the lower bound for any estimate.
#
# Two kinds of errors. Noise is independent in every reading, and the tracker's filter averages it. Constant errors are
# not reduced by a filter: those of the sensors (`sensitivity`), of the coils' field that is subtracted, and the
# remanence of the core. With J the field's derivative by the pose, Σ the covariance of all errors and W the tracker's
# weight of the readings, the tracker's covariance is A Σ Aᵀ, A = (Jᵀ W J)⁻¹ Jᵀ W, and the Cramér–Rao bound, for errors
# with covariance Σ, is (Jᵀ Σ⁻¹ J)⁻¹. Both are first order in the errors.


_CALIBRATED = 1e-3  #: relative standard deviation of the moment map's entries that the tracker assumes


@dataclass(frozen=True)
class SensorKnowledge:
    """Covariance of the sensors' constant errors.

    covariance  (15 k, 15 k) of the sensors' errors θ, as in `sensitivity`
    coils       (3 k, m) standard deviation of what each sensor reads per ampere, where that was measured [T/A]; None:
                it is computed from moments, whose entries are known to `moments`, and the sensors' errors apply to it
    moments     standard deviation of the moment map's entries, relative to their column
    drift       (2,) offset [T] and gain [1] by which the sensors drifted since, standard deviations
    remanent    moment that may be left in the core, standard deviation of each axis [A·m²]
    eddy        share of the moment that may be missing because the core lags, standard deviation
    uniform     field in which the device stands, standard deviation along each axis [T]
    steel       radius of a steel ball and its distance from the centre [m], anywhere but above; (0, 0): there is none
    """

    covariance: Array
    coils: Array | None = None
    moments: float = 0.0
    drift: tuple[float, float] = (0.0, 0.0)
    remanent: float = 0.0
    eddy: float = 0.0
    uniform: float = 0.0
    steel: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, errors: SensorErrors, count: int, **known: float) -> SensorKnowledge:
        """For `count` sensors with the distributions of `errors` alone."""
        whole = np.kron(np.eye(count), prior_covariance(errors))
        return cls(whole, **known)  # type: ignore[arg-type]


_DIRECTIONS, _HIGHEST = 24, 0.3  #: directions in which a steel ball is placed; largest cosine to the summit


def without_errors(device: SphericalElectromagnet) -> SphericalElectromagnet:
    """Return `device` with sensors that have noise and quantisation only, and a core without lag, for a study.

    In simulation, it is built exactly as in its file.

    >>> from haptorb.devices.loader import load
    >>> without_errors(load("omni")).hall.errors.offset
    0.0
    """
    hall = replace(device.hall, errors=SensorErrors(), warming=0.0, correction=None)
    return replace(device, hall=hall, core_dynamics=CoreDynamics(), tolerance=None)


def pose_covariance(
    device: SphericalElectromagnet,
    p: ArrayLike,
    axis: ArrayLike,
    currents: ArrayLike,
    knowledge: SensorKnowledge,
    share: float = 1.0,
) -> tuple[Array, Array]:
    """(5, 5) covariance of position [m²] and two rotations across the axis [rad²]: of the tracker, and the lower bound.

    The tool is at p (3,) [m] with `axis` (3,); currents (m,) [A]; share: of the noise's standard deviation that the
    filter leaves.

    >>> from haptorb.devices.loader import load
    >>> omni = without_errors(load("omni"))
    >>> ideal = SensorKnowledge.of(SensorErrors(), omni.sensors)
    >>> reached, bound = pose_covariance(omni, (0, 0, 0.06), (0, 0, 1), (0, 0, 0), ideal)
    >>> bool(np.allclose(reached, bound, rtol=1e-3)), bool(1e-4 < np.sqrt(np.trace(bound[:3, :3])) < 1e-2)
    (True, True)
    """
    at, along, i = (check_finite(value, name) for value, name in ((p, "p"), (axis, "axis"), (currents, "currents")))
    model, hall, supply = ToolModel.of(device), device.hall, device.supply
    B, J, gradient = tool_readings(model, np.ascontiguousarray(at), rotation_to_axis(along))
    per_ampere, unit = coil_field(device).reshape(-1, device.channels), moment_field(device).reshape(-1, 3)
    readings = 3 * device.sensors
    noise = hall.noise**2 + hall.step**2 / 12
    ampere = (supply.current_noise**2 + supply.current_step**2 / 12) * per_ampere @ per_ampere.T
    whole, slope = B, gradient
    if knowledge.coils is None:  # the sensors' errors apply to the coils' field as well
        moment = device.moment_per_current @ i
        whole, slope = B + (per_ampere @ i).reshape(-1, 3), gradient + _moment_gradient(model.sensors, moment)
    lasting = _spread(sensitivity(whole, slope), knowledge.covariance)
    columns = (device.moment_per_current**2).sum(axis=0)
    if knowledge.coils is None:
        lasting += float(columns @ (knowledge.moments * i) ** 2) * unit @ unit.T
    else:
        lasting += np.diag((knowledge.coils**2) @ i**2)
    late = knowledge.eddy * unit @ device.moment_per_current @ i
    lasting += knowledge.remanent**2 * unit @ unit.T + np.outer(late, late)
    if knowledge.uniform:  # uniform external field, with the core's response
        around = np.tile(np.eye(3), (device.sensors, 1)) + unit @ device.core.moment_in(np.eye(3))
        lasting += knowledge.uniform**2 * around @ around.T
    if knowledge.steel[0]:
        lasting += _add_steel(device, at, rotation_to_axis(along), i, *knowledge.steel)
    lasting += knowledge.drift[0] ** 2 * np.eye(readings) + np.diag((knowledge.drift[1] * whole.ravel()) ** 2)
    Σ = share**2 * (noise * np.eye(readings) + ampere) + lasting
    doubt = _CALIBRATED**2 + knowledge.eddy**2  # the tracker's uncertainty includes that of the core's lag
    believed = doubt * float(columns @ i**2) + device.core_dynamics.remanent_moment**2
    W = np.linalg.inv(noise * np.eye(readings) + ampere + believed * unit @ unit.T)
    j = J.reshape(-1, 5)
    A = np.linalg.solve(j.T @ W @ j, j.T @ W)
    return A @ Σ @ A.T, np.linalg.inv(j.T @ np.linalg.solve(Σ, j))


def _add_steel(
    device: SphericalElectromagnet, p: Array, R: Array, currents: Array, radius: float, away: float
) -> Array:
    """(3 k, 3 k) [T²] covariance of the readings of a steel ball of `radius` [m], `away` [m] from the centre.

    A dipole in the field of tool, coils and core; mean over directions that are not above the sensors.
    """
    k = np.arange(_DIRECTIONS) + 0.5
    z = _HIGHEST - (1 + _HIGHEST) * k / _DIRECTIONS
    turn, across = np.pi * (1 + 5**0.5) * k, np.sqrt(1 - z * z)
    places = away * np.column_stack([across * np.cos(turn), across * np.sin(turn), z])
    ring = ChargedRing(device.tool.outer_radius, device.tool.inner_radius, device.tool.length, device.tool.remanence)
    charges, q = ring.points @ R.T + p, ring.charges
    share, total = SoftSphere(radius).moment_in(np.eye(3))[0, 0], np.zeros((3 * device.sensors, 3 * device.sensors))
    for place in places:
        arm = place - charges
        field = MU0_OVER_4PI * (q / np.linalg.norm(arm, axis=1) ** 3) @ arm
        field = field + device.coil_fields(place[None])[0] @ currents
        read = (point_field(device.hall.positions - place) @ (share * field)).ravel()
        total += np.outer(read, read) / _DIRECTIONS
    return total


def _spread(S: Array, covariance: Array) -> Array:
    """(3 k, 3 k) covariance of readings with sensitivity S (k, 3, 15) to the sensors' errors."""
    count = len(S)
    full = np.zeros((3 * count, PARAMETERS * count))
    for k in range(count):
        full[3 * k : 3 * k + 3, PARAMETERS * k : PARAMETERS * (k + 1)] = S[k]
    spread: Array = full @ covariance @ full.T
    return spread


def _moment_gradient(at: Array, moment: Array) -> Array:
    """(k, 3, 3) ∂B/∂x [T/m] of a dipole `moment` (3,) [A·m²] at the centre, at positions (k, 3) [m].

    ∂B_i/∂x_j = 3 K/r⁵ [m_i x_j + m_j x_i + (m·x)(δ_ij − 5 x_i x_j/r²)], K = μ0/4π.
    """
    r2 = (at**2).sum(axis=1)[:, None, None]
    along = (at @ moment)[:, None, None]
    outer = at[:, :, None] * at[:, None, :]
    both = moment[None, :, None] * at[:, None, :] + at[:, :, None] * moment[None, None, :]
    slope: Array = 3e-7 / r2**2.5 * (both + along * (np.eye(3) - 5 * outer / r2))
    return slope


# --------------------------------------------------------------------------------------------------
# Readings of the field sensors along a calibration motion of the tool, first poses, and a check of their coverage.
#
# A sensor's errors are separated by a motion with the tool on every side, near and far, upright and tilted. Missing
# regions are reported, so that the user can visit them.


_SECTORS = 6  #: of azimuth
_LEAST_READINGS = 120
_LEAST_IN_SECTOR = 5
_SECTOR_ANGLE_SHARE = 0.35  #: share of the workspace's angle from which a position belongs to a sector
_MIN_ANGLE_SHARE = 0.7  #: share of the workspace's angle that must be reached
_MIN_HEIGHT_SHARE = 0.35  #: share of the shell's thickness that must lie between low and high readings
_MIN_TILT_RAD = np.radians(8.0)  #: minimum tilt of a tenth of the readings


@dataclass(frozen=True)
class ToolTour:
    """n readings of a motion: fields (n, k, 3) [T], coils off, and first estimates of positions (n, 3) [m] and axes.

    noise: standard deviation of one of these readings, each axis [T].
    """

    fields: Array
    places: Array
    axes: Array
    noise: float


def check_tour(device: SphericalElectromagnet, tour: ToolTour) -> None:
    """Raise CalibrationError with the missing regions, unless the tool covered the whole dome."""
    if len(tour.places) < _LEAST_READINGS:
        raise CalibrationError(
            f"the tool was found in {len(tour.places)} readings only, at least {_LEAST_READINGS} are needed: keep it "
            "within the shell above the dome, its tip towards the dome, for the whole time"
        )
    distance = np.linalg.norm(tour.places, axis=1)
    outward = tour.places / distance[:, None]
    polar = np.arccos(np.clip(outward[:, 2], -1.0, 1.0))
    half = device.workspace_half_angle
    azimuth = np.degrees(np.arctan2(outward[:, 1], outward[:, 0])) % 360
    sector = (azimuth // (360 / _SECTORS)).astype(int)
    lean = np.arccos(np.clip(np.einsum("ni,ni->n", outward, tour.axes), -1.0, 1.0))
    low, high = np.percentile(distance, (5, 95))
    missing = []
    visits = np.bincount(sector[polar > _SECTOR_ANGLE_SHARE * half], minlength=_SECTORS)
    empty = np.flatnonzero(visits < _LEAST_IN_SECTOR)
    if len(empty):
        wide = 360 // _SECTORS
        sides = ", ".join(f"{wide * one}° to {wide * (one + 1)}°" for one in empty)
        missing.append(f"it was not on these sides of the dome, counted from +x: {sides}")
    reached = float(np.percentile(polar, 98))
    if reached < _MIN_ANGLE_SHARE * half:
        missing.append(
            f"it reached {np.degrees(reached):.0f}° from the summit, "
            f"at least {np.degrees(_MIN_ANGLE_SHARE * half):.0f}° are needed"
        )
    if high - low < _MIN_HEIGHT_SHARE * device.shell_thickness:
        missing.append(
            f"its height varied by {1e3 * (high - low):.1f} mm, "
            f"at least {1e3 * _MIN_HEIGHT_SHARE * device.shell_thickness:.0f} mm are needed"
        )
    if float(np.percentile(lean, 90)) < _MIN_TILT_RAD:
        missing.append(
            f"it was tilted by {np.degrees(np.percentile(lean, 90)):.0f}°, "
            f"at least {np.degrees(_MIN_TILT_RAD):.0f}° are needed"
        )
    if missing:
        raise CalibrationError(
            "the tool was not moved enough: " + "; ".join(missing) + ". Move it over the whole dome, down to the "
            "edge on every side, lift and lower it, and tilt it to all sides"
        )


def choose_readings(tour: ToolTour, most: int) -> ToolTour:
    """At most `most` of the readings, evenly spaced."""
    chosen = np.unique(np.linspace(0, len(tour.places) - 1, most).round().astype(int))
    return ToolTour(tour.fields[chosen], tour.places[chosen], tour.axes[chosen], tour.noise)


# --------------------------------------------------------------------------------------------------
# Offset, gain and position of every field sensor from the coils and from a moved tool: bundle adjustment.
#
# The tool's pose is not measured. Each reading of k sensors has 3 k numbers and 5 unknowns of its own, the tool's
# position and axis; the remaining equations, some hundred times, determine the 15 errors of each sensor
# (`sensitivity`) and the strength of the tool's magnet. The coils, driven in turn, add the response of each
# sensor to fields of known directions. Gauss–Newton on all unknowns together, with the poses eliminated reading by
# reading (Schur complement); Huber's weights reduce the influence of disturbed readings; the device file's
# distributions are the prior, so that unobservable combinations remain at the data sheet's values, and are reported.


_MAX_STEPS = 30  #: Gauss–Newton iterations
_STEP_TOLERANCE = 1e-2  #: convergence: step relative to the standard deviation of the prior
_HUBER_SIGMAS = 2.5  #: standard deviations beyond which the influence of a reading is constant
_MODEL_SIGMA_T = 1e-6  #: standard deviation of the model error of the tool's field [T]
_STRENGTH_SIGMA = 0.03  #: standard deviation of the magnet's strength, relative
_MOMENT_SIGMA = 0.01  #: relative standard deviation of the moment map's entries: measured by the same sensors
_NOT_DIPOLE = 0.005  #: standard deviation of the coils' field from a dipole's, as a share
_MIN_VARIANCE = 1e-12  #: variance in place of a prior of zero, so that it can be inverted


@dataclass(frozen=True)
class CoilReadings:
    """Response of each sensor to the coils, without the tool.

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
    """Result of the bundle adjustment.

    theta       (k, 15) errors of each sensor, as in `sensitivity`
    covariance  (15 k, 15 k) of them
    strength    of the tool's magnet, relative to the device file
    residual    rms of the whitened residuals per degree of freedom: about 1 where the model explains the readings
    by_sensor   (k,) the same of each sensor
    places      (n, 3) [m] and axes (n, 3) of the tool
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
    """Estimate the errors of the sensors `used` (k,) of `device` from their readings of the coils and of the tool.

    Errors of the others stay zero. Raises CalibrationError if no plausible errors fit the readings.
    """
    return _Bundle(device, coils, tour, used).solve()


def predict_covariance(device: SphericalElectromagnet, coils: CoilReadings, tour: ToolTour) -> Array:
    """(15 k, 15 k) covariance of the errors θ [T, 1, m] that `fit_sensors` would have for such readings: the inverse
    of the information matrix, with the device file's distributions as prior."""
    H, _, _ = _Bundle(device, coils, tour, coils.used).normal()
    count = PARAMETERS * device.sensors
    return np.asarray(np.linalg.inv(H)[:count, :count], dtype=np.float64)


class _Bundle:
    """Current values of the unknowns: theta, strength, moment map, and a pose for each reading."""

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
            [np.zeros(PARAMETERS * k), [_STRENGTH_SIGMA**2], np.repeat(self._moment_deviation() ** 2, 3)]
        )
        self.prior = np.diag(variance)
        for sensor in range(k):
            at = slice(PARAMETERS * sensor, PARAMETERS * (sensor + 1))
            self.prior[at, at] = prior_covariance(device.hall.errors) + _MIN_VARIANCE * np.eye(PARAMETERS) * _scales()
        self._weight0: Array = np.asarray(np.linalg.inv(self.prior), dtype=np.float64)

    def _moment_deviation(self) -> Array:
        """(m,) [m²] standard deviation of the entries of each column of the moment map."""
        deviation: Array = _MOMENT_SIGMA * np.linalg.norm(self._device.moment_per_current, axis=0)
        return deviation

    def solve(self) -> SensorFit:
        """Iterate to convergence."""
        scale = np.sqrt(np.diag(self.prior))
        for _ in range(_MAX_STEPS):
            H, g, back = self.normal()
            step: Array = np.asarray(np.linalg.solve(H, g), dtype=np.float64)
            if not np.isfinite(step).all():
                raise CalibrationError("the readings are not numbers, or all equal; see `haptorb hardware monitor`")
            self._step(step, back)
            if np.abs(step / scale).max() < _STEP_TOLERANCE:
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
        return float(np.hypot(self._tour.noise, _MODEL_SIGMA_T))

    def _whiten(self) -> Array:
        """(n, k, 3) residuals divided by their standard deviations."""
        return np.array([self._predict(n)[0] for n in range(len(self._places))]) / self._deviation()

    def normal(self) -> tuple[Array, Array, list[tuple[Array, Array]]]:
        """H and g of the sensors' normal equations, poses eliminated; and for each pose the data for its own step."""
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
        """(size,) deviation of the unknowns from their prior, with the sign of a residual."""
        moments = (self._device.moment_per_current - self._moments).T.ravel()
        away: Array = np.concatenate([-self._theta.ravel(), [1.0 - self._strength], moments])
        return away

    def _add_coils(self, H: Array, g: Array) -> None:
        """Add the sensors' readings of the coils."""
        self._add_rest(H, g)
        coils, P, theta = self._coils, PARAMETERS, self._theta
        fields, slopes = _coil_fields(self._device, self._moments, self._model.sensors + theta[:, DISPLACEMENT])
        for sensor in np.flatnonzero(self._used):
            at = slice(P * sensor, P * sensor + P)
            mixing = np.eye(3) + theta[sensor, MIXING].reshape(3, 3)
            unit, _ = _unit_field(self._model.sensors[sensor] + theta[sensor, DISPLACEMENT])
            for coil in range(self._device.channels):
                B, gradient = fields[sensor, :, coil], slopes[sensor, :, :, coil]
                full = np.zeros((3, self._size))
                full[:, at] = sensitivity(B[None], gradient[None], mixing[None])[0]
                full[:, P * sensor : P * sensor + 3] = 0.0  # an offset is no response to a current
                first = P * self._k + 1 + 3 * coil
                full[:, first : first + 3] = mixing @ unit
                r = coils.per_ampere[sensor, :, coil] - mixing @ B
                w = 1.0 / (coils.deviation[coil] ** 2 + (_NOT_DIPOLE * np.linalg.norm(B)) ** 2)
                H += w * (full.T @ full)
                g += w * (full.T @ r)

    def _add_rest(self, H: Array, g: Array) -> None:
        """Add the sensors' readings at rest: their offsets, and the remanent moment of the core."""
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
    """Huber's weight of each sensor's reading (…, k, 3): the same for all three axes."""
    size = np.linalg.norm(whitened, axis=-1, keepdims=True) / np.sqrt(3)
    weights: Array = np.broadcast_to(np.minimum(1.0, _HUBER_SIGMAS / np.maximum(size, 1e-12)), whitened.shape)
    return weights


def _scales() -> Array:
    """(15, 15) unit variance of each parameter, on the diagonal: regularises a prior of zero."""
    scale = np.eye(PARAMETERS)
    scale[OFFSET, OFFSET] *= 1e-4
    scale[DISPLACEMENT, DISPLACEMENT] *= 1e-4
    return scale


def _coil_fields(device: SphericalElectromagnet, moments: Array, places: Array) -> tuple[Array, Array]:
    """(k, 3, m) [T/A] of the coils of `device` at `places` (k, 3) [m] for moments per ampere `moments` (3, m)
    [m²]; (k, 3, 3, m) [i, j] their derivative by position [T/(A·m)]."""
    h = 1e-5
    steps = h * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    at = (places[None] + steps[:, None]).reshape(-1, 3)
    found = replace(device, moment_per_current=moments).coil_fields(at).reshape(7, len(places), 3, -1)
    return found[0], np.stack([(found[1 + j] - found[4 + j]) / (2 * h) for j in range(3)], axis=2)


def _unit_field(place: Array) -> tuple[Array, Array]:
    """(3, 3) field [T/(A·m²)] at `place` (3,) [m] of unit moments along x, y, z at the centre; (3, 3, 3) [i, a, j] its
    derivative by position, of moment a."""
    h = 1e-5

    def unit(at: Array) -> Array:
        field: Array = np.stack([dipole.field(e, at[None])[0] for e in np.eye(3)], axis=1)
        return field

    by_place = np.stack([(unit(place + h * e) - unit(place - h * e)) / (2 * h) for e in np.eye(3)], axis=2)
    return unit(place), by_place


# --------------------------------------------------------------------------------------------------
# Unobservable combinations of sensor errors: common changes that change no reading, or hardly any.
#
# Each is a linear function of the sensors' errors. Its standard deviation after the calibration is compared with that
# of the device file: where most of it remains, the readings contain no information on it.


_UNOBSERVED = 0.7  #: remaining share of the prior's standard deviation above which it is unobserved


def _functions(device: SphericalElectromagnet, used: NDArray[np.bool_]) -> dict[str, tuple[Array, str, float, str]]:
    """Name → (c (15 k,) with value c·θ, description, factor to its unit, unit)."""
    k, count = device.sensors, int(used.sum())
    places = device.hall.positions
    out: dict[str, tuple[Array, str, float, str]] = {}
    for axis, name in enumerate("xyz"):
        c = np.zeros((k, PARAMETERS))
        i, j = (axis + 1) % 3, (axis + 2) % 3  # E of sensors rotated by ω: 1 − [ω]×
        c[:, 3 + 3 * i + j], c[:, 3 + 3 * j + i] = 0.5 / count, -0.5 / count
        out[f"turn-{name}"] = (c, f"rotation of all sensors together about {name}", float(np.degrees(1.0)), "°")
    c = np.zeros((k, PARAMETERS))
    c[:, [3, 7, 11]] = 1.0 / (3 * count)
    out["gain"] = (c, "common gain of all sensors (one with the strength of magnet and coils)", 100.0, "%")
    c = np.zeros((k, PARAMETERS))
    c[:, 12:15] = places / np.linalg.norm(places, axis=1)[:, None] / count
    out["distance"] = (c, "common distance of all sensors from the centre", 1e3, "mm")
    return {name: ((row * used[:, None]).ravel(), what, scale, unit) for name, (row, what, scale, unit) in out.items()}


def find_observed_share(
    device: SphericalElectromagnet, covariance: Array, used: NDArray[np.bool_]
) -> dict[str, tuple[float, float]]:
    """Name → remaining share of the device file's standard deviation (1: not observed), and the deviation itself.

    covariance (15 k, 15 k) of the errors θ [T, 1, m] after the calibration; used (k,).
    """
    prior = np.kron(np.eye(device.sensors), prior_covariance(device.hall.errors))
    out = {}
    for name, (c, _, scale, _) in _functions(device, used).items():
        before, after = float(np.sqrt(c @ prior @ c)), float(np.sqrt(c @ covariance @ c))
        out[name] = (after / before if before > 0 else 0.0, scale * after)
    return out


def list_unobserved(device: SphericalElectromagnet, covariance: Array, used: NDArray[np.bool_]) -> tuple[str, ...]:
    """One sentence for each common change without information in the readings.

    covariance (15 k, 15 k) of the errors θ [T, 1, m] after the calibration; used (k,).
    """
    functions = _functions(device, used)
    lines = []
    for name, (share, left) in find_observed_share(device, covariance, used).items():
        _, what, _, unit = functions[name]
        if share > _UNOBSERVED:
            lines.append(f"{what}: known only from the device file, to {left:.2g} {unit}")
    return tuple(lines)


_MAX_FIT_READINGS = 360  #: maximum number of readings in the fit
_FAILED_RESIDUAL_RATIO = 4.0  #: multiple of the median sensor's residual above which a sensor has failed
_FAILED_SHARE = 4  #: one in so many sensors may have failed
_MAX_RESIDUAL_SIGMAS = 3.0  #: limit on the residual, in standard deviations of the readings
_NOISE_SHARE = 0.01  #: remaining share of the noise where only constant errors count
_MAX_POSITION_ERROR_M = 1e-3  #: limit on the rms position error from constant errors over the shell [m]


def calibrate_sensors(device: SphericalElectromagnet, coils: CoilReadings, tour: ToolTour) -> SensorCalibration:
    """Offset, gain and position of every sensor of `device` from its readings of the coils and of a moved tool.

    A sensor that responds neither to the coils nor to the tool has failed and is excluded. Raises CalibrationError with
    the remedy if the tool was not moved enough, if too many sensors fail, or if the model does not fit the readings.
    """
    check_tour(device, tour)
    chosen = choose_readings(tour, _MAX_FIT_READINGS)
    used = coils.used.copy()
    for _ in range(1 + len(used) // _FAILED_SHARE):
        check_failures(device, used)
        fit = fit_sensors(device, coils, chosen, used)
        strange = _find_failed(fit, used)
        if strange is None:
            break
        used[strange] = False
    else:
        check_failures(device, used)
    if fit.residual > _MAX_RESIDUAL_SIGMAS:
        raise CalibrationError(
            f"the best fit leaves {fit.residual:.1f} standard deviations of the readings: keep other magnets and iron "
            "away, and check that the tool is the one of the device file"
        )
    theta, mixing = fit.theta, np.eye(3) + fit.theta[:, MIXING].reshape(-1, 3, 3)
    positions = device.hall.positions + theta[:, DISPLACEMENT]
    place, axis, uncertainty = uncertainty_over_shell(device, fit.covariance, coils.deviation, used)
    if not place < _MAX_POSITION_ERROR_M:
        raise CalibrationError(
            f"the sensors' errors remain so uncertain that the tool's position would be {1e3 * place:.1f} mm off: "
            "move the tool more slowly and over the whole dome, and repeat from the step 'fields' (--restart)"
        )
    gain = np.asarray(np.linalg.inv(mixing), dtype=np.float64)
    correction = SensorCorrection(gain, theta[:, OFFSET].copy(), coils.per_ampere, used, uncertainty)
    return SensorCalibration(
        positions, correction, place, axis, fit.strength, fit.residual, list_unobserved(device, fit.covariance, used)
    )


def check_failures(device: SphericalElectromagnet, used: NDArray[np.bool_]) -> None:
    """Raise CalibrationError with the failed sensors, if they are more than a quarter."""
    failed = [str(n + 1) for n in np.flatnonzero(~used)]
    if len(failed) > device.sensors // _FAILED_SHARE:
        raise CalibrationError(
            f"field sensors {', '.join(failed)} of {device.sensors} do not follow coils and tool; one in "
            f"{_FAILED_SHARE} may be left out: check their connection and supply"
        )


def _find_failed(fit: SensorFit, used: NDArray[np.bool_]) -> int | None:
    """Sensor with residuals far above the others', from 0; None if there is none."""
    each = np.where(used, fit.by_sensor, 0.0)
    worst = int(np.argmax(each))
    return worst if each[worst] > _FAILED_RESIDUAL_RATIO * max(float(np.median(each[used])), 1.0) else None


def shell_sample(device: SphericalElectromagnet, count: int = 3) -> tuple[Array, Array]:
    """Positions (n, 3) [m] over the whole shell and their weights (n,), for integrals over directions and distances."""
    middle = (np.arange(count) + 0.5) / count
    distance = device.contact_distance + device.shell_thickness * middle
    angle = device.workspace_half_angle * middle
    turn = 2 * np.pi * (np.arange(2 * count) + 0.25) / (2 * count)
    d, a, t = (one.ravel() for one in np.meshgrid(distance, angle, turn, indexing="ij"))
    places: Array = d[:, None] * np.column_stack([np.sin(a) * np.cos(t), np.sin(a) * np.sin(t), np.cos(a)])
    return places, np.sin(a) / np.sin(a).sum()


def uncertainty_over_shell(
    device: SphericalElectromagnet, covariance: Array, coil_deviation: Array, used: NDArray[np.bool_]
) -> tuple[float, float, float]:
    """rms constant errors over the shell, coils off: of position [m] and axis [rad], and of one reading of the tool
    [T].

    covariance (15 k, 15 k) of the sensors' errors; coil_deviation (m,) [T/A].
    """
    working = np.flatnonzero(used)
    part = replace(
        device, hall=FieldSensors(device.hall.positions[working], device.hall.noise, device.hall.step)
    )  # the working ones
    rows = (PARAMETERS * working[:, None] + np.arange(PARAMETERS)).ravel()
    knowledge = SensorKnowledge(
        covariance[np.ix_(rows, rows)], np.broadcast_to(coil_deviation, (3 * len(working), device.channels))
    )
    model, off = ToolModel.of(part), np.zeros(device.channels)
    places, weights = shell_sample(device)
    squares = np.zeros(3)
    for p, weight in zip(places, weights, strict=True):
        reached, _ = pose_covariance(part, p, p, off, knowledge, share=_NOISE_SHARE)
        B, _, gradient = tool_readings(model, p, rotation_to_axis(p))
        S = sensitivity(B, gradient)
        blocks = [
            np.trace(S[n] @ knowledge.covariance[a : a + PARAMETERS, a : a + PARAMETERS] @ S[n].T)
            for n, a in enumerate(range(0, len(rows), PARAMETERS))
        ]
        squares += weight * np.array([np.trace(reached[:3, :3]), np.trace(reached[3:, 3:]), np.mean(blocks) / 3])
    place, axis, reading = np.sqrt(squares).tolist()
    return place, axis, reading


# --------------------------------------------------------------------------------------------------
# Predicted result of the self-calibration for a device, from its information matrix.


_AVERAGED_SAMPLES = 10  #: number of samples averaged into one reading of the motion
_COIL_SAMPLES = 20 * 25  #: number of samples at ± 75 % of each coil's current
_COIL_SHARE = 0.75


def spread_tour(device: SphericalElectromagnet, count: int = 360, noise: float | None = None) -> ToolTour:
    """`count` ideal readings of a tool over the whole shell, tilted by up to 23° to all sides, with noise of `noise`
    [T].

    >>> from haptorb.devices.loader import load
    >>> spread_tour(load("omni"), 12).fields.shape
    (12, 9, 3)
    """
    n = np.arange(count)
    z = 1 - (n + 0.5) / count * (1 - np.cos(device.workspace_half_angle))
    turn, s = np.pi * (1 + np.sqrt(5)) * n, np.sqrt(1 - z * z)
    outward = np.column_stack([s * np.cos(turn), s * np.sin(turn), z])
    lift = device.shell_thickness * ((n * 0.7548776662) % 1.0)  # a low-discrepancy sequence in three more dimensions
    lean, side = 0.4 * np.sqrt((n * 0.5698402909) % 1.0), 2 * np.pi * ((n * 0.4301597090) % 1.0)
    places = (device.contact_distance + lift)[:, None] * outward
    model = ToolModel.of(device, azimuth=8)
    axes, fields = np.empty_like(places), np.empty((count, device.sensors, 3))
    for k in range(count):
        R = rotation_to_axis(outward[k])
        axis = outward[k] + lean[k] * (np.cos(side[k]) * R[:, 0] + np.sin(side[k]) * R[:, 1])
        axes[k] = axis / np.linalg.norm(axis)
        fields[k] = tool_readings(model, np.ascontiguousarray(places[k]), rotation_to_axis(axes[k]))[0]
    return ToolTour(
        fields, places, axes, _reading_noise(device) / np.sqrt(_AVERAGED_SAMPLES) if noise is None else noise
    )


def predict_coils(device: SphericalElectromagnet) -> CoilReadings:
    """Predicted result of the step `fields` of a calibration with ideal sensors, with its uncertainty."""
    noise = _reading_noise(device)
    deviation = noise / np.sqrt(_COIL_SAMPLES) / (_COIL_SHARE * device.driven_current)
    rest = noise / np.sqrt(_COIL_SAMPLES)
    k = device.sensors
    return CoilReadings(coil_field(device), deviation, np.zeros((k, 3)), float(rest), np.ones(k, dtype=np.bool_))


def predict_knowledge(device: SphericalElectromagnet, readings: int = 360) -> SensorKnowledge:
    """Predicted covariance of the sensors' errors after the steps `fields` and `sensors` with `readings` readings."""
    coils = predict_coils(device)
    covariance = predict_covariance(device, coils, spread_tour(device, readings))
    per_reading: Array = np.broadcast_to(coils.deviation, (3 * device.sensors, device.channels))
    return SensorKnowledge(covariance, per_reading)


def _reading_noise(device: SphericalElectromagnet) -> float:
    return float(np.hypot(device.hall.noise, device.hall.step / np.sqrt(12)))
