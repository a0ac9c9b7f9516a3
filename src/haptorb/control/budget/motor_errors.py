"""The chain of a spherical motor, from the torque asked for to the torque on the rotor, with errors in it.

The true motor has other magnets, coils and currents than the device file says; the controller knows the orientation,
and how strong the magnets are, from field sensors with errors of their own. Their fit is taken as linear about the
truth: one Gauss–Newton step from there. The torque is at rest, and both sides use the table of the exact model.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from haptorb.control.allocation.for_device import torque_allocator
from haptorb.control.budget.current_errors import ChainTrial, CurrentLoop
from haptorb.control.budget.error_model import Component, ErrorModel, ErrorSource
from haptorb.control.budget.sensor_errors import SensorTrial
from haptorb.devices.motor.models import coils_field
from haptorb.devices.motor.regulator import torque_over_sine
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.devices.tables import table_kernels
from haptorb.devices.wrench_map import WrenchMap
from haptorb.numerics.arrays import Array
from haptorb.numerics.rotations import rotation_from_euler
from haptorb.numerics.so3 import turn_by

__all__ = ["MotorErrors", "MotorPoint", "MotorTrial"]

TORQUE_JND = 0.127  #: just-noticeable difference of a torque of 60 mN·m, relative
REGIONS = ("tilt below a third", "tilt of a third to two thirds", "tilt above two thirds")
COMPONENTS = (Component("about X", (0,)), Component("about Y", (1,)), Component("about Z", (2,)))


@dataclass
class MotorTrial(SensorTrial):
    """How one motor differs from its model."""

    polarization: Array  #: (p,) of each magnet, true over model
    coils: Array  #: (c,) torque per ampere and field of each coil, true over model
    regulator: float  #: its torque, true over model
    weight: float  #: torque of the rotor's weight, true over model
    turn: Array  #: (3,) rotation from the true to the tracked orientation [rad]

    def strengthen(self, factors: Array) -> None:
        """Multiply the strength of all magnets by `factors` (1,), or that of each by its own (p,)."""
        self.polarization *= factors


class MotorPoint(NamedTuple):
    """An orientation of the rotor, and the torque asked for."""

    R: Array  #: (3, 3)
    wrench: Array  #: (6,) [N, N·m]
    field: Array  #: (k, 3) of the model's magnets at the sensors [T]
    solve: Array  #: (4, 3 k) from what is left of the readings to the rotation [rad/T] and the strength [1/T]


@final
class MotorErrors(ErrorModel[MotorTrial, MotorPoint]):
    """The error budget of `device` for torques of `asked` [N·m], with `sources`.

    estimator: "least-squares" (the field sensors) or "tracker".
    """

    unit, jnd, regions, components, motion = "N·m", TORQUE_JND, REGIONS, COMPONENTS, "at rest"

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
        """A tilt in that third of the workspace's tilts, any spin; the torque in any direction."""
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
        table_kernels.sensor_field_gradient(
            pair.cells, pair.scale, device.magnets.directions, self._polarity, sensors, R.reshape(1, 3, 3), field[None],
            slopes,
        )  # fmt: skip
        design = np.column_stack([slopes.reshape(-1, 3), field.ravel()])
        return field, np.asarray(np.linalg.solve(design.T @ design, design.T), dtype=np.float64)

    def make_trial(self) -> MotorTrial:
        """The motor of the model."""
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
        # The currents follow from the orientation, and the orientation from readings with the coils' field in them,
        # which is small: the second time both agree.
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
        table_kernels.torque_characteristic(
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
        table_kernels.sensor_field(
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
        own[0] += device.weight_torque  # the regulator alone
        back = trial.regulator * torque_over_sine(float(R[2, 2]), own, least) - trial.weight * device.weight_torque
        return np.array([back * R[1, 2], -back * R[0, 2], 0.0])
