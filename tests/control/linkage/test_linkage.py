"""Linkage, direct and by two modes, with the worlds that it renders."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.control.linkage import MODES, Direct, ModedLinkage
from haptorb.devices.base import State
from haptorb.errors import InputError
from haptorb.worlds import Nothing, Outlet, SnapFit, Wall

DT = 1e-3


def rotor(n, psi, lam, phi, rates=(0.0, 0.0, 0.0)):
    """At Rx(ψ) Ry(λ) Rz(φ), turning about x, then y turned by ψ, then its own z."""
    a, b, c = math.cos(psi), math.cos(lam), math.cos(phi)
    d, e, f = math.sin(psi), math.sin(lam), math.sin(phi)
    R = [
        [b * c, -b * f, e],
        [a * f + d * e * c, a * c - d * e * f, -d * b],
        [d * f - a * e * c, d * c + a * e * f, a * b],
    ]
    p, q, r = rates
    w = np.array([p + r * e, q * a - r * d * b, q * d + r * a * b])
    return State(n * DT, np.array(R), np.zeros(3), w, np.zeros(3))


def test_the_rotor_of_these_tests_is_the_one_of_bai_2012():
    state = rotor(3, 0.3, -0.2, 1.0, (0.5, -0.7, 2.0))
    assert np.abs(state.R_SR - Rotation.from_euler("XYZ", [0.3, -0.2, 1.0]).as_matrix()).max() < 1e-15
    later = rotor(3, 0.3 + 0.5e-6, -0.2 - 0.7e-6, 1.0 + 2e-6).R_SR
    assert Rotation.from_matrix(later @ state.R_SR.T).as_rotvec() / 1e-6 == pytest.approx(state.w, abs=1e-5)


def test_a_direct_linkage_is_the_world_itself():
    state = State.at((0, 0, -0.001), axis=(0, 0, 1))
    felt = Direct().render(Wall(), state)
    assert (felt.wrench == Wall().wrench(state)).all()
    assert felt.object is state
    assert (felt.mode, felt.engaged, felt.share.tolist()) == (0, True, [1.0, 1.0])
    assert not felt.contacts.any()
    with pytest.raises(InputError, match="no modes"):
        Direct().set_mode("rotate")
    with pytest.raises(InputError, match="no clutch"):
        Direct().set_clutch(False)
    Direct().restart()


def test_the_torque_scale_slides_and_leaves_motion_and_world_alone():
    """Pushed aside: the torque goes to the new scale within a second without a step; where the target is, and what
    acts on it, stays."""
    linkage = ModedLinkage()
    for n in range(300):
        linkage.render(Outlet(), rotor(n, 0.0, 0.0, 0.0))
    for n in range(300, 600):
        before = linkage.render(Outlet(), rotor(n, 0.05, 0.02, 0.0))
    linkage.set_torque_scale(3.0)
    last, largest = before, 0.0
    for n in range(600, 1600):
        felt = linkage.render(Outlet(), rotor(n, 0.05, 0.02, 0.0))
        largest = max(largest, np.abs(felt.wrench - last.wrench).max())
        last = felt
    assert last.wrench == pytest.approx(3.0 * before.wrench)
    assert largest < 0.01 * np.abs(last.wrench).max()
    assert (last.object.p == before.object.p).all()
    assert (last.object_wrench == before.object_wrench).all()
    for wrong in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="torque scale"):
            linkage.set_torque_scale(wrong)
    with pytest.raises(InputError, match="no torque scale"):
        Direct().set_torque_scale(1.0)


def turn(A, B):
    """(3,) [rad] from B to A, a small one: its rotation vector but for a cube."""
    M = A @ B.T
    return 0.5 * np.array([M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]])


def test_closed_paths_give_no_energy():
    """Out, aside, back and home with the mode and the clutch changed at random: the hand never gets more than it put
    in."""
    rng = np.random.default_rng(4)
    for world in (Outlet(friction=0.0), Outlet(), SnapFit()):
        linkage, work, last = ModedLinkage(), 0.0, None
        t = np.arange(6000) * DT
        knots = 0.3 * rng.standard_normal((3, 6))
        paths = sum(
            np.outer(knots[:, k], np.sin((k + 1) * np.pi * t / t[-1]) ** 2 * np.sin(np.pi * t / t[-1]))
            for k in range(6)
        )
        paths = np.clip(paths, -0.35, 0.35)
        for n in range(len(t)):
            psi, lam, phi = paths[:, n]
            rates = (paths[:, min(n + 1, len(t) - 1)] - paths[:, n]) / DT
            state = rotor(n, psi, lam, phi, rates)
            if n % 300 == 299:
                linkage.set_mode(MODES[rng.integers(2)])
                linkage.set_clutch(rng.random() < 0.7)
            felt = linkage.render(world, state)
            if last is not None:
                mean = 0.5 * (felt.wrench[3:] + last[0])
                work += float(mean @ turn(state.R_SR, last[1]))
            last = (felt.wrench[3:], state.R_SR)
        # the world's torque on the rotor does work on the hand: never positive round a closed path, but for the
        # trapezoids of the sum
        assert work < 1e-4


def test_contacts_of_the_world_are_in_what_the_linkage_gives():
    linkage = ModedLinkage(position=(2e-3, 0, 0))
    felt = linkage.render(Outlet(), rotor(0, 0, 0, 0))
    assert felt.contacts[:, 0] == pytest.approx(0.75e-3)
    assert felt.contacts[:, 2] == pytest.approx(Outlet().arm)
    assert felt.contacts[0, 5:] == pytest.approx(-felt.contacts[1, 5:], abs=1e-9)
    one = SnapFit(hooks=1).render_contacts(State.at((1e-3, 0, 0), R_SR=np.eye(3)))[1]
    assert one[0].any()
    assert not one[1].any()
    assert linkage.render(Nothing(), rotor(1, 0, 0, 0)).contacts.shape == (0, 8)


class Wrong(Outlet):
    def render_contacts(self, state):
        return super().render_contacts(state)[0], [[1.0, 2.0]]


def test_contacts_of_another_shape_are_refused():
    with pytest.raises(InputError, match=r"shape \(n, 8\); got shape \(1, 2\)"):
        ModedLinkage().render(Wrong(), rotor(0, 0, 0, 0))
