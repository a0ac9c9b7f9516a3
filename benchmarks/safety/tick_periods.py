"""A loop slower than its nominal rate: observed and true winding temperatures, and when it trips.

    python benchmarks/safety/tick_periods.py [--seconds S]

The whole chain of the Omni runs in simulated time at a nominal 1 kHz and renders 5 N (clamped by the device's limits)
at contact, with ticks of 1 to 50 ms, and with patterns of late ticks that meet more than 80 % of the deadlines.
Somebody re-engages 0.3 s after every trip. Limits: OVERRUN within 0.2 s where fewer than 80 % of the deadlines are met
and never elsewhere; the observed winding at most 0.1 K below the simulated one, which differs from the device file
within its tolerance; no winding above stop.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from itertools import cycle

import numpy as np

from haptorb.arrays import Array
from haptorb.control.linkage import make_linkage
from haptorb.control.registry import make_allocator
from haptorb.control.trip_reasons import Trip
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.estimation.registry import make_estimator
from haptorb.estimation.types import HandGoal
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.tick import Tick
from haptorb.worlds.base import World

MS = 1e-3
OBSERVER_ERROR, ABOVE, SOON = 0.1, 0.0, 0.2  #: the limits [K], [K], [s]
AGAIN = 300  #: from a trip to engaging [ms]
CASES: dict[str, tuple[int, ...]] = {
    **{f"ticks of {period} ms": (period,) for period in (1, 2, 3, 5, 8, 12, 19, 20, 21, 30, 50)},
    "one of five late by 1 ms": (1, 1, 1, 1, 1, 2),
    "a gap of 19 ms every 0.2 s": (19, *(1,) * 181),
    "a gap of 40 ms every second": (40, *(1,) * 960),
}


@dataclass(frozen=True)
class Push(World):
    """5 N outwards, wherever the tool is."""

    def wrench(self, state: State) -> Array:
        return np.concatenate((5.0 * state.p / np.linalg.norm(state.p), np.zeros(3)))


def try_case(steps: tuple[int, ...], seconds: float) -> tuple[float, float, float, int]:
    """(most by which the observed winding is below the simulated one [K], greatest winding above stop [K], longest time
    to OVERRUN [s], its count) while ticks last `steps` [ms] in turn."""
    device = load("omni")
    goal = HandGoal(np.array([0.0, 0.0, device.contact_distance]), np.array([0.0, 0.0, 0.0, 1.0]), 0.0, False)
    driver = SimDriver.of(device, MS, lambda now: goal)
    tick = Tick(
        device,
        Push(),
        driver,
        make_estimator(device, "tracker", None),
        make_allocator(device),
        MS,
        make_linkage(device),
    )
    row = tick.layout.empty()
    error, above, longest, count = 0.0, -np.inf, 0.0, 0
    now, since, tripped = 0, 0, -1
    simulation = driver.simulation
    with driver:
        for step in cycle(steps):
            if now > 1000 * seconds:
                break
            tick.step(row, now * MS)
            true = simulation.winding  # type: ignore[attr-defined]
            # Observed up to now, as the simulation is: both have seen the same time.
            error = max(error, float((true - tick.protection.coils["winding"]).max()))
            above = max(above, float(true.max()) - device.coils.heat.stop)
            if tick.protection.tripped and tripped < 0:
                tripped = now
                if tick.protection.reason is Trip.OVERRUN:
                    count += 1
                    longest = max(longest, (now - since) * MS)
            elif tick.protection.tripped and now - tripped >= AGAIN and tick.engage():
                tripped, since = -1, now
            now += step
    return error, above, longest, count


def main() -> int:
    """All cases; exit code 1 if a limit was not kept."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120.0, help="of simulated time in each case")
    seconds = parser.parse_args().seconds
    well = True
    print(f"{'case':30} {'observer below':>16} {'winding − stop':>16} {'OVERRUN after':>14} {'trips':>6}")
    for name, steps in CASES.items():
        error, above, longest, count = try_case(steps, seconds)
        met = len(steps) / sum(steps)
        good = error <= OBSERVER_ERROR and above <= ABOVE and longest <= SOON and (count > 0) == (met < 0.8)
        well &= good
        after = f"{longest:.3f} s" if count else "-"
        print(
            f"{name:30} {error:14.2f} K {above:14.1f} K {after:>14} {count:6d}{'' if good else '  NOT kept'}",
            flush=True,
        )
    print(
        "kept" if well else "NOT kept",
        f": observer at most {OBSERVER_ERROR:g} K below, no winding above stop, OVERRUN in {SOON:g} s",
    )
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
