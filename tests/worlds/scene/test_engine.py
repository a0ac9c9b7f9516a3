"""Contacts, sticking, stacks, joints and tendons are MuJoCo's: identical motion without haptorb."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptorb.arrays import Array
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.worlds import Scene
from haptorb.worlds.dynamic import bind_world

mujoco = pytest.importorskip("mujoco")

#: a hand that pulls a sledge by a string and opens a door; a stack of three; a box that sticks to a slope of 25°
YARD = """
<mujoco model="yard">
  <option timestep="0.001" integrator="implicitfast" cone="elliptic"/>
  <default><geom friction="0.6 0.002 0.0005" solref="0.006 1"/></default>
  <worldbody>
    <geom name="ground" type="plane" size="0.2 0.2 0.01" pos="0 0 0.04"/>
    <geom name="slope" type="box" size="0.03 0.02 0.002" pos="0.1 0.1 0.06" euler="0 25 0"/>
    <body name="hand" pos="0 0 0.055" gravcomp="1">
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/>
      <geom type="sphere" size="0.004" mass="0.05"/><site name="here"/>
    </body>
    <body name="sledge" pos="-0.03 0 0.046"><freejoint/>
      <geom type="box" size="0.006 0.006 0.006" mass="0.02"/><site name="there" pos="0.006 0 0"/>
    </body>
    <body name="door" pos="0.02 -0.02 0.055"><joint name="hinge" type="hinge" axis="0 0 1" damping="1e-4"/>
      <geom type="box" size="0.001 0.02 0.01" pos="0 0.02 0" mass="0.02"/>
    </body>
    <body name="low" pos="0.1 -0.1 0.046"><freejoint/><geom type="box" size="0.006 0.006 0.006" mass="0.02"/></body>
    <body name="middle" pos="0.1 -0.1 0.058"><freejoint/><geom type="cylinder" size="0.006 0.006" mass="0.02"/></body>
    <body name="high" pos="0.1 -0.1 0.07"><freejoint/><geom type="box" size="0.006 0.006 0.006" mass="0.02"/></body>
    <body name="stuck" pos="0.1033 0.1 0.0672" euler="0 25 0"><freejoint/>
      <geom type="box" size="0.006 0.006 0.006" mass="0.02"/>
    </body>
  </worldbody>
  <tendon>
    <spatial name="string" limited="true" range="0 0.03"><site site="here"/><site site="there"/></spatial>
  </tendon>
</mujoco>
"""
TICKS = 1500


@pytest.fixture(scope="module")
def yard(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Array, Array]:
    """The file; what pushed the hand (n, 3) [N]; and the state at the end."""
    path = tmp_path_factory.mktemp("yard") / "yard.xml"
    path.write_text(YARD)
    scene = Scene(path, body="hand", stiffness=300.0, damping=5.0).for_device(load("omni"))
    bound = bind_world(scene, 1e-3)
    assert bound is not None
    pushes = np.empty((TICKS, 3))
    for n in range(TICKS):
        x = 0.03 * np.sin(np.pi * min(n / 1000, 1.0) / 2.0)
        pushes[n] = -bound.wrench(State.at((x, 0.0, 0.055)))[:3]
    return path, pushes, bound.memory["state"][0].copy()


def test_pushed_alike_mujoco_alone_comes_to_the_same_state(yard: tuple[Path, Array, Array]) -> None:
    path, pushes, state = yard
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    hand = model.body("hand").id
    for push in pushes:
        data.xfrc_applied[hand, :3] = push
        mujoco.mj_step(model, data)
    kinds = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
    expected = np.empty(mujoco.mj_stateSize(model, kinds))
    mujoco.mj_getState(model, data, expected, kinds)
    assert state[: len(expected)] == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_it_pulls_sticks_stacks_and_turns(yard: tuple[Path, Array, Array]) -> None:
    path, pushes, state = yard
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state[: mujoco.mj_stateSize(model, int(mujoco.mjtState.mjSTATE_FULLPHYSICS))],
                       int(mujoco.mjtState.mjSTATE_FULLPHYSICS))  # fmt: skip
    mujoco.mj_forward(model, data)
    place = {name: data.body(name).xpos for name in ("sledge", "low", "middle", "high", "stuck")}
    assert place["sledge"][0] > -0.015  # the string is 30 mm long
    assert data.ten_length[0] < 0.031
    assert place["high"][2] == pytest.approx(0.07, abs=5e-4)
    assert [place[name][0] for name in ("low", "middle", "high")] == pytest.approx([0.1] * 3, abs=5e-4)
    assert np.linalg.norm(place["stuck"] - [0.1033, 0.1, 0.0672]) < 1e-3
    assert abs(data.joint("hinge").qpos[0]) > 0.1
    assert 0.05 < np.linalg.norm(pushes, axis=1).max() < 2.5
