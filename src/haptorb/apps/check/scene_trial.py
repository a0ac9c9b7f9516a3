"""What a random hand gets out of a scene in the whole simulated loop, over minutes.

Not the coupling alone but what a hand meets: sensors with their noise, estimator, latency, modes, guard, coils with
their inductance, the true wrench of the magnets. The hand wanders at random, and a motor's mode changes now and then.
Energy is counted where hand and mover meet, with the true wrench and the true motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from haptorb.apps.check.late_tracker import LateTracker
from haptorb.apps.check.noisy_tracker import NoisyTracker
from haptorb.control.clutch.modes import MODES
from haptorb.control.stability.coupling_choice import ASSUMED, CouplingSetting
from haptorb.control.stability.held_mover import hold_mover
from haptorb.devices.coil_array.coil_array import CoilArray
from haptorb.devices.electromagnet.electromagnet import Hand, SphericalElectromagnet
from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.driver import Driver
from haptorb.runtime.drivers.sim_driver import SimDriver
from haptorb.runtime.tick.assembly import allocator_of, check_estimator, estimator_of, linkage_of
from haptorb.runtime.tick.tick import Tick
from haptorb.runtime.tick.tick_log import TickFailure
from haptorb.runtime.trackers.tracker import Goal
from haptorb.sensing.sensors.sensing_accuracy import without_errors
from haptorb.simulation.registry import simulate
from haptorb.worlds.bound_world import BoundWorld
from haptorb.worlds.scene.scene import Scene

__all__ = ["SceneTrial", "find_passivity", "try_scene"]

NOISE = 2e-5  #: of the place that a tracker tells, rms in each direction [m]
TRACKER_RATE = 240.0  #: of a tracker with a process of its own [Hz]
_BEGIN = 0.8  #: the guard has ramped up, and the clutch holds [s]
_WANDER = 0.15  #: time constant of the hand's wish, twice [s]
_TILT = 0.3  #: about as far the hand of a motor turns its handle [rad]
_MODE = 5.0  #: in one mode [s]


@dataclass(frozen=True)
class SceneTrial:
    """What came out of a trial; energies [J] are counted from when the guard has ramped up.

    passivity the least, over all pairs of moments, of what scene and coupling held at the first, above the least that
              they ever held, and what the hand put in until the second: negative if it got out more than was there.
              With the wrench that the guard lets through, as late as the drive makes it
    given     the same with the true wrench of the coils: with saturation, errors of the model, and the drive, which
              makes a rotor that is turned to and fro fast feel heavier
    put_in    by the hand, from the beginning to the end, with the true wrench
    greatest  force, or torque of a motor, on the mover [N or N·m]
    injected  most damping that the passivity control added [N·s/m]
    detail    the lowest level of detail, as a number above 0
    tripped   the guard switched off
    """

    passivity: float
    given: float
    put_in: float
    greatest: float
    injected: float
    detail: int
    tripped: bool


@final
class _Shedding:
    """Changes a scene's detail at random, every `mean` ticks or so; 0: never.

    energy  that the scene holds [J]
    detail  the lowest level so far
    """

    def __init__(self, mean: float, seed: int) -> None:
        self._mean, self._rng = mean, np.random.default_rng(seed)
        self.energy, self.detail = 0.0, 0

    def begin(self) -> None:
        """Time does not matter."""

    def end(self, bound: BoundWorld) -> TickFailure:
        """Less detail, or more."""
        self.energy, self.detail = bound.energy, max(self.detail, int(bound.memory["detail"][0]))
        if self._mean and self._rng.random() < 1.0 / self._mean:
            change = bound.world.lighten if self._rng.random() < 0.5 else bound.world.restore
            change(bound.memory)
        return TickFailure(0)


def try_scene(
    scene: Scene, setting: CouplingSetting, seconds: float, *, seed: int = 0, shed_every: float = 0.0
) -> SceneTrial:
    """Let a random hand hold the mover of `setting`'s device in `scene`, whose coupling was chosen, for `seconds` [s].

    A tool is held by the setting's hand, a handle by that of the device file.

    shed_every: mean time between changes of the scene's detail, at random [s]; 0: it has all of it, whatever time that
    takes. Raises DeviceError for a device that cannot be simulated, InputError for one that has neither tool nor rotor.
    """
    device, dt, rng = setting.device, 1.0 / setting.rate, np.random.default_rng(seed)
    held = hold_mover(device, setting.hand)
    moved = held.is_tool
    if isinstance(device, SphericalElectromagnet | CoilArray):
        turn, grip = device.hand, setting.hand
        device = replace(
            without_errors(device) if setting.estimator == "hall" else device,  # as a calibration leaves its sensors
            hand=Hand(grip.mass, grip.damping, grip.stiffness, turn.turn_damping, turn.turn_stiffness),
        )
    wish, slow, fade = np.zeros(6), np.zeros(6), math.exp(-dt / _WANDER)
    spread = 2.0 * math.sqrt((1 + fade) / (1 - fade))  # white noise, so that the wish has a deviation of 2

    def goal(now: float) -> Goal:
        nonlocal wish, slow
        wish = wish + (1 - fade) * (spread * rng.standard_normal(6) - wish)
        slow = slow + (1 - fade) * (wish - slow)
        if moved:
            middle = held.aim(slow[:3]) if held.radii[1] else device.rest_position + held.aim(slow[:3])
            return Goal(middle, np.array([0.0, 0.0, 0.0, 1.0]), now, False)
        turned = 0.5 * _TILT * np.tanh(slow[:3])
        return Goal(np.zeros(3), np.append(turned, 1.0) / math.hypot(1.0, *turned), now, False)

    simulation = simulate(device, seed)
    driver: Driver = SimDriver(simulation, dt, goal, seed=seed)
    if setting.fed:
        late = ASSUMED if setting.latency is None else setting.latency
        driver = LateTracker(NoisyTracker(driver, NOISE, seed), TRACKER_RATE, late)
    estimator = check_estimator(device, setting.estimator if moved else None)
    tick = Tick(
        device, scene, driver, estimator_of(device, estimator, None), allocator_of(device), dt, linkage_of(device)
    )
    tick.budget = shedding = _Shedding(shed_every / dt, seed)
    row, layout = tick.layout.empty(), tick.layout
    given, asked, place = row[layout["given"]], row[layout["asked"]], simulation.state()
    find_work = _find_work if moved else _find_turning_work
    before, asked_before, asked_last = given.copy(), np.zeros(6), np.zeros(6)
    greatest, injected, tripped = 0.0, 0.0, False
    count, first = round(seconds * setting.rate), round(_BEGIN * setting.rate)
    works, energies = np.zeros((2, count)), np.zeros(count)  # with the asked wrench, and with the true one
    with driver:
        for n in range(count):
            if not moved and n % round(_MODE / dt) == round(_MODE / dt) - 1:
                tick.joining.set_mode(MODES[(n // round(_MODE / dt) + 1) % len(MODES)])
            tick.step(row, n * dt)
            now = simulation.state()
            if n >= first:
                # In a tick the drive brings the currents from what was asked before to what is asked now.
                works[0, n] = find_work(asked_before + asked_last, place, now)
                works[1, n] = find_work(before + given, place, now)
                greatest = max(greatest, float(np.linalg.norm(given[:3] if moved else given[3:])))
                injected = max(injected, float(row[layout["injected"]][0]))
                tripped = tripped or bool(row[layout["trip"]][0])
            energies[n], place = shedding.energy, now
            before[:], asked_before[:], asked_last[:] = given, asked_last, asked
    put_in, held_energy = -np.cumsum(works, axis=1)[:, first:], energies[first:]
    return SceneTrial(
        find_passivity(put_in[0], held_energy), find_passivity(put_in[1], held_energy), float(put_in[1, -1]), greatest,
        injected, shedding.detail, tripped,
    )  # fmt: skip


def find_passivity(put_in: Array, stored: Array) -> float:
    """The least, over all pairs of moments, of `stored` (n,) at the first, above its least, and of what was put in from
    then to the second; put_in (n,) is its sum [J].

    >>> find_passivity(np.array([0.0, 2.0, 0.5]), np.array([0.0, 1.0, 0.0]))   # 2 J put in, 1 J held, 1.5 J out
    -0.5
    """
    spent = put_in - (stored - stored.min())
    return float((put_in - np.maximum.accumulate(spent)).min())


def _find_work(wrenches: Array, start: State, end: State) -> float:
    """Work of a force between two ticks [J]; `wrenches` (6,) is the sum of both ticks'."""
    return 0.5 * float(wrenches[:3] @ (end.p - start.p))


def _find_turning_work(wrenches: Array, start: State, end: State) -> float:
    """Work of a torque between two ticks [J], by the small turn from one attitude to the other."""
    D = end.R_SR @ start.R_SR.T
    turn = 0.5 * np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])
    return 0.5 * float(wrenches[3:] @ turn)
