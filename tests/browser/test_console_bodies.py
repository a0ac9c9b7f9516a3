"""Bodies of worlds with memory on the page: drawn, moved with the servo's memory, and removed."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from haptorb.runtime.servo import Servo
from haptorb.worlds import RollingBall, Scene

#: one of each shape, in a row before the dome and above it; the held body has a box beside the stylus
KINDS = ("sphere", "capsule", "cylinder", "box", "ellipsoid", "mesh")
SIZES = {"sphere": "0.005", "capsule": "0.004 0.003", "cylinder": "0.005 0.005", "ellipsoid": "0.005 0.005 0.007"}
ROW = "".join(
    f'''<body pos="{0.014 * n - 0.035} -0.035 0.07"><joint type="slide" axis="0 0 1"/>
    <geom name="{kind}" type="{kind}" mass="0.01" contype="0" conaffinity="0"
    {'mesh="wedge"' if kind == "mesh" else f'size="{SIZES.get(kind, "0.005 0.005 0.005")}"'}/></body>'''
    for n, kind in enumerate(KINDS)
)
SCENE = f"""<mujoco model="kinds"><option timestep="0.001" gravity="0 0 0"/>
<asset><mesh name="wedge" vertex="-0.006 -0.006 -0.006  0.006 -0.006 -0.006  0 0.006 -0.006  0 0 0.009"/></asset>
<worldbody>{ROW}<body name="peg" pos="0 0 0.055"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
<joint type="slide" axis="0 0 1"/><geom name="flag" type="box" size="0.005 0.005 0.005" pos="0.03 0 0.03" mass="0.05"
contype="0" conaffinity="0"/></body></worldbody></mujoco>"""

pytestmark = [pytest.mark.browser, pytest.mark.realtime]


@pytest.fixture
def bowl(open_servo: Any, tmp_path: Path) -> Iterator[tuple[Any, Servo]]:
    """The Omni with a ball in a bowl, and a scene with one body of each shape."""
    (tmp_path / "kinds.xml").write_text(SCENE)
    with open_servo("omni", RollingBall() + Scene(tmp_path / "kinds.xml")) as opened:
        yield opened


def look_at(screen: Any, spots: list[tuple[float, float]]) -> Any:
    """(n, 3) the colours there, each the mean of a few pixels."""
    picture = np.asarray(Image.open(io.BytesIO(screen.page.screenshot())).convert("RGB"), dtype=float)
    return np.array([picture[round(y) - 1 : round(y) + 2, round(x) - 1 : round(x) + 2].mean((0, 1)) for x, y in spots])


def find_spots(screen: Any) -> list[tuple[float, float]]:
    """Where the middle of each shape of the scene is on the page [CSS px]."""
    corner = screen.page.locator("#scene").bounding_box()
    return [(corner["x"] + one["x"], corner["y"] + one["y"]) for one in screen.tell("haptorb.spots()")][1:]


def test_a_ball_rolls_on_the_page_where_the_servo_has_it_and_leaves_with_its_world(bowl):
    screen, servo = bowl
    screen.until(
        "haptorb.status === 'running' && haptorb.shapes().length === 8 && haptorb.shapes().every((one) => one)"
    )
    first = np.array(screen.tell("haptorb.shapes()[0]"))
    # At rest again it is where the servo has it; as long as it rolls, the picture is a frame behind.
    screen.until("haptorb.value('memory').slice(6, 9).every((x, i) => Math.abs(x - haptorb.shapes()[0][i]) < 1e-4)")

    def measure_redness() -> Any:
        colours = look_at(screen, find_spots(screen))
        return colours[:, 0] - colours[:, 2]

    # Moving shapes are blue, what the hand holds is red.
    screen.wait_for(
        lambda: (measure_redness() * ([-1] * len(KINDS) + [1]) > 40).all(), lambda: (KINDS, measure_redness().tolist())
    )
    spots = find_spots(screen)
    # The tool comes down onto the ball, which gives way.
    for tilt in np.linspace(0.5, -0.3, 40):
        servo.hand.point([0.05 * np.sin(tilt), 0.0, 0.05 * np.cos(tilt)])
        screen.page.wait_for_timeout(15)
    screen.until(f"Math.hypot(haptorb.shapes()[0][0] - {first[0]}, haptorb.shapes()[0][1] - {first[1]}) > 0.002")
    assert not screen.page.locator("#legend").is_visible()  # the dome has no colours: nothing to scale

    screen.page.get_by_role("combobox", name="World").select_option("dome")
    screen.until("haptorb.shapes().length === 0")
    screen.until("!document.querySelector('#legend').hidden")
    screen.wait_for(
        lambda: (np.ptp(look_at(screen, spots), axis=1) < 40).all(), lambda: look_at(screen, spots).tolist()
    )
    assert screen.troubles == []
