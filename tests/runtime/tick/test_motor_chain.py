"""Spherical motor in the whole chain: field, estimate, two modes, outlet, currents, torque; and failures."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.control.linkage import MOTOR_GAINS, make_linkage
from haptorb.control.registry import make_allocator
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.loader import load
from haptorb.errors import InputError, UnknownName
from haptorb.estimation.registry import check_estimator, list_estimators, make_estimator
from haptorb.estimation.types import HandGoal
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.servo import Servo
from haptorb.runtime.tick import Tick
from haptorb.simulation.hand_motion import handle_quaternion
from haptorb.simulation.motor import SimulatedMotor
from haptorb.worlds import Nothing, Outlet, SnapFit

PMSM = load("pmsm")
NOMINAL = replace(PMSM, tolerance=None)  #: a motor exactly as its file says
DT = 1e-3


class Rig:
    """A tick over a simulated motor whose hand follows `angles(t)` [rad], and every row."""

    def __init__(
        self, angles=lambda t: (0.0, 0.0, 0.0), world=None, estimator="least-squares", seed=1, device=NOMINAL, **motor
    ):
        self.motor = SimulatedMotor(device, seed, **motor)
        hand = lambda now: HandGoal(np.zeros(3), handle_quaternion(*angles(now)), now, False)  # noqa: E731
        self.driver = SimDriver(self.motor, DT, hand, seed=seed)
        self.tick = Tick(
            PMSM, world or Outlet(), self.driver, make_estimator(PMSM, estimator, None), make_allocator(PMSM), DT,
            make_linkage(PMSM),
        )  # fmt: skip
        self.row = self.tick.layout.empty()
        self.rows = []
        self.n = 0
        self.driver.open()

    def go(self, seconds):
        for _ in range(round(seconds / DT)):
            self.tick.step(self.row, self.n * DT)
            self.rows.append(self.row.copy())
            self.n += 1
        return self

    def __getitem__(self, name):
        return np.array(self.rows)[:, self.tick.layout[name]]


def hand_path(t):
    s = min(max((t - 0.6) / 1.2, 0.0), 1.0)
    return 0.02, np.radians(-18.0 + 22.0 * s * s * (3 - 2 * s)), 0.0


@pytest.fixture(scope="module")
def pull():
    return Rig(hand_path).go(2.2)


def test_a_pull_is_felt(pull):
    assert (pull["trip"] == Trip.NONE).all()
    assert pull["guard"][-1] == GuardState.RUNNING
    force, place = pull["object_wrench"][:, 0], pull["object"][:, 0]
    assert 5e-3 < place[-1] < 9e-3
    middle = (place > 2e-3) & (place < 4e-3)
    assert force[middle] == pytest.approx(-10.5, abs=1.0)  # 11.5 N less what creeping friction lacks
    assert pull["wrench_commanded"][middle, 4] == pytest.approx(force[middle] * MOTOR_GAINS.translate[0], rel=1e-2)
    assert (pull["contacts"][:, 0] > 0.7e-3).all()
    assert (pull["mode"] == 1).all()


def test_what_is_asked_is_given_within_two_per_cent(pull):
    """rms over rms, after the ramp: coils' lag, sensor noise, resistance and back-EMF all in it."""
    asked, given = pull["wrench_commanded"][500:, 3:], pull["wrench_actual"][500:, 3:]
    assert np.abs(asked).max() > 0.2
    assert np.sqrt(((asked - given) ** 2).sum() / (asked**2).sum()) < 0.02
    assert not pull["saturated"].any()


def test_a_motor_within_its_tolerances_gives_what_is_asked_within_a_few_per_cent():
    """Magnets and coils off their places, askew, of other strengths and turns: the controller knows none of it."""
    rig = Rig(hand_path, device=PMSM).go(1.5)
    asked, given = rig["wrench_commanded"][500:, 3:], rig["wrench_actual"][500:, 3:]
    error = np.sqrt(((asked - given) ** 2).sum() / (asked**2).sum())
    assert (rig["trip"] == Trip.NONE).all()
    assert 0.01 < error < 0.08
    true = Rotation.from_matrix(rig.motor.state().R_SR)
    assert 0.01 < np.degrees((Rotation.from_quat(rig["q"][-1]).inv() * true).magnitude()) < 0.3


def test_the_field_tells_the_orientation(pull):
    ours = Rotation.from_quat(pull["q"][-1])
    true = Rotation.from_matrix(pull.motor.state().R_SR)
    assert np.degrees((ours.inv() * true).magnitude()) < 0.1


def test_the_row_is_told_in_full(pull):
    left_to_the_loop = {"tick", "wall", "lateness", "missed", "buttons", "grip", "remaining", "memory", "hand_t"}
    left_to_the_loop |= {"gripper", "gripper_v", "gripper_force"}  # of a device that has one
    for field in pull.tick.layout.fields:
        assert np.isfinite(pull[field.name][-1]).all() or field.name in left_to_the_loop, field.name
    assert np.linalg.norm(pull["object_q"][-1]) == pytest.approx(1.0)


def test_the_drive_feeds_forward_what_the_turning_magnets_induce(monkeypatch):
    """Swung at 2 rad/s with nothing to feel, the induced voltage would drive currents that nobody wants."""

    def current_error(feed):
        rig = Rig(lambda t: (0.0, 0.3 * np.sin(7.0 * t), 0.0), world=Nothing())
        if not feed:  # as if the rotor stood still, as far as the drive knows
            protect = rig.tick.protection.protect_wrench

            def as_if_still(wrench, estimate, *others):
                still = replace(estimate.state, v=np.zeros(3), w=np.zeros(3))
                return protect(wrench, replace(estimate, state=still), *others)

            monkeypatch.setattr(rig.tick.protection, "protect_wrench", as_if_still)
        rig.go(0.6)
        return np.sqrt(((rig["current_measured"] - rig["current_commanded"])[350:] ** 2).mean())

    assert current_error(feed=True) < 0.4 * current_error(feed=False)


@pytest.mark.parametrize("moment", [0.9, 1.2005, 1.35])
def test_switching_in_the_middle_of_a_pull_is_no_step(moment):
    rig = Rig(hand_path).go(moment)
    rig.tick.joining.set_mode("rotate")
    rig.go(0.3)
    at = round(moment / DT)
    place, asked, wanted = rig["object"], rig["wrench_commanded"][:, 3:], rig["current_commanded"]
    speed = np.abs(np.diff(place[at - 20 : at], axis=0)).max()
    assert np.abs(np.diff(place[at - 2 : at + 30], axis=0)).max() <= 1.3 * speed + 1e-6
    steps = np.abs(np.diff(asked[at - 100 : at], axis=0)).max()
    assert np.abs(np.diff(asked[at - 2 : at + 150], axis=0)).max() <= 2.0 * steps + 5e-3
    assert np.abs(np.diff(wanted, axis=0)).max() <= PMSM.limits.slew * DT * 1.001
    assert rig["clutch_share"][-1].tolist() == [0.0, 1.0]
    assert rig["mode"][-1] == 2


def test_closed_paths_through_the_chain_give_the_hand_no_energy():
    """Round and round with the plug in its socket: the work of the delivered torque on the rotor is not positive."""

    def round_(t):
        a = 2 * np.pi * t / 1.5
        return 0.06 * np.sin(a), -0.15 + 0.06 * np.cos(a), 0.05 * np.sin(2 * a)

    rig = Rig(round_, world=Outlet()).go(4.0)
    # weight and regulator have a potential; over whole rounds they give nothing
    q = Rotation.from_quat(rig["q"][1000:])
    turned_by = (q[1:] * q[:-1].inv()).as_rotvec()
    given = rig["wrench_actual"][1000:, 3:]
    work = float((0.5 * (given[1:] + given[:-1]) * turned_by).sum())
    assert work < 0.0
    assert work < -1e-3  # and friction takes a good deal


def test_another_world_begins_anew_and_another_parameter_does_not():
    rig = Rig(hand_path).go(2.0)
    out = rig["object"][-1, 0]
    rig.tick.change_world(Outlet(friction=0.2))
    rig.go(0.01)
    assert rig["object"][-1, 0] == pytest.approx(out, abs=1e-4)
    rig.tick.change_world(SnapFit())
    rig.go(0.01)
    assert abs(rig["object"][-1, 0]) < 1e-4


# What goes wrong


def test_one_dead_sensor_is_no_trip():
    rig = Rig().go(0.5)
    rig.motor.fail([7], "dead")
    rig.go(0.3)
    assert rig["trip"][-1] == Trip.NONE


def test_all_sensors_dead_ends_in_coils_off():
    rig = Rig(hand_path).go(1.2)
    assert rig["current_measured"][-1].any()
    rig.motor.fail(range(48), "dead")
    rig.go(0.05)
    assert rig["trip"][-1] == Trip.POSE_LOST
    assert not rig["duty_applied"][-1].any()
    assert np.abs(rig["current_measured"][-1]).max() < 0.05  # what the still turning rotor drives through shorted coils
    assert not rig.tick.engage()
    rig.motor.fail(range(48), "none")
    rig.go(0.1)
    assert not rig["duty_applied"][-1].any()  # until somebody engages
    assert rig.tick.engage()
    rig.go(0.5)
    assert rig["guard"][-1] == GuardState.RUNNING


def test_a_hand_that_wants_too_much_meets_the_stop():
    rig = Rig(lambda t: (0.0, np.radians(60.0), 0.0), world=Nothing()).go(0.6)
    assert np.degrees(np.arccos(rig.motor.state().R_SR[2, 2])) < 24.0
    assert rig["trip"][-1] == Trip.NONE
    assert rig.motor.stop_deflection > 0


def test_two_runs_are_alike_to_the_bit():
    one, two = Rig(hand_path).go(0.8), Rig(hand_path).go(0.8)
    keep = np.ones(one.tick.layout.width, bool)
    keep[one.tick.layout["stages"]] = False
    keep[:5] = False
    assert np.array(one.rows)[:, keep].tobytes() == np.array(two.rows)[:, keep].tobytes()


# From names to a chain


def test_names():
    omni = load("omni")
    assert PMSM.kind.world == "outlet"
    assert PMSM.kind.modes == ("translate", "rotate")
    assert omni.kind.modes == ()
    assert next(iter(list_estimators(PMSM))) == "least-squares"
    assert check_estimator(omni, None) == "tracker"
    with pytest.raises(UnknownName, match="least-squares"):
        check_estimator(PMSM, "least-square")
    with pytest.raises(UnknownName, match="tracker"):
        check_estimator(omni, "network")
    assert assemble(RunConfig(device=PMSM, world=Outlet()), PointerTracker()).linkage.modes == PMSM.kind.modes


def test_the_servo_refuses_before_it_starts():
    servo = Servo("pmsm")
    assert servo.world[0] == "outlet"
    with pytest.raises(UnknownName, match="did you mean 'rotate'"):
        servo.set_mode("rotat")
    omni = Servo("omni")
    with pytest.raises(UnknownName, match="mode of device 'omni'"):
        omni.set_mode("rotate")
    with pytest.raises(InputError, match="no clutch"):
        omni.clutch(True)
    with pytest.raises(InputError, match="gains"):
        Servo("omni", gains=MOTOR_GAINS)
    with pytest.raises(InputError, match="tool over a sphere"):
        Servo("pmsm", "dome")


@pytest.mark.realtime
@pytest.mark.usefixtures("quick_starts")
def test_mode_and_clutch_reach_the_loop():
    with Servo("pmsm", record=False, estimator="tracker") as servo:
        servo.run(0.5)
        servo.set_mode("rotate")
        servo.clutch(False)
        servo.run(0.5)
        row, at = servo.latest(), servo.layout
        assert row[at["mode"]][0] == 2
        assert row[at["engaged"]][0] == 0
        assert row[at["clutch_share"]].tolist() == [0.0, 0.0]
        servo.clutch(True)
        servo.run(0.5)
        assert servo.latest()[at["clutch_share"]].tolist() == [0.0, 1.0]
        assert servo.report()["peak_torque_nm"] >= 0.0
