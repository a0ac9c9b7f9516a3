"""One complete tick: rendered and actual wrench; every failure in the chain ends with coils off."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from haptorb import worlds
from haptorb.control.allocation import LeastSquaresAllocator
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import DriverError, InputError
from haptorb.estimation.types import HandGoal, TrackedPose
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.linux import TickTimeout
from haptorb.runtime.tick import Tick, render_world
from haptorb.worlds.base import World
from haptorb.worlds.user_world import FunctionWorld

OMNI = replace(load("omni"), tolerance=None)  # simulated as its file says
DT = 1e-3


def hand(position):
    """A hand that holds the tool radially at `position`."""
    state = State.at(position)
    axis = state.axis
    q = np.array([-axis[1], axis[0], 0.0, 1 + axis[2]])
    return lambda now: HandGoal(np.asarray(position, float), q / np.linalg.norm(q), now, False)


class Faulty(Driver):
    """A driver around another that fails when told to."""

    name, simulated = "faulty", True

    def __init__(self, inner):
        self.inner, self.reads, self.writes = inner, True, True
        self.pose = {}
        self.lie = lambda currents: currents  #: what its current sensors tell
        self.written = np.zeros(3)

    def open(self):
        self.inner.open()

    def close(self):
        self.inner.close()

    def prepare(self, now):
        if not self.reads:
            raise DriverError("the device did not answer")
        self.inner.prepare(now)

    def read(self, now):
        if not self.reads:
            raise DriverError("the device did not answer")
        sample = self.inner.read(now)
        return replace(sample, currents=self.lie(sample.currents), pose=replace(sample.pose, **self.pose))

    def write(self, duties):
        if not self.writes:
            raise DriverError("the device does not take orders")
        self.written = self.inner.write(duties)
        return self.written

    def wrench_actual(self):
        return self.inner.wrench_actual()

    def hand_goal(self):
        return self.inner.hand_goal()


class Rig:
    """A tick over a faulty driver, a clock that it keeps itself, and its last row."""

    def __init__(self, world=None, position=(0.0, 0.0, 0.0495), model="published", device=OMNI):
        self.driver = Faulty(SimDriver.of(device, DT, hand(position)))
        allocator = LeastSquaresAllocator.force(device.coils.current_limit, compensate_passive=True)
        self.tick = Tick(device, world or worlds.Dome(), self.driver, TrackedPose(device, model), allocator, DT)
        self.row = self.tick.layout.empty()
        self.n = 0
        self.driver.open()

    def go(self, ticks, periods=1):
        for _ in range(ticks):
            self.tick.prepare(self.n * DT)
            self.tick.step(self.row, self.n * DT)
            self.n += periods
        return self

    def __getitem__(self, name):
        return self.row[self.tick.layout[name]]

    def is_off(self):
        """Over the next ticks: nothing is applied, and the current dies away."""
        for _ in range(40):
            self.go(1)
            if self.driver.writes:
                assert not self.driver.written.any()
            assert not self["current_commanded"].any()
        return True


def test_it_engages_by_itself_once_and_ramps():
    rig = Rig().go(1)
    assert np.linalg.norm(rig["wrench_commanded"]) < 0.01
    rig.go(400)
    assert rig["guard"][0] == GuardState.RUNNING
    assert np.linalg.norm(rig["wrench_commanded"]) > 0.4


def test_the_row_is_told_in_full():
    rig = Rig(position=(0, 0, 0.040)).go(500)
    left_to_the_loop = {"tick", "wall", "lateness", "missed", "buttons", "grip", "hand_t", "gripper", "gripper_v"}
    left_to_the_loop |= {"gripper_force"}  # of a device that has one
    for field in rig.tick.layout.fields:
        assert np.isfinite(rig[field.name]).all() or field.name in left_to_the_loop | {"remaining", "memory"}
    assert np.linalg.norm(rig["q"]) == pytest.approx(1)
    assert np.linalg.norm(rig["p"]) == pytest.approx(0.05, abs=1e-3)


def test_currents_follow_what_is_wanted():
    rig = Rig().go(1500)
    assert np.abs(rig["current_measured"] - rig["current_commanded"]).max() < 0.05
    assert np.abs(rig["current_commanded"]).max() > 5


def test_another_model_takes_over_while_the_loop_runs_without_a_step_of_the_force():
    rig = Rig(position=(0, 0, 0.048), model="exact").go(1500)
    assert rig["model"][0] == 0
    force, models = [], []
    for n in range(400):
        if n == 100:
            rig.tick.change_model(OMNI.models.index("published"))
        rig.go(1)
        force.append(np.linalg.norm(rig["wrench_actual"][:3]))
        models.append(rig["model"][0])
    force, noise = np.array(force), np.abs(np.diff(force[:100])).max()
    assert models == [0.0] * 100 + [2.0] * 300
    change = force[-50:].mean() - force[:100].mean()
    assert change < -0.01
    assert np.abs(np.diff(force)).max() < 2 * noise + 3 * abs(change) / 50
    assert force.min() > force[-50:].mean() + 0.5 * change


def test_the_dipole_inverse_gives_eight_percent_too_little_and_the_core_pulls():
    """E35 and E18 in the loop: given = asked × 0.919 − 53 mN at contact, as Zárate 2020's own controller would."""
    rig = Rig(position=(0, 0, 0.040)).go(1500)  # a hand that presses the tip onto the dome with a newton
    d = float(np.linalg.norm(rig["p"]))
    assert d == pytest.approx(0.050, abs=1e-4)
    asked, given = rig["wrench_commanded"][2], rig["wrench_actual"][2]
    assert asked > 0.5
    assert given == pytest.approx(0.919 * asked - 0.053, abs=0.004)


@pytest.mark.parametrize(("distance", "pull"), [(0.050, 0.0529), (0.060, 0.0123), (0.070, 0.0037)])
def test_with_no_world_the_core_still_pulls(distance, pull):
    """E18, in the loop: the hand is held where the tool then rests at `distance`, and nothing but the core acts."""
    sag = pull / OMNI.hand.stiffness  # the hand carries the weight by itself
    rig = Rig(worlds.Nothing(), (0, 0, distance + sag)).go(4000)
    assert rig["p"][2] == pytest.approx(distance, abs=1e-4)
    assert -rig["wrench_actual"][2] == pytest.approx(pull, rel=0.03)


def test_the_stylus_yields():
    """One feels by being moved: under the dome's push the stylus gives way by force over the hand's stiffness."""
    resting = Rig(worlds.Nothing(), (0, 0, 0.052)).go(2500)["p"][2]
    pushed = Rig(worlds.Dome(), (0, 0, 0.052)).go(2500)
    lifted = pushed["p"][2] - resting
    core = Rig(worlds.Nothing(), (0, 0, 0.052)).go(2500)["wrench_actual"][2]
    assert lifted == pytest.approx((pushed["wrench_actual"][2] - core) / OMNI.hand.stiffness, rel=0.05)
    assert lifted > 2e-3


@dataclass(frozen=True)
class BrokenWorld(World):
    """A world as a user might write it."""

    what: object = None

    def wrench(self, state):
        if isinstance(self.what, BaseException):
            raise self.what
        return np.asarray(self.what, float)


@dataclass(frozen=True)
class Careless(World):
    """Returns whatever it was given."""

    what: object = None

    def wrench(self, state):
        return self.what


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        (np.full(6, np.nan), Trip.WORLD_NOT_FINITE),
        ((0, 0, np.inf, 0, 0, 0), Trip.WORLD_NOT_FINITE),
        (ZeroDivisionError("division by zero"), Trip.WORLD_FAILED),
        (SystemExit(3), Trip.WORLD_FAILED),
        (KeyboardInterrupt(), Trip.WORLD_FAILED),
        (InputError("no"), Trip.WORLD_FAILED),
        ((1, 2, 3), Trip.WORLD_FAILED),
    ],
)
def test_a_broken_world_ends_in_coils_off(what, reason):
    rig = Rig().go(500)
    assert rig["current_measured"].any()
    rig.tick.change_world(BrokenWorld(what))
    rig.go(1)
    assert rig["trip"][0] == reason
    assert rig.is_off()
    rig.tick.change_world(worlds.Dome())  # mended: still off, until somebody engages
    assert rig.is_off()
    assert rig.tick.engage()
    rig.go(400)
    assert rig["guard"][0] == GuardState.RUNNING


def test_a_world_that_leaves_is_explained():
    rig = Rig().go(10)
    rig.tick.change_world(BrokenWorld(SystemExit(3)))
    rig.go(1)
    assert rig.tick.error.splitlines()[0] == "the world called sys.exit(3)"


def test_the_line_of_a_world_that_fails_is_told():
    rig = Rig().go(10)
    rig.tick.change_world(BrokenWorld(ZeroDivisionError("division by zero")))
    rig.go(1)
    first, place, source = rig.tick.error.splitlines()
    assert first == "ZeroDivisionError: division by zero"
    assert place.startswith(f'  File "{__file__}", line ')
    assert place.endswith("in BrokenWorld.wrench")
    assert source == "    raise self.what"


@pytest.mark.parametrize("what", [None, (1.0, 2.0, 3.0), np.zeros((6, 1))])
def test_a_wrench_of_another_kind_is_told_with_the_place_of_its_function(what):
    rig = Rig().go(10)
    rig.tick.change_world(Careless(what))
    rig.go(1)
    assert rig["trip"][0] == Trip.WORLD_FAILED
    first, place, _ = rig.tick.error.splitlines()
    assert "wrench must return an array" in first
    assert place.startswith(f'  File "{__file__}", line {Careless.wrench.__code__.co_firstlineno}')


def test_a_tick_that_is_ended_from_outside_is_no_failure_of_its_world():
    rig = Rig().go(10)
    rig.tick.change_world(BrokenWorld(TickTimeout("it takes too long")))
    with pytest.raises(TickTimeout):
        rig.go(1)


def test_an_allocation_that_fails_ends_in_coils_off(monkeypatch):
    rig = Rig().go(500)

    def allocate(wrench_map, wrench):
        raise InputError("wrench and wrench map must be finite")

    with monkeypatch.context() as patch:
        patch.setattr(rig.tick.part.allocator, "allocate", allocate)
        rig.go(1)
        assert rig["trip"][0] == Trip.CURRENTS_NOT_FINITE
        assert rig.is_off()
    assert rig.is_off()
    assert rig.tick.engage()


@pytest.mark.parametrize("broken", ["reads", "writes"])
def test_a_device_that_does_not_answer_ends_in_coils_off(broken):
    rig = Rig().go(500)
    setattr(rig.driver, broken, False)
    rig.go(1)
    assert rig["trip"][0] == Trip.DRIVER_FAILED
    assert rig.is_off()
    setattr(rig.driver, broken, True)
    assert rig.is_off()
    assert rig.tick.engage()


@pytest.mark.parametrize(
    "pose",
    [
        {"valid": False},
        {"p": np.full(3, np.nan)},
        {"R_SR": np.full((3, 3), np.inf)},
        {"v": np.array([np.nan, 0, 0])},
        {"p": np.array([0, 0, 0.001])},  # inside the core: a tracker that lies
    ],
)
def test_a_pose_that_cannot_be_ends_in_coils_off(pose):
    rig = Rig().go(500)
    rig.driver.pose = pose
    rig.go(1)
    assert rig["trip"][0] == Trip.POSE_LOST
    assert rig.is_off()
    assert not rig.tick.engage()  # while it lasts
    rig.driver.pose = {}
    assert rig.is_off()
    assert rig.tick.engage()


def test_an_old_pose_fades_and_latches():
    rig = Rig().go(500)
    rig.driver.pose = {"t": rig.n * DT - 0.06}
    asked = [float(np.linalg.norm(rig.go(1)["wrench_commanded"])) for _ in range(60)]
    assert rig["trip"][0] == Trip.POSE_EXPIRED
    assert 0 < asked[20] < asked[0]
    rig.driver.pose = {}
    assert rig.is_off()


def test_stop_means_zero_current_within_milliseconds():
    rig = Rig().go(800)
    rig.tick.protection.trip(Trip.STOPPED)
    rig.go(1)
    assert not rig.driver.written.any()
    rig.go(10)  # the current dies away with L/R, well below a millisecond
    assert np.abs(rig["current_measured"]).max() < 0.05


def test_a_stop_ends_the_fading_of_an_old_pose_at_once():
    rig = Rig().go(500)
    rig.driver.pose = {"t": rig.n * DT - 0.06}
    rig.go(10)
    assert rig["trip"][0] == Trip.POSE_EXPIRED
    assert 0.0 < rig["gain"][0] < 1.0
    rig.tick.stop()
    rig.go(1)
    assert rig["gain"][0] == 0.0
    assert not rig.driver.written.any()


def test_another_world_comes_without_a_jump_of_current():
    rig = Rig().go(800)
    before = rig["current_commanded"].copy()
    rig.tick.change_world(worlds.Dome(moment=-2.4))
    for _ in range(20):
        rig.go(1)
        step = np.abs(rig["current_commanded"] - before).max()
        assert step <= OMNI.limits.slew * DT * 1.001
        before = rig["current_commanded"].copy()
    assert rig["world"][0] == 1


def push(state):
    return np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])


def pull(state):
    return np.array([-0.3, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (FunctionWorld(push), FunctionWorld(pull)),
        (worlds.Sum((FunctionWorld(push),)), worlds.Sum((FunctionWorld(pull),))),
        (FunctionWorld(push) + worlds.Remote(), FunctionWorld(pull) + worlds.Remote()),
    ],
    ids=["functions", "sums", "beside clients"],
)
def test_another_world_of_the_same_class_is_felt_when_the_force_of_this_one_is_zero(one, other):
    rig = Rig(one).go(800)
    assert rig["wrench_commanded"][0] == pytest.approx(0.3, abs=0.02)
    render_world(rig.tick, other, one)
    sizes = []
    for _ in range(150):
        sizes.append(np.abs(rig.go(1)["wrench_commanded"][:3]).max())
    assert min(sizes) < 1e-3
    gone = int(np.argmin(sizes))
    assert gone > 5  # it fades, at the rate of a change of world
    assert rig["wrench_commanded"][0] == pytest.approx(-0.3, abs=0.02)
    render_world(rig.tick, other, other)  # the same once more
    assert np.abs(rig.go(1)["wrench_commanded"][0]) > 0.2


def test_two_runs_are_alike_to_the_bit():
    one, two = Rig().go(300), Rig().go(300)
    keep = np.ones(one.tick.layout.width, bool)
    for clocked in ("stages", "ahead"):
        keep[one.tick.layout[clocked]] = False
    assert np.array_equal(one.row[keep][5:], two.row[keep][5:], equal_nan=True)


def test_every_orientation_has_its_quaternion():
    from scipy.spatial.transform import Rotation

    from haptorb.runtime.tick import fill_quaternion

    for R in Rotation.random(200, rng=3).as_matrix():
        q = np.empty(4)
        fill_quaternion(R, q)
        assert np.allclose(Rotation.from_quat(q).as_matrix(), R, atol=1e-12)
    for R in (np.eye(3), np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])):
        q = np.empty(4)
        fill_quaternion(R, q)
        assert np.allclose(Rotation.from_quat(q).as_matrix(), R)


@dataclass(frozen=True)
class Odd(World):
    """Gives the same wrench in ever other arrays, as people's own worlds may."""

    def wrench(self, state):
        plain = np.array([0.0, 0, 0.1, 0, 0, 0])
        frozen = plain.copy()
        frozen.flags.writeable = False
        kinds = (plain, frozen, np.stack([plain, plain], axis=1)[:, 0], plain.astype(np.float32), plain[::-1][::-1])
        return kinds[int(state.t / DT + 0.5) % len(kinds)]


def test_nothing_is_compiled_in_a_tick_whatever_arrays_a_world_gives():
    """A compilation would be a silence of a second."""
    from numba.core import event

    rig = Rig().go(5)  # a plain world: what the rehearsal sees
    rig.tick.change_world(Odd())
    with event.install_recorder("numba:compile") as compiled:
        rig.go(20)
    assert [entry.data for _, entry in compiled.buffer] == []
    assert rig.row[rig.tick.layout["object_wrench"]] == pytest.approx([0, 0, 0.1, 0, 0, 0], abs=1e-7)


def test_a_stop_before_the_first_pose_is_not_cleared_by_the_tracker():
    rig = Rig()
    rig.driver.pose = {"valid": False}
    rig.go(10)
    rig.tick.stop()
    rig.driver.pose = {}
    assert rig.is_off()
    assert rig["trip"][0] == Trip.STOPPED
    assert rig.tick.engage()


def test_a_device_that_failed_before_the_first_pose_comes_back_by_hand_only_and_from_zero():
    rig = Rig()
    rig.driver.reads = False
    rig.go(3)
    rig.driver.reads = True
    assert rig.is_off()
    assert rig["trip"][0] == Trip.DRIVER_FAILED
    rig.driver.reads = False
    rig.go(15)
    rig.driver.reads = True
    assert rig.tick.engage()
    rig.go(1)
    assert rig["gain"][0] < 0.01  # the ticks that it missed are no part of the ramp


def test_engaging_what_is_engaged_changes_nothing():
    rig = Rig().go(800)
    before = float(rig["gain"][0])
    assert rig.tick.engage()
    rig.go(1)
    assert rig["gain"][0] == before == 1.0


@pytest.mark.parametrize("periods", [2, 5, 12, 50])
def test_a_loop_that_misses_its_deadlines_trips_within_a_fifth_of_a_second(periods):
    rig = Rig().go(800)
    rig.go(int(0.2 / DT / periods) + 1, periods)
    assert rig["trip"][0] == Trip.OVERRUN
    assert rig.is_off()


def test_after_a_pause_of_the_computer_the_force_comes_back_from_zero():
    rig = Rig().go(800)
    rig.go(1, periods=60).go(1)
    assert rig["guard"][0] == GuardState.RAMPING
    assert rig["gain"][0] < 0.01
    assert np.abs(rig["current_commanded"]).max() < 0.5
    assert np.abs(rig["current_measured"]).max() < 0.05  # the device had switched off by itself
    rig.go(400)
    assert rig["guard"][0] == GuardState.RUNNING


def test_the_simulated_device_switches_off_after_a_silence(
    check_limit: Callable[[str, float, float, str], None],
) -> None:
    """The shortest silence after which the ramp starts again from zero."""
    for periods in range(10, 40):
        rig = Rig().go(800)
        rig.go(1, periods=periods).go(1)
        if rig["guard"][0] == GuardState.RAMPING:
            break
    check_limit("simulated device: coils off after a silence of", float(periods), 20.0, "ms")


def test_the_ramp_takes_its_time_whatever_the_ticks_take():
    quick, slow = Rig().go(150), Rig()
    for n in range(150):  # the same time, with every tenth deadline missed
        if n % 10:
            slow.go(1, periods=2 if n % 10 == 9 else 1)
    assert slow["gain"][0] == pytest.approx(quick["gain"][0], abs=0.01)


@pytest.mark.parametrize("steps", [(1,), (1, 1, 1, 1, 2), (19, *(1,) * 181), (40, *(1,) * 400)])
def test_the_windings_are_observed_by_the_clock_and_not_by_the_count_of_ticks(steps):
    heat = replace(OMNI.coils.heat, coupling=None, tolerance=0.0)  # known exactly: the observer needs no margin
    rig = Rig(world=worlds.Dome(moment=-4.0), device=replace(OMNI, coils=replace(OMNI.coils, heat=heat)))
    for number in range(4000):
        rig.go(1, steps[number % len(steps)])
    assert rig["winding"].max() > 312.0  # it was driven hard
    true = rig.driver.inner.simulation.winding
    assert np.abs(rig["winding"] - true).max() < 2.0


@pytest.mark.parametrize("lie", [lambda i: 0.0 * i, lambda i: 0.1 * i, lambda i: 10.0 * i, lambda i: i + 3.0])
def test_a_current_sensor_that_lies_trips_within_50_ms(lie):
    rig = Rig().go(500)
    assert np.abs(rig["current_measured"]).max() > 5.0
    rig.driver.lie = lie
    rig.go(50)
    assert rig["trip"][0] in (Trip.CURRENT_MISMATCH, Trip.OVERCURRENT)
    assert rig.tick.protection.tripped
