"""Electromagnet with tolerances: its draws, and its wrench against an independent computation."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haptorb.devices.base import rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.field_sensors import SensorErrors
from haptorb.devices.loader import load
from haptorb.devices.uncertainty import ElectromagnetTolerance
from haptorb.errors import GeometryError
from haptorb.magnetics import dipole
from haptorb.magnetics.dipole import MU0
from haptorb.magnetics.soft_sphere import SoftSphere
from haptorb.simulation.electromagnet import SimulatedElectromagnet
from haptorb.simulation.electromagnet_specimen import (
    ElectromagnetSpecimen,
    Steel,
    compute_fields,
    draw_electromagnet,
    fill_truth,
)
from haptorb_papers.reproduce.zarate2020.second_coils import list_loops, loop_field
from oracles import electromagnet_specimen as oracle
from oracles import wound_coils
from oracles.repetitions import repetitions

OMNI = load("omni")
assert isinstance(OMNI, SphericalElectromagnet)
ROUND = ElectromagnetTolerance(core_shape=0.0)
SQUASHED = ElectromagnetTolerance(core_shape=0.02)
EXACT_BUT_TURNS = ElectromagnetTolerance(
    winding="0 mm", position="0 mm", tilt="0 deg", core_position="0 mm", core_shape=0.0, earth_field="0 T"
)


@cache
def draw_omni(number: int) -> ElectromagnetSpecimen:
    """The electromagnet of the catalogue with its tolerances."""
    return draw_electromagnet(OMNI, number)


def act(built: ElectromagnetSpecimen, R: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    matrix, passive = np.empty((6, 3)), np.empty(6)
    fill_truth(built.compute_map(OMNI.dome_radius), np.ascontiguousarray(R), p, matrix, passive, np.empty((6, 3)))
    return matrix, passive


def silence(device: SphericalElectromagnet) -> SphericalElectromagnet:
    """With field sensors that add nothing."""
    return replace(device, hall=replace(device.hall, noise=0.0, step=0.0, errors=SensorErrors()))


def places(count: int, seed: int = 3):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        tilt, turn = rng.uniform(0, np.radians(60)), rng.uniform(0, 2 * np.pi)
        axis = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        R = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, 3)).as_matrix() @ rotation_to_axis(axis)
        yield R, rng.uniform(0.05, 0.07) * axis


def test_without_tolerances_it_is_the_file():
    built = draw_electromagnet(replace(OMNI, tolerance=None))
    for R, p in places(repetitions(12, 200)):
        state = replace(SimulatedElectromagnet(OMNI).state(), R_SR=R, p=p)
        matrix, passive = act(built, R, p)
        true = wound_coils.wrench_map(OMNI, state)
        assert np.linalg.norm(matrix[:3] - true[:3]) < 1e-4 * np.linalg.norm(true[:3])
        assert np.linalg.norm(matrix[3:] - true[3:]) < 1e-4 * np.linalg.norm(true[3:])
        model = OMNI.wrench_map(state, "exact").passive
        assert np.linalg.norm(passive - model) < 1e-4 * np.linalg.norm(model)


@pytest.mark.parametrize(
    ("tolerance", "within", "pulls"),
    [(ROUND, 1e-3, 1e-3), (OMNI.tolerance, 2e-3, 8e-3)],
    ids=["a ball off the centre", "an ellipsoid"],
)
def test_what_a_drawn_one_does_is_what_loops_and_charges_in_its_core_do(tolerance, within, pulls):
    """An ellipsoid's answers above the first degree are taken for a ball's: half a per cent of the pull, 0.05 mN."""
    device = replace(OMNI, tolerance=tolerance)
    for specimen, (R, p) in enumerate(places(repetitions(2, 12))):
        built = draw_electromagnet(device, specimen)
        matrix, passive = act(built, R, p)
        true, still = oracle.read_wrench(built, R, p)
        assert np.linalg.norm(matrix[:3] - true[:3]) < within * np.linalg.norm(true[:3])
        assert np.linalg.norm(matrix[3:] - true[3:]) < within * np.linalg.norm(true[3:])
        assert np.linalg.norm(passive[:3] - still[:3]) < pulls * np.linalg.norm(still[:3])
        assert np.linalg.norm(passive[3:] - still[3:]) < within * 2.41 * 50e-6 + pulls * np.linalg.norm(still[3:])


def test_an_ellipsoid_pulls_the_magnet_otherwise_than_a_ball():
    """Most of the difference is there, for a core seven times as far from a ball as by default."""
    device, left, whole = replace(OMNI, tolerance=SQUASHED), 0.0, 0.0
    for specimen, (R, p) in enumerate(places(3)):
        built = draw_electromagnet(device, specimen)
        still = oracle.read_wrench(built, R, p)[1]
        left += float(np.linalg.norm(act(built, R, p)[1][:3] - still[:3]))
        whole += float(np.linalg.norm(act(replace(built, core_stretch=np.zeros(3)), R, p)[1][:3] - still[:3]))
    assert left < 0.7 * whole


def test_the_field_at_the_sensors_is_that_of_the_same_coils():
    built = draw_electromagnet(OMNI, 4)
    at = OMNI.hall.positions
    true = oracle.read_fields(built, at)
    found = compute_fields(built.compute_map(OMNI.dome_radius), at)
    assert np.abs(found - true).max() < 1e-3 * np.abs(true).max()


def test_sensors_close_to_a_winding_read_its_field_and_not_that_of_a_few_loops():
    """Seven millimetres from the outermost one, against the windings' closed form."""
    exact = replace(OMNI, tolerance=None)
    built, at = draw_electromagnet(exact), np.array([[0.024, 0.024, 0.003], [0.034, 0.0, 0.0]])
    found = built.compute_fields(built.compute_map(OMNI.dome_radius), at)
    true = OMNI.windings.field(OMNI.core, OMNI.moment_per_current, OMNI.moments_at, at, closed=True)
    assert np.abs(found - true).max() < 1e-4 * np.abs(true).max()


def test_measured_moments_hold_whatever_the_windings_are():
    """On each coil's axis at 55 mm the field is that of the file's moments, as well as they are known."""
    known = OMNI.uncertainty.moments * np.sqrt(3)
    for specimen in range(6):
        built = draw_omni(specimen)
        for number in range(3):
            axis = built.coils.axis[number]
            field = compute_fields(built.compute_map(OMNI.dome_radius), OMNI.moments_at * axis[None])[0, :, number]
            moment = float(field @ axis) * OMNI.moments_at**3 / 2e-7
            printed = OMNI.moment_per_current[:, number]
            assert abs(moment / np.linalg.norm(printed) - 1) < 2 * known
            assert np.linalg.norm(moment * axis - printed) < 2 * known * np.linalg.norm(printed)


def test_every_value_lies_in_its_tolerance_and_no_winding_in_the_core():
    known, sizes, most = OMNI.tolerance, OMNI.windings, np.sqrt(3.0) * (1 + 1e-12)
    drawn = [draw_omni(n) for n in range(repetitions(40, 400))]
    for built in drawn:
        coils = built.coils
        assert np.abs(coils.position).max() <= most * known.position
        for name in ("inner_radius", "outer_radius", "length"):
            assert np.abs(getattr(coils, name) - getattr(sizes, name)).max() <= most * known.winding
        assert np.abs(built.core_place).max() <= most * known.core_position
        assert np.abs(built.core_stretch).max() <= 4 / 3 * most * known.core_shape
        assert 200 <= built.core.permeability <= 5000
        assert np.linalg.norm(built.earth) == pytest.approx(50e-6)
        assert abs(built.ring.remanence / OMNI.tool.remanence - 1) <= most * OMNI.uncertainty.remanence
        apart = np.linalg.norm(coils.position - built.core_place, axis=1)
        assert (coils.inner_radius > built.core.radius).all()
        assert (apart < 1.2e-3).all()
    # all alike likely: the standard deviation is the file's
    spread = np.std([one.core_place for one in drawn])
    assert spread == pytest.approx(known.core_position, rel=0.15)


def test_each_layer_has_up_to_a_turn_more_or_less():
    known, most = OMNI.tolerance.turns_per_layer, np.sqrt(3.0) * OMNI.tolerance.turns_per_layer
    full = [[23.0] * 4, [23.0] * 3 + [22.0], [21.0] * 4]  # as `haptorb inspect omni` says
    drawn = [draw_omni(n) for n in range(repetitions(40, 400))]
    more = np.array([[np.subtract(a, b) for a, b in zip(one.layers, full, strict=True)] for one in drawn])
    assert most == pytest.approx(1.0, abs=0.01)
    assert np.abs(more).max() <= most
    assert np.std(more) == pytest.approx(known, rel=0.15)
    # where the moments are computed from the windings, the coil has these turns
    computed = draw_electromagnet(
        replace(OMNI, moments_from="windings", moments_at=np.inf, tolerance=ElectromagnetTolerance(turns=0.0)), 3
    )
    assert computed.coils.turns == pytest.approx([one.sum() for one in computed.layers])
    assert np.abs(computed.coils.turns - OMNI.windings.turns).max() > 0.1


def test_a_layer_with_more_turns_is_a_layer_with_a_greater_field():
    """Against a winding each of whose layers is loops of its own, at the tool, at a sensor near it, and far away."""
    built = draw_electromagnet(replace(OMNI, tolerance=EXACT_BUT_TURNS), 3)
    counts = [np.array([26.0, 23.0, 23.0, 20.0]), built.layers[1], built.layers[2]]
    built = replace(built, layers=tuple(counts), core=SoftSphere(built.core.radius, 1.0 + 1e-9))
    at = np.array([[0.0, 0.0, 0.055], [0.04, 0.02, 0.01], [0.0, 0.0, 0.5]])
    found = built.compute_fields(built.compute_map(OMNI.dome_radius), at)[:, :, 0]
    coil, total = built.coils, float(built.coils.turns[0])
    edges = np.linspace(coil.inner_radius[0], coil.outer_radius[0], 5)
    frame = rotation_to_axis(coil.axis[0])
    true = np.zeros_like(at)
    node, share = (2 * np.arange(25) + 1) / 25 - 1, np.full(25, 0.04)
    for n in range(4):
        turns = total * counts[0][n] / counts[0].sum()
        loops = list_loops(float(edges[n]), float(edges[n + 1]), float(coil.length[0]), turns, node, share)
        true += loop_field(*loops, (at - coil.position[0]) @ frame) @ frame.T
    error = np.linalg.norm(found - true, axis=1) / np.linalg.norm(true, axis=1)
    assert error.max() < 2e-4
    # the layers matter: turns from the outermost to the innermost change it by more
    even = replace(built, layers=())
    fields = even.compute_fields(even.compute_map(OMNI.dome_radius), at)[:, :, 0]
    assert (np.linalg.norm(fields - true, axis=1) > 10 * error * np.linalg.norm(true, axis=1)).all()


def test_a_number_is_one_electromagnet_and_the_seed_is_its_number():
    def moments(*args, **named):
        return SimulatedElectromagnet(*args, **named).built.compute_moments()

    assert np.array_equal(moments(OMNI, 3), moments(OMNI, 9, specimen=3))
    assert np.array_equal(moments(OMNI, 3), draw_electromagnet(OMNI, 3).compute_moments())  # drawn anew
    assert not np.array_equal(moments(OMNI, 3), moments(OMNI, 4))
    exact = replace(OMNI, tolerance=None)
    assert np.array_equal(moments(exact, 3), moments(exact, 4))


def test_a_steel_ball_far_away_pulls_as_a_ball_does():
    """All of its answer against the dipole's, without the core: a ball of 10 mm at 90 mm from the magnet."""
    steel = Steel(np.array([0.09, 0.0, 0.06]), 10e-3)
    without = draw_electromagnet(replace(OMNI, tolerance=None))
    with_it = replace(without, steel=steel)
    R, p = rotation_to_axis(np.array([1.0, 0.0, 0.0])), np.array([0.0, 0.0, 0.06])
    pull = act(with_it, R, p)[1] - act(without, R, p)[1]
    at, _, q = oracle.magnet(without, R, p)
    true = SoftSphere(steel.radius).forces(at - steel.place, q).sum(axis=0)
    assert np.linalg.norm(pull[:3] - true) < 0.05 * np.linalg.norm(true)
    # what the coils make of it moves the magnet, and is in the field
    own = compute_fields(without.compute_map(OMNI.dome_radius), steel.place[None])[0]
    moments = 4 * np.pi / MU0 * steel.radius**3 * own.T
    made = [q @ dipole.field(np.broadcast_to(m, at.shape), at - steel.place) for m in moments]
    coils = act(with_it, R, p)[0] - act(without, R, p)[0]
    assert np.linalg.norm(coils[:3] - np.transpose(made)) < 0.01 * np.linalg.norm(made)
    there = OMNI.hall.positions
    fields = [compute_fields(one.compute_map(OMNI.dome_radius), there) for one in (with_it, without)]
    more = [dipole.field(np.broadcast_to(m, there.shape), there - steel.place) for m in moments]
    assert np.linalg.norm(fields[0] - fields[1] - np.stack(more, axis=2)) < 0.01 * np.linalg.norm(more)
    seen, unseen = (SimulatedElectromagnet(silence(replace(OMNI, tolerance=None)), steel=one) for one in (steel, None))
    for one in (seen, unseen):
        one.place(p, Rotation.from_matrix(R).as_quat())
    more = seen.sample(0.0, 0.0, True).field - unseen.sample(0.0, 0.0, True).field
    true = SoftSphere(steel.radius).compute_induced_field(at - steel.place, q, OMNI.hall.positions - steel.place)
    assert np.linalg.norm(more - true) < 0.1 * np.linalg.norm(true)


def test_the_earths_field_turns_the_tool_and_offsets_the_sensors():
    far = np.array([0.0, 0.0, 0.4])
    built = draw_electromagnet(OMNI, 1)
    moment = np.array([0.0, 0.0, float(built.ring.moment[2])])
    passive = act(built, np.eye(3), far)[1]
    assert passive[3:] == pytest.approx(np.cross(moment, built.earth), rel=0.02, abs=1e-6)
    quiet = silence(OMNI)
    still = replace(quiet, tolerance=None, tool=replace(quiet.tool, remanence=built.ring.remanence))
    simulated, exact = SimulatedElectromagnet(quiet, 1), SimulatedElectromagnet(still, 1)
    for one in (simulated, exact):
        one.place(far, (0, 0, 0, 1))
    more = simulated.sample(0.0, 0.0, True).field - exact.sample(0.0, 0.0, True).field
    # with a ball of 15 mm, of three times the field at its pole, 55 mm away
    assert np.abs(more - built.earth).max() < 2.2 * (15 / 55) ** 3 * 50e-6


def test_windings_that_never_clear_the_core_are_refused_with_what_to_change():
    within = replace(OMNI.windings, inner_radius=np.array([13.0, 19.65, 24.17]) * 1e-3)
    with pytest.raises(GeometryError, match=r"do not clear the core .* make winding, position"):
        draw_electromagnet(replace(OMNI, windings=within))
