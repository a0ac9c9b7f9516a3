"""Torque on a tool, and force with torque: result against another computation, and reported deviations."""

import daqp
import numpy as np
import pytest
from scipy.optimize import brentq

from haptorb.control.allocation import TORQUE_ARM, WholeWrenchAllocator, check_arm, tool_choice
from haptorb.control.saturation import AT_CURRENT, AT_POWER, FREE, Saturation, solve_compromise
from haptorb.devices.base import State, WrenchMap
from haptorb.devices.loader import load
from haptorb.errors import InputError
from oracles import wound_coils

OMNI = load("omni")
TURN = tool_choice(OMNI).allocators["torque"]
BOTH = tool_choice(OMNI).allocators["both"]


def touching(tilt_deg, azimuth_deg=0.0, lean=(0.0, 0.0, 0.0)):
    """A tool in contact, its axis radial but for `lean`."""
    t, a = np.radians((tilt_deg, azimuth_deg))
    u = np.array([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)])
    return State.at(OMNI.contact_distance * u, axis=u + np.asarray(lean))


@pytest.mark.parametrize(
    "state", [touching(0), touching(30, 70), touching(60, 200), touching(20, 10, (0.3, -0.2, 0.1))]
)
def test_ten_millinewtonmetres_across_the_axis_arrive_at_contact(state):
    """Within 2 % by loops, a core of charges, and charges of the magnet, which is no code of the product."""
    across = np.cross(state.axis, (0.3, 1.0, 0.2))
    across *= 0.010 / np.linalg.norm(across)
    allocation = TURN.allocate(OMNI.wrench_map(state, "exact"), np.r_[np.zeros(3), across])
    assert np.abs(allocation.currents).max() <= 20.0
    passive = OMNI.wrench_map(state, "exact").passive
    given = wound_coils.wrench_map(OMNI, state) @ allocation.currents + passive
    assert allocation.scale == pytest.approx(1.0, abs=0.02)
    assert np.linalg.norm(given[3:] - across) < 0.02 * 0.010
    assert np.linalg.norm(given[:3]) == pytest.approx(0.6, abs=0.07)  # what comes along


def test_about_its_own_axis_nothing_turns_a_magnet_and_that_is_admitted():
    state = touching(25, 40)
    allocation = TURN.allocate(OMNI.wrench_map(state, "exact"), np.r_[np.zeros(3), 0.005 * state.axis])
    assert allocation.saturated is Saturation.AXIS
    assert allocation.residual[3:] @ state.axis == pytest.approx(0.005, rel=1e-3)
    across = np.cross(state.axis, (0, 1, 0))
    assert (
        TURN.allocate(OMNI.wrench_map(state, "exact"), np.r_[np.zeros(3), 0.004 * across]).saturated is Saturation.NONE
    )


def test_a_torque_beyond_the_coils_keeps_its_direction_and_says_why():
    state = touching(0)
    allocation = TURN.allocate(OMNI.wrench_map(state, "exact"), (0, 0, 0, 0.05, 0.02, 0))
    given = OMNI.wrench_map(state, "exact").wrench(allocation.currents)[3:]
    assert allocation.saturated in (Saturation.CURRENT, Saturation.POWER)
    assert np.abs(allocation.currents).max() <= 20.0
    assert given[1] / given[0] == pytest.approx(0.4, rel=1e-6)


def test_what_comes_along_is_limited_too():
    """A strong magnet near the coils: 10 mN·m would bring newtons of force along."""
    per_ampere = np.zeros((6, 3))
    per_ampere[3, 1], per_ampere[2, 1] = 1e-3, 0.5
    limited = WholeWrenchAllocator((20.0,) * 3, (0.6,) * 3, greatest=(1.2, 0.06))
    allocation = limited.allocate(WrenchMap(per_ampere, np.array([0, 0, -0.2, 0, 0, 0])), (0, 0, 0, 0.01, 0, 0))
    assert allocation.saturated is Saturation.ALONG
    assert per_ampere[2] @ allocation.currents - 0.2 == pytest.approx(1.2)
    assert limited.allocate(WrenchMap(per_ampere, np.array([0, 0, -2.0, 0, 0, 0])), (0, 0, 0, 1, 0, 0)).scale == 0.0


def random_problem(rng, m):
    A = rng.normal(size=(6, m))
    return A.T @ A, A.T @ rng.normal(size=6) * 10, rng.uniform(0.5, 2.0, m), rng.uniform(0.3, 1.5, m)


@pytest.mark.parametrize("m", [1, 2, 3, 5])
def test_the_compromise_is_optimal(m):
    """By the conditions of Karush, Kuhn and Tucker: nobody can do better within the limits."""
    rng, reasons = np.random.default_rng(m), set()
    for n in range(120):
        H, g, limit, resistance = random_problem(rng, m)
        power = np.inf if n % 3 == 0 else float(rng.uniform(0.05, 4.0))
        currents = np.empty(m)
        reason = solve_compromise(H, g * rng.uniform(0.01, 1), limit, resistance, power, currents)
        reasons.add(reason)
        assert (np.abs(currents) <= limit).all()
        heat = float(resistance @ currents**2)
        assert heat <= power * (1 + 1e-6)
        assert (reason == AT_POWER) == (heat > power * (1 - 1e-6))
    assert reasons == {FREE, AT_CURRENT, AT_POWER}


@pytest.mark.parametrize("m", [2, 3])
def test_no_current_nearby_is_better(m):
    rng = np.random.default_rng(10 + m)
    for n in range(60):
        H, g, limit, resistance = random_problem(rng, m)
        power = float(rng.uniform(0.05, 2.0)) if n % 2 else np.inf
        currents = np.empty(m)
        solve_compromise(H, g, limit, resistance, power, currents)
        tried = currents + rng.normal(size=(400, m)) * np.geomspace(1e-5, 1, 400)[:, None]
        tried = np.clip(tried, -limit, limit)
        heat = tried**2 @ resistance
        tried *= np.minimum(1.0, np.sqrt(min(power, 1e9) / np.maximum(heat, 1e-12)))[:, None]
        cost = 0.5 * np.einsum("nj,jk,nk->n", tried, H, tried) - tried @ g
        best = 0.5 * currents @ H @ currents - currents @ g
        assert cost.min() >= best - 1e-7 * abs(best)


def within_limits(H, g, limit):
    """DAQP's minimum of ½ iᵀHi − gᵀi within ±limit."""
    off = np.zeros(len(g), dtype=np.int32)
    return np.clip(daqp.solve(H, -g, np.zeros((0, len(g))), limit, -limit, off, primal_tol=1e-12)[0], -limit, limit)


@pytest.mark.parametrize("m", [1, 3, 6, 8])
def test_an_independent_solver_finds_no_better_compromise(m):
    """With more coils than components H is singular, and with a power limit its multiplier is searched for."""
    rng = np.random.default_rng(20 + m)
    for n in range(100):
        H, g, limit, resistance = random_problem(rng, m)
        g *= rng.uniform(0.01, 1)
        if n % 5 == 0:
            limit[0] = 0.0
        ridge = 1e-12 * H.max() * np.eye(m)
        best, power = within_limits(H + ridge, g, limit), np.inf
        if n % 2:
            power = float(rng.uniform(0.05, 0.95) * (resistance @ best**2)) + 1e-6

            def excess(heat, H=H, g=g, limit=limit, R=resistance, P=power):
                return R @ within_limits(H + heat * np.diag(R), g, limit) ** 2 - P

            if excess(1e-12 * H.max()) > 0:
                heat = brentq(excess, 1e-12 * H.max(), 1e6, xtol=1e-15)
                best = within_limits(H + heat * np.diag(resistance), g, limit)
        currents = np.empty(m)
        solve_compromise(H, g, limit, resistance, power, currents)
        ours, theirs = (0.5 * i @ H @ i - g @ i for i in (currents, best))
        assert (np.abs(currents) <= limit).all()
        assert resistance @ currents**2 <= power * (1 + 1e-7)
        assert ours <= theirs + 1e-7 * abs(theirs)


def test_both_is_a_compromise_that_the_arm_decides():
    state = touching(20)
    asked = np.r_[0.3 * state.axis, 0.004 * np.cross(state.axis, (0, 1, 0))]
    torques, forces = [], []
    for arm in (1e-3, TORQUE_ARM, 10.0):
        allocator = tool_choice(OMNI, "both", arm).allocators["both"]
        allocation = allocator.allocate(OMNI.wrench_map(state, "exact"), asked)
        torques.append(np.linalg.norm(allocation.residual[3:]))
        forces.append(np.linalg.norm(allocation.residual[:3]))
        assert allocation.saturated is Saturation.COILS
    assert torques[0] < 2e-5
    assert forces[2] < 1e-3
    assert torques == sorted(torques)
    assert forces == sorted(forces, reverse=True)


def test_the_weight_is_that_of_noticeable_differences():
    assert pytest.approx(0.127 * 0.060 / (0.07 * 2.5)) == TORQUE_ARM
    assert check_arm(TORQUE_ARM) == TORQUE_ARM


@pytest.mark.parametrize("arm", [0.0, -1.0, float("nan"), float("inf"), 1e-6, "40", True])
def test_an_arm_is_a_length(arm):
    with pytest.raises(InputError, match="torque arm must be a length"):
        check_arm(arm)


@pytest.mark.parametrize("allocator", [TURN, BOTH])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_none_are_refused(allocator, bad):
    with pytest.raises(InputError, match="finite"):
        allocator.allocate(OMNI.wrench_map(touching(0), "exact"), (0, 0, 0, bad, 0, 0))
    with pytest.raises(InputError, match="finite"):
        allocator.allocate(WrenchMap(np.full((6, 3), bad), np.zeros(6)), np.ones(6))
