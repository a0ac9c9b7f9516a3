"""Where the Hall tracker believes the tool to be, if magnets, coils, currents and sensors are not what it believes.

One step of the tracker's own weighted least squares, from the true pose: right to first order in the errors.
"""

from __future__ import annotations

import numpy as np

from haptorb.control.budget.sensor_errors import SensorTrial
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.numerics.arrays import Array
from haptorb.physics.sources import dipole
from haptorb.sensing.tool.tool_field import ToolModel, coil_field, moment_field, tool_field

__all__ = ["HallFit"]


class HallFit:
    """The tracker of `device` about a true pose."""

    def __init__(self, device: SphericalElectromagnet) -> None:
        self._model, self._per_ampere = ToolModel.of(device), coil_field(device)
        hall, supply = device.hall, device.supply
        sigma = float(np.hypot(max(hall.noise, 1e-7), hall.step / np.sqrt(12)))
        read = np.hypot(supply.current_noise, supply.current_step / np.sqrt(12))
        unit = (moment_field(device) @ device.moment_per_current).reshape(3 * device.sensors, -1) * read
        # What is known of the readings' errors: noise of their own, and of the currents that are subtracted.
        self._weight = np.linalg.inv(sigma**2 * np.eye(len(unit)) + unit @ unit.T)

    def linearize(self, p: Array, R: Array) -> tuple[Array, Array]:
        """(k, 3) field of the believed tool at p (3,) [m], R (3, 3) [T]; (5, 3 k) least-squares solution about it."""
        field, slopes = self._field(self._model, p, R)
        design = slopes.reshape(-1, 5)
        weighted = design.T @ self._weight
        return field, np.linalg.solve(weighted @ design, weighted)

    def _field(self, model: ToolModel, p: Array, R: Array) -> tuple[Array, Array]:
        field = np.empty((len(model.sensors), 3))
        slopes = np.empty((len(model.sensors), 3, 5))
        tool_field(model, np.ascontiguousarray(p), np.ascontiguousarray(R), field, slopes)
        return field, slopes

    def leave(self, trial: SensorTrial, p: Array, R: Array, strength: float, moment: Array, currents: Array) -> Array:
        """(3 k,) [T] the readings less what the tracker takes off for the currents.

        The tool is at p, R with `strength` times the believed remanence; the electromagnet has `moment` (3,) [A·m²] under
        the true `currents` (m,) [A].
        """
        model = self._model
        if trial.placement.any():
            model = model._replace(sensors=np.ascontiguousarray(model.sensors + trial.placement))
        field = strength * self._field(model, p, R)[0]
        field += dipole.field(np.broadcast_to(moment, model.sensors.shape), model.sensors)
        left: Array = trial.read_field(field) - self._per_ampere @ trial.read_currents(currents)
        return left.ravel()
