"""Force of a client: held, faded, limited, and reproducible from the same memory."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.worlds import Remote, Terrain, Wall
from haptorb.worlds.client_force import FADE_TIME_S, HOLD_TIME_S
from haptorb.worlds.dynamic import BoundWorld, make_client_force

STATE = State.at((0.0, 0.0, 0.05))


def feel(world, force, *, session=1.0, age=0.0, lost=0.0):
    bound = BoundWorld(world, 1e-3)
    client = bound.client
    client["force"], client["session"], client["age"], client["lost"] = force, session, age, lost
    return bound.wrench(STATE), bound


def test_a_command_is_rendered_whole_for_fifty_milliseconds_and_is_gone_twenty_later():
    for age, share in (
        (0.0, 1.0),
        (HOLD_TIME_S, 1.0),
        (HOLD_TIME_S + FADE_TIME_S / 2, 0.5),
        (HOLD_TIME_S + FADE_TIME_S, 0.0),
        (1e9, 0.0),
    ):
        wrench, bound = feel(Remote(), (0.1, -0.2, 0.3), age=age)
        assert wrench == pytest.approx([*(share * np.array([0.1, -0.2, 0.3])), 0, 0, 0], abs=1e-12)
        assert bound.memory["fade"][0] == pytest.approx(share)


def test_a_lost_connection_fades_at_once():
    wrench, _ = feel(Remote(), (0.0, 0.0, 0.4), age=0.001, lost=FADE_TIME_S / 2)
    assert wrench[2] == pytest.approx(0.2)
    wrench, _ = feel(Remote(), (0.0, 0.0, 0.4), age=0.001, lost=FADE_TIME_S)
    assert not wrench.any()


def test_nobody_commands_nothing():
    assert not feel(Remote(), (1.0, 1.0, 1.0), session=0.0)[0].any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_no_force_and_leaves_the_memory_finite(bad):
    for where in ("force", "age", "lost", "session", "torque", "gripper"):
        bound = BoundWorld(Remote(), 1e-3)
        bound.client["session"], bound.client["force"] = 1.0, (0.1, 0.0, 0.0)
        bound.client[where] = bad
        assert not bound.wrench(STATE).any()
        assert np.isfinite(bound.numbers).all()


def test_no_force_is_greater_than_the_limit_however_large_the_numbers():
    for force in ((1e308, 1e308, -1e308), (30.0, 40.0, 0.0)):
        wrench, _ = feel(Remote(limit=2.0), force)
        assert np.linalg.norm(wrench[:3]) == pytest.approx(2.0)
        assert np.sign(wrench[:3]).tolist() == np.sign(force).tolist()


def test_torque_and_gripper_force_have_limit_and_fade_of_a_force():
    bound = BoundWorld(Remote(torque_limit=0.5, gripper_limit=2.0), 1e-3)
    client = bound.client
    client["session"], client["torque"], client["gripper"] = 1.0, (3e8, 0.0, 4e8), -1e9
    assert bound.wrench(STATE) == pytest.approx([0, 0, 0, 0.3, 0.0, 0.4])
    assert bound.gripper_force == -2.0
    client["age"] = HOLD_TIME_S + FADE_TIME_S / 2
    assert bound.wrench(STATE) == pytest.approx([0, 0, 0, 0.15, 0.0, 0.2])
    assert bound.gripper_force == pytest.approx(-1.0)
    client["lost"] = FADE_TIME_S
    assert not bound.wrench(STATE).any()
    assert bound.gripper_force == 0.0


def test_limits_are_those_of_the_device():
    """A motor's are those on its object; a world may be weaker, but not stronger."""
    sigma, arm, motor = (Remote().for_device(load(name)) for name in ("arm-sigma", "arm", "pmsm"))
    assert (sigma.limit, sigma.torque_limit, sigma.gripper_limit) == (20.0, 0.4, 8.0)
    assert (arm.limit, arm.gripper_limit) == (12.0, 0.0)
    assert (motor.limit, motor.torque_limit) == pytest.approx((1.0 / 0.024, 1.0 / 0.25))
    assert Remote(limit=3.0).for_device(load("arm")).limit == 3.0


def test_it_is_active_alone_and_in_a_sum_and_adds_to_worlds_of_both_kinds():
    assert not Remote().passive
    for other in (Terrain(), Wall()):
        world = other + Remote()
        assert not world.passive
        assert world.takes_commands
        wrench, _ = feel(world, (0.0, 0.0, 0.25))
        assert wrench - other.wrench(STATE) == pytest.approx([0, 0, 0.25, 0, 0, 0])


def test_the_memory_of_a_row_gives_the_same_force_bit_for_bit():
    for world in (Remote(), Terrain() + Remote()):
        prefix = "" if isinstance(world, Remote) else "remote_"
        first, bound = feel(world, (0.1, 1 / 3, -0.07), session=10001.0, age=HOLD_TIME_S + 0.0071)
        fields, at = {}, 0
        for field in world.memory_fields:
            fields[field.name] = bound.numbers[at : at + field.size].copy()
            at += field.size
        again = BoundWorld(world, 1e-3)
        for name in ("force", "session", "age", "lost"):
            again.client[name] = fields[prefix + name] if name == "force" else fields[prefix + name][0]
        assert again.wrench(STATE).tobytes() == first.tobytes()
        assert again.numbers.tobytes() == bound.numbers.tobytes()


def test_a_client_of_nobody_is_zero():
    assert all(not make_client_force()[name].any() for name in ("force", "session", "age", "lost"))
