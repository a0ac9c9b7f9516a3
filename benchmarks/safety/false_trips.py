"""False trips of the guard: real time, the default device and world, busy processes beside it.

    python benchmarks/safety/false_trips.py [--minutes M] [--busy N] [--device omni]

A servo renders with the pointer led over the dome by this program, which says the pose 60 times a second, while N
processes compute. Every 10 s it computes in C for 0.3 s and lets none of its threads run: its poses expire, but it is
not dead. Nothing is broken, so a trip is false unless its reason was so, which is judged from numbers that the guard
does not use: OVERRUN by the deadlines that the recorded ticks missed in the last 0.2 s (a virtual machine's host may
take the core away: its "steal" is printed), POSE_EXPIRED and HOST_SILENT by how long this program itself was held up,
for more than 50 ms and half a second. A servo that ended because this program was held up for half a second is started
again; only rendering counts as time.
"""

from __future__ import annotations

import argparse
import ctypes
import multiprocessing
import os
import sys
from contextlib import suppress
from time import monotonic, sleep

import numpy as np

from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.errors import ServoError
from haptorb.runtime.black_box import TripRecord
from haptorb.runtime.servo import Servo

EVERY, COMPUTING = 10.0, 0.3  #: so often, and so long, the program computes in C [s]
SILENT = 0.48  #: a host that is held up for so long may count as ended: half a second less one heartbeat [s]


def compute() -> None:
    """What a busy process does."""
    while True:
        sum(range(100_000))


def place(t: float, distance: float) -> np.ndarray:
    """(3,) where the hand is at `t` [s]: circles over the dome, now and then across the summit [m]."""
    tilt = np.radians(25.0 + 25.0 * np.sin(0.7 * t))
    turn = 1.1 * t
    return distance * np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])


def steal() -> float:
    """What the host of a virtual machine took from all of its cores since it started [s]."""
    with open("/proc/stat", encoding="ascii") as file:
        return int(file.readline().split()[8]) / os.sysconf("SC_CLK_TCK")


def find_missed_share(trip: TripRecord, servo: Servo) -> float:
    """Share of the deadlines of the last 0.2 s before `trip` that were missed."""
    wall = trip.rows[:, servo.layout["wall"]][:, 0]
    window = wall[wall >= wall[-1] - 0.2]
    return max(0.0, 1.0 - (len(window) - 1) / (servo.rate * (wall[-1] - wall[0] if len(window) == len(wall) else 0.2)))


class Judge:
    """All trips so far, with what was so when they came."""

    def __init__(self) -> None:
        self.trips = self.false = self.ticks = self.missed = 0
        self._held_up = 0.0
        self._steal = steal()

    def judge(self, servo: Servo, tripped: TripRecord, pauses: list[float], at: float) -> None:
        """Print one trip and its verdict."""
        share, pause = find_missed_share(tripped, servo), max(pauses)
        so = {Trip.OVERRUN: share > 0.2, Trip.POSE_EXPIRED: pause > 0.05, Trip.HOST_SILENT: pause > SILENT}
        really = so.get(tripped.trip, False)
        self.trips += 1
        self.false += not really
        print(
            f"{'really so' if really else 'FALSE'}: {at:.1f} s {tripped.trip.name}: {100 * share:.0f} % of the "
            f"deadlines missed, this program held up for {1e3 * pause:.0f} ms, steal {steal() - self._steal:.2f} s "
            "since the last",
            flush=True,
        )
        self._steal = steal()

    def render(self, device: str, seconds: float, before: float) -> float:
        """Seconds for which one servo rendered: `seconds`, or less where a trip that was really so ended it."""
        with Servo(device, record=False) as servo:
            distance = getattr(servo.device, "contact_distance", 0.05)
            start = last = monotonic()
            pauses, known, computed = [0.0] * 30, 0, 0.0
            try:
                while (t := monotonic() - start) < seconds:
                    servo.hand.point(place(t, distance))
                    pauses = [*pauses[1:], monotonic() - last]
                    last, self._held_up = monotonic(), max(self._held_up, pauses[-1])
                    for tripped in servo.trips[known:]:
                        self.judge(servo, tripped, pauses, before + t)
                    known = len(servo.trips)
                    if servo.latest().guard == GuardState.TRIPPED:  # again, where the pose was still too old
                        servo.engage()
                    servo.check()
                    if t > computed + EVERY:
                        computed = t
                        ctypes.PyDLL(None).usleep(round(1e6 * COMPUTING))
                    sleep(1 / 60)
            except ServoError as ended:
                pause = max(*pauses, monotonic() - last)
                false = pause < SILENT
                self.false += false
                print(f"{'FALSE: ' * false}ended after {pause:.2f} s held up, started again: {ended}", flush=True)
                t = last - start
            report = servo.report()
        self.ticks += report["ticks"]
        self.missed += report["ticks"] - round(report["success_rate"] * report["ticks"])
        return t

    def summarize(self) -> str:
        """One line."""
        return (
            f"{self.ticks} ticks, {100 * (1 - self.missed / self.ticks):.3f} % on time, {self.trips} trips, "
            f"{self.false} of them false; this program was held up for {1e3 * self._held_up:.0f} ms at most"
        )


def main() -> int:
    """Exit code 1 if it tripped without a reason."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--busy", type=int, default=1)
    parser.add_argument("--device", default="omni")
    arguments = parser.parse_args()
    busy = [multiprocessing.Process(target=compute, daemon=True) for _ in range(arguments.busy)]
    for process in busy:
        process.start()
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -10)  # as the console's server does: it stands for a hand
    judge, rendered = Judge(), 0.0
    try:
        while rendered < 60.0 * arguments.minutes:
            rendered += judge.render(arguments.device, 60.0 * arguments.minutes - rendered, rendered)
    finally:
        for process in busy:
            process.kill()
        print(f"{rendered / 60:.1f} minutes of {arguments.device} beside {arguments.busy} busy processes: ", end="")
        print(judge.summarize())
    print("kept: no false trip" if not judge.false else "NOT kept")
    return 1 if judge.false else 0


if __name__ == "__main__":
    sys.exit(main())
