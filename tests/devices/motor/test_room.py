"""Clearance of a motor's parts, against point clouds at many poses of the rotor."""

from dataclasses import replace

import numpy as np
import pytest
from tests.oracles.turning_parts import draw_poses, draw_surface, least_distance, stand_along

import haptorb
from haptorb.devices.build_checks import BuildError
from haptorb.devices.loader import parse
from haptorb.devices.motor import check_range
from haptorb.devices.turning_clearance import AxialBody, TiltedAxis, find_clearance
from haptorb.rotations import rotation_from_euler

_COARSE = 0.6e-3  #: between points of a cloud that are nearest, and the true places [m]


@pytest.mark.parametrize("seed", range(10))
def test_the_distance_of_two_turning_bodies_is_that_of_their_points(seed):
    """Drawn bodies at drawn ranges of angles; where they overlap, some point of one must be in the other."""
    draw = np.random.default_rng(seed)
    bodies = []
    for least in (30e-3, 55e-3):
        low, inner = draw.uniform(least, least + 30e-3), draw.choice([0.0, draw.uniform(2e-3, 30e-3)])
        bodies.append((low, low + draw.uniform(1e-3, 10e-3), inner, inner + draw.uniform(2e-3, 12e-3)))
    low = draw.uniform(0, np.pi)
    axis = TiltedAxis(low, low + draw.uniform(0, np.pi - low))
    one, other = (draw_surface(*body, 150, draw) for body in bodies)
    found = find_clearance(AxialBody(*bodies[0]), AxialBody(*bodies[1]), axis)
    least, inside = np.inf, False
    for gamma in np.linspace(axis.low, axis.high, 40):
        at = stand_along(one, np.array([np.sin(gamma), 0.0, np.cos(gamma)]))
        least = min(least, least_distance(at, other, draw_poses(0.0, 0, draw)[:1]))
        rho, z = np.hypot(at[:, 0], at[:, 1]), at[:, 2]
        b_low, b_high, inner, outer = bodies[1]
        inside |= bool(((z > b_low) & (z < b_high) & (rho > inner) & (rho < outer)).any())
    if found > 1e-4:
        assert not inside
        assert found - 1e-9 <= least <= found + 3e-3
    elif found < -1e-3:
        assert inside
    else:
        assert least < 4e-3


def test_upside_down_and_from_the_other_side_the_distance_is_the_same():
    draw = np.random.default_rng(1)
    for _ in range(60):
        sizes = []
        for least in (30e-3, 50e-3):
            low, inner = draw.uniform(least, least + 30e-3) * draw.choice([-1, 1]), draw.uniform(0, 30e-3)
            sizes.append((low, low + draw.uniform(1e-3, 10e-3), inner, inner + draw.uniform(2e-3, 12e-3)))
        low = draw.uniform(0, np.pi)
        high = low + draw.uniform(0, np.pi - low)
        one, other = (AxialBody(*size) for size in sizes)
        found = find_clearance(one, other, TiltedAxis(low, high))
        assert find_clearance(other, one, TiltedAxis(low, high)) == pytest.approx(found, abs=1e-12)
        turned = AxialBody(-one.high, -one.low, one.inner_radius, one.outer_radius)
        assert find_clearance(turned, other, TiltedAxis(np.pi - high, np.pi - low)) == pytest.approx(found, abs=1e-4)
        halves = [TiltedAxis(low, (low + high) / 2), TiltedAxis((low + high) / 2, high)]
        least = min(find_clearance(one, other, half) for half in halves)
        assert (least <= 0) == (found <= 0) or abs(least - found) < 5e-4
        assert found <= 0 or least == pytest.approx(found, abs=5e-4)


def test_discs_that_pass_over_each_other_are_as_far_apart_as_rim_and_face():
    outer, inner = AxialBody(65.36e-3, 70.44e-3, 0.0, 15.875e-3), AxialBody(52.99e-3, 60.61e-3, 0.0, 15.88e-3)
    found = find_clearance(outer, inner, TiltedAxis(0.0, np.pi))
    assert found == pytest.approx(65.36e-3 - np.hypot(60.61e-3, 15.88e-3), abs=1e-5)
    ring, disc = AxialBody(-10e-3, -5e-3, 60e-3, 65e-3), AxialBody(50e-3, 55e-3, 0.0, 8e-3)
    found = find_clearance(ring, disc, TiltedAxis(np.pi / 6, 2.7))
    assert found == pytest.approx(np.hypot(60e-3, 5e-3) - np.hypot(55e-3, 8e-3), abs=1e-5)


def clouds(motor, draw):
    """Clouds of all parts of `motor`, by its file: what moves in the rotor's frame, what stands in the stator's."""
    coil, magnet = motor.electromagnet, motor.magnet
    radial = {
        "coils": (motor.electromagnets, coil.length, coil.outer_radius),
        "magnets": (motor.magnets, magnet.length, magnet.radius),
    }
    made = {}
    for name, (layout, length, radius) in radial.items():
        middle = layout.distance
        surface = draw_surface(middle - length / 2, middle + length / 2, 0.0, radius, 60, draw)
        made[name] = stand_along(surface, layout.directions)
    made["sensors"] = motor.sensor_layout.positions
    for name, ring, height in (
        ("ring", motor.regulator.rotor_ring, motor.regulator.rotor_height),
        ("base", motor.regulator.stator_ring, motor.regulator.stator_height),
    ):
        ends = (height - ring.length / 2, height + ring.length / 2)
        made[name] = draw_surface(*ends, ring.inner_radius, ring.outer_radius, 600, draw)
    made["handle"] = draw_surface(0.0, motor.rotor.handle_length, 0.0, 5e-3, 1000, draw)
    made["axis below"] = np.linspace(0, 1, 1000)[:, None] * [0.0, 0.0, -0.1]
    return made


@pytest.mark.parametrize("name", ["pmsm", pytest.param("pmsm-three-rings", marks=pytest.mark.slow)])
def test_what_moves_past_what_stands_has_the_room_that_the_card_states(name):
    motor, draw = haptorb.load(name), np.random.default_rng(3)
    made, poses = clouds(motor, draw), draw_poses(motor.workspace_tilt, 2, draw)
    upright = draw_poses(0.0, 0, draw)[:1]
    stated = {check.condition: check.value for check in motor.build_checks}
    found = {
        "regulator's ring on the rotor free to move": least_distance(
            made["ring"], np.concatenate([made["coils"], made["sensors"], made["base"]]), poses
        ),
        "magnets free to move": least_distance(made["magnets"], made["base"], poses),
        "handle free to move": least_distance(
            made["handle"], np.concatenate([made["coils"], made["sensors"], made["base"]]), poses
        ),
        "room for the column that carries the stator": min(
            least_distance(np.concatenate([made["ring"], made["magnets"]]), made["axis below"], poses),
            least_distance(made["coils"], made["axis below"], upright),
        ),
        "regulator's rings beside the parts of their own side": min(
            least_distance(made["ring"], made["magnets"], upright),
            least_distance(
                made["base"], np.concatenate([made["coils"], made["sensors"]]), draw_poses(0.0, 0, draw)[:1]
            ),
        ),
    }
    for condition, least in found.items():
        assert stated[condition] - 1e-6 <= least <= stated[condition] + _COARSE, condition
    gap = least_distance(made["magnets"], made["coils"], poses)
    assert gap >= stated["gap between rotor and stator"] - 1e-6


def refuse(*tables, base="pmsm"):
    with pytest.raises(BuildError) as refused:
        parse(f'based_on = "{base}"\nname = "own"\n' + "\n".join(tables), "own")
    return {check.condition: check for check in refused.value.failures}


def test_a_ring_that_cuts_its_own_rotors_magnets_is_refused():
    """Of pmsm's regulator below magnets at −36°: as the catalogue had it."""
    ring = (
        '[regulator.rotor]\nouter_radius = "54.5 mm"\ninner_radius = "47 mm"\nlength = "1 mm"\nheight = "-46 mm"\n'
        '[regulator.stator]\nouter_radius = "149 mm"\ninner_radius = "113 mm"\nlength = "15 mm"\nheight = "-48.5 mm"\n'
    )
    found = refuse(ring, base="pmsm-three-rings")
    assert set(found) == {"regulator's rings beside the parts of their own side"}
    motor = parse(f'based_on = "pmsm-three-rings"\nname = "own"\n{ring}', "own", override=True)
    rho, z, magnet = 47e-3, -46e-3, motor.magnet
    place = np.array([rho, 0.0, z]) @ motor.magnets.directions[0]  # the ring's inner edge, at 0° as a magnet
    aside = np.sqrt(rho**2 + z**2 - place**2)
    assert abs(place - motor.magnets.distance) < magnet.length / 2
    assert aside < magnet.radius


def test_a_handle_that_meets_a_coil_is_refused():
    steep = refuse('[workspace]\ntilt = "36 deg"', "[regulator.rotor]", 'height = "-66 mm"')
    assert "handle free to move" in steep


def test_magnets_that_swing_into_the_ring_on_the_base_are_refused():
    found = refuse('[regulator.stator]\ninner_radius = "60 mm"\nouter_radius = "110 mm"\nheight = "-30 mm"')
    assert found["magnets free to move"].value < 0


def test_a_ring_on_the_base_that_only_tilted_magnets_reach_is_refused():
    """Above the motor: the magnets reach up to a latitude of 29°, tilted to 60°; the ring's edge is at 49°."""
    above = '[regulator.stator]\ninner_radius = "45 mm"\nouter_radius = "60 mm"\nheight = "60 mm"\n'
    assert refuse(above)["magnets free to move"].value < 0
    found = refuse(above + '[workspace]\ntilt = "5 deg"\n[regulator.rotor]\npolarization = "1.55 T"')
    assert "magnets free to move" not in found


def test_what_carries_the_ring_on_the_base_stands_too():
    """A ring that the rotor does not reach, far below it, on a foot that it does: only where it is above its base."""
    found = refuse('[regulator.stator]\ninner_radius = "20 mm"\nouter_radius = "30 mm"\nheight = "-50 mm"')
    assert "regulator's ring on the rotor free to move" in found


def test_touching_parts_pass_and_overlapping_ones_name_their_pairs():
    condition = "electromagnets beside each other"
    room = next(check.limit for check in haptorb.load("pmsm").build_checks if check.condition == condition)
    parse(f'based_on = "pmsm"\nname = "own"\n[electromagnets]\nouter_radius = "{1e3 * room} mm"', "own")
    found = refuse(f'[electromagnets]\nouter_radius = "{1e3 * room + 0.01} mm"')
    assert set(found) == {condition}
    assert "EM1 and EM17 at 33.9°" in found[condition].note


def test_a_gap_that_is_too_narrow_to_turn_in_is_refused():
    gap = next(c.value for c in haptorb.load("pmsm").build_checks if c.condition == "gap between rotor and stator")
    assert gap == pytest.approx(67.9e-3 - 2.54e-3 - np.hypot(56.8e-3 + 3.81e-3, 15.88e-3), abs=1e-9)
    found = refuse('[magnets]\ndistance = "65.6 mm"', '[sensors]\ndistance = "61.7 mm"')
    assert set(found) == {"gap between rotor and stator"}
    assert found["gap between rotor and stator"].value > 0


@pytest.mark.parametrize("name", ["pmsm", "pmsm-three-rings"])
def test_the_card_states_the_greatest_field_that_a_sensor_reads(name):
    """Against the tables of the exact model over orientations of the whole workspace, and the coils' exact fields."""
    motor, rng = haptorb.load(name), np.random.default_rng(3)
    (check,) = check_range(motor)
    tilts = motor.workspace_tilt * rng.uniform(-1.0, 1.0, (600, 2))
    R = np.stack([rotation_from_euler(*one, spin) for one, spin in zip(tilts, rng.uniform(0, 7, 600), strict=True)])
    frames = motor.sensor_layout.frames
    magnets = np.abs(np.einsum("nka,kab->nkb", motor.sensor_field(R, "table"), frames)).max(axis=(0, 2))
    per_ampere = motor.sensor_field_per_ampere.reshape(motor.channels, motor.sensors, 3)
    coils = np.linalg.norm(np.einsum("cka,kab->ckb", per_ampere, frames), axis=2)
    greatest = float((magnets + motor.driven_current @ coils).max())
    assert 0.97 * greatest < check.value < 1.2 * greatest
    assert check.holds
    assert check.limit == 32767 * motor.hall.step


def test_a_sensor_that_clips_is_refused():
    found = refuse('[sensors]\nrange = "250 mT"')["fields within the sensors' range"]
    assert found.value > found.limit == 0.25
    motor = haptorb.load("pmsm")
    assert check_range(replace(motor, hall=replace(motor.hall, step=0.0))) == []
