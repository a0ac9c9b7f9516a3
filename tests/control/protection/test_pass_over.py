"""Changes of client and mode pass through zero; no client's force steps; nothing delays a Stop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from control.protection.protected import DT, FRESH, OMNI, Loop
from haptorb.control.trip_reasons import Trip
from haptorb.devices.base import WrenchMap
from haptorb.worlds.dynamic import make_client_force

RATE = OMNI.limits.force_rate
NOTHING = np.zeros(6)


class Commanded:
    """A loop in which a client commands a part of the wrench; the guard lets everything through."""

    def __init__(self, arm: float = 0.0) -> None:
        self.loop = Loop(arm=arm).run()
        self.client = make_client_force()
        self._protect = self.loop.protection.protect_wrench
        self.loop.protection.protect_wrench = self._with_client

    def _with_client(self, wrench, estimate, now, stored=np.nan):
        session, mapping = self.client["session"].item(), self.client["mapping"].item()
        return self._protect(wrench, estimate, now, stored, session, mapping)

    def ask(self, force=(0.0, 0.0, 0.0), *, world=NOTHING, session=1.0, mapping=0.0):
        """(3,) the force that may be asked in one tick."""
        commanded = np.array([*force, 0.0, 0.0, 0.0])
        self.loop.protection.commanded[:] = commanded
        self.client["session"], self.client["mapping"] = session, mapping
        return self.loop.ask(world + commanded)[:3]

    def follow(self, ticks, force, **more):
        """(ticks, 3) the forces of so many ticks."""
        return np.array([self.ask(force, **more) for _ in range(ticks)])


def largest_step(forces):
    return np.linalg.norm(np.diff(forces, axis=0), axis=1).max()


def test_a_clients_force_changes_at_the_rate_of_the_device_file_and_no_faster():
    rig = Commanded()
    forces = rig.follow(20, (1.0, 0.0, 0.0))
    assert forces[0] == pytest.approx([RATE * DT, 0, 0])
    assert forces[-1] == pytest.approx([1.0, 0, 0])
    back = rig.follow(30, (-1.0, 0.0, 0.0))
    assert largest_step([forces[-1], *back]) <= RATE * DT * (1 + 1e-9)
    assert back[-1] == pytest.approx([-1.0, 0, 0])


def test_what_a_client_commands_beyond_the_limit_leaves_no_debt():
    rig = Commanded()
    rig.follow(20, (1e6, 0.0, 0.0))
    forces = rig.follow(int(OMNI.limits.force / RATE / DT) + 2, (0.0, 0.0, 0.0))
    assert not forces[-1].any()


@pytest.mark.parametrize("change", [{"session": 2.0}, {"mapping": 1.0}])
def test_another_client_and_another_mapping_are_felt_when_the_force_of_before_is_zero(change):
    rig = Commanded()
    rig.follow(20, (0.0, 0.0, 1.0))
    forces = rig.follow(30, (1.0, 0.0, 0.0), **change)
    assert largest_step([(0, 0, 1.0), *forces]) <= RATE * DT * (1 + 1e-9)
    before, after = forces[:, 2], forces[:, 0]
    assert not (before * after).any()  # one or the other
    assert after[-1] == pytest.approx(1.0)


def test_clients_in_turn_make_no_force_that_jumps():
    rig, forces = Commanded(), [np.zeros(3)]
    for n in range(300):
        sign = 1.0 if n % 2 else -1.0
        forces.append(rig.ask((sign, 0.0, 0.0), session=1.0 + n % 2))
    assert largest_step(forces) <= RATE * DT * (1 + 1e-9)


def test_the_contact_of_a_world_is_as_steep_as_it_is_beside_a_client_too():
    rig = Commanded()
    for n, push in enumerate((0.0, 0.4, -0.4, 0.4)):
        force = rig.ask((0.0, 0.0, 0.1 * (n > 0)), world=np.array([push, 0, 0, 0, 0, 0]))
        assert force[0] == pytest.approx(push)


def test_another_world_is_felt_when_the_force_of_this_one_is_zero_and_then_is_free():
    rig = Commanded()
    rig.follow(3, (0, 0, 0), world=np.array([1.0, 0, 0, 0, 0, 0]))
    rig.loop.protection.change_world(passive=True, other=True)
    forces = rig.follow(120, (0, 0, 0), world=np.array([-1.0, 0, 0, 0, 0, 0]))[:, 0]
    zero = int(np.argmin(np.abs(forces)))
    assert forces[zero] == 0.0
    assert np.abs(np.diff([1.0, *forces])).max() <= OMNI.limits.force / 0.05 * DT * (1 + 1e-9)
    assert forces[-1] == -1.0
    assert rig.ask(world=np.array([1.0, 0, 0, 0, 0, 0]))[0] == 1.0


def test_the_same_world_with_other_values_comes_without_a_step_and_without_a_gap():
    rig = Commanded()
    rig.follow(3, (0, 0, 0), world=np.array([1.0, 0, 0, 0, 0, 0]))
    rig.loop.protection.change_world(passive=True)
    forces = rig.follow(60, (0, 0, 0), world=np.array([0.2, 0, 0, 0, 0, 0]))[:, 0]
    assert np.abs(np.diff([1.0, *forces])).max() <= OMNI.limits.force / 0.05 * DT * (1 + 1e-9)
    assert forces.min() == forces[-1] == pytest.approx(0.2)


def test_a_stop_waits_for_no_rate_and_no_fade():
    rig = Commanded()
    rig.follow(20, (1.0, 0.0, 0.0))
    rig.loop.protection.change_world(passive=True, other=True)
    rig.ask((1.0, 0.0, 0.0), session=2.0)
    rig.loop.protection.trip(Trip.STOPPED)
    assert not rig.ask((1.0, 0.0, 0.0)).any()


def test_after_a_stop_a_clients_force_begins_at_zero():
    rig = Commanded()
    rig.follow(20, (1.0, 0.0, 0.0))
    rig.loop.protection.trip(Trip.STOPPED)
    rig.ask((1.0, 0.0, 0.0))
    rig.loop.open()
    assert rig.ask((1.0, 0.0, 0.0)) == pytest.approx([RATE * DT, 0, 0])


def test_what_is_no_number_still_trips():
    rig = Commanded()
    assert not rig.ask((np.nan, 0.0, 0.0)).any()
    assert rig.loop.protection.reason is Trip.WORLD_NOT_FINITE


def test_the_torque_that_a_client_causes_has_a_rate_of_its_own():
    rig, commanded = Commanded(), np.array([0.0, 0.0, 0.0, 0.05, 0.0, 0.0])
    rig.client["session"] = 1.0
    rig.loop.protection.commanded[:] = commanded
    torques = np.array([rig.loop.ask(commanded)[3:] for _ in range(20)])
    assert torques[0] == pytest.approx([OMNI.limits.torque_rate * DT, 0, 0])
    assert torques[-1] == pytest.approx([0.05, 0, 0])


PULL = WrenchMap(np.vstack([0.1 * np.eye(3), np.zeros((3, 3))]), np.zeros(6))  #: 0.1 N/A along each axis
HELD_BACK = replace(FRESH, wrench_map=PULL)


def jump(rig, wanted, force, *, estimate=HELD_BACK, world=NOTHING):
    """By how much the coils' force changes [N] in a tick in which `wanted` (3,) [A] is allocated for `force`."""
    before = rig.loop.held
    rig.ask(force, world=world)
    rig.loop.drive(wanted, estimate=estimate)
    return 0.1 * np.linalg.norm(rig.loop.held - before)


@pytest.fixture
def held_back():
    """A client pushes with 0.3 N, but nothing flows yet: slew and limits of the coils let nothing through before."""
    rig = Commanded()
    rig.loop.unlimit()
    rig.loop.protection.state["guard"]["force"] = OMNI.limits.force
    for _ in range(5):
        jump(rig, np.zeros(3), (0.3, 0.0, 0.0))
    return rig


def test_coils_that_were_held_back_make_up_for_it_at_the_rate_of_a_clients_force(held_back):
    steps = [jump(held_back, np.array([3.0, 0.0, 0.0]), (0.3, 0.0, 0.0)) for _ in range(4)]
    assert steps == pytest.approx([RATE * DT, RATE * DT, 0.0, 0.0])
    assert held_back.loop.held == pytest.approx([3.0, 0.0, 0.0])


def test_a_client_that_is_gone_leaves_at_its_rate_and_limits_nothing_afterwards(held_back):
    for _ in range(4):
        jump(held_back, np.array([3.0, 0.0, 0.0]), (0.3, 0.0, 0.0))
    held_back.loop.protection.state["guard"]["slew"] = 200.0
    slow = [jump(held_back, np.zeros(3), (0.0, 0.0, 0.0)) for _ in range(4)]
    held_back.loop.unlimit()
    assert slow == pytest.approx([0.02] * 4)
    assert jump(held_back, np.zeros(3), (0.0, 0.0, 0.0)) == pytest.approx(RATE * DT)
    jump(held_back, np.zeros(3), (0.0, 0.0, 0.0))
    assert jump(held_back, np.array([3.0, 0.0, 0.0]), (0.0, 0.0, 0.0)) == pytest.approx(0.3)


def test_a_contact_beside_a_client_flows_at_once_and_where_it_was_held_back_too(held_back):
    contact = np.array([0.0, 0.8, 0.0, 0.0, 0.0, 0.0])
    assert jump(held_back, np.array([0.0, 8.0, 0.0]), (0.3, 0.0, 0.0), world=contact) == pytest.approx(0.8)
    assert jump(held_back, np.array([0.0, 4.0, 0.0]), (0.3, 0.0, 0.0), world=NOTHING) == pytest.approx(0.4)
    assert jump(held_back, np.zeros(3), (0.3, 0.0, 0.0), world=NOTHING) == pytest.approx(RATE * DT)


def test_what_fades_after_a_trip_is_not_held_back(held_back):
    for _ in range(4):
        jump(held_back, np.array([3.0, 0.0, 0.0]), (0.3, 0.0, 0.0))
    held_back.loop.protection.trip(Trip.POSE_EXPIRED)
    assert jump(held_back, np.zeros(3), (0.3, 0.0, 0.0)) == pytest.approx(0.3)


@pytest.mark.parametrize(("arm", "steps"), [(0.05, [1.0, 1.0, 0.0]), (0.0, [2.0, 0.0, 0.0])])
def test_coils_that_were_held_back_make_up_for_a_torque_at_its_rate_where_one_is_rendered(arm, steps):
    """The torque that comes along with a tool's force is not rendered, and limits nothing."""
    rig = Commanded(arm)
    rig.loop.unlimit()
    step = OMNI.limits.torque_rate * DT
    turning = replace(FRESH, wrench_map=WrenchMap(np.vstack([np.zeros((3, 3)), 0.01 * np.eye(3)]), np.zeros(6)))
    commanded = np.array([0.0, 0.0, 0.0, 2.0 * step, 0.0, 0.0])
    rig.client["session"] = 1.0
    rig.loop.protection.commanded[:] = commanded
    for _ in range(5):
        rig.loop.ask(commanded)
        rig.loop.drive(np.zeros(3), estimate=turning)
    found = []
    for _ in steps:
        before = rig.loop.held
        rig.loop.ask(commanded)
        rig.loop.drive(np.array([200.0 * step, 0.0, 0.0]), estimate=turning)
        found.append(0.01 * np.linalg.norm(rig.loop.held - before) / step)
    assert found == pytest.approx(steps)
