"""Capability of the PMSM: consistent with the allocator, with symmetry, and with ohmic heat."""

import numpy as np
import pytest
from scipy.optimize import linprog

import haptorb
from haptorb.control.allocation import MinimumPowerAllocator
from haptorb.control.capability import motor_capability
from haptorb.devices.base import State
from haptorb.errors import DeviceError, InputError
from haptorb.rotations import rotation_from_euler


@pytest.fixture(scope="module")
def pmsm():
    return haptorb.load("pmsm")


@pytest.fixture(scope="module")
def capability(pmsm):
    return motor_capability(pmsm, tilts=5, spins=12)


def test_shapes(capability):
    assert capability.peak.shape == capability.continuous.shape == capability.power.shape == (5, 5, 3)
    assert capability.condition.shape == capability.weakest.shape == (5, 5)
    assert capability.shares.shape == (3, 12)
    np.testing.assert_allclose(capability.shares.sum(axis=1), 1.0)


def test_peak_is_the_linear_programmes(pmsm):
    capability = motor_capability(pmsm, tilts=2, spins=1)
    tilt = pmsm.workspace_tilt
    K = haptorb.torque_characteristic(pmsm, rotation_from_euler(-tilt, tilt, 0.0), grouped=True)
    for axis in range(3):
        others = [row for row in range(3) if row != axis]
        best = linprog(-K[axis], A_eq=K[others], b_eq=[0, 0], bounds=[(-1, 1)] * 12)
        assert capability.peak[0, 1, axis] == pytest.approx(-best.fun, rel=1e-6)


def test_the_allocator_gives_the_peak_and_no_more(pmsm, capability):
    wrench_map = pmsm.wrench_map(State.from_rotation(np.eye(3)), "table")
    allocator = MinimumPowerAllocator(pmsm.coils.current_limit)
    least = capability.peak[2, 2]
    for axis in range(3):
        asked = np.zeros(6)
        asked[3 + axis] = 0.999 * least[axis]
        assert allocator.allocate(wrench_map, asked).scale == 1.0
        asked[3 + axis] = 10.0
        assert allocator.allocate(wrench_map, asked).scale < 1.0


def test_symmetric_about_the_axes_as_the_motor_is(capability):
    for values in (capability.condition, capability.weakest):
        for mirrored in (values[::-1], values[:, ::-1], values[::-1, ::-1]):
            np.testing.assert_allclose(values, mirrored, rtol=1e-6)
    np.testing.assert_allclose(capability.peak[2, 2, 0], capability.peak[2, 2, 1], rtol=1e-6)


def test_lasting_torque_is_less_than_peak_and_heats_what_the_coils_can_shed(pmsm, capability):
    assert (capability.continuous < 0.5 * capability.peak).all()
    ratio = capability.continuous / capability.peak
    np.testing.assert_allclose(ratio, pmsm.sustained_current[0] / pmsm.coils.current_limit[0], rtol=1e-6)


def test_power_is_that_of_the_least_currents(pmsm):
    capability = motor_capability(pmsm, tilts=2, spins=1)
    tilt = pmsm.workspace_tilt
    wrench_map = pmsm.wrench_map(State.from_rotation(rotation_from_euler(tilt, tilt, 0.0)), "table")
    currents = MinimumPowerAllocator(np.full(12, 1e3)).allocate(wrench_map, (0, 0, 0, 0, 0.1, 0)).currents
    heat = pmsm.coils.resistance @ currents**2
    assert capability.power[1, 1, 1] == pytest.approx(100 * heat, rel=1e-6)


def test_bad_grids_and_dead_motors_are_refused(pmsm):
    with pytest.raises(InputError, match="at least 2 tilts"):
        motor_capability(pmsm, tilts=1)
    from dataclasses import replace

    dead = replace(pmsm, groups=np.abs(pmsm.groups))
    with pytest.raises(DeviceError, match="torque about every axis"):
        motor_capability(dead, 3, 4)
