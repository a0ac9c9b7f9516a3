"""Device of a trial on a real loop, while the study's program gets no processor time."""

from __future__ import annotations

import time

import numpy as np
import pytest

from haptorb.runtime.servo import Servo
from haptorb_study.study_file import Study
from haptorb_study.trial_device import TrialDevice


@pytest.mark.realtime
def test_a_steered_pen_rests_while_the_program_waits_for_a_processor(identify: Study) -> None:
    """Two pages of one session and a start of the device can keep it waiting for 0.2 s; a pose expires after 0.05 s."""
    with Servo(identify.device, identify.world_name, record=False) as servo:
        device = TrialDevice(identify, servo)
        device.repeat_goal()
        cursor = servo.rows()[0]
        deadline = time.monotonic() + 20.0
        while servo.rows()[0] < cursor + 400 and time.monotonic() < deadline:
            time.sleep(0.01)
        _, rows = servo.rows(cursor)
        age = rows[:, servo.layout["age"]]
        assert len(rows) >= 300
        assert np.nanmax(age) < servo.device.limits.expiry
        device.poll_trips()
        assert device.trips == []
