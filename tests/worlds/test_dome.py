"""Force map against an independent implementation of the printed algorithm, step by step."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError, UnknownName
from haptorb.worlds import CATALOGUE, Dome, Nothing, World, find_world
from haptorb.worlds.base import parameters
from oracles.repetitions import repetitions

MU0 = 4e-7 * np.pi
angles = st.floats(0.0, np.pi)
turns = st.floats(-np.pi, np.pi)


def frame_along(axis):
    """Rows: two tangents and the radial direction; Fig. 3's rotation from S to a spherical system."""
    z = axis / np.linalg.norm(axis)
    helper = np.array([1.0, 0, 0]) if abs(z[0]) < 0.9 else np.array([0, 1.0, 0])
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])


def paper_force(rp, summit, d_min, me0, theta1, theta2, d_max, m_p):
    """Fig. 3, calc_F, in the summit's frame, with the argument of E13 and F_t along the e_t of E12."""
    to_summit = frame_along(np.asarray(summit, float))
    local = to_summit @ rp
    d = np.linalg.norm(local)
    alpha = np.arccos(np.clip(local[2] / d, -1, 1))
    azimuth = np.arctan2(local[1], local[0])
    F0 = 3 * MU0 * me0 * m_p / (4 * np.pi * d_min**4)
    Fr = Ft = 0.0
    if d < d_max and alpha < theta2:
        Fr = 2 * F0 * np.cos(alpha * np.pi / (2 * theta1)) * (d_min / d) ** 4
        Ft = F0 * np.sin(alpha * np.pi / (2 * theta1)) * (d_min / d) ** 4
    e_r = local / d
    e_t = np.array([np.cos(alpha) * np.cos(azimuth), np.cos(alpha) * np.sin(azimuth), -np.sin(alpha)])
    return to_summit.T @ (Fr * e_r + Ft * e_t)


def paper_moment(rp, force, m_p):
    """Fig. 3, calc_Me, with the 1/m_p that E14 adds: m_e in the tool's frame is (1, 1, −1/2) · F, scaled."""
    to_tool = frame_along(rp)
    d = np.linalg.norm(rp)
    return to_tool.T @ (4 * np.pi * d**4 / (3 * MU0 * m_p) * np.array([1, 1, -0.5]) * (to_tool @ force))


@settings(max_examples=repetitions(100, 300), deadline=None)
@given(
    alpha=angles,
    azimuth=turns,
    d=st.floats(0.050, 0.08),
    tilt=angles,
    bearing=turns,
    theta1=st.floats(5, 90),
    extra=st.floats(0, 90),
    me0=st.floats(-4, 4),
)
def test_the_map_is_the_printed_algorithm_corrected(alpha, azimuth, d, tilt, bearing, theta1, extra, me0):
    summit = (np.sin(tilt) * np.cos(bearing), np.sin(tilt) * np.sin(bearing), np.cos(tilt))
    rp = d * np.array([np.sin(alpha) * np.cos(azimuth), np.sin(alpha) * np.sin(azimuth), np.cos(alpha)])
    dome = Dome(summit, half_width_deg=theta1, cut_off_deg=theta1 + extra, moment=me0)
    from_summit = np.arccos(np.clip(rp @ np.array(summit) / d, -1, 1))
    if abs(from_summit - np.radians(theta1 + extra)) < 1e-6 or from_summit < 1e-5 or from_summit > np.pi - 1e-5:
        return  # on the very edge of a cut-off, or where e_t does not exist, both readings are right
    if abs(d - dome.reach) < 1e-12:
        return
    wanted = paper_force(rp, summit, 0.050, me0, np.radians(theta1), np.radians(theta1 + extra), 0.070, 2.406)
    got = dome.wrench(State.at(rp))
    assert np.allclose(got[:3], wanted, atol=1e-7)
    assert not got[3:].any()


def test_the_printed_inverse_with_its_tool_moment_gives_the_dipole_force_back():
    """E14: the magnet that the inverse asks for really makes that force; without 1/m_p it would be 2.4 times off."""
    omni = load("omni")
    dome = Dome().for_device(omni)
    rng = np.random.default_rng(1)
    for _ in range(50):
        rp = rng.normal(size=3)
        rp *= 0.05 / np.linalg.norm(rp)
        rp[2] = abs(rp[2])
        force = dome.wrench(State.at(rp))[:3]
        moment = paper_moment(rp, force, omni.tool.moment)
        currents = np.linalg.solve(omni.moment_per_current, moment)
        assert np.allclose(omni.wrench_map(State.at(rp), "published").force @ currents, force, atol=1e-9)


def at(alpha_deg, d=0.05):
    a = np.radians(alpha_deg)
    return State.at((d * np.sin(a), 0, d * np.cos(a)))


def radial(world, state):
    return float(world.wrench(state)[:3] @ state.axis)


def test_the_first_zero_the_sign_change_and_the_cut_off():
    dome = Dome(half_width_deg=18, cut_off_deg=54)
    assert radial(dome, at(0)) == pytest.approx(2 * dome.strength)
    assert radial(dome, at(0)) > 0  # a dome pushes
    assert radial(dome, at(18)) == pytest.approx(0, abs=1e-12)
    assert radial(dome, at(17.9)) > 0 > radial(dome, at(18.1))
    assert np.linalg.norm(dome.wrench(at(53.99))) > 0.1
    assert not dome.wrench(at(54.001)).any()
    assert not dome.wrench(at(90)).any()


def test_a_right_angle_is_a_permanent_magnet():
    """At θ1 = 90° the map is the force between two dipoles, Zárate 2020 eqs. (1) and (2)."""
    omni = load("omni")
    dome = Dome(half_width_deg=90, cut_off_deg=180, moment=-2.0).for_device(omni)
    for alpha in (5, 40, 85, 120, 175):
        state = at(alpha)
        direct = omni.wrench_map(state, "published").force @ np.linalg.solve(omni.moment_per_current, (0, 0, 2.0))
        assert np.allclose(dome.wrench(state)[:3], direct, atol=1e-9)


def test_attractive_is_minus_repulsive():
    for alpha in (0, 10, 30, 50):
        assert np.allclose(Dome(moment=2).wrench(at(alpha)), -Dome(moment=-2).wrench(at(alpha)))


def test_beyond_the_shell_there_is_nothing():
    assert Dome().wrench(at(0, 0.0699)).any()
    assert not Dome().wrench(at(0, 0.0701)).any()


def test_maps_add():
    a, b = Dome(summit=(0, 0, 1)), Dome(summit=(1, 0, 1), moment=-1)
    state = at(20)
    assert np.allclose((a + b).wrench(state), a.wrench(state) + b.wrench(state))
    assert len((a + b + a).parts) == 3


def test_a_sharpened_map_is_no_potential():
    """E19: the map is called a potential; but with the tool held radial, its force (and torque) round a loop give work
    unless θ1 = 90°. Both loops: up at α₁, across, down at α₂, back, force and magnet torque counted."""
    omni = load("omni")
    work = {}
    for theta1 in (18, 90):
        dome = Dome(half_width_deg=theta1, cut_off_deg=180).for_device(omni)
        corners = [(5, 0.05), (5, 0.06), (15, 0.06), (15, 0.05), (5, 0.05)]
        total = 0.0
        for (a0, d0), (a1, d1) in itertools.pairwise(corners):
            s = np.linspace(0, 1, 501)
            middle = (s[1:] + s[:-1]) / 2
            for k, m in enumerate(middle):
                state = at(a0 + m * (a1 - a0), d0 + m * (d1 - d0))
                wrench = dome.wrench(state)
                currents = np.linalg.solve(omni.wrench_map(state, "published").force, wrench[:3])
                given = omni.wrench_map(state, "published").wrench(currents)
                step = (
                    at(a0 + s[k + 1] * (a1 - a0), d0 + s[k + 1] * (d1 - d0)).p
                    - at(a0 + s[k] * (a1 - a0), d0 + s[k] * (d1 - d0)).p
                )
                turn = np.radians((s[k + 1] - s[k]) * (a1 - a0))
                total += given[:3] @ step + given[4] * turn
        work[theta1] = total
    assert abs(work[90]) < 1e-9
    assert abs(work[18]) > 1e-4  # a tenth of a millijoule per loop of 10 mm by 9 mm


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"half_width_deg": 0}, "between 5 and 90 deg"),
        ({"half_width_deg": float("nan")}, "finite"),
        ({"half_width_deg": "18"}, "finite number"),
        ({"half_width_deg": 60, "cut_off_deg": 50}, "must not be smaller than half_width_deg"),
        ({"moment": 40}, "between -4 and 4 A·m²"),
        ({"summit": (0, 0, 0)}, "zero vector"),
        ({"summit": (0, 1)}, "must be 3 numbers"),
    ],
)
def test_bad_parameters_are_refused(values, told):
    with pytest.raises(InputError, match=told):
        Dome(**values)


def test_an_unknown_parameter_suggests_the_nearest():
    with pytest.raises(UnknownName, match="did you mean 'moment'"):
        Dome().replace(momnt=1)


def test_the_catalogue():
    assert find_world("dome") is Dome
    assert find_world("nothing") is Nothing
    with pytest.raises(UnknownName, match="did you mean 'dome'"):
        find_world("doom")
    assert set(parameters(Dome)) == {"summit", "half_width_deg", "cut_off_deg", "moment"}
    assert all(issubclass(world, World) for world in CATALOGUE.values())


def test_a_summit_below_the_rim_is_refused():
    with pytest.raises(InputError, match="below the rim"):
        Dome(summit=(0.2, 0, -1)).for_device(load("omni"))
    Dome(summit=(1, 0, 0)).for_device(load("omni"))  # at the rim there is still dome
