"""Time of a tick of the world `path_guidance`, and its worst solution.

    python benchmarks/worlds/guidance_solve.py [--json]

A hand follows a circle, is pushed about, jumps, and turns back. Every run is the same bit for bit and is made several
times; of each tick the shortest time counts, so that what the computer did beside is left out. The longest single time
is told too.
"""

from __future__ import annotations

import json
import sys
from time import perf_counter

import numpy as np

from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.worlds import PathGuidance

TICKS, RUNS = 20_000, 5
LIMIT = 500.0  #: [µs]


def make_states() -> list[State]:
    """A hand at 1 kHz: smooth, trembling, jumping by up to 10 mm, and to and fro."""
    noise = np.random.default_rng(0)
    states, turn, aside = [], 0.0, 0.0
    for n in range(TICKS):
        pace = 0.06 * np.sin(0.001 * n) + 0.03
        turn += 1e-3 * pace / 0.021
        if n % 500 == 0:
            aside = noise.uniform(-0.01, 0.01)
        aside *= 0.995
        tilt = np.radians(25.0) + (aside + 2e-4 * noise.standard_normal()) / 0.05
        place = 0.05 * np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        states.append(State.at(place, v=(-pace * np.sin(turn), pace * np.cos(turn), 0.0)))
    return states


def main() -> None:
    """Measure and print."""
    world, states = PathGuidance(rest_pace=0.0, height=1.0).for_device(load("omni")), make_states()
    world.advance(world.begin(), states[0], 1e-3)
    shortest, single, steps = np.full(TICKS, np.inf), 0.0, 0.0
    for _ in range(RUNS):
        memory, times = world.begin(), np.empty(TICKS)
        for n, state in enumerate(states):
            start = perf_counter()
            world.advance(memory, state, 1e-3)
            times[n] = perf_counter() - start
            steps = max(steps, float(memory["steps"][0]), 99.0 if memory["steps"][0] < 0 else 0.0)
        shortest, single = np.minimum(shortest, times), max(single, float(times.max()))
    found = {
        "ticks": TICKS, "runs": RUNS, "median_us": 1e6 * float(np.median(shortest)),
        "p99_us": 1e6 * float(np.percentile(shortest, 99)), "worst_us": 1e6 * float(shortest.max()),
        "longest_single_us": 1e6 * single, "most_newton_steps": steps, "limit_us": LIMIT,
    }  # fmt: skip
    if "--json" in sys.argv[1:]:
        print(json.dumps(found, indent=1))
        return
    print(f"{TICKS} ticks, {RUNS} times: median {found['median_us']:.0f} µs, 99 % {found['p99_us']:.0f} µs, worst "
          f"{found['worst_us']:.0f} µs (limit {LIMIT:.0f} µs), at most {steps:.0f} Newton steps; "
          f"longest single time {found['longest_single_us']:.0f} µs")  # fmt: skip


if __name__ == "__main__":
    main()
