"""Messages to Foxglove, decoded by the transmitted schemas."""

from __future__ import annotations

import base64
import json
import math

import numpy as np
import pytest
from foxglove.messages import Timestamp

from haptorb.devices.loader import load
from haptorb.recording.row import RowLayout
from haptorb.serve.foxglove import ARROW_LENGTH_M, RowMessages, make_shape, make_tube, turn_to
from oracles.protobuf import Schema

STAMP = 1_700_000_000_123_456_789


def make_row(layout: RowLayout) -> np.ndarray:
    row = np.random.default_rng(7).uniform(0.1, 1.0, layout.width)
    row[layout["guard"]], row[layout["trip"]], row[layout["coil_state"]], row[layout["valid"]] = 2, 0, 1, 1
    row[layout["winding"]] = 300.15
    row[layout["q"]] = 0, 0, 0.6, 0.8
    return row


def read_all(device_name: str, row: np.ndarray | None = None) -> tuple[dict, np.ndarray, RowLayout]:
    device = load(device_name)
    layout = RowLayout.of(device)
    row = make_row(layout) if row is None else row
    found = {}
    for one in RowMessages(device, layout).topics:
        data = one.encode(row, STAMP)
        if one.topic.encoding == "json":
            found[one.topic.name] = json.loads(data)
        else:
            schema = Schema(base64.b64decode(one.topic.schema))
            found[one.topic.name] = schema.read(one.topic.schema_name, data)
    return found, row, layout


def test_pose_and_frames_are_those_of_the_row() -> None:
    found, row, layout = read_all("omni")
    (mover, target) = found["/tf"]["transforms"]
    assert (mover["parent_frame_id"], mover["child_frame_id"], target["child_frame_id"]) == (
        "stator",
        "mover",
        "hand_goal",
    )
    assert list(mover["translation"].values()) == row[layout["p"]].tolist()
    assert mover["rotation"] == {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}
    assert found["/pose"]["pose"]["position"] == mover["translation"]
    assert found["/pose"]["timestamp"] == {"seconds": STAMP // 10**9, "nanos": STAMP % 10**9}


def test_a_motor_has_its_object_and_twelve_currents() -> None:
    found, row, layout = read_all("pmsm")
    assert [one["child_frame_id"] for one in found["/tf"]["transforms"]] == ["mover", "hand_goal", "object"]
    assert list(found["/currents"]["measured_a"].values()) == row[layout["current_measured"]].tolist()


def test_numbers_have_names_units_and_values() -> None:
    found, row, layout = read_all("omni")
    modelled = row[layout["wrench_model"]]
    assert list(found["/wrench"]["model"]["force_n"].values()) == modelled[:3].tolist()
    assert list(found["/wrench"]["model"]["torque_nm"].values()) == modelled[3:].tolist()
    assert found["/temperatures"]["winding_c"]["x"] == pytest.approx(27.0)
    assert found["/state"]["guard"] == "running"
    assert found["/state"]["trip"] == "none"


def test_what_is_not_known_is_null() -> None:
    layout = RowLayout.of(load("omni"))
    row = make_row(layout)
    for name in ("wrench_actual", "p", "remaining", "trip"):
        row[layout[name]] = np.nan
    found, *_ = read_all("omni", row)
    assert found["/wrench"]["actual"]["force_n"] == {"x": None, "y": None, "z": None}
    assert found["/temperatures"]["remaining_s"] is None
    assert found["/state"]["trip"] == "unknown"
    assert [one["child_frame_id"] for one in found["/tf"]["transforms"]] == ["hand_goal"]


def test_the_arrow_points_along_the_force() -> None:
    layout = RowLayout.of(load("omni"))
    row = make_row(layout)
    row[layout["wrench_model"]][:3] = 0.0, 2.0, 0.0
    found, *_ = read_all("omni", row)
    ((arrow,),) = [entity["arrows"] for entity in found["/force"]["entities"]]
    turn = arrow["pose"]["orientation"]
    # The arrow lies along x; a quarter turn about z brings it to y.
    assert (turn["z"], turn["w"]) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))
    assert arrow["shaft_length"] + arrow["head_length"] == pytest.approx(2.0 * ARROW_LENGTH_M)


@pytest.mark.parametrize("name", ["omni", "pmsm", "arm", "arm-touch"])
def test_the_shape_has_every_part_of_the_device(name: str) -> None:
    device = load(name)
    shape = make_shape(device, Timestamp(1, 0))
    schema = Schema(shape.get_schema().data)
    entities = {one["id"]: one for one in schema.read("foxglove.SceneUpdate", shape.encode())["entities"]}
    geometry = device.geometry()
    for part in geometry.round_parts:
        entity = entities[part.name]
        assert entity["frame_id"] == ("mover" if part.moves else "stator")
        (mesh,) = entity["triangles"]
        points = np.array([[point[axis] for axis in "xyz"] for point in mesh["points"]])
        assert np.hypot(points[:, 0], points[:, 1]).max() == pytest.approx(part.outer_radius)
        assert np.ptp(points[:, 2]) == pytest.approx(part.length)
    for ball in geometry.balls:
        assert entities[ball.name]["spheres"][0]["size"]["x"] == pytest.approx(2 * ball.radius)
    known = geometry.round_parts, geometry.balls, geometry.spots, geometry.rods, geometry.edges
    assert len(entities) == sum(map(len, known))
    for edge in geometry.edges:
        entity = entities[edge.name]
        assert entity["frame_id"] == "stator"
        points = [[point[axis] for axis in "xyz"] for point in entity["lines"][0]["points"]]
        assert np.allclose(points, edge.points)


@pytest.mark.parametrize("inner", [0.0, 0.01])
def test_a_tube_is_closed_and_has_its_volume(inner: float) -> None:
    points, indices = make_tube(inner, 0.02, 0.05, sides=400)
    corners = points[np.array(indices).reshape(-1, 3)]
    volume = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(math.pi * (0.02**2 - inner**2) * 0.05, rel=1e-3)


@pytest.mark.parametrize("axis", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, 0, -0.8)])
def test_a_turn_brings_the_axis_there(axis: tuple[float, ...]) -> None:
    x, y, z, w = turn_to(axis)
    turned = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
    assert turned == pytest.approx(axis, abs=1e-12)
