"""Stiffness of worlds with memory, which may have none initially."""

import pytest

from haptorb.analysis.workspace import list_quick_steepness, workspace
from haptorb.devices.loader import load
from haptorb.worlds import Friction, RollingBall, StirredFluid

OMNI, MOTOR = load("omni"), load("pmsm")


@pytest.mark.parametrize(
    ("world", "stiffness"), [(Friction(stiffness=260.0), 260.0), (RollingBall(stiffness=90.0), 90.0)]
)
def test_bristles_and_contacts_are_as_stiff_as_they_say(world, stiffness):
    found = list_quick_steepness(OMNI, world, workspace(OMNI), 1e-3)
    assert found[0].stiffness.real == pytest.approx(stiffness, rel=0.05)


def test_a_fluid_has_none():
    found = list_quick_steepness(OMNI, StirredFluid(), workspace(OMNI), 1e-3)
    assert all(one.stiffness.real < 1.0 for one in found)


def test_through_a_motors_modes_it_is_that_of_the_handle():
    found = list_quick_steepness(MOTOR, Friction(stiffness=1000.0), workspace(MOTOR), 1e-3)
    assert 0.0 < found[0].stiffness.real < 5.0  # [N·m/rad]: 24 mm of plug for a radian of handle
