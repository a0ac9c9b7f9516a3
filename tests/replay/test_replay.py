"""Replay is bit-identical for all commands; one changed bit is found at its tick."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from haptorb import Recording, State
from haptorb.analysis.coupling import CouplingSetting
from haptorb.analysis.stability import GRIPS
from haptorb.arrays import Array
from haptorb.control.linkage import Gains
from haptorb.control.trip_reasons import Trip
from haptorb.devices.loader import load
from haptorb.errors import DriverError
from haptorb.estimation import network as network_file
from haptorb.estimation import registry
from haptorb.estimation.network import train, write_networks
from haptorb.estimation.registry import list_estimators
from haptorb.recording.row import RowLayout
from haptorb.replay.replay import Replay
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.tick import Tick, WorldBudget
from haptorb.runtime.tick_log import MODEL, TickCommand, TickFailure
from haptorb.worlds import Dome, Fluid, Friction, Nothing, RollingBall, Sum, World, find_world
from haptorb.worlds.client_force import Remote
from haptorb.worlds.dynamic import BoundWorld
from haptorb.worlds.scene import parse_scene_file
from haptorb.worlds.user_world import FunctionWorld
from oracles.recorded_chain import Deed, record_chain

OMNI = RowLayout.of(load("omni"))
CASES = [(name, estimator) for name in ("omni", "pmsm") for estimator in tuple(list_estimators(load(name)))]


@pytest.fixture
def hurried_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the motor's networks are found in this test: trained in a moment, and no good."""
    path = tmp_path / "pmsm.network"
    write_networks(train(load("pmsm"), starts=1, iterations=2, grid=(5, 5, 20)), path)
    for module in (registry, network_file):
        monkeypatch.setattr(module, "networks_path", lambda motor: path)
    return path


@pytest.mark.parametrize(("device", "estimator"), CASES)
def test_every_estimator_replays_bit_for_bit(
    device: str, estimator: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    network = request.getfixturevalue("hurried_network") if estimator == "network" else tmp_path / "none"
    recording = record_chain(tmp_path / "run.mcap", device, estimator=estimator)
    network.unlink(missing_ok=True)  # the recording has what was learned
    replay = Replay(recording)
    found = replay.run()
    assert found.identical, found.first
    assert (found.compared, found.differing) == (300, 0)
    assert found.numbers > 300 * 100
    assert replay.remarks == []


def test_the_files_that_a_device_is_based_on_are_in_the_recording(tmp_path: Path) -> None:
    base, mine = tmp_path / "base.toml", tmp_path / "mine.toml"
    base.write_text('based_on = "omni"\nname = "base"\n[tool]\nlength = "19 mm"\n', encoding="utf-8")
    mine.write_text(f'based_on = "{base}"\nname = "mine"\n[tool]\nlength = "18 mm"\n', encoding="utf-8")
    recording = record_chain(tmp_path / "run.mcap", str(mine), ticks=50)
    for file in (base, mine):
        file.unlink()
    replay = Replay(recording)
    assert replay.recorded.device.digest == recording.metadata["device"]["digest"]
    assert replay.run().identical
    assert replay.remarks == []


def _both(*deeds: Deed) -> Deed:
    """One after the other, before one tick."""

    def act(tick: Tick) -> None:
        for deed in deeds:
            deed(tick)

    return act


def _fail_once(tick: Tick, method: str) -> None:
    """The driver fails in this tick, and in no other."""
    works = getattr(tick.driver, method)

    def fail(*given: object) -> object:
        setattr(tick.driver, method, works)
        raise DriverError("pulled out")

    setattr(tick.driver, method, fail)


def _fail_engaging(tick: Tick) -> None:
    _fail_once(tick, "engage")
    assert not tick.engage()


OMNI_DEEDS: dict[int, Deed] = {
    20: lambda tick: tick.stop(),
    40: lambda tick: tick.engage(),
    60: lambda tick: tick.change_world(Dome(half_width_deg=25.0)),
    90: lambda tick: tick.change_model(1),
    120: lambda tick: tick.replace_world(Fluid(viscosity=4.0)),
    140: lambda tick: tick.cool(),
    150: _both(lambda tick: tick.change_world(RollingBall()), lambda tick: tick.exclude_next_lateness()),
    180: lambda tick: _fail_once(tick, "read"),
    190: _fail_engaging,
    195: lambda tick: tick.engage(),
    220: lambda tick: _fail_once(tick, "write"),
    230: _both(
        lambda tick: tick.stop(), lambda tick: tick.engage(), lambda tick: tick.change_world(RollingBall(mass=0.07))
    ),
}
PMSM_DEEDS: dict[int, Deed] = {
    30: lambda tick: tick.joining.set_mode("rotate"),
    60: lambda tick: tick.joining.set_clutch(False),
    90: _both(lambda tick: tick.joining.set_clutch(True), lambda tick: tick.joining.set_mode("translate")),
    120: lambda tick: tick.joining.set_torque_scale(0.37),
    150: lambda tick: tick.change_world(find_world("friction")()),
    200: lambda tick: tick.stop(),
    210: lambda tick: tick.engage(),
}


@pytest.mark.parametrize(("device", "deeds"), [("omni", OMNI_DEEDS), ("pmsm", PMSM_DEEDS)])
def test_everything_that_can_be_commanded_is_commanded_again(
    device: str, deeds: dict[int, Deed], tmp_path: Path
) -> None:
    recording = record_chain(tmp_path / "run.mcap", device, deeds=deeds, steps={100: 0.004, 205: 0.03})
    trips = set(recording["trip"][:].tolist())
    assert Trip.STOPPED in trips
    found = Replay(recording).run()
    assert found.identical, found.first


def test_commands_are_noted_in_the_tick_that_obeys() -> None:
    """The row's sum says what was told, and nothing is told twice."""
    deeds: dict[int, Deed] = {
        5: lambda tick: tick.stop(),
        7: _both(lambda tick: tick.engage(), lambda tick: tick.change_model(1)),
    }
    tick = assemble(RunConfig(device=load("omni"), world=Nothing()), PointerTracker())
    row, told = tick.layout.empty(), []
    with tick.driver:
        for number in range(10):
            if number in deeds:
                deeds[number](tick)
            tick.step(row, number * 1e-3)
            told.append(int(row[tick.layout["commands"]][0]))
    assert {n: one for n, one in enumerate(told) if one} == {5: TickCommand.STOP, 7: TickCommand.ENGAGE + 2 * MODEL}


def flip(tick: int, field: str, number: int) -> Callable[[Array], None]:
    """The lowest bit of one number is another one."""

    def change(rows: Array) -> None:
        bits = rows[tick : tick + 1, OMNI[field].start + number].view(np.uint64)
        bits ^= np.uint64(1)

    return change


@pytest.mark.parametrize(
    ("field", "number"), [("wrench_commanded", 2), ("winding", 1), ("q", 3), ("energy", 0), ("duty_commanded", 0)]
)
def test_a_planted_bit_is_found_at_its_tick(field: str, number: int, tmp_path: Path) -> None:
    found = Replay(record_chain(tmp_path / "run.mcap", change=flip(211, field, number))).run()
    assert found.first is not None
    assert (found.first.tick, found.first.field, found.first.number) == (211, field, number)
    assert 0.0 < found.first.size < 1e-9
    assert found.differing == 1
    assert [one.field for one in found.bounds] == [field]


def test_a_bit_of_what_was_read_is_found_where_it_acts(tmp_path: Path) -> None:
    """The sample is believed, as it is all there is: what was made of it in the run is not."""
    found = Replay(record_chain(tmp_path / "run.mcap", change=flip(150, "pose_p", 0))).run()
    assert found.first is not None
    assert found.first.tick == 150
    assert found.first.field == "p"


def test_worlds_with_memory_and_sums_replay(tmp_path: Path) -> None:
    ball = RollingBall(mass=0.05) + Fluid()
    found = Replay(record_chain(tmp_path / "run.mcap", world=ball)).run()
    assert found.identical, found.first


def test_gains_and_rendered_part_are_the_recorded_ones(tmp_path: Path) -> None:
    gains = Gains(translate=(0.03, 0.004, 0.01))
    found = Replay(record_chain(tmp_path / "motor.mcap", "pmsm", ticks=100, gains=gains)).run()
    assert found.identical, found.first
    found = Replay(record_chain(tmp_path / "tool.mcap", ticks=100, render="both", torque_arm=0.02)).run()
    assert found.identical, found.first


def _pull(state: State) -> Array:
    return np.append(-20.0 * (state.p - (0.0, 0.0, 0.05)), np.zeros(3))


def test_a_world_of_own_code_replays_from_its_recorded_wrench(tmp_path: Path) -> None:
    replay = Replay(record_chain(tmp_path / "run.mcap", world=FunctionWorld(_pull)))
    found = replay.run()
    assert found.identical, found.first
    (remark,) = replay.remarks
    assert "recorded wrench" in remark
    assert Path(__file__).name in remark


def test_the_recorded_wrench_of_a_world_with_memory_replays_too(tmp_path: Path) -> None:
    """Its energy counts in the passivity control: that comes from the recorded memory."""
    recording = record_chain(tmp_path / "run.mcap", world=RollingBall())
    found = Replay(recording, recorded_world=True).run()
    assert found.identical, found.first


def _explode(state: State) -> Array:
    if state.t > 0.1:
        raise ZeroDivisionError("too far")
    return _pull(state)


def test_a_world_that_failed_fails_again_without_its_code(tmp_path: Path) -> None:
    deeds: dict[int, Deed] = {160: lambda tick: tick.change_world(Dome()), 170: lambda tick: tick.engage()}
    recording = record_chain(tmp_path / "run.mcap", world=FunctionWorld(_explode), deeds=deeds)
    assert Trip.WORLD_FAILED in recording["trip"][:].tolist()
    found = Replay(recording).run()
    assert found.identical, found.first


def test_another_world_changes_what_follows_from_it_and_nothing_else(tmp_path: Path) -> None:
    replay = Replay(record_chain(tmp_path / "run.mcap"), world=Sum((Fluid(),)))
    found = replay.run()
    changed = {one.field for one in found.bounds}
    assert {"wrench_commanded", "object_wrench", "current_commanded"} <= changed
    assert not {"p", "q", "v", "w", "current_measured", "boundary", "field", "pose_p"} & changed
    assert list(replay.replaced) == ["world"]


@pytest.mark.parametrize("rate", [500.0, 2000.0, 333.0])
def test_another_rate_has_its_own_ticks_and_the_same_commands(rate: float, tmp_path: Path) -> None:
    recording = record_chain(
        tmp_path / "run.mcap", deeds={100: lambda tick: tick.stop(), 150: lambda tick: tick.engage()}
    )
    replay, rows = Replay(recording, rate=rate), []
    replay.run(keep=lambda block: rows.append(block.copy()))
    out = np.concatenate(rows)
    assert len(out) == int(0.299 * rate) + 1
    assert np.allclose(np.diff(out[:, OMNI["t"].start]), 1.0 / rate)
    assert np.array_equal(out[:, OMNI["tick"].start], np.arange(len(out)))
    tripped = out[:, OMNI["trip"].start] == Trip.STOPPED
    assert tripped.sum() == pytest.approx(0.05 * rate, abs=1.5)


def test_what_comes_out_is_a_recording_that_replays(tmp_path: Path) -> None:
    recording = record_chain(tmp_path / "run.mcap")
    replay = Replay(recording, world=Fluid(), model="published")
    with replay.write_to(tmp_path / "other.mcap") as written:
        replay.run(keep=written.append)
    again = Recording(tmp_path / "other.mcap")
    assert len(again) == len(recording)
    assert again.metadata["replay"]["world"] == "fluid"
    assert again.metadata["run"]["model"] == "published"
    found = Replay(again).run()
    assert found.identical, found.first


@pytest.mark.parametrize("local", [None, Dome()])
def test_what_a_client_commanded_is_commanded_again(local: World | None, tmp_path: Path) -> None:
    def command(force: float, age: float) -> Deed:
        def act(tick: Tick) -> None:
            tick.client["force"], tick.client["session"], tick.client["age"] = (force, 0.1, -0.2), 3.0, age

        return act

    deeds = {10: command(0.3, 0.01), 80: command(-0.4, 0.06), 140: command(np.nan, 0.0), 200: command(0.2, 0.0)}
    world = Remote() if local is None else local + Remote()
    if local is not None:
        deeds[150] = lambda tick: tick.change_world(local.replace(moment=0.7) + Remote())
        deeds[250] = lambda tick: tick.change_world(Fluid() + Remote())
    recording = record_chain(tmp_path / "run.mcap", world=world, deeds=deeds)
    replay = Replay(recording)
    found = replay.run()
    assert found.identical, found.first
    assert replay.remarks == []
    if local is None:
        return
    other = Replay(recording, world=Friction())  # in the place of the local world; the clients go on
    rows: list[Array] = []
    other.run(keep=lambda block: rows.append(block.copy()))
    memory = other.tick.world.memory_fields
    start = OMNI["memory"].start + sum(
        field.size for field in memory[: [one.name for one in memory].index("remote_force")]
    )
    assert np.concatenate(rows)[100, start : start + 3] == pytest.approx([-0.4, 0.1, -0.2])


class SlowSteps:
    """Tells a tick's budget that the world's steps take `took` [s] of each tick."""

    def __init__(self, tick: Tick, took: float) -> None:
        budget = tick.budget.budget if isinstance(tick.budget, SlowSteps) else tick.budget
        assert isinstance(budget, WorldBudget)
        self.budget, self._took = budget, took
        tick.budget = self

    def begin(self, bound: BoundWorld) -> None:
        self.budget.begin(bound)

    def end(self, bound: BoundWorld) -> TickFailure:
        found = self.budget.end(bound)  # with the background work; its steps are fast
        return found | self.budget.judge(bound, self._took)


def test_a_scene_and_the_detail_that_it_sheds_replay_bit_for_bit(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    scene = parse_scene_file("boxes").load()
    coupled = CouplingSetting(load("omni"), 1000.0, GRIPS["light"]).couple(scene)

    deeds: dict[int, Deed] = {0: lambda tick: SlowSteps(tick, 0.0), 40: lambda tick: SlowSteps(tick, 1.9e-3)}
    recording = record_chain(tmp_path / "run.mcap", "omni", coupled, ticks=400, deeds=deeds)
    (detail,) = (values for name, values in recording.memory.items() if name.endswith(".detail"))
    assert detail[:40].max() == 0.0
    assert detail[-1] == 5.0
    taken = recording["failures"].astype(int) & TickFailure.WORK
    assert np.count_nonzero(taken) > 5  # steps that a thread computed, each when it was ready
    replay = Replay(recording)
    found = replay.run()
    assert replay.remarks == []
    assert found.identical, found.first
