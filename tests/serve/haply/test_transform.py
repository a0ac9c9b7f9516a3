"""The tool in a client's frame: axes, mount and scale, and the transformation of its forces back."""

from __future__ import annotations

import math

import numpy as np
import pytest

from haptorb.devices.loader import load
from haptorb.errors import HaptorbError, InputError
from haptorb.serve.haply_protocol import PRESETS, Basis, Transform, default_space, parse_basis, parse_transform

TURNED = Transform((0.1, -0.2, 0.3), (0.0, 0.0, math.sin(0.4), math.cos(0.4)), (2.0, 1.0, -0.5))


def test_a_basis_names_the_axes_as_the_service_documents_it():
    assert parse_basis("YZX").name_axes((1.0, 2.0, 3.0)) == (2.0, 3.0, 1.0)  # X is forward, Y up, Z to the right
    assert parse_basis("XZY").name_axes((1.0, 2.0, 3.0)) == (1.0, 3.0, 2.0)
    assert parse_basis("X-YZ").name_axes((1.0, 2.0, 3.0)) == (1.0, -2.0, 3.0)
    for text in ("XYZ", "XZY", "X-YZ", "-Z+XY"):
        basis = parse_basis(text)
        assert basis.undo(basis.name_axes((1.0, 2.0, 3.0))) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("text", ["", "XY", "XXY", "XYZW", "abc", None, 3, "X" * 100, {"permutation": "XYZ"}])
def test_what_is_no_basis_is_refused(text):
    with pytest.raises(InputError):
        parse_basis(text)


@pytest.mark.parametrize("text", ["XYZ", "YZX", "XZY", "X-YZ"])
def test_an_orientation_turns_the_same_things_in_every_basis(text):
    """The tool's axis, named in the client's axes, is where the client's quaternion turns its own z, or −z where its
    axes are mirrored."""
    basis, q = parse_basis(text), (0.1, -0.3, 0.2, math.sqrt(1 - 0.14))
    turned = Transform(rotation=basis.name_turn(q))
    v = (0.3, -0.5, 0.8)
    assert turned.turn(basis.name_axes(v)) == pytest.approx(basis.name_axes(Transform(rotation=q).turn(v)))
    assert np.linalg.norm(basis.name_turn(q)) == pytest.approx(1.0)


def test_a_force_does_the_same_work_sign_on_both_sides():
    space = default_space(load("omni"))
    space = space.configure({"mount": {"transform": TURNED.as_json()}, "basis": {"permutation": "XZY"}})
    for force in np.eye(3):
        client = space.force(force)
        assert space.stator_force(client) == pytest.approx(force)
        assert np.linalg.norm(client) == pytest.approx(1.0)  # a newton stays a newton
        assert np.sign(np.dot(client, space.velocity(force))) == 1.0  # along the way that it pushes


def test_the_tool_at_rest_is_in_the_middle_of_the_other_devices_space():
    device = load("omni")
    space, rest = default_space(device), (0.0, 0.0, device.shell.contact_distance)
    assert space.place(rest) == pytest.approx((0.0, -0.14, 0.20))
    for name in ("arm_front_centered", "led_front_centered"):
        assert space.configure({"preset": name}).place(rest) == pytest.approx((0.0, 0.0, 0.0))
    aside = space.place((0.01, 0.0, rest[2]))
    assert aside == pytest.approx((0.02, -0.14, 0.20))
    assert space.configure({"preset": "led_front"}).place((0.01, 0.0, rest[2]))[0] == pytest.approx(-0.02)


def test_mount_and_transform_are_in_the_axes_that_the_basis_names_and_presets_follow_it():
    rest = (0.0, 0.0, load("omni").shell.contact_distance)
    plain = default_space(load("omni"))
    up = plain.configure({"basis": {"permutation": "XZY"}})
    assert up.configure({"preset": "arm_front_centered"}).place(rest) == pytest.approx((0.0, 0.0, 0.0))
    aside = (0.01, 0.0, rest[2])
    turned = plain.configure({"preset": "led_front"}).place(aside)
    assert up.configure({"preset": "led_front"}).place(aside) == pytest.approx(up.basis.name_axes(turned))
    for name in ("mount", "transform"):
        lifted = up.configure({name: {"transform": {"position": {"x": 0, "y": 1, "z": 0}}}})
        assert lifted.place(rest)[1] == pytest.approx(up.place(rest)[1] + 1.0)  # Y is up there
        assert lifted.stator_force((0.0, 1.0, 0.0)) == pytest.approx((0.0, 0.0, 1.0))


def test_the_workspace_is_adjustable():
    space = default_space(load("omni")).configure({"workspace": {"position": [0, 0, 0], "scale": 1}})
    assert space.place((0.01, 0.02, 0.05)) == pytest.approx((0.01, 0.02, 0.05))


@pytest.mark.parametrize(
    "bad",
    [
        {"mount": {}, "preset": "arm_front"},
        {"preset": "nowhere"},
        {"preset": 3},
        {"mount": {"scale": 0}},
        {"mount": {"rotation": {"x": 0, "y": 0, "z": 0, "w": 0}}},
        {"mount": {"position": {"x": math.nan}}},
        {"mount": {"position": {"x": 1e308}}},
        {"mount": {"position": {"x": 10**400}}},
        {"mount": {"position": "here"}},
        {"mount": 7},
        {"basis": {}},
    ],
)
def test_what_cannot_be_is_refused(bad):
    with pytest.raises(HaptorbError):
        default_space(load("omni")).configure(bad)


def test_presets_are_those_of_the_service():
    assert set(PRESETS) == {"defaults", "arm_front", "arm_front_centered", "led_front", "led_front_centered"}
    assert parse_transform({}) == Transform()
    assert Basis().hand == 1.0
