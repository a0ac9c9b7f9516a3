"""One person on one path with one kind of guidance, through the whole simulated chain."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from haptorb.analysis.stability import HandGrip
from haptorb.arrays import Array, Records
from haptorb.cli.check_world import PoseDelay
from haptorb.control.registry import make_allocator
from haptorb.devices.base import State
from haptorb.devices.electromagnet import Hand, SphericalElectromagnet
from haptorb.estimation.registry import make_estimator
from haptorb.estimation.sensor_calibration import without_errors
from haptorb.estimation.types import Pose
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.sim import ImperfectTracker, PoseDistortion, SimDriver
from haptorb.runtime.tick import Tick
from haptorb.simulation.electromagnet import SimulatedElectromagnet
from haptorb.worlds.base import World
from haptorb.worlds.dynamic import DynamicWorld, MemoryField
from haptorb.worlds.path import GuidancePath
from haptorb_papers.guidance.person import Habits, Person, place_across

__all__ = ["MovingPoint", "PoseNoise", "Trial", "run_trial"]


# --------------------------------------------------------------------------------------------------
# Noise of the positions that a tracker reports.


@final
class PoseNoise(PoseDistortion):
    """An error of the position, new in every sample: `deviation` [m] rms in each direction, drawn with `seed`."""

    def __init__(self, deviation: float, seed: int) -> None:
        self._deviation, self._seed = deviation, seed
        self.reset()

    def reset(self) -> None:
        """The same errors from the beginning."""
        self._generator = np.random.default_rng(self._seed)

    def distort(self, now: float, pose: Pose) -> Pose:
        """`pose` with a noisy position."""
        return replace(pose, p=pose.p + self._deviation * self._generator.standard_normal(3))


TRACKER_RATE = 240.0  #: [Hz]
LATENCY = 4e-3  #: of the tracker [s]
NOISE = 2e-5  #: of the position that it reports, rms in each direction [m]
_BEGIN = 1.0  #: the guard has ramped up, and the person is under way [s]


@dataclass(frozen=True)
class Trial:
    """Result of a trial; one row per tick from the first second on."""

    places: Array  #: (n, 3) true places of the tool [m]
    across: Array  #: (n,) true deviation across the path [m]
    forces: Array  #: (n, 3) force that the world asks, within the guard's limits [N]
    heats: Array  #: (n,) power that the coils turn into heat [W]
    tripped: bool  #: the guard switched off

    @property
    def error(self) -> float:
        """Mean size of the deviation [m]."""
        return float(np.abs(self.across).mean())

    @property
    def force(self) -> float:
        """Mean size of the force [N]."""
        return float(np.linalg.norm(self.forces, axis=1).mean())

    @property
    def heat(self) -> float:
        """Mean power in the coils [W]."""
        return float(self.heats.mean())


def run_trial(
    device: SphericalElectromagnet, world: World, path: GuidancePath, grip: HandGrip, habits: Habits, duration: float,
    seed: int, *, rate: float = 1000.0, sensing: str = "tracker",
) -> Trial:  # fmt: skip
    """`duration` [s] of a person with `grip` and `habits` on `path`, guided by `world` at `rate` [Hz]."""
    turn = device.hand
    held = replace(device, hand=Hand(grip.mass, grip.damping, grip.stiffness, turn.turn_damping, turn.turn_stiffness))
    held = without_errors(held)  # as a calibration leaves the field sensors; their noise stays
    dt = 1.0 / rate
    person = Person(path, grip, device.contact_distance, habits, duration, dt, seed)
    simulation = SimulatedElectromagnet(held, seed=seed)
    driver: Driver = SimDriver(simulation, dt, person.goal, seed=seed)
    if sensing == "tracker":
        driver = ImperfectTracker(driver, PoseNoise(NOISE, seed), PoseDelay(TRACKER_RATE, LATENCY))
    tick = Tick(held, world, driver, make_estimator(held, sensing, None), make_allocator(held), dt)
    row, layout = tick.layout.empty(), tick.layout
    count, first = round(duration * rate), round(_BEGIN * rate)
    places, forces = np.empty((count - first, 3)), np.empty((count - first, 3))
    heats = np.empty(count - first)
    asked, trip = layout["wrench_commanded"], layout["trip"]
    tripped = False
    with driver:
        for n in range(count):
            tick.step(row, n * dt)
            place = simulation.state().p
            person.feel(place)
            tripped = tripped or bool(row[trip][0])
            if n >= first:
                places[n - first], forces[n - first] = place, row[asked][:3]
                heats[n - first] = float((device.coils.resistance * simulation.currents**2).sum())
    return Trial(places, place_across(path, places), forces, heats, tripped)


# --------------------------------------------------------------------------------------------------
# Guidance by the clock, for comparison: a spring to a point that goes along the path at a pace of its own.


@dataclass(frozen=True)
class MovingPoint(DynamicWorld):
    """A spring of strength/width [N/m] to a point that goes to and fro on an open path, round and round on a closed
    one. Its force is at most `strength`."""

    passive: ClassVar[bool] = False
    continuous: ClassVar[bool] = False

    path: GuidancePath | None = None
    pace: float = 0.03  #: [m/s]
    strength: float = 0.35  #: [N]
    width: float = 0.003  #: [m]

    @property
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """Progress along the path."""
        return (MemoryField("gone", "m", "length gone by the clock"),)

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) pull towards the point [N], `dt` [s] later."""
        assert self.path is not None
        memory["gone"] += self.pace * dt
        gone, length = float(memory["gone"][0]), self.path.length
        arc = gone % length if self.path.closed else length - abs(gone % (2 * length) - length)
        pull = -self.strength / self.width * (state.p - self.path.find_place(arc))
        size = float(np.linalg.norm(pull))
        wrench = np.zeros(6)
        wrench[:3] = pull * min(1.0, self.strength / size) if size > 0.0 else pull
        return wrench
