"""Regression tests of haptic programs and worlds: a simulated device, a scripted hand, and assertions on its forces.

    from haptorb.testing import assert_force_within, haptic_device, scripted_hand

    def test_the_wall_is_as_stiff_as_it_says():
        hand = scripted_hand("start 0 0 62 mm\\nmove 0 0 49 mm in 0.5 s\\nwait 0.5 s")
        with haptic_device("omni", world="wall", hand=hand) as run:
            run.play()
        assert_force_within(run.recording, "wall", newtons=0.02, between=(0.6, 1.0))

Without a process and without waiting: the whole loop is stepped by its own clock, several times faster than real
time, and gives the same numbers bit for bit in every run. `real_time=True` runs the servo as `haptorb run` does, with
servers for other programs. pytest has `haptic_device` and `scripted_hand` also as fixtures, which keep the recordings.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.lazy_names import lazy_names

if TYPE_CHECKING:
    from haptorb.testing.assertions import assert_force_within, assert_no_trip, assert_torque_within
    from haptorb.testing.run import DeviceRun, haptic_device, scripted_hand

__all__ = [
    "DeviceRun",
    "assert_force_within",
    "assert_no_trip",
    "assert_torque_within",
    "haptic_device",
    "scripted_hand",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "haptorb.testing.assertions": "assert_force_within assert_no_trip assert_torque_within",
        "haptorb.testing.run": "DeviceRun haptic_device scripted_hand",
    },
)
