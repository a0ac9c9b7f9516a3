"""Recording of some ticks of a simulated device, made without processes or clocks; commands between the ticks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from haptorb import Recording
from haptorb.arrays import Array
from haptorb.devices.loader import load
from haptorb.recording.mcap import Recorder
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.tick import Tick
from haptorb.runtime.world_requests import description
from haptorb.worlds import find_world
from haptorb.worlds.base import World

RATE = 1000.0
Deed = Callable[[Tick], Any]


def record_chain(
    path: Path,
    device_name: str = "omni",
    world: World | None = None,
    *,
    ticks: int = 300,
    deeds: Mapping[int, Deed] | None = None,
    estimator: str | None = None,
    change: Callable[[Array], None] | None = None,
    own: tuple[World, ...] = (),
    steps: Mapping[int, float] | None = None,
    **choices: Any,
) -> Recording:
    """`ticks` ticks of `world`; deeds: tick → what is done before it; steps: tick → time added to the clock [s].

    change: what is done to the rows (n, width) before they are written.
    """
    device = load(device_name)
    world = world or find_world(device.kind.world)()
    config = RunConfig(device=device, world=world, rate=RATE, seed=7, estimator=estimator, **choices)
    tick = assemble(config, PointerTracker())
    layout, now = tick.layout, 0.0
    rows = np.full((ticks, layout.width), np.nan)
    changes = [(0, description(world))]
    with tick.driver:
        for number, row in enumerate(rows):
            if number:
                now = now + 1.0 / RATE + (steps or {}).get(number, 0.0)
            if deeds and number in deeds:
                before = tick.world_changes
                deeds[number](tick)
                changes += [(number, description(tick.world))] if tick.world_changes > before else []
            tick.prepare(now)
            tick.step(row, now)
            row[layout["tick"]], row[layout["wall"]] = number, now
            row[layout["lateness"]] = row[layout["missed"]] = 0.0
    if change is not None:
        change(rows)
    with path.open("wb") as file:
        recorder = Recorder(file, layout, RATE, 0)
        for name, values in config.notes(own).items():
            recorder.add_metadata(name, values)
        for change_number, (number, text) in enumerate(changes):
            recorder.add_metadata("world", {"change": str(change_number), "tick": str(number), "world": text})
        recorder.append(rows)
        recorder.finish()
    return Recording(path)
