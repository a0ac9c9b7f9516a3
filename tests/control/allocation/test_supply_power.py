"""Power limit of the supply in both allocators: never exceeded, direction kept, reason reported."""

from dataclasses import replace

import numpy as np
import pytest

from haptorb.control.allocation import (
    LeastSquaresAllocator,
    MinimumPowerAllocator,
    force_allocator,
    tool_choice,
    torque_allocator,
)
from haptorb.control.array_allocation import array_choice
from haptorb.control.saturation import Saturation, scale_to_power
from haptorb.devices.base import State, WrenchMap
from haptorb.devices.loader import load
from haptorb.errors import InputError

OMNI, PMSM = load("omni"), load("pmsm")
WEAK = replace(PMSM, supply=replace(PMSM.supply, power=300.0))


def hot_resistance(device):
    return device.coils.resistance_at(np.full(device.channels, device.coils.heat.stop))


def random_maps(draw, device, count):
    """Wrench maps of a tool over the dome, or of a rotor in its workspace."""
    for _ in range(count):
        if device is OMNI:
            way = draw.normal(size=3) + np.array([0.0, 0.0, 2.0])
            place = draw.uniform(0.05, 0.07) * way / np.linalg.norm(way)
            yield device.wrench_map(State.at(place), draw.choice(["exact", "published"]))
        else:
            turn = np.linalg.qr(draw.normal(size=(3, 3)))[0]
            turn *= np.sign(np.linalg.det(turn))
            yield device.wrench_map(State(0.0, turn, np.zeros(3), np.zeros(3), np.zeros(3)), "table")


@pytest.mark.parametrize(("device", "make", "part"), [(OMNI, force_allocator, 0), (WEAK, torque_allocator, 3)])
def test_never_above_the_limit_and_along_the_wrench(device, make, part):
    """10⁴ random wrenches for the tool, 10³ for the rotor; 10⁶ in `benchmarks/safety/supply_power.py`."""
    draw, allocator, resistance = np.random.default_rng(1), make(device), hot_resistance(device)
    reasons = dict.fromkeys(Saturation, 0)
    for known in random_maps(draw, device, 50 if device is OMNI else 10):
        strength = np.linalg.norm(known.matrix[part : part + 3], axis=0).max() * device.coils.current_limit[0]
        for _ in range(200 if device is OMNI else 100):
            wrench = np.zeros(6)
            wrench[part : part + 3] = strength * draw.uniform(0, 2) * draw.normal(size=3)
            allocation = allocator.allocate(known, wrench)
            power = float(resistance @ allocation.currents**2)
            assert power <= device.supply.power
            reasons[allocation.saturated] += 1
            rows = slice(part, part + 3)
            asked = wrench[rows] - known.passive[rows]
            given = known.matrix[rows] @ allocation.currents
            assert np.allclose(given, allocation.scale * asked, atol=1e-7 * np.linalg.norm(asked))
            if allocation.saturated is Saturation.POWER:
                assert allocation.scale < 1.0
                assert power == pytest.approx(device.supply.power, rel=1e-9)
    cases = [reasons[one] for one in (Saturation.NONE, Saturation.CURRENT, Saturation.POWER)]
    assert min(cases) > 50, reasons  # every case was there


def test_the_reason_is_the_limit_that_holds_the_wrench_back():
    pull = WrenchMap(np.vstack([np.eye(3), np.zeros((3, 3))]), np.zeros(6))
    allocator = LeastSquaresAllocator((4.0, 4.0, 4.0), resistance=(1.0, 1.0, 1.0), power=27.0)
    cases = {
        (1.0, 1, 1): (Saturation.NONE, 1.0),
        (5.0, 0, 0): (Saturation.CURRENT, 0.8),
        (6.0, 6, 6): (Saturation.POWER, 0.5),
    }
    for force, (reason, scale) in cases.items():
        allocation = allocator.allocate(pull, (*force, 0, 0, 0))
        assert allocation.saturated is reason
        assert allocation.scale == pytest.approx(scale)
        assert bool(allocation.saturated) == (scale < 1.0)
        assert bool(reason.text) == bool(reason)


def test_the_least_heat_for_a_torque_decides_and_not_the_greatest_current():
    """Four channels: of 0.2 W the torque is had by two channels together, 0.1 W each, and with one alone it is not."""
    motor = WrenchMap(np.vstack([np.zeros((3, 4)), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0]]]), np.zeros(6))
    allocator = MinimumPowerAllocator([1.0] * 4, resistance=[10.0] * 4, power=0.2)
    allocation = allocator.allocate(motor, (0, 0, 0, 0.2, 0, 0))
    assert allocation.currents == pytest.approx((0.1, 0, 0, 0.1))
    assert not allocation.saturated
    half = allocator.allocate(motor, (0, 0, 0, 0.4, 0, 0))
    assert (half.saturated, half.scale) == (Saturation.POWER, pytest.approx(0.5))


def test_without_a_limit_nothing_is_scaled():
    currents = np.array([1e200, 1.0])
    assert scale_to_power(currents, np.ones(2), np.inf) == 1.0
    assert currents[0] == 1e200
    assert PMSM.supply.power == np.inf


def test_a_limit_that_cannot_be_is_refused():
    with pytest.raises(InputError, match="needs the resistance"):
        LeastSquaresAllocator((1.0, 1.0, 1.0), power=10.0)
    with pytest.raises(InputError, match="above 0 W"):
        MinimumPowerAllocator((1.0, 1.0, 1.0), resistance=(1.0, 1.0, 1.0), power=0.0)
    with pytest.raises(InputError, match="one entry above 0 Ω per channel"):
        LeastSquaresAllocator((1.0, 1.0, 1.0), resistance=(1.0, 1.0), power=10.0)


@pytest.mark.parametrize("part", ["torque", "both"])
@pytest.mark.parametrize("name", ["omni", "planar"])
def test_torques_and_whole_wrenches_take_no_more_than_the_supply_gives(name, part):
    """With a supply that the coils exceed: random wrenches meet the limit and never pass it."""
    device = load(name)
    device = replace(device, supply=replace(device.supply, power=200.0))
    choice = tool_choice(device) if name == "omni" else array_choice(device)
    height = device.contact_distance if name == "omni" else device.contact_height
    known = device.wrench_map(State.at((0.004, -0.003, height + 0.002)), "exact")
    draw, most = np.random.default_rng(3), 0.0
    strength = np.array([*[20.0] * 3, *[1.0] * 3])
    for _ in range(100):
        wrench = strength * draw.normal(size=6) * (1.0 if part == "both" else np.array([0, 0, 0, 1, 1, 1]))
        currents = choice.allocators[part].allocate(known, wrench).currents
        most = max(most, float(hot_resistance(device) @ currents**2))
    assert 0.99 * 200.0 < most <= 200.0
