"""Quantities of coil arrays against the allocator and geometry; the design file of one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from haptorb.arrays import cap_directions
from haptorb.control.array_allocation import ArrayAllocator
from haptorb.devices.base import State, WrenchMap
from haptorb.devices.loader import load
from haptorb.devices.placed_coils import find_spacing, place_coils
from haptorb.errors import InputError
from haptorb.magnetics.dipole import MU0
from haptorb.magnetics.interaction import wrench
from haptorb.magnetics.magnets import CylinderMagnet
from haptorb.magnetics.source import PlacedSource
from haptorb_design.design_file import load_design
from haptorb_design.evaluate import evaluate
from haptorb_design.objectives import greatest_force, quantity, quantity_names
from haptorb_design.problem import DesignCandidate, build_device, write_device_text
from haptorb_design.sampling import sample

PLANAR, TETRAHEDRON = load("planar"), load("tetrahedron")
_DISK = PLANAR.tool.magnets[0]
#: one magnet has no torque about its axis
PLATFORM = replace(
    PLANAR,
    tool=replace(
        PLANAR.tool,
        magnets=tuple(replace(_DISK, position=np.array([x, 0.0, 0.0]), axis=np.array([0.0, 0.0, up]))
                      for x, up in ((-0.022, 1.0), (0.022, -1.0))),
    ),
)  # fmt: skip
EXAMPLE = Path(__file__).parents[3] / "examples" / "design" / "tetrahedron.toml"


def of(name, device, base=None, **options):
    return quantity(name).compute(DesignCandidate(device, base or device, options))


@pytest.mark.parametrize("device", [PLATFORM, TETRAHEDRON], ids=["platform", "tetrahedron"])
def test_every_quantity_of_the_kind_is_a_finite_number(device):
    candidate = DesignCandidate(device, device, {"places": 9})
    names = quantity_names("coil-array")
    assert {"peak_force", "heat_per_force_squared", "force_isotropy", "spacing", "cost", "temperature"} <= set(names)
    for name in names:
        if "torque" in name and device is TETRAHEDRON:
            with pytest.raises(InputError, match="no torque about the magnet's axis"):
                quantity(name).compute(candidate)
        else:
            assert np.isfinite(quantity(name).compute(candidate)), name


def at_a_point(device, power=np.inf):
    """`device` with a workspace that is one position, and a supply of `power`."""
    point = replace(device.surface, half_width=(1e-9, 1e-9), half_angle=1e-9)
    return replace(device, surface=point, supply=replace(device.supply, power=power))


@pytest.mark.parametrize("power", [np.inf, 150.0], ids=["by current", "by power"])
def test_the_allocator_gives_the_peak_in_every_direction_and_hardly_more_in_the_worst(power):
    for part, wide in (("force", PLANAR), ("torque", PLATFORM)):
        device = at_a_point(wide, power)
        ball = of(f"peak_{part}", device)
        here = device.wrench_map(State.at((0.0, 0.0, device.contact_height), axis=(0, 0, 1)), "exact")
        active = WrenchMap(here.matrix, np.zeros(6))
        allocator = ArrayAllocator(device.driven_current, device.greatest_resistance, part, power=power)
        rows = slice(0, 3) if part == "force" else slice(3, 6)
        dense = cap_directions(np.pi / 2, 20_000)  # the worst direction of a torque is narrow
        reach = np.abs(dense @ here.matrix[rows]) @ device.driven_current
        directions = np.vstack([dense[:: len(dense) // 150], dense[np.argmin(reach)]])
        wrenches = ball * np.eye(6)[rows]
        less, more = (
            [allocator.allocate(active, share * one @ wrenches) for one in directions] for share in (0.999, 1.02)
        )
        # A force is given exactly; of a torque, up to 3e-4 are left (measured).
        low, high = (max(np.abs(one.residual[rows]).max() for one in allocations) for allocations in (less, more))
        assert all(one.scale == 1.0 for one in less), part
        assert low < (1e-9 if part == "force" else 1e-3) * ball, part
        assert high > 5e-3 * ball, part


def test_torque_quantities_agree_with_those_of_the_magnets_field_on_the_filaments():
    """Third law: without the device's wrench map, and with a search over all directions."""
    device = at_a_point(PLATFORM)
    at = np.array([0.0, 0.0, device.contact_height + 8e-3])
    torque = np.zeros((3, device.channels))
    for magnet in device.tool.magnets:
        source = CylinderMagnet(magnet.outer_radius, magnet.length, magnet.remanence * magnet.axis[2])
        placed = PlacedSource(source, at + magnet.position, np.eye(3))
        for k, coil in enumerate(place_coils(device.windings)):
            on_coil = wrench(placed, coil.source, coil.position, coil.turn, about=at, precision=1e-3).value
            torque[:, k] -= on_coil[3:]
    values = np.linalg.eigvalsh((torque / device.coils.resistance) @ torque.T)
    assert of("heat_per_torque_squared", device, height=8e-3) == pytest.approx(1 / values[0], rel=5e-3)
    sizes = np.linalg.svd(torque, compute_uv=False)
    assert of("torque_isotropy", device, height=8e-3) == pytest.approx(sizes[2] / sizes[0], rel=5e-3)
    reach = np.abs(cap_directions(np.pi / 2, 20_000) @ torque)
    for name, current in (
        ("peak_torque", device.driven_current),
        ("continuous_torque", np.minimum(device.sustained_current_together, device.driven_current)),
    ):
        assert of(name, device, height=8e-3) == pytest.approx((reach @ current).min(), rel=5e-3), name


def test_the_stress_of_a_long_thin_winding_is_that_of_a_current_sheet():
    """B = μ0 n I in a long solenoid, so the free turns of a sheet of thickness t have the stress μ0 (n I)² r/t."""
    n = PLANAR.channels
    sizes = {"inner_radius": 20e-3, "outer_radius": 20.05e-3, "length": 4.0, "turns": 4000.0}
    windings = replace(PLANAR.windings, **{key: np.full(n, value) for key, value in sizes.items()})
    tool = replace(PLANAR.tool, magnets=(replace(_DISK, remanence=1e-12),))
    current = float(PLANAR.driven_current[0])
    expected = MU0 * (1000.0 * current) ** 2 * 20e-3 / 0.05e-3
    assert of("coil_stress", replace(PLANAR, windings=windings, tool=tool)) == pytest.approx(expected, rel=0.01)


def test_the_greatest_force_within_limits_and_power_is_that_of_a_fine_search():
    rng = np.random.default_rng(3)
    c, limit, resistance = rng.normal(size=(5, 6)), rng.uniform(0.5, 3.0, 6), rng.uniform(0.5, 2.0, 6)
    for power in (0.5, 5.0, 20.0, 1e3, np.inf):
        mu = np.geomspace(1e-4, 1e6, 400_000)[:, None, None]
        currents = np.minimum(mu[::100] * np.abs(c) / resistance, limit)
        force = np.where((resistance * currents**2).sum(-1) <= power, (np.abs(c) * currents).sum(-1), 0.0).max(axis=0)
        found = greatest_force(c, limit, resistance, power)
        assert (force <= found * (1 + 1e-12)).all()
        assert found == pytest.approx(force, rel=0.01)
    assert greatest_force(np.eye(2), np.ones(2), np.ones(2), np.inf) == pytest.approx([1.0, 1.0])


def test_the_worst_heat_is_that_of_currents_that_make_the_wrench():
    for part, device in (("force", TETRAHEDRON), ("torque", PLATFORM)):
        device = at_a_point(device, device.supply.power)
        at = device.contact_height * np.array([0.0, 0.0, 1.0])
        here = device.wrench_map(State.at(at, axis=(0, 0, 1)), "exact")
        free = ArrayAllocator(np.full(device.channels, 1e9), device.coils.resistance, part)
        heats = []
        for one in cap_directions(np.pi / 2, 300):
            wrench = 1e-3 * (
                np.concatenate([one, np.zeros(3)]) if part == "force" else np.concatenate([np.zeros(3), one])
            )
            currents = free.allocate(WrenchMap(here.matrix, np.zeros(6)), wrench).currents
            heats.append(device.coils.resistance @ currents**2 * 1e6)
        found = of(f"heat_per_{part}_squared", device, places=4)
        assert found >= max(heats) * (1 - 1e-6)
        assert found == pytest.approx(max(heats), rel=0.05)
    heat = of("heat_per_force_squared", TETRAHEDRON)
    assert of("supply_power", TETRAHEDRON, load=0.02) == pytest.approx(
        heat * 0.02**2 * (1 + TETRAHEDRON.coils.temperature_coefficient * (85 - 20)), rel=1e-6
    )
    assert of("core_pull", TETRAHEDRON) == pytest.approx(of("core_pull", load("omni")), rel=1e-3)
    # a lasting force rises with the root of the limit of heat, and any force falls with height
    assert of("continuous_force", TETRAHEDRON) < of("peak_force", TETRAHEDRON)
    assert of("peak_force", PLANAR, height=0.02) < 0.7 * of("peak_force", PLANAR)


def test_parts_and_gaps():
    # the rims of two neighbours meet on the plane between them: 2 (15.5 sin 54.7° - 14 cos 54.7°) mm
    half = 0.5 * np.arccos(-1 / 3)
    assert of("spacing", TETRAHEDRON) == pytest.approx(2e-3 * (15.5 * np.sin(half) - 14 * np.cos(half)), abs=1e-6)
    assert of("spacing", PLANAR) == pytest.approx(np.hypot(17.5e-3, 30.311e-3) - 32e-3, abs=1e-6)
    assert of("clearance", TETRAHEDRON) == pytest.approx(np.hypot(4e-3, 15.5e-3) - 15e-3, abs=1e-8)  # holes
    assert of("clearance", PLANAR) == pytest.approx(2e-3)
    assert of("copper", TETRAHEDRON) == pytest.approx(4 * 27.2e-3, rel=0.01)
    assert of("envelope_radius", TETRAHEDRON) == 30e-3
    assert of("magnet_volume", PLANAR) == pytest.approx(np.pi * 19e-3**2 * 12.5e-3)
    coil = PLANAR.windings.coil(0)
    density = 4.0 * 1000 / (30e-3 * 11e-3)  # 4 A in 1000 turns of 30 mm × 11 mm, at a hole of 5 mm
    field = 4.0 * coil.field((5e-3, 0.0, 0.0))[2] + 0.625
    assert of("coil_stress", PLANAR) == pytest.approx(density * field * 5e-3)
    crossed = replace(PLANAR.windings, position=PLANAR.windings.position * 0.9)
    assert find_spacing(crossed) == 0.0


def test_the_example_is_swept_and_its_designs_are_devices(tmp_path):
    """Lists of places, a whole list as a choice, and the first entry of a list that holds for all coils."""
    design = load_design(EXAMPLE)
    values = {
        "core": 8.6, "first": "above-20", "ring_radius": 14.2, "ring_height": 1.6, "ring_rise": 0.5, "hole": 4.4,
        "width": 13.5, "length": 7.8, "fill": "0.6",
    }  # fmt: skip
    device = build_device(design, values, "mine")
    assert device.windings.position == pytest.approx(
        1e-3 * np.array([[0, 0, 20], [14.2, 0, 1.6], [-7.1, 12.29756, 1.6], [-7.1, -12.29756, 1.6]]), abs=1e-6
    )
    assert np.degrees(np.arcsin(device.windings.axis[1:, 2])) == pytest.approx([26.565] * 3, abs=1e-3)
    assert device.windings.fill(device.coils) == pytest.approx([0.6] * 4)
    path = tmp_path / "mine.toml"
    path.write_text(write_device_text(design, values, "mine"), encoding="utf-8")
    assert load(path).digest == device.digest
    swept = [evaluate(design, number, found) for number, found in enumerate(sample(design, "sobol", 24, 1))]
    reasons = {one.refused_by for one in swept}
    refused = {reason for reason in reasons if reason.startswith("build: ")}
    assert reasons - refused <= {"", "device", "clearance", "spacing", "core_pull", "copper"}
    assert refused or "device" in reasons
    good = evaluate(design, 0, values)
    assert good.valid, good.reason
    assert good.objectives["heat_per_force_squared"] < 0.5 * of("heat_per_force_squared", TETRAHEDRON)


def test_paths_that_the_base_has_not_are_told_together(tmp_path):
    text = EXAMPLE.read_text(encoding="utf-8").replace('"windings.length.1"', '"windings.length.2"')
    text = text.replace('"windings.position.2.1"', '"windings.position.5.1"').replace("core.radius", "core.radus")
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        load_design(path)
    for part in ("windings.position of device 'tetrahedron' has 4 entries", "has 1 entries", "'core.radius'?"):
        assert part in str(refused.value)
