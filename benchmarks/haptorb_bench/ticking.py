"""Computing time of one tick of the whole chain, in this process and without a clock."""

from __future__ import annotations

import gc
from collections.abc import Callable
from time import perf_counter

import numpy as np

from haptorb import worlds
from haptorb.devices.api import electromagnet
from haptorb.devices.base import Device
from haptorb.devices.loader import load
from haptorb.estimation.registry import list_estimators
from haptorb.estimation.sensor_calibration import without_errors
from haptorb.runtime.assembly import make_tick
from haptorb.runtime.config import RunConfig
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.shared_memory import SLOTS
from haptorb.runtime.tick_state import TickState
from haptorb.simulation.registry import simulate
from haptorb_bench.result import Metric

__all__ = ["rows"]

_DT = 1e-3
_SNAPSHOT = 10.0  #: that a snapshot may take [µs]
_OFTEN = 16  #: ticks from one snapshot to the next
#: device, estimator, limit of the median [µs]
_CHAINS = (("omni", "tracker", 60.0), ("omni", "hall", 60.0), ("pmsm", "least-squares", 90.0))


def rows(effort: float, notify: Callable[[str], None]) -> list[Metric]:
    """Median and 99 % over 6000 ticks times `effort`, simulation of the device included and without it."""
    out = []
    for name, estimator, limit in _CHAINS:
        device = load(name)
        if estimator not in tuple(list_estimators(device)):
            continue
        notify(f"{name}, {estimator}")
        whole, chain, snapshots = _time_ticks(device, estimator, max(int(6000 * effort), 400))
        out += [
            Metric("tick", f"{name}, {estimator}: estimate, world, allocate and guard, median", float(np.median(chain)),
                "µs", limit=limit),
            Metric("tick", f"{name}, {estimator}: the same, 99 %", float(np.percentile(chain, 99)), "µs"),
            Metric("tick", f"{name}, {estimator}: whole tick, simulated device included, median",
                float(np.median(whole)), "µs"),
            Metric("tick", f"{name}, {estimator}: a snapshot of the chain, every 256 ticks, median",
                float(np.median(snapshots)), "µs", limit=_SNAPSHOT),
        ]  # fmt: skip
    return out


def _time_ticks(device: Device, estimator: str, ticks: int) -> tuple[list[float], list[float], list[float]]:
    """[µs] of each tick, of its stages without reading and writing, and of snapshots."""
    if estimator == "hall":
        device = without_errors(electromagnet(device))  # calibrated sensors: the tool is found in every tick
    driver = SimDriver(simulate(device, 0), _DT, seed=0)
    world = worlds.CATALOGUE[device.kind.world]()
    tick = make_tick(RunConfig(device=device, world=world, rate=1.0 / _DT, estimator=estimator), driver)
    row = tick.layout.empty()
    stages = tick.layout["stages"]
    state = TickState(tick)
    places = [state.find_places(np.zeros(state.size, dtype=np.uint8)) for _ in range(SLOTS)]
    whole, chain, snapshots = [], [], []
    collecting = gc.isenabled()
    gc.disable()  # as in the loop
    try:
        with driver:
            for n in range(ticks + 200):
                start = perf_counter()
                tick.step(row, n * _DT)
                took = perf_counter() - start
                if n >= 200:  # compiled, settled
                    whole.append(1e6 * took)
                    chain.append(1e6 * float(row[stages][1:-1].sum()))
                    if n % _OFTEN == 0:  # more often than in a loop, for a median
                        start = perf_counter()
                        state.copy_to(places[n // _OFTEN % SLOTS])
                        snapshots.append(1e6 * (perf_counter() - start))
    finally:
        if collecting:
            gc.enable()
    return whole, chain, snapshots
