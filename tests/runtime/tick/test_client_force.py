"""A client's force through the whole chain: its rate limit applies to its part only, on a tool and on a motor."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.control.trip_reasons import GuardState
from haptorb.devices.loader import load
from haptorb.errors import DriverError
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.pointer import PointerTracker
from haptorb.worlds import Fluid, Remote

DT = 1e-3


class Rig:
    def __init__(self, device, world):
        self.device = load(device)
        self.tick = assemble(RunConfig(device=self.device, world=world, rate=1 / DT), PointerTracker())
        self.row, self.n = self.tick.layout.empty(), 0
        self.tick.driver.open()

    def go(self, ticks, force, session=1.0, mapping=0.0, torque=(0.0, 0.0, 0.0), gripper=0.0, silent=False, lost=False):
        """(ticks, 6) what is asked while a client commands `force`, or is silent, or lost, from the first tick on."""
        found = []
        for n in range(ticks):
            client = self.tick.client
            client["force"], client["session"], client["mapping"] = force, session, mapping
            client["torque"], client["gripper"] = torque, gripper
            client["age"], client["lost"] = silent * n * DT, lost * (n + 1) * DT
            self.tick.prepare(self.n * DT)
            self.tick.step(self.row, self.n * DT)
            self.n += 1
            found.append(self.row[self.tick.layout["wrench_commanded"]].copy())
        return np.array(found)


@pytest.mark.parametrize(("device", "part"), [("omni", slice(0, 3)), ("pmsm", slice(3, 6))])
def test_a_clients_force_that_turns_round_comes_back_at_the_rate_of_the_device(device, part):
    rig = Rig(device, Remote())
    limits = rig.device.limits
    rate = limits.force_rate if device == "omni" else limits.torque_rate
    rig.go(700, (0.0, 0.0, 100.0))
    assert rig.row[rig.tick.layout["guard"]][0] == GuardState.RUNNING
    asked = rig.go(120, (0.0, 0.0, -100.0), mapping=1.0)[:, part]
    steps = np.linalg.norm(np.diff(asked, axis=0), axis=1)
    assert 0.5 * rate * DT < steps.max() <= rate * DT * (1 + 1e-6)
    assert (np.linalg.norm(asked, axis=1) == 0.0).any()
    along = asked @ asked[-1]
    assert along[0] < 0.0 < along[-1]


def test_of_a_sum_the_clients_part_alone_is_limited():
    rig = Rig("omni", Fluid() + Remote())
    rig.go(500, (0.0, 0.0, 0.0))
    before = rig.go(1, (0.0, 0.0, 0.0))[0]
    first = rig.go(1, (0.5, 0.0, 0.0))[0]
    assert (first - before)[0] == pytest.approx(rig.device.limits.force_rate * DT, abs=0.02)
    assert rig.tick.protection.commanded[:3] == pytest.approx([0.5, 0.0, 0.0])


TURN = (0.0, 0.3, 0.0)


@pytest.mark.parametrize("device", ["arm-sigma", "omni", "planar"])
def test_a_clients_torque_is_rendered(device):
    """By a device that can: on an arm all of it, on a tool as its coils can; of a force alone nothing changes."""
    rig = Rig(device, Remote())
    size = 0.5 * rig.device.limits.torque
    still = rig.go(600, (0.0, 0.0, 0.1))
    assert not still[:, 3:].any()
    assert rig.row[rig.tick.layout["part"]][0] == (-1.0 if device == "arm-sigma" else 0.0)
    asked = rig.go(300, (0.0, 0.0, 0.1), torque=(0.0, size, 0.0))[-1]
    assert asked == pytest.approx([0.0, 0.0, 0.1, 0.0, size, 0.0], abs=1e-9)
    given = rig.row[rig.tick.layout["wrench_actual"]]
    if device == "arm-sigma":
        assert given[3:] == pytest.approx(asked[3:], abs=0.02 * size)
        assert given[:3] == pytest.approx(asked[:3], abs=0.02)
    else:
        assert rig.row[rig.tick.layout["part"]][0] == 2.0, "force and torque"
        assert given[4] > 0.1 * size


def test_a_clients_torque_has_limit_rate_and_end_of_a_force():
    rig = Rig("arm-sigma", Remote())
    limits = rig.device.limits
    asked = rig.go(700, (0.0, 0.0, 0.0), torque=(0.0, 100.0, 0.0))
    assert rig.row[rig.tick.layout["guard"]][0] == GuardState.RUNNING
    assert asked[-1, 4] == pytest.approx(limits.torque)
    back = rig.go(100, (0.0, 0.0, 0.0), torque=(0.0, -100.0, 0.0))[:, 4]
    steps = np.abs(np.diff(back))
    assert 0.5 * limits.torque_rate * DT < steps.max() <= limits.torque_rate * DT * (1 + 1e-6)
    assert back[-1] == pytest.approx(-limits.torque)
    gone = rig.go(90, (0.0, 0.0, 0.0), torque=(0.0, -100.0, 0.0), silent=True)[:, 4]
    assert gone[49] == pytest.approx(-limits.torque), "a command lasts 50 ms"
    assert (gone[71:] == 0.0).all(), "and is zero 70 ms later"


def test_the_currents_of_a_torque_change_at_its_rate():
    """An arm that is turned is held at a lever: its torque counts in the limits on currents, and in the energy."""
    rig = Rig("arm-sigma", Remote())
    rig.go(600, (0.0, 0.0, 0.0), torque=TURN)
    at, rate = rig.tick.layout["current_commanded"], rig.device.limits.torque_rate
    assert rig.tick.protection.state["passivity"]["arm"][0] == pytest.approx(rig.device.turning_arm)
    before = rig.row[at].copy()
    for _ in range(30):
        rig.go(1, (0.0, 0.0, 0.0), torque=(0.0, -0.3, 0.0))
        step = (rig.device.matrix @ (rig.row[at] - before))[3:]
        assert np.linalg.norm(step) <= rate * DT * (1 + 1e-6)
        before = rig.row[at].copy()


def test_a_torque_that_is_no_number_is_no_command():
    rig = Rig("arm-sigma", Remote())
    rig.go(500, (0.0, 0.0, 1.0), torque=TURN, gripper=1.0)
    for torque, gripper in (((0.0, np.nan, 0.0), 1.0), ((0.0, np.inf, 0.0), 1.0), (TURN, np.nan), (TURN, -np.inf)):
        asked = rig.go(60, (0.0, 0.0, 1.0), torque=torque, gripper=gripper)[-1]
        assert not asked.any()
        assert rig.row[rig.tick.layout["gripper_force"]][0] == 0.0
        assert rig.row[rig.tick.layout["guard"]][0] == GuardState.RUNNING
        rig.go(60, (0.0, 0.0, 1.0), torque=TURN, gripper=1.0)


def grip(rig, ticks, gripper, **more):
    """(ticks,) forces of the gripper [N] and openings [m] while a client commands `gripper`."""
    at, found = rig.tick.layout, []
    for n in range(ticks):
        late = {name: True for name in ("silent", "lost") if more.get(name)}
        client = rig.tick.client
        client["force"], client["torque"], client["gripper"] = 0.0, 0.0, gripper
        client["session"] = more.get("session", 1.0)
        client["age"], client["lost"] = ("silent" in late) * n * DT, ("lost" in late) * (n + 1) * DT
        rig.tick.prepare(rig.n * DT)
        rig.tick.step(rig.row, rig.n * DT)
        rig.n += 1
        found.append([rig.row[at["gripper_force"]][0], rig.row[at["gripper"]][0]])
    return np.array(found).T


def test_a_gripper_pushes_the_fingers_that_hold_it():
    """Opening and force are those of a spring, within dry friction; a positive force opens."""
    rig = Rig("arm-sigma", Remote())
    gripper = rig.device.gripper
    force, opening = grip(rig, 900, 0.0)
    assert not force.any()
    assert opening[-1] == pytest.approx(0.5 * gripper.opening, abs=2e-5), "relaxed fingers are half open"
    force, opening = grip(rig, 900, 2.0)
    assert force[-1] == pytest.approx(2.0)
    slack = gripper.coulomb / gripper.finger_stiffness + 2e-5
    assert opening[-1] == pytest.approx(0.5 * gripper.opening + 2.0 / gripper.finger_stiffness, abs=slack)
    force, opening = grip(rig, 900, -1000.0)
    assert force[-1] == pytest.approx(-gripper.force), "clamped"
    assert -1e-3 < opening[-1] < 1e-4, "thumb and finger meet"
    step = gripper.force * DT / 0.02
    assert np.abs(np.diff(grip(rig, 60, 1000.0)[0])).max() <= step * (1 + 1e-9), "slewed"


@pytest.mark.parametrize("end", ["silent", "lost"])
def test_the_force_of_a_gripper_ends_with_the_command(end):
    rig = Rig("arm-sigma", Remote())
    grip(rig, 700, 1000.0)
    force = grip(rig, 100, 1000.0, **{end: True})[0]
    last = 71 if end == "silent" else 21
    assert force[0] > 0.5 * rig.device.gripper.force
    assert (force[last:] == 0.0).all()


def test_a_gripper_is_off_at_once_with_the_coils():
    """On Stop, in the same tick; and when the driver is closed."""
    rig = Rig("arm-sigma", Remote())
    grip(rig, 700, 5.0)
    simulated = rig.tick.driver.simulation.gripper
    assert simulated.force == pytest.approx(5.0, abs=1e-6)
    rig.tick.stop()
    force = grip(rig, 4, 5.0)[0]
    assert not force.any()
    assert abs(simulated.force) < 1e-3, "the motor's force has died away"
    assert rig.tick.engage()
    grip(rig, 700, 5.0)
    rig.tick.driver.close()
    assert rig.tick.driver.write_grip_force(5.0) == 0.0


def test_another_clients_gripper_force_passes_zero():
    rig = Rig("arm-sigma", Remote())
    grip(rig, 700, 8.0)
    force = grip(rig, 60, 8.0, session=2.0)[0]
    assert force.min() == 0.0
    assert force[-1] == pytest.approx(8.0)


def test_a_gripper_is_off_in_a_tick_in_which_the_device_is_silent(monkeypatch):
    rig = Rig("arm-sigma", Remote())
    grip(rig, 700, 5.0)
    squeezed, squeeze, read = [], rig.tick.driver.write_grip_force, rig.tick.driver.read

    def fail(now):
        read(now)
        raise DriverError("no answer")

    monkeypatch.setattr(rig.tick.driver, "write_grip_force", lambda force: squeezed.append(force) or squeeze(force))
    monkeypatch.setattr(rig.tick.driver, "read", fail)
    grip(rig, 1, 5.0)
    assert squeezed == [0.0]
