"""Temperature of an unattended demonstration: every world of the catalogue, after the guided motion.

    python benchmarks/heat_at_rest.py [--json]

The simulated hand rests for half a minute; what the coils then take is taken for ever. A world that tires the coils
derates, and a demonstration that nobody touches would feel weaker each time that somebody comes back to it.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

from haptorb import worlds
from haptorb.devices.loader import load
from haptorb.errors import HaptorbError
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.pointer import PointerTracker
from haptorb.terminal import Column, TextTable, make_console, print_table
from haptorb.worlds.base import World

RATE = 1000.0  #: [Hz]
MOVED = 20.0  #: when every guided motion is over [s]
REST = 30.0  #: of rest before the currents are looked at [s]
LOOK = 24.0  #: for so long, several periods of what moves [s]


def rest_on(device: str, world: World, rest: float = REST, start: float = 0.0) -> dict[str, Any]:
    """Power [W] and final temperature [degC] of the coils of `device`, untouched, after `rest` [s] on `world`.

    `start` [s] of the guided motion; at MOVED the hand is at rest from the beginning.
    """
    known = load(device)
    tick = assemble(RunConfig(device=known, world=world, rate=RATE), PointerTracker())
    row, at = tick.layout.empty(), tick.layout["current_measured"]
    squares, looks = np.zeros(known.channels), 0
    with tick.driver:
        for n in range(round(start * RATE), round((MOVED + rest + LOOK) * RATE)):
            tick.prepare(n / RATE)
            tick.step(row, n / RATE)
            if n >= (MOVED + rest) * RATE:
                squares += row[at] ** 2
                looks += 1
    coils, heat = known.coils, known.coils.heat
    squares, hot = squares / looks, np.full(known.channels, heat.ambient)
    network = heat.network(known.channels)
    for _ in range(50):
        power = squares * coils.resistance_at(hot)
        hot = heat.ambient + network.steady_rise(power)[: known.channels]
    return {
        "device": device, "world": world.name, "power_W": float(power.sum()), "hottest_degC": float(hot.max() - 273.15),
        "derate_degC": heat.derate - 273.15, "trip": int(row[tick.layout["trip"]][0]),
    }  # fmt: skip


def measure(rest: float = REST) -> list[dict[str, Any]]:
    """Every world on every device that can render it."""
    found = []
    for device in ("omni", "pmsm"):
        for kind in worlds.CATALOGUE.values():
            try:
                found.append(rest_on(device, kind(), rest))
            except HaptorbError as cause:
                found.append({"device": device, "world": kind().name, "refused": str(cause)})
    return found


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--json", action="store_true")
    words = parser.parse_args()
    found = measure()
    if words.json:
        print(json.dumps(found))
        return 0
    table = TextTable((Column("device", kind="key"), Column("world", kind="key"), Column("power", "W"),
                       Column("hottest", "°C"), Column("derates", "°C")))  # fmt: skip
    for row in found:
        if "refused" not in row:
            table.add_row(row["device"], row["world"], f"{row['power_W']:.2f}", f"{row['hottest_degC']:.1f}",
                          f"{row['derate_degC']:.0f}")  # fmt: skip
    print_table(make_console(), table)
    return 0 if all(row.get("hottest_degC", 0.0) < row.get("derate_degC", 1.0) for row in found) else 1


if __name__ == "__main__":
    raise SystemExit(main())
