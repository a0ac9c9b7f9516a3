"""Energy that a random hand extracts from a scene in the whole simulated loop, over minutes.

Not the coupling alone, but the whole loop of a hand: sensors with their noise, estimator, latency, modes, guard, coils
with their inductance, the true wrench of the magnets. The hand moves at random, and a motor's mode changes now and
then. Energy is counted between hand and mover, with the true wrench and the true motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from haptorb.analysis.coupling import DEFAULT_LATENCY_S, CouplingSetting
from haptorb.arrays import Array
from haptorb.cli.check_world import PoseDelay
from haptorb.control.linkage import MODES, make_linkage
from haptorb.control.registry import make_allocator
from haptorb.devices.base import Device, State
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.electromagnet import Hand, SphericalElectromagnet
from haptorb.estimation.registry import check_estimator, make_estimator
from haptorb.estimation.sensor_calibration import without_errors
from haptorb.estimation.types import HandGoal
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.sim import ImperfectTracker, SimDriver
from haptorb.runtime.tick import Tick
from haptorb.runtime.tick_log import TickFailure
from haptorb.simulation.registry import simulate
from haptorb.worlds.dynamic import BoundWorld
from haptorb.worlds.scene import Scene
from haptorb_papers.guidance.trial import PoseNoise

__all__ = ["SceneTrial", "find_passivity", "try_scene"]

NOISE = 2e-5  #: of the position that a tracker reports, rms in each direction [m]
TRACKER_RATE = 240.0  #: of a tracker with a process of its own [Hz]
_BEGIN = 0.8  #: the guard has ramped up, and the clutch holds [s]
_WANDER = 0.15  #: time constant of the hand's wish, twice [s]
_TILT = 0.3  #: about how far the hand of a motor turns its handle [rad]
_LIFT = 6e-3  #: how far the hand lifts a tool from the device [m]
_MODE = 5.0  #: in one mode [s]


@dataclass(frozen=True)
class SceneTrial:
    """The result of a trial; energies [J] are counted from the end of the guard's ramp.

    passivity the least of `find_passivity`: negative if the hand extracted more than was there. With the wrench that
              the guard admits, delayed as by the drive
    given     the same with the true wrench of the coils: with saturation and errors of model and drive. The drive
              compensates the induced voltage by a velocity that is late. This makes a mover feel heavier, and what
              that stores in a movement is counted as stored (`find_late_energy`)
    put_in    by the hand, from the beginning to the end, with the true wrench
    greatest  force, or torque of a motor, on the mover [N or N·m]
    injected  maximum damping that the passivity control added [N·s/m]
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
class _RandomDetail:
    """Changes a scene's detail at random, every `mean` ticks on average; 0: never.

    energy  of the scene [J]
    detail  the lowest level so far
    """

    def __init__(self, mean: float, seed: int) -> None:
        self._mean, self._rng = mean, np.random.default_rng(seed)
        self.energy, self.detail = 0.0, 0

    def begin(self, bound: BoundWorld) -> None:
        """A step that is computed in the background arrives in time, or up to some ticks late."""
        if bound.world.is_work_due(bound.memory) and self._rng.random() < 0.5:
            work = bound.world.find_work(bound.memory)
            assert work is not None
            bound.world.take_over(bound.memory, work.compute())

    def end(self, bound: BoundWorld) -> TickFailure:
        """Less detail, or more."""
        self.energy, self.detail = bound.energy, max(self.detail, int(bound.memory["detail"][0]))
        if self._mean and self._rng.random() < 1.0 / self._mean:
            change = bound.world.lighten if self._rng.random() < 0.5 else bound.world.restore
            change(bound.memory)
        return TickFailure(0)


def try_scene(
    scene: Scene, setting: CouplingSetting, seconds: float, *, seed: int = 0, change_every: float = 0.0
) -> SceneTrial:
    """Let a random hand hold the mover of `setting`'s device in `scene`, whose coupling was chosen, for `seconds` [s].

    A tool is held by the setting's hand, a handle by the hand of the device file.

    change_every: mean time between changes of the scene's detail, at random [s]; 0: full detail, regardless of the
    time that it takes.
    """
    device, dt, rng = setting.device, 1.0 / setting.rate, np.random.default_rng(seed)
    moved = isinstance(device, SphericalElectromagnet | CoilArray)
    if isinstance(device, SphericalElectromagnet | CoilArray):
        turn, grip = device.hand, setting.hand
        device = replace(
            without_errors(device) if setting.estimator == "hall" else device,  # as a calibration leaves its sensors
            hand=Hand(grip.mass, grip.damping, grip.stiffness, turn.turn_damping, turn.turn_stiffness),
        )
    wish, slow, fade = np.zeros(6), np.zeros(6), math.exp(-dt / _WANDER)
    spread = 2.0 * math.sqrt((1 + fade) / (1 - fade))  # white noise, so that the wish has a deviation of 2

    def goal(now: float) -> HandGoal:
        nonlocal wish, slow
        wish = wish + (1 - fade) * (spread * rng.standard_normal(6) - wish)
        slow = slow + (1 - fade) * (wish - slow)
        if moved:
            return HandGoal(_aim(device, np.tanh(slow[:3])), np.array([0.0, 0.0, 0.0, 1.0]), now, False)
        turned = 0.5 * _TILT * np.tanh(slow[:3])
        return HandGoal(np.zeros(3), np.append(turned, 1.0) / math.hypot(1.0, *turned), now, False)

    simulation = simulate(device, seed)
    driver: Driver = SimDriver(simulation, dt, goal, seed=seed)
    if setting.fed:
        late = DEFAULT_LATENCY_S if setting.latency is None else setting.latency
        driver = ImperfectTracker(driver, PoseNoise(NOISE, seed), PoseDelay(TRACKER_RATE, late))
    estimator = check_estimator(device, setting.estimator if moved else None)
    estimator_used = make_estimator(device, estimator, None)
    tick = Tick(device, scene, driver, estimator_used, make_allocator(device), dt, make_linkage(device))
    tick.budget = detail = _RandomDetail(change_every / dt, seed)
    row, layout = tick.layout.empty(), tick.layout
    given, asked, place = row[layout["wrench_actual"]], row[layout["wrench_commanded"]], simulation.state()
    find_work = _find_work if moved else _find_turning_work
    before, asked_before, asked_last = given.copy(), np.zeros(6), np.zeros(6)
    greatest, injected, tripped = 0.0, 0.0, False
    count, first = round(seconds * setting.rate), round(_BEGIN * setting.rate)
    works, energies, late_energies = np.zeros((2, count)), np.zeros(count), np.zeros(count)  # asked wrench, true one
    lag, resistance = 0.5 * dt + getattr(estimator_used, "lag", 0.0), tick.protection.coils["resistance"]
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
            energies[n], place = detail.energy, now
            late_energies[n] = find_late_energy(device, now, lag, resistance)
            before[:], asked_before[:], asked_last[:] = given, asked_last, asked
    put_in, stored = -np.cumsum(works, axis=1)[:, first:], energies[first:]
    return SceneTrial(
        find_passivity(put_in[0], stored), find_passivity(put_in[1], stored + late_energies[first:]),
        float(put_in[1, -1]), greatest, injected, detail.detail, tripped,
    )  # fmt: skip


def _aim(device: Device, wish: Array) -> Array:
    """(3,) target of a hand that moves a tool over the dome or the plate [m], for a `wish` (3,) within ±1."""
    if isinstance(device, CoilArray) and not device.surface.is_dome:
        on_plate: Array = device.rest_position + wish * np.array([*device.surface.half_width, _LIFT])
        return on_plate
    assert isinstance(device, SphericalElectromagnet | CoilArray)
    near = device.contact_height if isinstance(device, CoilArray) else device.contact_distance
    u = np.array([math.sin(0.6 * wish[0]), math.sin(0.6 * wish[1]), 1.0])
    on_dome: Array = (near + 0.5 * _LIFT * (1.0 + wish[2])) / np.linalg.norm(u) * u
    return on_dome


def find_passivity(put_in: Array, stored: Array) -> float:
    """The minimum, over all pairs of instants, of `stored` (n,) at the first, above its least value, plus the energy
    put in between the first and the second; put_in (n,) is the sum of the energy put in [J].

    >>> find_passivity(np.array([0.0, 2.0, 0.5]), np.array([0.0, 1.0, 0.0]))   # 2 J put in, 1 J held, 1.5 J out
    -0.5
    """
    spent = put_in - (stored - stored.min())
    return float((put_in - np.maximum.accumulate(spent)).min())


def find_late_energy(device: Device, state: State, lag: float, resistance: Array) -> float:
    """Energy that a mover in motion seems to have besides its own [J], if the drive compensates the induced voltage e
    (m,) `lag` [s] late: currents of lag · ė/R oppose the acceleration, as an inertia does. ½ lag Σ e²/R."""
    induced = device.wrench_map(state, device.models[0]).matrix.T @ np.concatenate((state.v, state.w))
    return 0.5 * lag * float((induced**2 / resistance).sum())


def _find_work(wrenches: Array, start: State, end: State) -> float:
    """Work of a force between two ticks [J]; `wrenches` (6,) is the sum of both ticks'."""
    return 0.5 * float(wrenches[:3] @ (end.p - start.p))


def _find_turning_work(wrenches: Array, start: State, end: State) -> float:
    """Work of a torque between two ticks [J], by the small turn from one attitude to the other."""
    D = end.R_SR @ start.R_SR.T
    turn = 0.5 * np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])
    return 0.5 * float(wrenches[3:] @ turn)
