"""Planned guidance: the person sets the pace; the device corrects the deviation from a path with little heat."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.errors import GeometryError
from haptorb.numerics.arrays import Array, Records
from haptorb.worlds.dynamic_world import DynamicWorld
from haptorb.worlds.memory import MemoryField, make_memory
from haptorb.worlds.parameter import parameter
from haptorb.worlds.path_guidance.contouring import WORK, advance_plan
from haptorb.worlds.path_guidance.controller_state import MEMORY, SETTINGS, STEPS, weigh_plan
from haptorb.worlds.path_guidance.guidance_path import GuidancePath, make_path
from haptorb.worlds.path_guidance.path_drawing import draw_path
from haptorb.worlds.path_guidance.path_shapes import SHAPES, make_shape
from haptorb.worlds.shape import Shape

__all__ = ["PathGuidance"]


@dataclass(frozen=True)
class PathGuidance(DynamicWorld):
    """Planned guidance that keeps the tool on a path: contouring control after Langerak et al., UIST 2020.

    In every tick it estimates deviation, its rate and the hand's force across the path, predicts them over
    `horizon`, and chooses the forces with the lowest cost: Σ (deviation² + (30 ms · rate)²)/tolerance² + heat_weight ·
    power + Σ (change of force/`change`)², each force at most `strength`. The first of them is rendered. There is no
    force along the path: the person determines progress and speed. A hand at rest gets no force.

    Active: it works against the hand, so it can put energy into a hand that leaves the path.
    """

    passive: ClassVar[bool] = False
    continuous: ClassVar[bool] = False
    asks = "force"

    mode: float = parameter(1.0, "1", 0, 1, "1: guide; 0: no force, only observe and record the deviation")
    strength: float = parameter(0.5, "N", 0, 1, "maximum force across the path")
    horizon: float = parameter(0.1, "s", 0.05, 0.4, "prediction horizon")
    tolerance: float = parameter(0.0005, "m", 0.0002, 0.01, "deviation with a cost of 1 in every step of the plan")
    heat_weight: float = parameter(0.005, "1/W", 0, 1, "cost of 1 W in the coils")
    change: float = parameter(0.5, "N", 0.01, 1, "change of force from step to step with a cost of 1")
    rest_pace: float = parameter(
        0.005, "m/s", 0, 0.05, "pace at which half of the guidance is given; 0: always full guidance"
    )
    height: float = parameter(0.0, "1", 0, 1, "share of radial guidance, for paths above the dome")
    hand_mass: float = parameter(0.1, "kg", 0.05, 2, "mass of hand and tool in the prediction")
    hand_damping: float = parameter(2.0, "N·s/m", 0.2, 20, "damping of the hand in the prediction")
    observer: float = parameter(20.0, "Hz", 1, 30, "bandwidth of the estimate of the hand's force")
    shape: float = parameter(1.0, "1", 0, 3, "default path: 0 line, 1 circle, 2 square, 3 spiral")
    size_deg: float = parameter(25.0, "deg", 10, 55, "tilt from the summit to the edge of that path")
    path: GuidancePath | tuple[tuple[float, ...], ...] | None = None
    device: Device | None = None

    def __post_init__(self) -> None:
        DynamicWorld.__post_init__(self)
        if self.path is not None and not isinstance(self.path, GuidancePath):
            object.__setattr__(self, "path", make_path(self.path))

    def for_device(self, device: Device) -> PathGuidance:
        """With the path checked against the workspace of `device`, and the heat of its coils in the cost.

        Raises InputError for a device without a dome, and for a path that leaves the workspace.
        """
        path = self.path if isinstance(self.path, GuidancePath) else self._find_shape(device)
        path.check(device)
        return replace(self, path=path, device=device)

    def _find_shape(self, device: Device | None) -> GuidancePath:
        shell = None if device is None else device.shell
        name = SHAPES[round(self.shape)]
        return (
            make_shape(name, self.size_deg)
            if shell is None
            else make_shape(name, self.size_deg, shell.contact_distance)
        )

    @cached_property
    def curve(self) -> GuidancePath:
        """The path [m]."""
        return self.path if isinstance(self.path, GuidancePath) else self._find_shape(self.device)

    @property
    def bound(self) -> float:
        """[N]"""
        return self.strength if self.mode >= 0.5 else 0.0

    @cached_property
    def _settings(self) -> Records:
        """(1,) SETTINGS."""
        made = np.zeros(1, dtype=SETTINGS)
        made["strength"], made["height"], made["step"] = self.bound, self.height, self.horizon / STEPS
        made["tolerance"], made["heat"], made["change"] = self.tolerance, self.heat_weight, self.change
        made["slowest"], made["mass"], made["damping"] = self.rest_pace, self.hand_mass, self.hand_damping
        made["power"] = np.inf if self.device is None else self.device.supply.power
        made["observer"] = 2 * np.pi * self.observer
        made["lower"] = self._lower
        made["closed"], made["spacing"] = self.curve.closed, self.curve.spacing
        weigh_plan(made)
        return made

    @cached_property
    def _scratch(self) -> tuple[Array, Array, Array]:
        return np.zeros((WORK, 2 * STEPS)), np.zeros((3, 5)), np.zeros((2, 3))

    @property
    def name(self) -> str:
        """Its name in the catalogue."""
        return "path_guidance"

    @property
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """Progress, estimates of the hand, and the plan."""
        return MEMORY

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The path, and the point on it that the hand has reached."""
        return draw_path(self.curve, self._lower), Shape("progress", "sphere", (0.0015,), "place")

    @property
    def _lower(self) -> float:
        """By how much a tool's tip is nearer to the centre than its magnet, which the path is for [m]."""
        shell = None if self.device is None else self.device.shell
        return 0.0 if shell is None else shell.contact_distance - shell.dome_radius

    def begin(self) -> Records:
        """(1,) no observation yet; progress at the beginning of the path."""
        memory = make_memory(MEMORY)
        first = self.curve.places[0]
        memory["place"] = first * (1.0 - self._lower / np.linalg.norm(first))
        return memory

    def keep(self, memory: Records, previous: DynamicWorld, old: Records) -> None:
        """Keep everything, unless the path changed: then find the hand's position on it again. In the fields' units."""
        if isinstance(previous, PathGuidance) and np.array_equal(previous.curve.places, self.curve.places):
            memory[:] = old

    def wrench(self, state: State) -> Array:
        """(6,) the first force on a hand that moves along the path at `state` [N], for force maps."""
        return replace(self, rest_pace=0.0).advance(self.begin(), state, 1e-3)

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) force across the path at `state`, `dt` [s] after the previous tick [N]."""
        work, actuation, motion = self._scratch
        device = self.device
        if device is not None and device.channels == 3:
            try:
                known = device.wrench_map(state, device.models[0])
            except GeometryError:  # a place that no tool can have: heat is not weighed there
                actuation[:] = 0.0
            else:
                actuation[:, :3], actuation[:, 3] = known.force, known.passive[:3]
                actuation[:, 4] = device.greatest_resistance
        motion[0], motion[1] = state.p, state.v
        wrench = np.empty(6)
        curve = self.curve
        advance_plan(memory, self._settings, curve.places, curve.tangents, actuation, motion, dt, work, wrench)
        return wrench
