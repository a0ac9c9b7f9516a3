"""A state is complete: a chain restored from it continues identically from any tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress

import numpy as np
import pytest

from haptorb.arrays import Array, StateArray
from haptorb.control.linkage import Mode
from haptorb.devices.base import Device
from haptorb.devices.loader import load
from haptorb.errors import InputError
from haptorb.estimation.registry import list_estimators
from haptorb.estimation.types import Sample
from haptorb.replay.recorded_run import PlayedDriver
from haptorb.replay.replay import CLOCK_FIELDS
from haptorb.runtime.assembly import make_tick
from haptorb.runtime.config import RunConfig
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.shared_memory import split_snapshot
from haptorb.runtime.tick import Tick
from haptorb.runtime.tick_state import TickState, load_state, save_state
from haptorb.simulation.hand_motion import guide_hand
from haptorb.worlds import RollingBall, World, find_world
from runtime.tick.memory_differences import list_differences

WINDOW = 24  #: ticks from a state to the comparison
POINTS = (
    20,
    33,
    70,
    104,
    131,
    153,
)  #: calm, between two models, lost, ramping up in another version of the world, after a pause, stopped
#: of the computer's clock, of the run before, or of the outside
NO_MEMORY = {"driver", "budget", "_failure", "_stages", "_ahead", "_device", "_motor", "_world", "world"}
FAULTS: dict[int, Callable[[SimDriver], None]] = {
    60: lambda driver: driver.simulation.fail(range(driver.simulation.device.sensors), "dead"),  # type: ignore[attr-defined]
    90: lambda driver: driver.simulation.fail(range(driver.simulation.device.sensors), "none"),  # type: ignore[attr-defined]
}


def _change_model(tick: Tick) -> None:
    with suppress(InputError):  # an estimator that has one model only
        tick.change_model(len(tick._device.models) - 1)  # of the motor's the quickest


def _join(mode: Mode, scale: float, engaged: bool) -> Callable[[Tick], None]:
    """What can be told to a motor's linkage."""

    def act(tick: Tick) -> None:
        if tick.linkage.modes:
            tick.joining.set_mode(mode)
            tick.joining.set_torque_scale(scale)
            tick.joining.set_clutch(engaged)

    return act


DEEDS: dict[int, Callable[[Tick], object]] = {
    19: _join("rotate", 0.5, True),
    32: _change_model,
    100: lambda tick: tick.engage(),
    103: lambda tick: tick.replace_world(tick.world),
    129: _join("translate", 0.8, False),
    130: lambda tick: tick.exclude_next_lateness(),
    150: lambda tick: tick.stop(),
    160: lambda tick: tick.engage(),
}
PAUSES = {130: 0.06, 140: 0.002}  #: tick → time in which nothing is read before it [s]


class InTurns(Driver):
    """Tells two sensors of `driver` in each tick, and currents that are measured at another time than the field."""

    name, simulated = "turns", True

    def __init__(self, driver: SimDriver) -> None:
        self._driver, self._ticks = driver, 0

    def open(self) -> None:
        self._driver.open()

    def close(self) -> None:
        self._driver.close()

    def read(self, now: float) -> Sample:
        whole, self._ticks = self._driver.read(now), self._ticks + 1
        field, first = np.full_like(whole.field, np.nan), 2 * self._ticks % len(whole.field)
        field[first : first + 2] = whole.field[first : first + 2]
        ages = 2e-4 + 1e-4 * (self._ticks % 7), 1e-4 * (self._ticks % 5)
        return Sample(now, whole.currents, whole.temperatures, field, whole.pose, *ages)

    def write(self, duties: Array) -> Array:
        return self._driver.write(duties)

    def wrench_actual(self) -> Array:
        return self._driver.wrench_actual()

    def hand_goal(self) -> Array:
        return self._driver.hand_goal()


def go_on(
    device: Device, world: World, estimator: str, turns: bool, rows: Array, state: Mapping[str, StateArray], first: int
) -> Tick:
    """A chain that is given the `state` after row `first`, after the ticks that follow; it fills the same rows."""
    driver = PlayedDriver(device.sensors)
    tick = make_tick(
        RunConfig(device=device, world=world, estimator=estimator, driver="i2c:1" if turns else "sim"), driver
    )
    layout = tick.layout
    driver.load({field.name: rows[:, layout[field.name]] for field in layout.fields}, rows[:, layout["t"].start].copy())
    load_state(tick, state, rows[first, layout["memory"]])
    row = layout.empty()
    compared = np.concatenate([np.r_[layout[one.name]] for one in layout.fields if one.name not in CLOCK_FIELDS])
    for number in range(first + 1, len(rows)):
        driver.select(number)
        if number in DEEDS:
            DEEDS[number](tick)
        tick.step(row, float(rows[number, layout["t"].start]))
        assert row[compared].tobytes() == rows[number, compared].tobytes(), (first, number)
    return tick


CASES = [
    *(
        (name, one, False)
        for name in ("omni", "pmsm")
        for one in tuple(list_estimators(load(name)))
        if one != "network"
    ),
    ("omni", "hall", True),
    ("omni", "memory", False),
]


@pytest.mark.parametrize(("name", "estimator", "turns"), CASES)
def test_a_state_has_all_that_a_chain_remembers(name: str, estimator: str, turns: bool) -> None:
    device, world = load(name), find_world(load(name).kind.world)()
    if estimator == "memory":
        estimator, world = "tracker", RollingBall()
    tracker = PointerTracker()
    tracker.guide = guide_hand(device)
    simulated = SimDriver.of(device, 1e-3, tracker.goal, 3)
    driver = InTurns(simulated) if turns else simulated
    tick = make_tick(
        RunConfig(device=device, world=world, estimator=estimator, driver="i2c:1" if turns else "sim"), driver
    )
    rows, states = np.full((POINTS[-1] + WINDOW + 1, tick.layout.width), np.nan), dict[int, Mapping[str, StateArray]]()
    now, invalid = 0.0, 0
    with driver:
        for number, row in enumerate(rows):
            now = now + 1e-3 + PAUSES.get(number, 0.0)
            if number in FAULTS and device.sensors:
                FAULTS[number](simulated)
            if number in DEEDS:
                DEEDS[number](tick)
            tick.step(row, now)
            invalid += row[tick.layout["valid"].start] != 1.0
            if number in POINTS:
                states[number] = save_state(tick)
            if number - WINDOW in states:
                first = number - WINDOW
                other = go_on(device, world, estimator, turns, rows[: number + 1], states[first], first)
                # What is copied for a snapshot only is copied now, of both.
                assert list_differences(save_state(tick), save_state(other)) == []
                assert list_differences(tick, other, NO_MEMORY) == []
    assert (invalid > 10) == (estimator != "tracker")


def make_older(state: Mapping[str, StateArray]) -> dict[str, StateArray]:
    """The same as recordings have it from before the passivity control softened worlds: 512 wrenches, and no more."""
    control = "tick/protection/state/passivity"
    added = ("softened", "softer", "since", "moved", "made", "spread", "poses", "taken", "touched", "smooth", "spacing")
    older = {name: array for name, array in state.items() if name not in {f"{control}/{one}" for one in added}}
    count = int(older[f"{control}/count"][0])
    for name, shape in (("times", (1, 512)), ("wrenches", (1, 512, 6))):
        ring, new = np.full(shape, 99.0), older[f"{control}/{name}"]  # what was there before is not zero
        for number in range(max(count - new.shape[1], 0), count):
            ring[0, number % 512] = new[0, number % new.shape[1]]
        older[f"{control}/{name}"] = ring
    return older


def test_a_state_of_an_older_version_goes_on_to_the_bit() -> None:
    """Where the passivity control does nothing: with its newest wrenches, of which poses that are late need many."""
    device, world = load("omni"), find_world("dome")()
    simulated = SimDriver.of(device, 1e-3, None, 3)
    tick = make_tick(RunConfig(device=device, world=world, estimator="tracker"), simulated)
    rows, states = np.full((700, tick.layout.width), np.nan), {}
    with simulated:
        for number, row in enumerate(rows):
            tick.step(row, 1e-3 * (number + 1))
            if number in (60, 650):
                states[number] = make_older(save_state(tick))
    go_on(device, world, "tracker", False, rows[:99], states[60], 60)
    go_on(device, world, "tracker", False, rows, states[650], 650)
    assert np.abs(rows[650:, tick.layout["energy"]]).max() > 0.0


@pytest.mark.parametrize(("name", "estimator", "turns"), CASES)
def test_a_snapshot_is_one_copy(name: str, estimator: str, turns: bool) -> None:
    """All that a chain remembers lies in one block, whoever owns it; 17 copies of parts took three times as long."""
    device, world = load(name), find_world(load(name).kind.world)()
    if estimator == "memory":
        estimator, world = "tracker", RollingBall()
    driver = SimDriver.of(device, 1e-3, None, 3)
    tick = make_tick(
        RunConfig(device=device, world=world, estimator=estimator, driver="i2c:1" if turns else "sim"), driver
    )
    state = TickState(tick)
    memory = np.full(state.size, 255, dtype=np.uint8)
    ((there, here),) = state.find_places(memory)
    assert len(there) == len(here) == state.size
    row = tick.layout.empty()
    with driver:
        for number in range(30):
            tick.step(row, 1e-3 * number)
    state.copy_to([(there, here)])
    arrays = split_snapshot(state.layout, memory)
    for owner, prefix in ((tick.protection, "tick/protection/duties"), (tick, "tick/rendered")):
        assert arrays[prefix].tobytes() == owner.state_arrays()[prefix.rpartition("/")[2]].tobytes()
