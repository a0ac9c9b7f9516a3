"""All quantities of a candidate: units, agreement with independent computation, and rejections."""

from dataclasses import replace

import numpy as np
import pytest

from haptorb.arrays import cap_directions
from haptorb.devices.base import State
from haptorb.devices.electromagnet import pen_distance
from haptorb.devices.electromagnet_capability import shell_capability
from haptorb.devices.loader import load
from haptorb.devices.motor import workspace_sample
from haptorb.devices.placed_coils import PlacedCoils
from haptorb.errors import InputError, UnknownName
from haptorb.magnetics.coil import COPPER_DENSITY
from haptorb_design.objectives import (
    find_worst,
    quantity,
    quantity_names,
    spread_angles,
)
from haptorb_design.problem import DesignCandidate

OMNI, PMSM = load("omni"), load("pmsm")


def of(name, device, base=None, **options):
    return quantity(name).compute(DesignCandidate(device, base or device, options))


@pytest.mark.parametrize("device", [OMNI, PMSM], ids=["omni", "pmsm"])
def test_a_catalogue_device_has_a_finite_number_for_every_quantity_of_its_kind(device):
    candidate = DesignCandidate(device, device, {"orientations": 60})
    for name in quantity_names(device.kind.name):
        assert np.isfinite(quantity(name).compute(candidate)), name


def test_unknown_names_and_other_kinds_are_refused_with_what_there_is():
    with pytest.raises(UnknownName, match="core_pull"):
        quantity("core_pul")
    with pytest.raises(InputError, match=r"'core_pull'.*spherical-electromagnet"):
        of("core_pull", PMSM)
    with pytest.raises(InputError, match=r"evaluation\.orientations"):
        of("heat_per_torque_squared", PMSM, orientations=-1)


def test_the_worst_heat_of_the_motor_is_no_less_than_on_any_grid_and_is_reached():
    R = workspace_sample(PMSM.workspace_tilt, 7, 40)
    K = PMSM.torque_characteristic(R, "table") @ PMSM.groups
    on_grid = PMSM.coils.resistance[0] / np.linalg.eigvalsh(K @ K.transpose(0, 2, 1))[:, 0].min()
    found = of("heat_per_torque_squared", PMSM)
    assert on_grid <= found * (1 + 1e-6)
    assert found < 1.15 * on_grid
    assert found == pytest.approx(of("heat_per_torque_squared", PMSM, orientations=1500), rel=1e-3)


def test_a_narrow_valley_is_found_between_the_points_of_the_sample():
    bottom = np.array([0.1, -0.2, 1.0])

    def value(R):
        psi, lam = np.arctan2(-R[:, 1, 2], R[:, 2, 2]), np.arcsin(R[:, 0, 2])
        phi = np.mod(np.arctan2(-R[:, 0, 1], R[:, 0, 0]), np.pi / 3)
        away = np.column_stack([psi, lam, 3 * (phi - bottom[2])]) - [*bottom[:2], 0.0]
        return 1.0 - np.exp(-((away / 0.1) ** 2).sum(axis=1))

    assert find_worst(value, 0.39, 400)[0] < 1e-3
    angles = spread_angles(0.39, 400)
    assert np.abs(angles[:, :2]).max() == 0.39
    assert 0 <= angles[:, 2].min() <= angles[:, 2].max() < 2 * np.pi


def test_the_ball_of_torques_lies_within_what_the_axes_alone_reach():
    from haptorb.control.capability import motor_capability

    card = motor_capability(PMSM, 5, 24)
    assert 0.6 * card.continuous.min() < of("continuous_torque", PMSM) <= card.continuous.min()
    assert 0.6 * card.peak.min() < of("peak_torque", PMSM) <= card.peak.min()


def test_forces_of_the_omni_agree_with_its_card():
    card = shell_capability(OMNI, np.array([OMNI.contact_distance]), 40).layers[0]
    assert of("continuous_force", OMNI) == pytest.approx(card.continuous_tangential_all_warm, rel=0.03)
    assert of("continuous_force", OMNI) <= card.continuous_tangential_all_warm * (1 + 1e-9)
    assert of("core_pull", OMNI) == pytest.approx(card.passive_pull, rel=1e-6)
    errors = [
        np.linalg.norm(maps["exact"].force @ np.linalg.inv(maps["published"].force) - np.eye(3), 2)
        for maps in (
            {model: OMNI.wrench_map(State.at(OMNI.contact_distance * place), model) for model in OMNI.models}
            for place in cap_directions(OMNI.workspace_half_angle, 40)
        )
    ]
    assert of("force_model_error", OMNI) == pytest.approx(max(errors), rel=0.02)


def test_the_force_of_windings_is_that_of_a_coil_array_of_them():
    """By tables of their field and solid harmonics of the core, where the quantity sums zonal harmonics."""
    device, array = load("omni-small-core"), load("tetrahedron")
    sizes = (getattr(device.windings, key) for key in ("turns", "inner_radius", "outer_radius", "length"))
    coils = replace(
        array.coils, names=("x", "y", "z"), **{key: getattr(array.coils, key)[:3] for key in
                                               ("resistance", "inductance", "current_limit")}
    )  # fmt: skip
    same = replace(array, windings=PlacedCoils(np.zeros((3, 3)), np.eye(3), *sizes), coils=coils, core=device.core)
    states = [
        State.at(device.contact_distance * np.array(place)) for place in ((0, 0, 1), (0.6, 0, 0.8), (0.48, -0.64, 0.6))
    ]
    found = np.stack([device.wrench_map(state, "exact").force for state in states])
    for one, state in zip(found, states, strict=True):
        assert one == pytest.approx(same.wrench_map(state, "exact").force, abs=2e-4 * np.abs(found).max())
    # by the dipoles of the same moments it would be another force
    points = device.wrench_map(states[0], "point-coils").force
    ratio = np.linalg.norm(found[0], axis=0) / np.linalg.norm(points, axis=0)
    assert ratio[2] < 0.85 < 1.05 < ratio[0]


def test_sizes_gaps_and_masses_are_those_of_the_files():
    assert of("envelope_radius", PMSM) == pytest.approx(np.hypot(67.9e-3 + 2.54e-3, 15.875e-3))
    assert of("magnet_volume", PMSM) == pytest.approx(24 * np.pi * 15.875e-3**2 * 5.08e-3)
    assert of("copper", PMSM) == pytest.approx(0.680, rel=5e-3)  # 24 coils of 64.9 m of 0.25 mm wire: 28.3 g
    coil = PMSM.electromagnet
    volume = np.pi * (coil.outer_radius**2 - coil.inner_radius**2) * coil.length
    assert of("copper", PMSM) == pytest.approx(24 * 0.58 * COPPER_DENSITY * volume)
    assert of("clearance", PMSM) == pytest.approx(65.36e-3 - np.hypot(60.61e-3, 15.88e-3))
    # on their sphere two coils 0 and 45° apart on the equator touch where their inner rims meet
    assert of("spacing", PMSM) > 0
    assert of("spacing", load("pmsm-thick-coils", override=True)) < 0
    heavier = replace(OMNI, tool=replace(OMNI.tool, length=2 * OMNI.tool.length, tip_distance=24e-3))
    more = 7.5e3 * (of("magnet_volume", heavier) - of("magnet_volume", OMNI))
    assert of("moving_mass", heavier, OMNI) == pytest.approx(OMNI.tool.mass + more)


def test_a_load_heats_with_its_square_and_temperature_follows_from_the_power():
    cold, warm = (of("supply_power", OMNI, load=load_) for load_ in (0.04, 0.08))
    assert warm == pytest.approx(4 * cold)
    ambient = OMNI.coils.heat.ambient
    rises = [of("temperature", OMNI, load=load_) - ambient for load_ in (0.04, 0.08)]
    assert rises[1] == pytest.approx(4 * rises[0])
    # the continuous force with all coils warm is a bound: one load takes less heat than all coils at once
    assert of("temperature", OMNI, load=of("continuous_force", OMNI)) < OMNI.coils.heat.derate


def test_a_pen_sweeps_what_is_over_the_dome_and_not_what_is_far_below():
    points = np.array([[0.05, 0.0, 0.03], [0.05, 0.0, -0.03]])
    upright, leaning = (pen_distance(OMNI, points, np.radians(lean)) for lean in (1.0, 30.0))
    assert upright[0] < 3e-3 < 40e-3 < upright[1]
    assert leaning[1] < upright[1] - 4e-3  # it reaches further down, and as far up to what its steps are apart
    assert leaning[0] < upright[0] + 1e-3
