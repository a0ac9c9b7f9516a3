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
from haptorb.arrays import Array
from haptorb.control.allocation import torque_allocator
from haptorb.control.capability import motor_capability
from haptorb.devices import tables
from haptorb.devices.base import WrenchMap
from haptorb.devices.motor import SphericalMotor, measure_ring_pull
from haptorb.devices.motor_model import coils_field, torque_over_sine
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
# exact model.


TORQUE_JND = 0.127  #: just-noticeable difference of a torque of 60 mN·m, relative
MOTOR_ERRORS_REGIONS = ("tilt below a third", "tilt of a third to two thirds", "tilt above two thirds")
MOTOR_ERRORS_COMPONENTS = (Component("about X", (0,)), Component("about Y", (1,)), Component("about Z", (2,)))


@dataclass
class MotorTrial(SensorTrial):
    """Deviations of one motor from its model."""

    polarization: Array  #: (p,) of each magnet, true over model
    coils: Array  #: (c,) torque per ampere and field of each coil, true over model
    regulator: float  #: its torque, true over model
    weight: float  #: torque of the rotor's weight, true over model
    turn: Array  #: (3,) rotation from the true to the tracked orientation [rad]

    def strengthen(self, factors: Array) -> None:
        """Multiply the strength of all magnets by `factors` (1,), or that of each by its own (p,)."""
        self.polarization *= factors


class MotorPoint(NamedTuple):
    """Orientation of the rotor, and the commanded torque."""

    R: Array  #: (3, 3)
    wrench: Array  #: (6,) [N, N·m]
    field: Array  #: (k, 3) of the model's magnets at the sensors [T]
    solve: Array  #: (4, 3 k) from the residuals of the readings to the rotation [rad/T] and the strength [1/T]


@final
class MotorErrors(ErrorModel[MotorTrial, MotorPoint]):
    """Error model of `device` for commanded torques of `asked` [N·m], with `sources`.

    estimator: "least-squares" (the field sensors) or "tracker".
    """

    unit, jnd, regions, components, motion = "N·m", TORQUE_JND, MOTOR_ERRORS_REGIONS, MOTOR_ERRORS_COMPONENTS, "at rest"

    def __init__(
        self, device: SphericalMotor, asked: float, sources: tuple[ErrorSource[MotorTrial], ...], estimator: str
    ) -> None:
        self.device, self.estimator, self.asked, self.sources = device.name, estimator, asked, sources
        self._device, self._senses = device, estimator != "tracker"
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
        return MotorPoint(R, wrench, field, solve)

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
        )  # fmt: skip

    def wrench_error(self, point: MotorPoint, trial: MotorTrial) -> Array:
        """(3,) about the stator's axes [N·m]."""
        device, R = self._device, np.empty((3, 3))
        turn, strength, currents = trial.turn, 1.0, np.zeros(device.channels)
        believed = point.R
        # The currents depend on the orientation, and the orientation on readings that include the coils' field, which
        # is small: two iterations suffice.
        for _ in range(2 if self._senses else 1):
            if self._senses:
                turn, strength = self._fit_readings(point, trial, currents)
            turn_by(float(turn[0]), float(turn[1]), float(turn[2]), point.R, R)
            believed = R
            matrix = np.zeros((6, device.channels))
            matrix[3:] = strength * self._torque(believed, self._polarity) @ device.groups
            wanted = self._allocator.allocate(WrenchMap(matrix, device.passive(believed)), point.wrench).currents
            currents = self._loop.true_currents(wanted, trial)
        torque = self._torque(point.R, self._polarity * trial.polarization) @ (trial.coils * (device.groups @ currents))
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
        """(3,) rotation from the true to the estimated orientation [rad], and the estimated strength of the magnets."""
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
_MOTOR_SOURCES_AVERAGED = 2.4


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
    sources: tuple[ErrorSource[MotorTrial], ...] = (
        source("polarization of all magnets", known.polarization, "1", origin("polarization"), 1, strengthen),
        magnet_warmth("temperature of the magnets", device, known),
        source(
            "polarization from magnet to magnet", known.polarization_spread, "1", origin(spread), magnets, strengthen
        ),
        source("torque per ampere of each coil", known.coil, "1", origin("coil"), coils, multiply("coils")),
        source("torque of the regulator", known.regulator, "1", origin("regulator"), 1, add_to("regulator")),
        source("weight of the rotor", known.weight, "1", origin("weight"), 1, add_to("weight")),
        *_motor_sources_pose_sources(device, chosen),
        *current_sources(device, known, known.current_offset),
    )
    most = float(motor_capability(device, 5, 20).peak.min())
    made = MotorErrors(device, choose_size(device.name, asked, most, "N·m"), sources, chosen)
    if device.regulator is not None:
        made.left_out = (
            "coils pull on the regulator's ring too, which the model neglects: at most "
            f"{100 * measure_ring_pull(device):.0f} % of a coil's greatest torque on the magnets"
        )
    return made


def _motor_sources_pose_sources(device: SphericalMotor, estimator: str) -> tuple[ErrorSource[MotorTrial], ...]:
    """Error sources of the orientation, by estimator."""
    if estimator == "tracker":
        known = device.uncertainty
        return (
            source("tracked orientation", known.axis, "rad", find_origin(device, known, "axis"), 3, add_to("turn")),
        )
    return sensor_sources(device, device.hall, "sensors", _MOTOR_SOURCES_AVERAGED)
