"""Run the loop on the simulated device, with a client beside it that drags and reads as a console does."""

from __future__ import annotations

import math
from time import monotonic, sleep

import numpy as np

from haptorb.apps.check.fitness import Fitness
from haptorb.apps.check.machine import StolenTimeCounter, this_machine
from haptorb.apps.terminal import make_progress
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.runtime.servo.servo import Servo

__all__ = ["drag_position", "measure_fitness"]

_FRAME = 1 / 60  #: a console's [s]


def measure_fitness(
    duration: float = 30.0, *, rate: float = 1000.0, device: str = "omni", dragging: bool = True, progress: bool = True
) -> Fitness:
    """Run for `duration` [s] and judge. With `dragging`, a client in this process points and reads at 60 Hz.

    Shows a progress bar on the terminal by default. Raises InputError for a duration that is no time.
    """
    if not (math.isfinite(duration) and duration >= 0.5):
        raise InputError(f"duration must be at least 0.5 s; got {duration!r} s")
    with (
        make_progress(show=progress) as bar,
        Servo(device, rate=rate, record=False) as servo,
    ):
        task = bar.add_task("measuring the loop", total=duration)
        watch, begin, cursor = StolenTimeCounter(servo.servo_pid), monotonic(), 0
        while (t := monotonic() - begin) < duration:
            servo.check()
            if dragging:
                servo.point(drag_position(t))
                cursor, _ = servo.rows(cursor)
            if int(t / _FRAME) % 30 == 0:
                bar.update(task, completed=t)
            sleep(max(_FRAME - (monotonic() - begin - t), 0.0))
        took = watch.measure()
    return Fitness(servo.report(), this_machine(), took, duration, dragging)


def drag_position(t: float) -> Array:
    """(3,) [m] where the client holds the pointer: round and round the summit, leaning on the dome."""
    tilt, turn = math.radians(15 + 12 * math.sin(0.9 * t)), 1.7 * t
    return 0.048 * np.array([math.sin(tilt) * math.cos(turn), math.sin(tilt) * math.sin(turn), math.cos(tilt)])
