"""Cost per tick of a replayable recording: readings and commands in the row, and a state at intervals.

    python benchmarks/recordings/replay_cost.py [--ticks 6000] [--json]

Both devices with their defaults, in this process and without a clock. Blocks of ticks with everything, and without what
only a replay needs, take turns; each figure is the 10th percentile over all ticks of its kind, with the simulation left
out (`prepare`). `state` is what one saved state takes, spread over the ticks between two.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from haptorb.devices.loader import load
from haptorb.runtime import tick as module
from haptorb.runtime.assembly import assemble
from haptorb.runtime.black_box import SNAPSHOT_INTERVAL_TICKS
from haptorb.runtime.config import RunConfig
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.shared_memory import SLOTS
from haptorb.runtime.tick import Tick
from haptorb.runtime.tick_log import TickLog
from haptorb.runtime.tick_state import TickState
from haptorb.worlds import find_world

_BLOCK = 100  #: ticks of one kind in a row


def time_ticks(tick: Tick, first: int, count: int) -> list[float]:
    """What `count` ticks from number `first` on take [s]."""
    row, took = tick.layout.empty(), []
    for number in range(first, first + count):
        now = 1e-3 * number
        tick.prepare(now)
        begin = perf_counter()
        tick.step(row, now)
        took.append(perf_counter() - begin)
    return took


def do_nothing(*given: Any) -> None:
    """In place of what is left out."""


def measure_device(name: str, ticks: int) -> dict[str, float]:
    """Times of a tick [µs], and what the replay's part of it is [1]."""
    device = load(name)
    tick = assemble(RunConfig(device=device, world=find_world(device.kind.world)()), PointerTracker())
    parts: list[tuple[Any, str, Callable[..., None]]] = [
        (module, "fill_pose", module.fill_pose), (TickLog, "fill", TickLog.fill),
    ]  # fmt: skip
    times: dict[bool, list[float]] = {True: [], False: []}
    with tick.driver:
        time_ticks(tick, 0, 500)
        for number, first in enumerate(range(500, 500 + 2 * ticks, _BLOCK)):
            whole = number % 2 == 0
            for owner, attribute, works in parts:
                setattr(owner, attribute, works if whole else do_nothing)
            times[whole] += time_ticks(tick, first, _BLOCK)
        for owner, attribute, works in parts:
            setattr(owner, attribute, works)
        taken = TickState(tick)
        memory = np.zeros((SLOTS, taken.size), dtype=np.uint8)
        places = [taken.find_places(slot) for slot in memory]
        saved = []
        row, crowd = tick.layout.empty(), np.zeros(2_000_000)
        for number in range(300):
            tick.step(row, 1e-3 * (500 + 2 * ticks + number))
            crowd += 1.0  # 16 MB: between two snapshots, others have the caches
            begin = perf_counter()
            taken.copy_to(places[number % SLOTS])
            saved.append(perf_counter() - begin)
    whole, less, state = (1e6 * float(np.percentile(one, 10)) for one in (times[True], times[False], saved))
    cost = whole - less + state / SNAPSHOT_INTERVAL_TICKS
    return {
        "tick_us": whole,
        "fields_us": whole - less,
        "snapshot_us": state,
        "snapshot_bytes": taken.size,
        "state_us": state / SNAPSHOT_INTERVAL_TICKS,
        "share": cost / (whole - cost),
    }


def main() -> None:
    """Measure, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ticks", type=int, default=6000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    load_before = os.getloadavg()[0]
    found = {name: measure_device(name, options.ticks) for name in ("omni", "pmsm")}
    if options.json:
        print(json.dumps({"load_before": load_before, **found}, indent=1))
        return
    print(f"load before: {load_before:.2f}")
    for name, one in found.items():
        print(
            f"{name:6} tick {one['tick_us']:5.1f} µs, of it fields {one['fields_us']:.2f} and states "
            f"{one['state_us']:.2f} µs: {100 * one['share']:.1f} % on top"
        )


if __name__ == "__main__":
    main()
