"""A world with memory in the tick: advance, pause, and restart."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from haptorb import worlds
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.loader import load
from haptorb.errors import InputError
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.pointer import PointerTracker
from haptorb.worlds import DynamicWorld, MemoryField
from haptorb.worlds.base import parameter

DT = 1e-3
DEVICES = {name: load(name) for name in ("omni", "pmsm")}


@dataclass(frozen=True)
class Counter(DynamicWorld):
    """Counts its steps, and fails in one of them if it is told to."""

    breaks: int = 0
    raises: bool = False
    push: float = parameter(0.0, "N", 0, 1, "upwards")

    @property
    def memory_fields(self):
        counted = MemoryField("steps", "1", "so far"), MemoryField("dt", "s", "of the last")
        return (*counted, MemoryField("bad", "m", "two places", (2,)))

    def advance(self, memory, state, dt):
        memory["steps"] += 1
        memory["dt"] = dt
        if memory["steps"][0] == self.breaks:
            if self.raises:
                raise ZeroDivisionError("division by zero")
            memory["bad"][0, 1] = np.inf
        return np.array([0.0, 0.0, self.push, 0.0, 0.0, 0.0])


class Rig:
    """A simulated device that renders `world`, a clock, and the last row."""

    def __init__(self, world, device="omni"):
        self.tick = assemble(RunConfig(device=DEVICES[device], world=world, rate=1 / DT), PointerTracker())
        self.row, self.n = self.tick.layout.empty(), 0
        self.tick.driver.open()
        self._update = self.tick.estimator.update

    def go(self, ticks=1, periods=1):
        for _ in range(ticks):
            self.tick.prepare(self.n * DT)
            self.tick.step(self.row, self.n * DT)
            self.n += periods
        return self

    def lose_pose(self, lost=True):
        self.tick.estimator.update = (lambda s: replace(self._update(s), valid=False)) if lost else self._update

    def __getitem__(self, name):
        return self.row[self.tick.layout[name]]

    @property
    def steps(self):
        return self["memory"][0]


@pytest.mark.parametrize("device", DEVICES)
def test_its_memory_is_in_the_row_and_nothing_behind_it(device):
    rig = Rig(Counter(), device).go(5)
    assert rig["memory"][:4].tolist() == [5.0, DT, 0.0, 0.0]
    assert np.isnan(rig["memory"][4:]).all()
    rig.tick.change_world(worlds.Nothing())
    assert np.isnan(rig.go()["memory"]).all()


def test_a_memory_that_is_longer_than_its_row_is_cut():
    @dataclass(frozen=True)
    class Long(Counter):
        @property
        def memory_fields(self):
            return (*super().memory_fields, MemoryField("more", "1", "numbers", (100,)))

    assert np.isfinite(Rig(Long()).go(3)["memory"]).all()


def test_it_goes_on_while_the_coils_are_off_and_through_a_stop():
    rig = Rig(Counter()).go(10)
    rig.tick.stop()
    assert rig.go(10).steps == 20
    assert rig.tick.engage()
    assert rig.go(10).steps == 30


def test_without_a_pose_it_stands_still():
    rig = Rig(Counter(push=0.1)).go(10)
    rig.lose_pose()
    assert rig.go(10).steps == 10
    assert rig["trip"][0] == Trip.POSE_LOST
    assert not rig["object_wrench"].any()
    rig.lose_pose(False)
    rig.go()
    assert rig.tick.engage()
    assert rig.go().steps == 12


def test_a_missed_tick_is_no_longer_step():
    rig = Rig(Counter()).go(5).go(3, periods=4)
    assert rig["memory"][:2].tolist() == [8.0, DT]


@pytest.mark.parametrize(("raises", "reason"), [(False, Trip.MEMORY_NOT_FINITE), (True, Trip.WORLD_FAILED)])
def test_a_memory_that_breaks_ends_in_coils_off_and_begins_anew_when_somebody_engages(raises, reason):
    rig = Rig(Counter(breaks=700, raises=raises, push=0.1)).go(699)
    assert rig["guard"][0] == GuardState.RUNNING
    rig.go()
    assert rig["trip"][0] == reason
    assert ("division by zero" if raises else "world 'counter' is no longer finite in bad") in rig.tick.error
    for _ in range(50):
        assert rig.go().steps == 700  # it is not touched any more
        assert not rig["current_commanded"].any()
        assert not rig["object_wrench"].any()
    assert rig.tick.engage()
    assert rig.go(2).steps == 2
    assert np.isfinite(rig["memory"][:4]).all()
    assert rig["guard"][0] == GuardState.RAMPING


def test_a_world_that_cannot_begin_again_stays_off():
    class Once(Counter):
        begun = 0

        def begin(self):
            Once.begun += 1
            if Once.begun > 1:
                raise OSError("its file is gone")
            return super().begin()

    rig = Rig(Once(breaks=5)).go(10)
    rig.tick.engage()
    assert rig.go(5)["guard"][0] == GuardState.TRIPPED
    assert "its file is gone" in rig.tick.error


def test_other_parameters_keep_it_and_another_world_begins_anew():
    rig = Rig(Counter()).go(10)
    rig.tick.change_world(Counter(push=0.1))
    assert rig.go().steps == 11
    rig.tick.change_world(worlds.Nothing())
    rig.go()
    rig.tick.change_world(Counter())
    assert rig.go().steps == 1


def test_its_own_rule_says_what_goes_on():
    class Half(Counter):
        def keep(self, memory, previous, old):
            memory["steps"] = old["steps"] // 2

    rig = Rig(Half()).go(10)
    rig.tick.change_world(Half(push=0.1))
    assert rig.go().steps == 6


def test_a_rule_that_leaves_what_is_not_finite_is_refused_and_the_world_stays():
    class Careless(Counter):
        def keep(self, memory, previous, old):
            memory["bad"] = np.nan

    rig = Rig(Careless()).go(10)
    with pytest.raises(InputError, match="after keep, its memory has numbers"):
        rig.tick.change_world(Careless(push=0.1))
    assert rig.go().steps == 11


def test_where_the_target_begins_anew_so_does_the_memory():
    class Other(Counter):
        @property
        def name(self):
            return "counter"

    for device, steps in (("pmsm", 1.0), ("omni", 11.0)):
        rig = Rig(Counter(), device).go(10)
        rig.tick.change_world(Other())
        assert rig.go().steps == steps


@pytest.mark.parametrize("name", ["ball", "button", "friction", "stirred_fluid"])
def test_two_runs_are_alike_to_the_bit(name):
    rows = []
    for _ in range(2):
        rig = Rig(worlds.find_world(name)())
        keep = np.ones(rig.tick.layout.width, bool)
        for clocked in ("tick", "wall", "lateness", "missed", "stages", "ahead"):
            keep[rig.tick.layout[clocked]] = False
        rows.append(np.array([rig.go().row[keep].copy() for _ in range(300)]))
    assert rows[0].tobytes() == rows[1].tobytes()


@dataclass(frozen=True)
class Spring(DynamicWorld):
    """A spring to where it was begun, that makes energy: it says that it holds more and more."""

    leak: float = 0.0
    told: bool = True

    @property
    def memory_fields(self):
        return (MemoryField("energy" if self.told else "other", "J", "held"),)

    def advance(self, memory, state, dt):
        x = state.p[0]
        memory[memory.dtype.names[0]] = 0.5 * 20.0 * x * x + self.leak * state.t
        return np.array([-20.0 * x, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(("leak", "told", "counted"), [(0.0, True, False), (2e-3, True, True), (2e-3, False, False)])
def test_energy_that_a_memory_makes_is_counted_and_damped(leak, told, counted):
    rig = Rig(Spring(leak=leak, told=told))
    injected = max(rig.go()["injected"][0] for _ in range(1500))
    assert bool(injected > 0.0) is counted


def test_a_sum_says_what_it_holds_only_if_all_parts_do():
    for world, counted in ((Spring(leak=2e-3) + Spring(), True), (Spring(leak=2e-3) + worlds.Nothing(), False)):
        rig = Rig(world)
        injected = max(rig.go()["injected"][0] for _ in range(1500))
        assert bool(injected > 0.0) is counted
