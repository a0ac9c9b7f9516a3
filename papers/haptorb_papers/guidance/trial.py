"""One person on one path with one kind of guidance, through the whole simulated chain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from haptorb.analysis.stability import HandGrip
from haptorb.arrays import Array
from haptorb.cli.check_world import PoseDelay
from haptorb.devices.electromagnet import Hand, SphericalElectromagnet
from haptorb.estimation.sensor_calibration import without_errors
from haptorb.runtime.assembly import allocator_of, estimator_of
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.sim import ImperfectTracker, SimDriver
from haptorb.runtime.tick import Tick
from haptorb.simulation.electromagnet import SimulatedElectromagnet
from haptorb.worlds.base import World
from haptorb.worlds.path import GuidancePath
from haptorb_papers.guidance.person import Habits, Person, place_across
from haptorb_papers.guidance.pose_noise import PoseNoise

__all__ = ["Trial", "run_trial"]

TRACKER_RATE = 240.0  #: [Hz]
LATENCY = 4e-3  #: of the tracker [s]
NOISE = 2e-5  #: of the position that it reports, rms in each direction [m]
_BEGIN = 1.0  #: the guard has ramped up, and the person is under way [s]


@dataclass(frozen=True)
class Trial:
    """What a trial gave; one row per tick from the first second on."""

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
    tick = Tick(held, world, driver, estimator_of(held, sensing, None), allocator_of(held), dt)
    row, layout = tick.layout.empty(), tick.layout
    count, first = round(duration * rate), round(_BEGIN * rate)
    places, forces = np.empty((count - first, 3)), np.empty((count - first, 3))
    heats = np.empty(count - first)
    asked, trip = layout["asked"], layout["trip"]
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
