"""Cost of a world's memory per tick: the same force without and with a memory of 32 numbers, alternately.

    python benchmarks/world_memory.py [--rounds 60] [--json]

Every tick is that of the simulated Omni, without a clock; both worlds are compiled, as those of the catalogue. In each
round each world runs 100 ticks; a round's cost is the difference of the medians. Ends with code 1 if the median over
all rounds is above 5 µs. The worlds with memory of the catalogue are told beside it, against a world that renders
nothing.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from haptorb import worlds
from haptorb.arrays import Array, Records
from haptorb.compiled import kernel
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.tick import Tick
from haptorb.worlds import DynamicWorld, MemoryField, World

LIMIT = 5.0  #: [µs]
NUMBERS = 32
TICKS = 100  #: of a round
_DT = 1e-3


@kernel
def _push(p: Array, wrench: Array) -> None:
    for i in range(6):
        wrench[i] = 0.0
    wrench[2] = 0.05 + 0.0 * p[2]


@kernel
def _remember(memory: Records, p: Array, wrench: Array) -> None:
    m = memory[0]
    m.steps += 1.0
    for i in range(m.others.size):
        m.others[i] += p[i % 3]
    _push(p, wrench)


@dataclass(frozen=True)
class Plain(World):
    """A push upwards."""

    def wrench(self, state: State) -> Array:
        """(6,) 0.05 N."""
        wrench = np.empty(6)
        _push(state.p, wrench)
        return wrench


@dataclass(frozen=True)
class Remembering(DynamicWorld):
    """The same push, and a memory that changes in every tick."""

    @property
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """32 numbers."""
        return MemoryField("steps", "1", "so far"), MemoryField("others", "m", "sums", (NUMBERS - 1,))

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) 0.05 N."""
        wrench = np.empty(6)
        _remember(memory, state.p, wrench)
        return wrench


class Runner:
    """A simulated Omni under `world`."""

    def __init__(self, world: World) -> None:
        self.tick: Tick = assemble(RunConfig(device=load("omni"), world=world, rate=1 / _DT), PointerTracker())
        self.row, self.n = self.tick.layout.empty(), 0
        self.tick.driver.open()
        self.run(500)

    def run(self, ticks: int) -> float:
        """Median time of a tick [µs]."""
        took = []
        for _ in range(ticks):
            self.tick.prepare(self.n * _DT)
            start = perf_counter()
            self.tick.step(self.row, self.n * _DT)
            took.append(perf_counter() - start)
            self.n += 1
        return 1e6 * float(np.median(took))


def main() -> int:
    """Measure, print, and judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    dynamic = [name for name, kind in worlds.CATALOGUE.items() if kind.remembers]
    with_memory = {"memory of 32 numbers": Remembering(), **{name: worlds.find_world(name)() for name in dynamic}}
    plain = {"memory of 32 numbers": Runner(Plain()), **{name: Runner(worlds.Nothing()) for name in dynamic}}
    runners = {name: Runner(world) for name, world in with_memory.items()}
    costs: dict[str, list[float]] = {name: [] for name in runners}
    gc.disable()  # as in the loop
    for _ in range(given.rounds):
        for name, runner in runners.items():
            without = plain[name].run(TICKS)
            costs[name].append(runner.run(TICKS) - without)
    found = {name: float(np.median(cost)) for name, cost in costs.items()}
    within = found["memory of 32 numbers"] <= LIMIT
    if given.json:
        print(json.dumps({"cost_us": found, "limit_us": LIMIT, "kept": within, "rounds": given.rounds}))
    else:
        for name, cost in found.items():
            print(f"{name:22} {cost:6.2f} µs more in a tick")
        print(f"limit {LIMIT:g} µs for the first: {'kept' if within else 'NOT KEPT'}")
    return 0 if within else 1


if __name__ == "__main__":
    sys.exit(main())
