"""A diverging scene in a running servo: coils off with the reason until they are engaged again."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from haptorb.control.trip_reasons import Trip
from haptorb.runtime.servo import Servo
from haptorb.worlds import Scene

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("quick_starts")]
pytest.importorskip("mujoco")

# After one second the charge is so fast that a place has no meaning any more.
FALLING = """
<mujoco model="boom">
  <option timestep="0.001" gravity="0 0 -9e7" integrator="implicitfast"/>
  <worldbody>
    <body name="peg" pos="0 0 0.055" gravcomp="1">
      <joint type="slide" axis="0 0 1"/>
      <geom type="sphere" size="0.005" mass="0.05"/>
    </body>
    <body name="charge" pos="0.1 0 0.1"><freejoint/><geom type="sphere" size="0.005" mass="0.05"/></body>
  </worldbody>
</mujoco>
"""


def wait_for(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_scene_that_diverges_switches_the_coils_off_and_restarts_when_engaged(tmp_path: Path) -> None:
    file = tmp_path / "boom.xml"
    file.write_text(FALLING)
    with Servo("omni", Scene(str(file), stiffness=100.0, damping=1.0), record=False) as servo:
        wait_for(lambda: len(servo.trips) == 1)
        assert servo.trips[0].trip == Trip.MEMORY_NOT_FINITE
        assert servo.report()["coil_state"] == "off"
        assert servo.world_trouble.count("diverged") == 1
        assert "body 'charge'" in servo.world_trouble
        servo.engage()
        wait_for(lambda: servo.report()["coil_state"] == "on")
        assert not servo.world_trouble
        wait_for(lambda: len(servo.trips) == 2)
        assert [one.trip for one in servo.trips] == [Trip.MEMORY_NOT_FINITE] * 2
