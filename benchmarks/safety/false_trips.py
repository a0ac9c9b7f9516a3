"""Does the guard ever trip without a reason? Real time, the default device and world, busy processes beside it.

    python benchmarks/safety/false_trips.py [--minutes M] [--busy N] [--device omni]

A servo renders with the pointer led over the dome by this program, which says the pose 60 times a second, while N
processes compute. Every trip is false: nothing is broken, and the hand never stops.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
from contextlib import suppress
from time import monotonic, sleep

import numpy as np

from haptorb.runtime.servo.servo import Servo


def compute() -> None:
    """What a busy process does."""
    while True:
        sum(range(100_000))


def place(t: float, distance: float) -> np.ndarray:
    """(3,) where the hand is at `t` [s]: circles over the dome, now and then across the summit [m]."""
    tilt = np.radians(25.0 + 25.0 * np.sin(0.7 * t))
    turn = 1.1 * t
    return distance * np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])


def main() -> int:
    """Exit code 1 if it tripped."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--busy", type=int, default=1)
    parser.add_argument("--device", default="omni")
    arguments = parser.parse_args()
    busy = [multiprocessing.Process(target=compute, daemon=True) for _ in range(arguments.busy)]
    for process in busy:
        process.start()
    trips: list[str] = []
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -10)  # as the console's server does: it stands for a hand
    try:
        with Servo(arguments.device, record=False) as servo:
            distance = getattr(servo.device, "contact_distance", 0.05)
            begun = monotonic()
            while (t := monotonic() - begun) < 60.0 * arguments.minutes:
                servo.point(place(t, distance))
                servo.check()
                for tripped in servo.trips[len(trips) :]:
                    trips.append(f"{tripped.t:.1f} s {tripped.trip.name}")
                    print(f"tripped: {trips[-1]}", flush=True)
                    servo.engage()
                sleep(1 / 60)
            report = servo.report()
    finally:
        for process in busy:
            process.kill()
    print(
        f"{arguments.minutes:g} minutes of {arguments.device} beside {arguments.busy} busy processes, "
        f"{report['scheduler'].get('policy', '?')}: {report['ticks']} ticks, "
        f"{100 * report['success_rate']:.3f} % in time, {len(trips)} trips"
    )
    print("kept: no trip" if not trips else f"NOT kept: {', '.join(trips[:10])}")
    return 1 if trips else 0


if __name__ == "__main__":
    sys.exit(main())
