"""A kind of device unknown to haptorb: two coils, and between them a magnet on a rail along x.

Nothing of it is in `src`. The magnet's moment m lies along x, so coil c pulls with F = m dB/dx per ampere, B being the
field of a ring of wire on its own axis. This is what the how-to "Add a device" adds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from haptorb import Device, Pose, Sample, Simulation, State, WrenchMap
from haptorb.devices import (
    Damping,
    DeviceFile,
    DeviceKind,
    Force,
    Length,
    Mass,
    Number,
    Positive,
    Section,
    Stiffness,
)
from haptorb.kinds import Allocator, LeastSquaresAllocator, describe_scene, make_allocator, simulate

MU0 = 4e-7 * np.pi
STEP = 5e-4  #: of the simulation [s]


@dataclass(frozen=True, kw_only=True)
class Rail(Device):
    """Two coils at ±distance on the x axis, a magnet that slides between them, and the hand that holds it."""

    kind: ClassVar[DeviceKind]  # below

    distance: float  #: of each coil from the middle [m]
    radius: float  #: of the coils [m]
    turns: float
    moment: float  #: of the magnet, along x [A·m²]
    travel: float  #: greatest |x| [m]
    mass: float  #: of magnet and hand [kg]
    friction: float  #: dry [N]
    hand_stiffness: float  #: [N/m]
    hand_damping: float  #: [N·s/m]
    models: tuple[str, ...] = ("ring",)

    def per_ampere(self, x: float) -> np.ndarray:
        """(2,) force along x per ampere in each coil, with the magnet at `x` [m]."""
        away = x - np.array([-self.distance, self.distance])
        slope = -1.5 * MU0 * self.turns * self.radius**2 * away / (self.radius**2 + away**2) ** 2.5
        return self.moment * slope

    def wrench_map(self, state: State, model: str) -> WrenchMap:
        self.check_model(model)
        matrix = np.zeros((6, 2))
        matrix[0] = self.per_ampere(float(state.p[0]))
        return WrenchMap(matrix, np.zeros(6))


@simulate.register(Rail)
class RailSimulation(Simulation):
    """Currents behind resistance and inductance; a mass with friction on the hand's spring."""

    def __init__(self, device: Rail, seed: int = 0) -> None:
        self.device: Rail = device
        self.reset(seed)

    def reset(self, seed: int = 0) -> None:
        self._rng = np.random.default_rng(seed)
        self._i, self._x, self._v, self._t = np.zeros(2), 0.0, 0.0, 0.0
        self._truth = np.zeros(6)

    def place(self, p: Any, q: Any) -> None:
        self._x, self._v = float(np.clip(p[0], -self.device.travel, self.device.travel)), 0.0

    def advance(self, dt: float, duties: Any, goal_p: Any, goal_q: Any) -> None:
        rail, coils = self.device, self.device.coils
        steps = max(round(dt / STEP), 1)
        h, given = dt / steps, 0.0
        rate = coils.resistance / coils.inductance
        for _ in range(steps):
            k = rail.per_ampere(self._x)
            settled = (duties * rail.supply.voltage - k * self._v) / coils.resistance  # what moves, induces
            self._i = settled + (self._i - settled) * np.exp(-rate * h)
            force = float(k @ self._i)
            hand = rail.hand_stiffness * (goal_p[0] - self._x) - rail.hand_damping * self._v
            drag = rail.friction * np.tanh(self._v / 1e-3)
            self._v += (force + hand - drag) / rail.mass * h
            self._x += self._v * h
            if abs(self._x) > rail.travel:  # the rail ends
                self._x, self._v = float(np.copysign(rail.travel, self._x)), 0.0
            given += force / steps
        self._t += dt
        self._truth = np.array([given, 0, 0, 0, 0, 0])

    def sample(self, t: float, pose_stamp: float, pose_valid: bool) -> Sample:
        rail, state = self.device, self.state()
        read = self._i + rail.supply.current_noise * self._rng.standard_normal(2)
        pose = Pose(pose_stamp, state.R_SR, state.p, state.w, state.v, pose_valid)
        return Sample(t, read, np.full(2, rail.coils.heat.ambient), np.zeros((0, 3)), pose)

    def wrench_actual(self) -> Any:
        return self._truth.copy()

    def state(self) -> State:
        x, v = np.array([self._x, 0.0, 0.0]), np.array([self._v, 0.0, 0.0])
        return State(self._t, np.eye(3), x, np.zeros(3), v)

    def quantise(self, duties: Any) -> Any:
        steps = 2**self.device.supply.duty_bits
        return np.round(np.clip(np.nan_to_num(duties), -1, 1) * steps) / steps


@make_allocator.register(Rail)
def allocate_along_rail(device: Rail) -> Allocator:
    """Least squares over the force along x alone: the rail carries the others."""
    return LeastSquaresAllocator(device.coils.current_limit, weights=(1, 0, 0, 0, 0, 0))


@describe_scene.register(Rail)
def describe_rail(device: Rail) -> dict[str, Any]:
    """For the console: a scene that its page does not know, so it draws axes and a marker."""
    return {"kind": "rail", "rest": [0.0, 0.0, 0.0], "travel": device.travel}


class RailSection(Section):
    """[rail]"""

    distance: Annotated[Length, Positive]
    radius: Annotated[Length, Positive]
    turns: Annotated[Number, Positive]
    moment: Annotated[Number, Positive]
    travel: Annotated[Length, Positive]
    mass: Annotated[Mass, Positive]
    friction: Annotated[Force, Positive]
    hand_stiffness: Annotated[Stiffness, Positive]
    hand_damping: Annotated[Damping, Positive]


class RailFile(DeviceFile):
    """A file of kind "rail"."""

    kind: Literal["rail"]
    rail: RailSection

    def build(self, assumed: dict[str, str], digest: str, *, override: bool = False) -> Rail:
        return Rail(**self.common(), **self.rail.model_dump(), assumed=assumed, digest=digest)


RAIL = DeviceKind(name="rail", title="magnet on a rail", world="wall", file=RailFile)
Rail.kind = RAIL
