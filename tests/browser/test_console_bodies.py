"""Bodies of worlds with memory on the page: they are drawn, they go where the servo's memory has them, and leave."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from haptorb.runtime.servo.servo import Servo

pytestmark = [pytest.mark.browser, pytest.mark.realtime]


@pytest.fixture
def bowl(open_servo: Any) -> Iterator[tuple[Any, Servo]]:
    """The Omni with a ball in a bowl."""
    with open_servo("omni", "ball") as opened:
        yield opened


def test_a_ball_rolls_on_the_page_where_the_servo_has_it_and_leaves_with_its_world(bowl):
    screen, servo = bowl
    screen.until("haptorb.status === 'running' && haptorb.shapes().length === 1 && haptorb.shapes()[0]")
    first = np.array(screen.tell("haptorb.shapes()[0]"))
    # At rest again it is where the servo has it; as long as it rolls, the picture is a frame behind.
    screen.until("haptorb.value('memory').slice(6, 9).every((x, i) => Math.abs(x - haptorb.shapes()[0][i]) < 1e-4)")
    # The tool comes down onto the ball, which gives way.
    for tilt in np.linspace(0.5, -0.3, 40):
        servo.point([0.05 * np.sin(tilt), 0.0, 0.05 * np.cos(tilt)])
        screen.page.wait_for_timeout(15)
    screen.until(f"Math.hypot(haptorb.shapes()[0][0] - {first[0]}, haptorb.shapes()[0][1] - {first[1]}) > 0.002")
    assert not screen.page.locator("#legend").is_visible()  # the dome has no colours: nothing to scale

    screen.page.get_by_role("combobox", name="World").select_option("dome")
    screen.until("haptorb.shapes().length === 0")
    screen.until("!document.querySelector('#legend').hidden")
    assert screen.troubles == []
