"""The stability boundary by trying: a spring of growing stiffness in the whole simulated chain, pushed once.

Not a model of the loop but the loop itself: estimator, allocator, guard, drive, coils with their inductance, the
magnets' true wrench, a tool in a hand; only the tracker is made slow and late. Linear as long as no limit is reached.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi
from typing import ClassVar

import numpy as np

from haptorb.apps.check.pose_delay import PoseDelay
from haptorb.control.stability.hand_grip import HandGrip
from haptorb.devices.electromagnet.electromagnet import Hand, SphericalElectromagnet
from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.imperfect_tracker import ImperfectTracker
from haptorb.runtime.drivers.sim_driver import SimDriver
from haptorb.runtime.tick.assembly import allocator_of, estimator_of
from haptorb.runtime.tick.tick import Tick
from haptorb.runtime.trackers.tracker import Goal
from haptorb.sensing.sensors.sensing_accuracy import without_errors
from haptorb.simulation.electromagnet.electromagnet import SimulatedElectromagnet
from haptorb.worlds.world import World

__all__ = ["boundary", "is_growing"]

_ABOVE = 0.010  #: the spring's middle is so far above contact, where no dome is touched [m]
_SETTLED = 0.45  #: by then the guard has ramped up [s]
_PUSH = 0.02  #: by which the hand leans on its own spring [N]
_CYCLES = 5  #: of the oscillation, twice: the later ones are compared with the earlier
_STEP = 1e-4  #: of the simulation [s]


@dataclass(frozen=True)
class _Spring(World):
    """Draws the tool back to a plane across x: the simplest world that can oscillate."""

    passive: ClassVar[bool] = True

    stiffness: float = 0.0  #: [N/m]

    def wrench(self, state: State) -> Array:
        """(6,) [N]"""
        wrench = np.zeros(6)
        wrench[0] = -self.stiffness * state.p[0]
        return wrench


def is_growing(
    device: SphericalElectromagnet, grip: HandGrip, stiffness: float, rate: float, tracker_rate: float | None,
    latency: float, *, hall: bool = False,
) -> bool:  # fmt: skip
    """Whether an oscillation of the tool across a spring of `stiffness` [N/m] grows; `grip` is the hand alone.

    hall: the field sensors tell the pose, as a calibration leaves them and without noise (which makes the tool tremble,
    and no spring unstable).
    """
    held = replace(
        device,
        hand=Hand(grip.mass, grip.damping, grip.stiffness, device.hand.turn_damping, device.hand.turn_stiffness),
    )
    if hall:
        held = without_errors(held)
        held = replace(
            held,
            hall=replace(held.hall, noise=0.0, step=0.0),
            supply=replace(held.supply, current_noise=0.0, current_step=0.0),
        )
    middle = np.array([0.0, 0.0, device.contact_distance + _ABOVE])
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    lean = np.array([_PUSH / max(grip.stiffness, 1.0), 0.0, 0.0])
    pushed_for = 0.25 * 2 * pi * ((grip.mass + device.tool.mass) / (stiffness + grip.stiffness)) ** 0.5

    def goal(now: float) -> Goal:
        pushed = _SETTLED <= now < _SETTLED + pushed_for
        return Goal(middle + lean if pushed else middle, upright, now, False)

    dt = 1 / rate
    inner = SimDriver(SimulatedElectromagnet(held, step=_STEP), dt, goal)
    driver = inner if hall else ImperfectTracker(inner, PoseDelay(tracker_rate, latency))
    estimator = estimator_of(held, "hall" if hall else "tracker", None)
    tick = Tick(held, _Spring(stiffness), driver, estimator, allocator_of(held), dt)
    row = tick.layout.empty()
    window = _CYCLES * 4 * pushed_for
    start = _SETTLED + pushed_for + 0.25 * window
    places: list[float] = []
    with driver:
        for n in range(round((start + 2 * window) * rate)):
            tick.step(row, n * dt)
            if n * dt >= start:
                places.append(float(inner.simulation.state().p[0]))
    half = len(places) // 2
    early, late = (np.std(part) for part in (places[:half], places[half:]))
    return bool(late > early)


def boundary(
    device: SphericalElectromagnet, grip: HandGrip, expected: float, rate: float, tracker_rate: float | None = None,
    latency: float = 0.0, precision: float = 0.02, *, hall: bool = False,
) -> float:  # fmt: skip
    """The largest stiffness [N/m] whose oscillation dies away, by bisection from about `expected`."""
    low, high = 0.7 * expected, 1.4 * expected
    while is_growing(device, grip, low, rate, tracker_rate, latency, hall=hall):
        low, high = 0.5 * low, low
        if low < 1e-3 * expected:
            return 0.0
    while not is_growing(device, grip, high, rate, tracker_rate, latency, hall=hall):
        low, high = high, 2 * high
        if high > 1e3 * expected:
            return float("inf")
    while high - low > precision * high:
        middle = 0.5 * (low + high)
        if is_growing(device, grip, middle, rate, tracker_rate, latency, hall=hall):
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)
