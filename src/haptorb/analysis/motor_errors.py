"""Error model of a spherical motor: from the commanded torque to the torque on the rotor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from haptorb.analysis.error_budget import Component, ErrorModel, ErrorSource, choose_size
from haptorb.analysis.error_sources import (
    ChainTrial,
    CurrentLoop,
    Effect,
    SensorTrial,
    add_to,
    current_sources,
    find_origin,
    magnet_warmth,
    multiply,
    sensor_sources,
    source,
    strengthen,
)
from haptorb.analysis.motor_tolerances import MotorSlopes, PartDeviations, ToleranceSlopes
from haptorb.arrays import Array
from haptorb.control.allocation import torque_allocator
from haptorb.control.capability import motor_capability
from haptorb.devices import tables
from haptorb.devices.base import WrenchMap
from haptorb.devices.motor import SphericalMotor, measure_ring_pull
from haptorb.devices.motor_wrench_map import coils_field
from haptorb.devices.weight_regulator import torque_over_sine
from haptorb.errors import InputError, UnknownName
from haptorb.estimation.calibration_file import Calibration
from haptorb.rotations import rotation_from_euler, turn_by

__all__ = ["MotorErrors", "MotorPoint", "MotorTrial", "motor_errors"]


# --------------------------------------------------------------------------------------------------
# Error chain of a spherical motor, from the commanded torque to the torque on the rotor.
#
# The true motor has other magnets, coils and currents than those of the device file; the controller estimates the
# orientation, and the strength of the magnets, from field sensors with errors of their own. Their fit is linearised
# about the true values: one Gauss–Newton step from there. The torque is static, and both sides use the table of the
# exact model; what parts off their places, or wound otherwise, add to torque and readings is linear in them
# (`motor_tolerances`). What such coils add to the readings is left out: 0.1 mT (rms) in `pmsm` at the currents for half
# of the smallest peak, where such magnets and sensors add 1.3 mT.


TORQUE_JND = 0.127  #: just-noticeable difference of a torque of 60 mN·m, relative
_REGIONS = ("tilt below a third", "tilt of a third to two thirds", "tilt above two thirds")
_COMPONENTS = (Component("about X", (0,)), Component("about Y", (1,)), Component("about Z", (2,)))


@dataclass
class MotorTrial(SensorTrial):
    """Deviations of one motor from its model."""

    polarization: Array  #: (p,) of each magnet, true over model
    coils: Array  #: (c,) torque per ampere and field of each coil, true over model
    regulator: float  #: its torque, true over model
    weight: float  #: torque of the rotor's weight, true over model
    turn: Array  #: (3,) rotation from the true to the tracked orientation [rad]
    parts: PartDeviations  #: of magnets and coils, as they are built

    def strengthen(self, factors: Array) -> None:
        """Multiply the strength of all magnets by `factors` (1,), or that of each by its own (p,)."""
        self.polarization *= factors


class MotorPoint(NamedTuple):
    """Orientation of the rotor, and the commanded torque."""

    R: Array  #: (3, 3)
    wrench: Array  #: (6,) [N, N·m]
    currents: Array  #: (m,) without errors [A]
    field: Array  #: (k, 3) of the model's magnets at the sensors [T]
    solve: Array  #: (4, 3 k) from the residuals of the readings to the rotation [rad/T] and the strength [1/T]
    slopes: MotorSlopes | None  #: of torque and fit by how parts are built; None: they are as in the file


@final
class MotorErrors(ErrorModel[MotorTrial, MotorPoint]):
    """Error model of `device` for commanded torques of `asked` [N·m], with `sources`.

    estimator: "least-squares" (the field sensors) or "tracker"; built: how it may be built, or None.
    """

    unit, jnd, regions, components, motion = "N·m", TORQUE_JND, _REGIONS, _COMPONENTS, "at rest"

    def __init__(
        self, device: SphericalMotor, asked: float, sources: tuple[ErrorSource[MotorTrial], ...], estimator: str,
        built: ToleranceSlopes | None,
    ) -> None:  # fmt: skip
        self.device, self.estimator, self.asked, self.sources = device.name, estimator, asked, sources
        self._device, self._built, self._senses = device, built, estimator != "tracker"
        self._allocator, self._loop = torque_allocator(device), CurrentLoop(device)
        self._polarity = np.array(device.polarity, dtype=np.float64)
        self._frames = device.sensor_layout.frames

    @cached_property
    def _coil_field(self) -> Array:
        """(c, 3 k) [T/A] of each single coil at the sensors."""
        places = self._device.sensor_layout.positions
        one = np.eye(len(self._device.electromagnets))
        return np.stack([coils_field(self._device, places, row).ravel() for row in one])

    def draw_point(self, region: int, rng: np.random.Generator) -> MotorPoint:
        """Random tilt in that third of the workspace's tilts, any spin; the torque in any direction."""
        device = self._device
        while True:
            psi, lam = rng.uniform(-1.0, 1.0, 2)
            if region / 3 <= max(abs(psi), abs(lam)) < (region + 1) / 3:
                break
        tilt = device.workspace_tilt
        R = np.ascontiguousarray(rotation_from_euler(psi * tilt, lam * tilt, rng.uniform(0, 2 * np.pi)))
        wrench = np.zeros(6)
        direction = rng.standard_normal(3)
        wrench[3:] = self.asked * direction / np.linalg.norm(direction)
        field, solve = self._linearize(R) if self._senses else (np.empty((0, 3)), np.empty((4, 0)))
        currents = self._allocate(R, 1.0, wrench)
        slopes = None if self._built is None else self._built.find(R, device.groups @ currents, solve)
        return MotorPoint(R, wrench, currents, field, solve, slopes)

    def _allocate(self, believed: Array, strength: float, wrench: Array) -> Array:
        """(m,) [A] for the `wrench` where the rotor is believed to be at an orientation, with magnets of `strength`."""
        device = self._device
        matrix = np.zeros((6, device.channels))
        matrix[3:] = strength * self._torque(believed, self._polarity) @ device.groups
        wanted: Array = self._allocator.allocate(WrenchMap(matrix, device.passive(believed)), wrench).currents
        return wanted

    def _linearize(self, R: Array) -> tuple[Array, Array]:
        """(k, 3) field of the model's magnets at R [T], and the (4, 3 k) least-squares solution about it."""
        device, pair = self._device, self._device.tables.field_pair
        sensors = device.sensor_layout.directions
        field, slopes = np.empty((len(sensors), 3)), np.empty((1, len(sensors), 3, 3))
        tables.sensor_field_gradient(
            pair.cells, pair.scale, device.magnets.directions, self._polarity, sensors, R.reshape(1, 3, 3), field[None],
            slopes,
        )  # fmt: skip
        design = np.column_stack([slopes.reshape(-1, 3), field.ravel()])
        return field, np.asarray(np.linalg.solve(design.T @ design, design.T), dtype=np.float64)

    def make_trial(self) -> MotorTrial:
        """Motor without errors."""
        device = self._device
        exact = ChainTrial.exact(device.channels)
        return MotorTrial(
            **vars(exact), polarization=np.ones(len(device.magnets)), coils=np.ones(len(device.electromagnets)),
            regulator=1.0, weight=1.0, turn=np.zeros(3), mixing=np.zeros((device.sensors, 3, 3)),
            reading=np.zeros((device.sensors, 3)),
            placement=np.zeros((device.sensors, 3)),
            parts=PartDeviations.none(device, 1 if self._built is None else len(self._built.layers)),
        )  # fmt: skip

    def wrench_error(self, point: MotorPoint, trial: MotorTrial) -> Array:
        """(3,) about the stator's axes [N·m]."""
        device, believed = self._device, np.empty((3, 3))
        turn, strength = trial.turn, 1.0
        if self._senses:
            # The readings include the coils' field, of which little is left: currents without an error of orientation
            # suffice there.
            turn, strength = self._fit_readings(point, trial, self._loop.true_currents(point.currents, trial))
        turn_by(float(turn[0]), float(turn[1]), float(turn[2]), point.R, believed)
        currents = self._loop.true_currents(self._allocate(believed, strength, point.wrench), trial)
        torque = self._torque(point.R, self._polarity * trial.polarization) @ (trial.coils * (device.groups @ currents))
        if point.slopes is not None:
            torque += trial.parts.change_torque(point.slopes)
        error: Array = torque + self._passive(point.R, trial) - point.wrench[3:]
        return error

    def _torque(self, R: Array, polarity: Array) -> Array:
        """(3, c) torque per ampere of every coil at R [N·m/A]."""
        device, pair = self._device, self._device.tables.torque_pair
        out = np.empty((1, 3, len(device.electromagnets)))
        tables.torque_characteristic(
            pair.cells, pair.scale, device.magnets.directions, polarity, device.electromagnets.directions,
            np.ascontiguousarray(R).reshape(1, 3, 3), out,
        )  # fmt: skip
        torque: Array = out[0]
        return torque

    def _fit_readings(self, point: MotorPoint, trial: MotorTrial, currents: Array) -> tuple[Array, float]:
        """(3,) rotation from the true to the estimated orientation [rad], and the estimated strength of the magnets.

        currents (m,) [A] flow.
        """
        device, pair = self._device, self._device.tables.field_pair
        sensors = device.sensor_layout.directions
        field = np.empty((1, len(sensors), 3))
        tables.sensor_field(
            pair.cells, pair.scale, device.magnets.directions, self._polarity * trial.polarization, sensors,
            point.R.reshape(1, 3, 3), field,
        )  # fmt: skip
        true = field[0] + ((trial.coils * (device.groups @ currents)) @ self._coil_field).reshape(-1, 3)
        read = trial.read_field(true, self._frames)
        read -= (trial.read_currents(currents) @ device.sensor_field_per_ampere).reshape(-1, 3)
        fit = point.solve @ (read - point.field).ravel()
        if point.slopes is not None:
            fit += point.slopes.fit_magnets.reshape(4, -1) @ trial.parts.magnets.ravel()
            fit += point.slopes.fit_sensors.reshape(4, -1) @ trial.placement.ravel()
        return fit[:3] / (1 + fit[3]), 1.0 + float(fit[3])

    def _passive(self, R: Array, trial: MotorTrial) -> Array:
        """(3,) true torque of weight and regulator at R [N·m]."""
        device = self._device
        coefficients, least = device.tilt_torque
        own = coefficients.copy()
        own[0] += device.weight_torque  # regulator only
        back = trial.regulator * torque_over_sine(float(R[2, 2]), own, least) - trial.weight * device.weight_torque
        return np.array([back * R[1, 2], -back * R[0, 2], 0.0])


# --------------------------------------------------------------------------------------------------
# Error sources of a spherical motor.


MOTOR_SOURCES_ESTIMATORS = ("least-squares", "tracker")
#: number of readings that the orientation's filter averages, at 1 kHz: 1/0.42, for its time constant of 2.5 ms
_AVERAGED_READINGS = 2.4


def motor_errors(
    device: SphericalMotor,
    asked: float | None = None,
    estimator: str | None = None,
    calibration: Calibration | None = None,
) -> MotorErrors:
    """Error model of `device` for torques of `asked` [N·m]; None: half of the smallest peak torque in its workspace.

    Raises InputError for a torque that is not feasible everywhere, and for a calibration, which motors do not have;
    UnknownName for another estimator.
    """
    if calibration is not None:
        raise InputError(f"device '{device.name}' is a {device.kind.title}; a calibration is for electromagnets")
    chosen = MOTOR_SOURCES_ESTIMATORS[0] if estimator is None else estimator
    if chosen not in MOTOR_SOURCES_ESTIMATORS:
        raise UnknownName(f"estimator of the error budget of '{device.name}'", chosen, MOTOR_SOURCES_ESTIMATORS)
    known = device.uncertainty

    def origin(key: str) -> str:
        return find_origin(device, known, key)

    magnets, coils, spread = len(device.magnets), len(device.electromagnets), "polarization_spread"
    built = None if device.tolerance is None else ToleranceSlopes(device)
    sources: tuple[ErrorSource[MotorTrial], ...] = (
        source("polarization of all magnets", known.polarization, "1", origin("polarization"), 1, strengthen),
        magnet_warmth("temperature of the magnets", device, known),
        source(
            "polarization from magnet to magnet", known.polarization_spread, "1", origin(spread), magnets, strengthen
        ),
        *(
            (source("torque per ampere of each coil", known.coil, "1", origin("coil"), coils, multiply("coils")),)
            if known.coil > 0
            else ()
        ),
        *_tolerance_sources(device, built),
        source("torque of the regulator", known.regulator, "1", origin("regulator"), 1, add_to("regulator")),
        source("weight of the rotor", known.weight, "1", origin("weight"), 1, add_to("weight")),
        *_pose_sources(device, chosen),
        *current_sources(device, known, known.current_offset),
    )
    most = float(motor_capability(device, 5, 20).peak.min())
    made = MotorErrors(device, choose_size(device.name, asked, most, "N·m"), sources, chosen, built)
    if device.regulator is not None:
        made.left_out = (
            "coils pull on the regulator's ring too, which the model neglects: at most "
            f"{100 * measure_ring_pull(device):.0f} % of a coil's greatest torque on the magnets"
        )
    return made


def _pose_sources(device: SphericalMotor, estimator: str) -> tuple[ErrorSource[MotorTrial], ...]:
    """Error sources of the orientation, by estimator."""
    if estimator == "tracker":
        known = device.uncertainty
        return (
            source("tracked orientation", known.axis, "rad", find_origin(device, known, "axis"), 3, add_to("turn")),
        )
    placement = device.hall.errors.placement
    origin = "assumed" if "sensors.placement" in device.assumed else "device file"
    return (
        *sensor_sources(device, device.hall, "sensors", _AVERAGED_READINGS),
        source("field sensors, position", placement, "m", origin, 3 * device.sensors, add_to("placement")),
    )


def _tolerance_sources(device: SphericalMotor, built: ToleranceSlopes | None) -> tuple[ErrorSource[MotorTrial], ...]:
    """Sources from [tolerance]: all values within √3 of their standard deviation equally likely."""
    known = device.tolerance
    if known is None or built is None:
        return ()

    def origin(key: str) -> str:
        if f"tolerance.{key}" in device.assumed:
            return "assumed"
        return "device file" if key in known.model_fields_set else "default"

    def part(name: str, key: str, unit: str, dimension: int, effect: Effect) -> ErrorSource[MotorTrial]:
        return source(name, getattr(known, key), unit, origin(key), dimension, effect, evenly=True)

    magnets, coils, turns = device.magnets.directions, device.electromagnets.directions, known.turns_per_layer
    c, layers, of_layers = len(coils), len(built.layers), "turns of each layer of the windings"
    return (
        part("positions of the coils", "position", "m", 3 * c, move_parts("coils")),
        part("axes of the coils", "tilt", "rad", 3 * c, tilt_parts("coils", coils)),
        part("edges of the windings", "winding", "m", 3 * c, add_to("parts.edges")),
        part(of_layers, "turns_per_layer", f"{turns:g} turns", c * layers, wind_layers(built.layers)),
        part("positions of the magnets", "magnet_position", "m", 3 * len(magnets), move_parts("magnets")),
        part("axes of the magnets", "magnet_tilt", "rad", 3 * len(magnets), tilt_parts("magnets", magnets)),
    )


def move_parts(name: str) -> Effect:
    """Effect that displaces the magnets or the coils."""

    def move(trial: MotorTrial, metres: Array) -> None:
        getattr(trial.parts, name)[:, :3] += metres.reshape(-1, 3)

    return move


def tilt_parts(name: str, axes: Array) -> Effect:
    """Effect that rotates the `axes` (n, 3) of the magnets or the coils about their own centres."""
    across = np.cross(np.eye(3), axes[:, None])  # (n, 3, 3) by a rotation about each axis

    def tilt(trial: MotorTrial, angles: Array) -> None:
        getattr(trial.parts, name)[:, 3:] += (angles.reshape(-1, 1, 3) @ across)[:, 0]

    return tilt


def wind_layers(nominal: Array) -> Effect:
    """Effect of more turns in each layer than the `nominal` ones (l,).

    The model fills the section evenly. Where the last layer is not full, all coils differ from it by the same amount.
    """
    uneven = nominal - nominal.mean()

    def wind(trial: MotorTrial, turns: Array) -> None:
        trial.parts.layers += uneven + turns.reshape(trial.parts.layers.shape)

    return wind
