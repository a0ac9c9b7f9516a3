"""The chain of a spherical electromagnet, from the force asked for to the force on the tool, with errors in it.

The controller uses the device file and a pose; the true device has other magnets, other currents and another pose.
Both use the exact model: its own errors are 1e-7 and no part of the budget. The force is at rest: what the loop's
delay and the coils' inductance do to a force that changes is known, and not uncertain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np

from haptorb.control.allocation.for_device import force_allocator
from haptorb.control.budget.current_errors import ChainTrial, CurrentLoop
from haptorb.control.budget.error_model import Component, ErrorModel, ErrorSource
from haptorb.control.budget.hall_fit import HallFit, HallPoint, MomentFit
from haptorb.control.budget.sensor_errors import SensorTrial
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.electromagnet.passive_pull import pull
from haptorb.devices.electromagnet.remarks import FORCE_JND
from haptorb.devices.electromagnet.ring_tool import ring_per_ampere
from haptorb.devices.state import State, rotation_to_axis
from haptorb.numerics.arrays import Array
from haptorb.numerics.so3 import turn_by
from haptorb.physics.sources.charged_ring import ChargedRing

__all__ = ["ToolErrors", "ToolPoint", "ToolTrial"]

REGIONS = ("in contact", "lower half of the shell", "upper half of the shell")
COMPONENTS = (Component("radial", (2,)), Component("tangential", (0, 1)))


@dataclass
class ToolTrial(SensorTrial):
    """How one device differs from its model."""

    strength: float  #: remanence of the tool's magnet, true over model
    moments: Array  #: (3, 3) true moment per ampere [m²]
    core_radius: float  #: true minus model [m]
    shift: Array  #: (3,) of core and coils from the frame's origin [m]
    place: Array  #: (3,) estimated minus true position of the tool's magnet [m]
    turn: Array  #: (3,) rotation from the tool's true to its estimated axis [rad]
    remanent: Array  #: (3,) moment that stays in the core [A·m²]
    lag: complex  #: what eddy currents take of a moment that turns, relative
    turning: Array  #: (3,) any vector; its part across the force is the direction into which the force turns

    def strengthen(self, factors: Array) -> None:
        """Multiply the magnet's strength by `factors` (1,)."""
        self.strength *= float(factors[0])


class ToolPoint(NamedTuple):
    """A radial tool, and the force asked for."""

    p: Array  #: (3,) [m]
    R: Array  #: (3, 3); its columns are two tangents and the radius
    wrench: Array  #: (6,) [N, N·m]
    hall: HallPoint | None  #: where the field sensors tell the pose


@final
class ToolErrors(ErrorModel[ToolTrial, ToolPoint]):
    """The error budget of `device` for forces of `asked` [N], with `sources`.

    estimator          "tracker" or "hall"
    radius_span [m]    up to how far from the device file's the core's radius is looked up, less where the magnet is
                       near; 0: it is exact
    calibrated         the moments were measured with the device's own sensors, whose errors are in them
    frequency [Hz]     at which the force turns
    """

    unit, jnd, regions, components = "N", FORCE_JND, REGIONS, COMPONENTS

    def __init__(
        self,
        device: SphericalElectromagnet,
        asked: float,
        sources: tuple[ErrorSource[ToolTrial], ...],
        estimator: str,
        radius_span: float,
        *,
        calibrated: bool = False,
        frequency: float = 0.0,
    ) -> None:
        self.device, self.estimator, self.asked, self.sources = device.name, estimator, asked, sources
        self._device = device
        self._allocator, self._loop = force_allocator(device), CurrentLoop(device)
        # After a self-calibration it is known how well the sensors tell the pose.
        senses = estimator == "hall" and device.hall.correction is None
        self._hall = HallFit(device, calibrated=calibrated) if senses else None
        self._calibrated = MomentFit(device) if calibrated else None
        self.motion = f"turning at {frequency:g} Hz" if frequency else "at rest"
        tool = device.tool
        self._rows = ChargedRing(tool.outer_radius, tool.inner_radius, tool.length, tool.remanence).rows
        self._moments = np.array(device.moment_per_current, dtype=np.float64, order="C")
        self._pull = device.passive_pull
        air = self._pull.nearest - self._pull.core_radius - max(tool.length / 2, tool.outer_radius)
        self._span = max(min(radius_span, 0.3 * air, 0.5 * device.core_radius), 1e-9)
        self._tables = [self._tabulate(k * self._span) if radius_span else self._pull.table for k in (-1, 0, 1)]

    def _tabulate(self, more: float) -> Array:
        """The core's pull if its radius were `more` [m] larger than in the model."""
        known = self._pull
        return replace(known, core_radius=known.core_radius + more).table

    def draw_point(self, region: int, rng: np.random.Generator) -> ToolPoint:
        """Anywhere in the region, spread evenly over the dome; the tool is radial, the force in any direction."""
        device = self._device
        cosine = rng.uniform(np.cos(device.workspace_half_angle), 1.0)
        azimuth, height = rng.uniform(0, 2 * np.pi), rng.uniform(0.5 * region - 0.5, 0.5 * region)
        flat = np.sqrt(1 - cosine * cosine)
        axis = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), cosine])
        distance = device.contact_distance + max(height, 0.0) * device.shell_thickness
        wrench = np.zeros(6)
        direction = rng.standard_normal(3)
        wrench[:3] = self.asked * direction / np.linalg.norm(direction)
        p, R = distance * axis, rotation_to_axis(axis)
        if self._hall is None:
            return ToolPoint(p, R, wrench, None)
        state = State(0.0, R, p, np.zeros(3), np.zeros(3))
        currents = self._allocator.allocate(device.wrench_map(state, "exact"), wrench).currents
        return ToolPoint(p, R, wrench, self._hall.linearize(p, R, currents))

    def make_trial(self) -> ToolTrial:
        """The device of the model."""
        exact, k = ChainTrial.exact(self._device.channels), self._device.sensors
        return ToolTrial(
            **vars(exact), mixing=np.zeros((k, 3, 3)), reading=np.zeros((k, 3)), placement=np.zeros((k, 3)),
            strength=1.0, moments=self._moments.copy(), core_radius=0.0, shift=np.zeros(3), place=np.zeros(3),
            turn=np.zeros(3), remanent=np.zeros(3), lag=0.0, turning=np.zeros(3),
        )  # fmt: skip

    def wrench_error(self, point: ToolPoint, trial: ToolTrial) -> Array:
        """(3,) along two tangents and the radius [N]."""
        if self._calibrated is not None:
            trial.moments = self._calibrated.find_true(trial)
        place, turn = trial.place, trial.turn
        currents, extra = np.zeros(self._device.channels), np.zeros(3)
        # Currents follow from the pose, and the pose from readings with the coils' field in them: the third time all
        # agree, and the first pose of a tracker is its last.
        for _ in range(1 if point.hall is None else 3):
            if self._hall is not None and point.hall is not None:
                place, turn = self._locate(self._hall, point, trial, trial.moments @ currents + extra, currents)
            R = np.empty((3, 3))
            turn_by(float(turn[0]), float(turn[1]), float(turn[2]), point.R, R)
            believed = self._device.wrench_map(State(0.0, R, point.p + place, np.zeros(3), np.zeros(3)), "exact")
            wanted = self._allocator.allocate(believed, point.wrench).currents
            currents = self._loop.true_currents(wanted, trial)
            extra = trial.remanent - self._lag(point, trial, believed.force)
        error: Array = point.R.T @ (self._deliver(point, trial, currents, extra) - point.wrench[:3])
        return error

    def _locate(
        self, hall: HallFit, point: ToolPoint, trial: ToolTrial, moment: Array, currents: Array
    ) -> tuple[Array, Array]:
        """(3,) estimated minus true position [m], and rotation from the true to the estimated axis [rad].

        Core and coils are off their place by `trial.shift`, which the tracker does not know: for them, tool and
        sensors are off, the other way.
        """
        assert point.hall is not None
        still = np.zeros(3)
        tool = State(0.0, point.R, point.p - trial.shift, still, still)
        seen_from_core = replace(trial, placement=trial.placement - trial.shift)
        left = hall.read(seen_from_core, tool, trial.strength, moment, currents)
        fit = point.hall.solve @ (left - point.hall.field).ravel()
        return fit[:3], point.R[:, :2] @ fit[3:]

    def _lag(self, point: ToolPoint, trial: ToolTrial, force_per_ampere: Array) -> Array:
        """(3,) what is missing of the moment because the force turns, and the core is late [A·m²]."""
        if trial.lag == 0:
            return np.zeros(3)
        force = point.wrench[:3]
        across = trial.turning - force * (trial.turning @ force) / (force @ force)
        across *= self.asked / np.linalg.norm(across)
        both = np.stack([force, across], axis=1)
        moments = trial.moments @ np.linalg.solve(force_per_ampere, both)
        missing: Array = trial.lag.real * moments[:, 0] + trial.lag.imag * moments[:, 1]
        return missing

    def _deliver(self, point: ToolPoint, trial: ToolTrial, currents: Array, extra: Array) -> Array:
        """(3,) the true force [N]: of the coils and the moment `extra` (3,) [A·m²] with the magnet's strength, of the
        core with its square."""
        matrix, passive, still = np.empty((6, 3)), np.zeros(6), np.zeros(6)
        p, per_moment = point.p - trial.shift, np.eye(3)
        ring_per_ampere(self._rows, self._tables[1], self._pull.nearest, per_moment, p, point.R, matrix, passive)
        low, middle, high = self._tables
        x = trial.core_radius / self._span
        table = middle + 0.5 * x * (high - low) + 0.5 * x * x * (high - 2 * middle + low)
        pull(table, self._pull.nearest, p, np.ascontiguousarray(point.R[:, 2]), still)
        force: Array = (
            trial.strength * (matrix[:3] @ (trial.moments @ currents + extra)) + trial.strength**2 * still[:3]
        )
        return force
