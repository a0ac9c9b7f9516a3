"""What the budget derives from a motor's tolerances is what loops and charges of the simulation give for that motor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from haptorb.analysis.motor_errors import motor_errors
from haptorb.analysis.motor_tolerances import PartDeviations, ToleranceSlopes, count_layers
from haptorb.devices.loader import load
from haptorb.devices.uncertainty import MotorTolerance
from haptorb.errors import GeometryError
from haptorb.rotations import rotation_from_euler
from haptorb.simulation.motor_specimen import draw_motor, fill_field, fill_torque

MOTORS = {name: load(name) for name in ("pmsm", "pmsm-three-rings")}
PMSM = MOTORS["pmsm"]
EXACT = MotorTolerance(
    winding="0 mm", position="0 mm", tilt="0 deg", turns_per_layer=0.0, magnet_position="0 mm", magnet_tilt="0 deg"
)  # fmt: skip
#: key of [tolerance], and the beginning of its source's name
BUILT = {
    "position": "positions of the coils", "tilt": "axes of the coils", "winding": "edges of the windings",
    "turns_per_layer": "turns of each layer", "magnet_position": "positions of the magnets",
    "magnet_tilt": "axes of the magnets",
}  # fmt: skip
TURNS = [rotation_from_euler(*one) for one in ((0.3, -0.2, 1.0), (-0.05, 0.38, 4.0), (0.0, 0.1, 2.5), (0.2, 0.3, 0.3))]


@pytest.fixture(scope="module", params=["pmsm", pytest.param("pmsm-three-rings", marks=pytest.mark.slow)])
def slopes(request):
    return ToleranceSlopes(MOTORS[request.param])


def isolate(device, key):
    """Family of `device` with this tolerance alone."""
    none = {"polarization": 0.0, "polarization_spread": 0.0, "regulator": 0.0, "weight": 0.0}
    known, tolerance = device.uncertainty.model_copy(update=none), EXACT
    if key is not None:
        tolerance = EXACT.model_copy(update={key: getattr(device.tolerance, key)})
    return replace(device, tolerance=tolerance, uncertainty=known)


def lean(axes, nominal):
    """(n, 3) tilt of `axes` from the `nominal` ones, across these."""
    return axes / (axes * nominal).sum(axis=1, keepdims=True) - nominal


def find_deviations(built):
    """How the motor `built` by the simulation differs from its file."""
    device = built.device
    made = PartDeviations.none(device, len(count_layers(device)))
    made.magnets[:, :3] = built.magnet_places - device.magnets.positions
    made.magnets[:, 3:] = lean(built.magnet_axes, device.magnets.directions)
    made.coils[:, :3] = built.coil_places - device.electromagnets.positions
    made.coils[:, 3:] = lean(built.coil_axes, device.electromagnets.directions)
    layers = made.layers.shape[1]
    for j, (radii, heights, turns) in enumerate(built.turns):
        depth = (radii.max() - radii.min()) * layers / (layers - 1)
        many = len(radii) // layers
        known = device.electromagnet
        made.edges[j, 0] = radii.min() - 0.5 * depth / layers - known.inner_radius
        made.edges[j, 1] = made.edges[j, 0] + known.inner_radius + depth - known.outer_radius
        made.edges[j, 2] = np.ptp(heights) * many / (many - 1) - known.length
        counts = turns.reshape(layers, many).sum(axis=1)
        made.layers[j] = counts - known.turns / layers
    return made


def torque_of(built, R, currents):
    """(3,) torque of `currents` (c,) in every single coil, by the simulation."""
    truth, K = built.compile()._replace(groups=np.eye(len(currents))), np.empty((3, len(currents)))
    fill_torque(truth, built.strength, R, K)
    return K @ currents


@pytest.mark.parametrize("key", BUILT)
def test_a_part_that_is_not_as_in_the_file_changes_the_torque_as_its_loops_and_charges_do(slopes, key) -> None:
    device, rng = slopes._device, np.random.default_rng(1)
    nominal = draw_motor(replace(device, tolerance=None))
    wrong, sizes = [], []
    for specimen, R in enumerate(TURNS):
        built, currents = draw_motor(isolate(device, key), specimen), rng.standard_normal(len(device.electromagnets))
        true = torque_of(built, R, currents) - torque_of(nominal, R, currents)
        found = find_deviations(built).change_torque(slopes.find(R, currents, np.empty((0, 0))))
        wrong.append(found - true)
        sizes.append(true)
    assert np.linalg.norm(sizes) > 1e-3
    assert np.linalg.norm(wrong) < 0.06 * np.linalg.norm(sizes)


@pytest.mark.parametrize("key", ["magnet_position", "magnet_tilt", "placement"])
def test_magnets_and_sensors_off_their_places_change_the_readings_as_the_charges_do(slopes, key) -> None:
    device, rng = slopes._device, np.random.default_rng(2)
    k, wrong, sizes = device.sensors, [], []
    for specimen, R in enumerate(TURNS):
        placement = device.hall.errors.placement * rng.standard_normal((k, 3)) * (key == "placement")
        built = draw_motor(isolate(device, None if key == "placement" else key), specimen, placement)
        field = np.empty((k, 3))
        fill_field(built.compile(), built.strength, R, field)
        true = (field - device.sensor_field(R[None], "table")[0]).ravel()
        known = slopes.find(R, np.zeros(len(device.electromagnets)), np.eye(3 * k))
        found = known.fit_magnets.reshape(3 * k, -1) @ find_deviations(built).magnets.ravel()
        found += known.fit_sensors.reshape(3 * k, -1) @ placement.ravel()
        wrong.append(found - true)
        sizes.append(true)
    assert np.sqrt(np.mean(np.square(sizes))) > 5e-4
    assert np.linalg.norm(wrong) < 0.06 * np.linalg.norm(sizes)


@pytest.mark.parametrize("key", BUILT)
def test_they_are_as_far_off_as_the_file_says(key: str) -> None:
    model = motor_errors(PMSM, 0.3, "tracker")
    source = next(one for one in model.sources if one.name.startswith(BUILT[key]))
    rng, drawn, nominal = np.random.default_rng(3), [], model.make_trial()
    uneven = count_layers(PMSM) - count_layers(PMSM).mean() if key == "turns_per_layer" else 0.0
    for _ in range(20):
        trial = model.make_trial()
        source.perturb(rng.standard_normal(source.dimension), trial)
        parts = {
            "winding": trial.parts.edges, "turns_per_layer": trial.parts.layers - uneven,
            "position": trial.parts.coils[:, :3], "tilt": trial.parts.coils[:, 3:],
            "magnet_position": trial.parts.magnets[:, :3], "magnet_tilt": trial.parts.magnets[:, 3:],
        }  # fmt: skip
        drawn.append(parts[key])
    assert not nominal.parts.coils.any()
    standard, size = getattr(PMSM.tolerance, key), np.sqrt(np.mean(np.square(drawn)))
    axes = 2 / 3 if "tilt" in key else 1.0  # a rotation about the axis itself changes nothing
    assert size == pytest.approx(standard * np.sqrt(axes), rel=0.03)
    assert source.origin == "assumed"


def test_a_coil_is_as_uncertain_as_the_user_says_beside_its_tolerances() -> None:
    names = [one.name for one in motor_errors(PMSM, 0.3).sources]
    assert "torque per ampere of each coil" not in names
    known = PMSM.uncertainty.model_copy(update={"coil": 0.02})
    rows = {one.name: one.standard for one in motor_errors(replace(PMSM, uncertainty=known), 0.3).sources}
    assert rows["torque per ampere of each coil"] == "2 %"
    exact = [one.name for one in motor_errors(replace(PMSM, tolerance=None), 0.3).sources]
    assert not set(exact) & {name for name in names if name.startswith(tuple(BUILT.values()))}


def test_a_motor_without_a_gap_has_no_budget_of_its_tolerances() -> None:
    wide = replace(PMSM, electromagnets=replace(PMSM.electromagnets, distance=62e-3))
    with pytest.raises(GeometryError, match="no gap between coils and magnets"):
        ToleranceSlopes(wide)
