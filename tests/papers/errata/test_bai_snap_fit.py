"""Bai et al. 2012, section 3.2 and Fig. 8: both phases through the two modes; errata E22 to E25."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.beams import balance_face
from haptorb.control.linkage import Gains, ModedLinkage, RenderedWrench
from haptorb.devices.base import State
from haptorb.worlds import Outlet, PublishedOutlet, SnapFit

TILT = math.radians(2.0)
X_0 = 0.5 * 6.3e-3 * math.sin(TILT)
ARM = 16e-3  # h, assumed


def plug(x: float, *, y: float = 0.0, tilt: float = 0.0, vx: float = 0.0) -> State:
    """The plug with o' at X_0 + x, tilted by ε_z, which (16) counts clockwise about Z' (E23)."""
    R = Rotation.from_rotvec([0, 0, -tilt]).as_matrix()
    return State(0.0, R, np.array([X_0 + x, y, 0.0]), np.zeros(3), np.array([vx, 0.0, 0.0]))


def test_phase_1_the_pull_is_constant_and_the_side_force_falls_in_a_line(numbers) -> None:
    world = PublishedOutlet(surface_height="printed")
    x = np.linspace(0.0, 12e-3, 60)
    wrench = np.array([world.wrench(plug(place, tilt=TILT, vx=1e4)) for place in x])
    assert np.ptp(wrench[:, 0]) < 1e-9
    assert np.abs(np.diff(wrench[:, 1], 2)).max() < 1e-6 * wrench[0, 1]
    assert wrench[-1, 1] > 0  # and never zero: the plug deviates
    assert wrench[:, 2:5] == pytest.approx(0.0)
    assert -wrench[0, 0] == pytest.approx(50.97, abs=0.01)  # H_x as printed; with E9:
    pull, side, arm = numbers("bai2012", "figure 7", "fig7-17-x", "fig7-17-y", "fig7-18-arm")
    assert pull == pytest.approx(50.97 * (1 - 0.0244), abs=0.01)
    assert (side, arm) == pytest.approx((273.82, 15.89), abs=0.01)


def test_phase_2_the_torque_falls_to_zero_with_the_tilt(numbers) -> None:
    world = PublishedOutlet()
    tilts = np.radians(np.linspace(2.0, 0.0, 41))
    torque = np.array([world.wrench(plug(4e-3, tilt=tilt))[5] for tilt in tilts])
    assert (np.diff(torque) < 0).all()
    assert torque[0] == pytest.approx(world.wrench(plug(4e-3, tilt=TILT))[1] * (ARM - X_0 - 4e-3))
    assert torque[-1] == 0.0
    assert numbers("bai2012", "figure 7", "fig7-18-falls") == [1.0]


@pytest.mark.parametrize("world", [PublishedOutlet(beam="timoshenko"), Outlet()], ids=["published", "felt"])
def test_both_phases_by_hand_through_the_modes(world: PublishedOutlet | Outlet) -> None:
    linkage = ModedLinkage(position=(X_0, 0, 0), attitude=(0, 0, -TILT))
    t, lam, phi = 0.0, 0.0, 0.0

    def render(rates: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> RenderedWrench:
        R = Rotation.from_euler("XYZ", [0, lam, phi])
        w = np.array([0, rates[1], 0]) + Rotation.from_euler("Y", lam).apply([0, 0, rates[2]])
        return linkage.render(world, State(t, R.as_matrix(), np.zeros(3), w, np.zeros(3)))

    torques = [render().wrench[3:]]
    for k in range(500):  # phase 1: λ pulls
        t, lam = t + 1e-3, 0.2 * k / 500
        there = render((0, 0.4, 0))
        torques.append(there.wrench[3:])
    pulled = np.array(torques)[201:]
    assert np.linalg.norm(pulled, axis=1).max() < 0.6  # the defaults suit a motor of about 1 N·m
    assert (pulled[:, 1] < -0.1).all()  # T_λ from F_X', well above the threshold
    assert (np.diff(pulled[:, 0]) < 0).all()  # T_ψ from F_Y', falling as the plug comes out
    x = there.object.p[0]
    linkage.set_mode("rotate")
    steps = []
    for _ in range(200):  # hands still
        t += 1e-3
        there = render()
        steps.append(there.wrench[3:])
    assert there.object.p[0] == pytest.approx(x, abs=1e-12)
    assert there.share.tolist() == [0.0, 1.0]
    assert np.abs(np.diff(steps, axis=0)).max() < 0.01
    torques = [steps[-1]]
    for _ in range(600):  # phase 2: φ rights the plug, 8° of handle for 2° of plug
        t, phi = t + 1e-3, phi + math.radians(8.0) / 600
        there = render((0, 0, math.radians(8.0) / 0.6))
        torques.append(there.wrench[3:])
    size = np.linalg.norm(torques, axis=1)
    assert 0.05 < size[0] < 0.6
    assert size[-1] < 0.02 * size[0]
    assert pytest.approx(np.eye(3), abs=1e-9) == there.object.R_SR


def test_the_default_gains_keep_the_outlet_below_0_6_newton_metre() -> None:
    @dataclass
    class FixedPlug:
        """The outlet with the plug at one place, wherever the target is."""

        place: State

        def wrench(self, state: State) -> np.ndarray:
            return world.wrench(self.place)

    world, linkage = Outlet(), ModedLinkage()
    still = [State(k * 0.04, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3)) for k in range(6)]
    for rotor in still:  # the clutch engages
        linkage.render(FixedPlug(plug(0.0)), rotor)
    side = math.radians(22.5) * Gains().translate[1]

    def torque(place: State) -> float:
        return float(np.abs(linkage.render(FixedPlug(place), still[-1]).wrench).max())

    def worst(to: float, sideways: float) -> float:
        return max(
            torque(plug(x - X_0, y=y, vx=speed))
            for x in np.linspace(0, to, 40)
            for y in np.linspace(-sideways, sideways, 21)
            for speed in (-0.05, 0.05)
        )

    assert 0.5 < worst(world.arm - 1.25 * world.lead_in, side) < 0.6  # wherever the handle may go, up to the bevel
    assert 0.3 < worst(18e-3, 0.2e-3) < 0.6  # all the way out; forced aside on the bevel it may take more


def test_e22_retention_with_the_printed_sign_costs_less_than_the_hook_stores(numbers, printed) -> None:
    # eq. (11) prints tan(γ' − arctan μ) for retention; slowly pulled up the rear face from its foot to its top
    ids = ("fig6-retention-frictionless", "fig6-retention")
    assert numbers("bai2012", "figure 6", *ids) == pytest.approx([1.0, 1.218], abs=1e-3)  # μ = 0: all stored
    assert printed("bai2012", "figure 6", "fig6-retention") == pytest.approx([0.807], abs=1e-3)  # less than stored
    world = SnapFit(friction=0.3, edge=0.02e-3)
    pull = {v: world.wrench(State(0.0, np.eye(3), np.array([1.58e-3, 0, 0]), np.zeros(3), np.array([v, 0, 0])))[0]
            for v in (-1e3, 1e3)}  # fmt: skip
    assert pull[1e3] < 2.5 * pull[-1e3] < 0  # pulling it out is harder than letting it snap home
    printed_sign = balance_face(world.hook, world.hook.ramp_end, world.hook.height, world.hook.rear, -0.3)
    assert 2 * float(printed_sign.pull) == pytest.approx(2.7, abs=0.05)


def test_e23_only_one_sense_of_the_tilt_makes_equations_16_to_18_restore(numbers) -> None:
    # (17)'s side force, tilted counterclockwise, over the gradient of the springs' energy: against it
    assert numbers("bai2012", "figure 7", "fig7-16-sense") == pytest.approx([-1.0], rel=0.01)
    assert Outlet(friction=0.0).wrench(plug(0.0, tilt=-0.01))[5] < 0
    # and F_X' of (17), positive along a pull towards +X', is what the hand pulls with, not the force on the plug
    assert PublishedOutlet().wrench(plug(1e-3, vx=0.1))[0] < 0 < -PublishedOutlet().wrench(plug(1e-3, vx=0.1))[0]


def test_e24_equation_17_lacks_the_pull_that_a_tilted_face_needs(numbers) -> None:
    # ∂F_Y'/∂x ≠ ∂F_X'/∂y without friction: no energy has these forces as its gradient
    ids = ("fig7-17-curl", "fig7-felt-curl", "fig7-17-tilted")
    printed_curl, felt_curl, missing = numbers("bai2012", "figure 7", *ids)
    assert printed_curl == pytest.approx(-2 * math.tan(TILT), rel=1e-3)
    assert felt_curl == pytest.approx(0.0, abs=1e-3)
    assert missing == pytest.approx(0.19, abs=0.02)  # at the start of phase 1: a fifth of the pull


def test_e25_friction_by_the_direction_of_pulling_gives_energy(numbers) -> None:
    # (15): the hook is softer while the plug is drawn out, Ω₊ + μΩ₋, than while it is pushed in, Ω₊ − μΩ₋. Bent while
    # drawn out by a hair and let go while pushed in by a hair, it gives back more than it took
    (ratio,) = numbers("bai2012", "figure 6", "fig6-s")
    assert ratio == pytest.approx(1.30, abs=0.01)
    hair = 0.01  # of the bending; friction's loss is μ times that
    gained = 0.5 * (ratio - 1.0) - 0.134 * hair * 0.5 * (ratio + 1.0)
    assert gained / 0.5 > 0.29
