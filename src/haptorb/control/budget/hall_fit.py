"""The Hall tracker's estimate of the tool's pose, if magnets, coils, currents and sensors differ from its model.

One step of the tracker's own weighted least squares, from the true pose: right to first order in the errors.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from haptorb.control.budget.sensor_errors import SensorTrial
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.physics.sources import dipole
from haptorb.sensing.tool.tool_field import ToolModel, coil_field, moment_field, tool_field
from haptorb.sensing.tool.tool_following import CALIBRATED

__all__ = ["HallFit", "HallPoint", "MomentFit"]


class CalibratedTrial(Protocol):
    """What a calibration depends on."""

    moments: Array
    gain: Array
    placement: Array
    reading: Array

    def read_field(self, field: Array, frames: Array | None = None) -> Array:
        """What the field sensors make of a field."""


class HallPoint(NamedTuple):
    """The tracker's least squares about one true pose."""

    field: Array  #: (k, 3) of the estimated tool at the sensors [T]
    solve: (
        Array  #: (5, 3 k) from what is left of the readings to the place [m/T] and the turns about R's x and y [rad/T]
    )


class HallFit:
    """The Hall tracker of `device`; calibrated: the sensors' offsets were measured, and are taken off."""

    def __init__(self, device: SphericalElectromagnet, *, calibrated: bool = False) -> None:
        self._model, self._per_ampere = ToolModel.of(device), coil_field(device)
        hall, supply = device.hall, device.supply
        noise = np.hypot(max(hall.noise, 1e-7), hall.step / np.sqrt(12))
        self._noise = float(noise if calibrated else np.hypot(noise, hall.errors.offset))
        moments = device.moment_per_current
        self._read = (supply.current_noise**2 + supply.current_step**2 / 12) * (moments @ moments.T)
        self._read = self._read + device.core_dynamics.remanent_moment**2 * np.eye(3)
        self._columns = (moments**2).sum(axis=0)
        self._unit = moment_field(device).reshape(-1, 3)

    def linearize(self, p: Array, R: Array, currents: Array) -> HallPoint:
        """About the tool at p (3,) [m], R (3, 3); readings weighed as the tracker does under `currents` (m,) [A]."""
        field, slopes = self._field(self._model, p, R)
        moments = self._read + CALIBRATED**2 * float(self._columns @ currents**2) * np.eye(3)
        spread = self._noise**2 * np.eye(len(self._unit)) + self._unit @ moments @ self._unit.T
        design = slopes.reshape(-1, 5)
        weighted = np.linalg.solve(spread, design).T
        return HallPoint(field, np.linalg.solve(weighted @ design, weighted))

    def _field(self, model: ToolModel, p: Array, R: Array) -> tuple[Array, Array]:
        field, slopes = np.empty((len(model.sensors), 3)), np.empty((len(model.sensors), 3, 5))
        tool_field(model, np.ascontiguousarray(p), np.ascontiguousarray(R), field, slopes)
        return field, slopes

    def read(self, trial: SensorTrial, tool: State, strength: float, moment: Array, currents: Array) -> Array:
        """(k, 3) [T] the readings less what the tracker takes off for the currents.

        The magnet of `tool` has `strength` times the model's remanence; the electromagnet has `moment` (3,) [A·m²]
        under the true `currents` (m,) [A]. Core and coils are at the origin, the sensors off by their placement.
        """
        model = self._model._replace(sensors=np.ascontiguousarray(self._model.sensors + trial.placement))
        field = strength * self._field(model, tool.p, tool.R_SR)[0]
        field += dipole.field(np.broadcast_to(moment, model.sensors.shape), model.sensors)
        left: Array = trial.read_field(field) - self._per_ampere @ trial.read_currents(currents)
        return left


class MomentFit:
    """What the calibration of `device` found of the moments, by its own current and field sensors."""

    def __init__(self, device: SphericalElectromagnet) -> None:
        self._places = np.asarray(device.hall.positions, dtype=np.float64).reshape(-1, 3)
        unit = moment_field(device).reshape(-1, 3)
        self._solve = np.linalg.solve(unit.T @ unit, unit.T)

    def find_true(self, trial: CalibratedTrial) -> Array:
        """(3, m) [m²] the moments per true ampere that sensors with the errors of `trial` took for its moments."""
        at = self._places + trial.placement
        fields = [trial.read_field(dipole.field(np.broadcast_to(axis, at.shape), at)) for axis in np.eye(3)]
        read = np.stack([field - trial.reading for field in fields], axis=2).reshape(-1, 3)
        moments: Array = np.linalg.solve(self._solve @ read, trial.moments) * (1 + trial.gain)
        return moments
