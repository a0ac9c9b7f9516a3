"""Faulty current sensors: time until the guard trips, and false trips.

    python benchmarks/safety/current_faults.py [--hours H] [--faults N]

The whole chain runs in simulated time at 1 kHz. Faults: a sensor that reads 0, a tenth, ten times the current, or 3 A
too much, injected while its coil carries at least a sixth of its limit (an offset: at any time); what counts is the
time until the trip, whatever its reason. False trips: hours of rendering on a simulated device that is not what the
controller's device file says: resistance 8 % higher, inductance 30 % higher, supply 5 % lower, sensors 2 % and 0.5 % of
the limit off.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from haptorb import worlds
from haptorb.control.linkage import make_linkage
from haptorb.control.registry import make_allocator
from haptorb.control.trip_reasons import Trip
from haptorb.devices.base import Device
from haptorb.devices.loader import load
from haptorb.devices.motor import SphericalMotor
from haptorb.estimation.registry import check_estimator, make_estimator
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.tick import Tick
from haptorb.simulation.hand_motion import HandleMotion

DT = 1e-3
LIMIT = 0.050  #: to the trip [s]
WORLDS = {
    "omni": ("dome", "wall", "terrain", "magnet", "orbit", "fluid", "vibration"),
    "pmsm": ("outlet", "outlet-published", "snap_fit", "detents"),
}
FAULTS: dict[str, Callable[[float], float]] = {
    "reads 0": lambda i: 0.0,
    "reads a tenth": lambda i: 0.1 * i,
    "reads ten times": lambda i: 10.0 * i,
    "reads 3 A more": lambda i: i + 3.0,
}


class Lying(Driver):
    """A simulated driver whose current sensors `lie`."""

    name, simulated = "sim", True

    def __init__(self, inner: SimDriver, gain: float = 1.0, offset: float = 0.0) -> None:
        self.inner, self.gain, self.offset = inner, gain, offset
        self.lie: tuple[int, Callable[[float], float]] | None = None
        self.lead = inner.lead

    def open(self) -> None:
        self.inner.open()

    def close(self) -> None:
        self.inner.close()

    def prepare(self, now: float) -> None:
        self.inner.prepare(now)

    def read(self, now: float):
        sample = self.inner.read(now)
        currents = self.gain * sample.currents + self.offset
        if self.lie is not None:
            coil, lie = self.lie
            currents[coil] = lie(float(sample.currents[coil]))
        return replace(sample, currents=currents)

    def write(self, duties):
        return self.inner.write(duties)

    def wrench_actual(self):
        return self.inner.wrench_actual()

    def hand_goal(self):
        return self.inner.hand_goal()


def imperfect(device: Device) -> Device:
    """`device` as it might have been built."""
    coils = replace(device.coils, resistance=1.08 * device.coils.resistance, inductance=1.3 * device.coils.inductance)
    return replace(device, coils=coils, supply=replace(device.supply, voltage=0.95 * device.supply.voltage))


def chain(device: Device, built: Device, world: str, seed: int) -> tuple[Tick, Lying]:
    """The chain for `device` on the simulation of `built`."""
    tracker = PointerTracker()
    if isinstance(device, SphericalMotor):
        tracker.guide = HandleMotion()
    off = 0.0 if built is device else 0.005 * float(device.coils.current_limit[0])
    driver = Lying(SimDriver.of(built, DT, tracker.goal, seed), 1.0 if built is device else 1.02, off)
    estimator = make_estimator(device, check_estimator(device, None), None)
    kind = worlds.find_world(world)()
    return Tick(device, kind, driver, estimator, make_allocator(device), DT, make_linkage(device)), driver


def run(tick: Tick, ticks: int, start: int = 0) -> Iterator[int]:
    """Step the chain; yields after every tick."""
    row = tick.layout.empty()
    for n in range(start, start + ticks):
        tick.prepare(n * DT)
        tick.step(row, n * DT)
        yield n


def detect(name: str, count: int) -> bool:
    """Inject `count` faults of each kind into device `name`; prints how long each took."""
    device = load(name)
    limit = float(device.coils.current_limit[0])
    random = np.random.default_rng(0)
    well = True
    for fault, lie in FAULTS.items():
        times, missed, reasons = [], 0, set()
        for number in range(count):
            world = WORLDS[name][number % len(WORLDS[name])]
            tick, driver = chain(device, device, world, number)
            least = limit / 6 if "3 A" not in fault else 0.0
            wait = int(random.integers(400, 3000))
            injected: int | None = None
            with driver:
                for n in run(tick, 12000):
                    if injected is None:
                        currents = np.abs(tick.protection.coils["model"])
                        coil = int(np.argmax(currents)) if least else number % device.channels
                        if n >= wait and currents[coil] >= least:
                            driver.lie, injected = (coil, lie), n
                    elif tick.protection.tripped:
                        times.append((n - injected) * DT)
                        reasons.add(tick.protection.reason.name)
                        break
                    elif n - injected > 1000:
                        missed += 1
                        break
        worst = max(times, default=float("nan"))
        good = bool(times) and not missed and worst <= LIMIT
        well &= good
        found = f"median {1e3 * np.median(times):.0f} ms, longest {1e3 * worst:.0f} ms" if times else "never"
        why = ", ".join(sorted(reasons))
        print(f"{name}: a sensor {fault}: {len(times)} of {len(times) + missed} found, {found} ({why})", flush=True)
    return well


def rest(name: str, hours: float) -> bool:
    """Render for `hours` of simulated time on an imperfect `name`; prints the trips, of which there must be none."""
    device = load(name)
    built = imperfect(device)
    trips: list[str] = []
    share = int(hours * 3600 / DT / len(WORLDS[name]))
    for number, world in enumerate(WORLDS[name]):
        tick, driver = chain(device, built, world, number)
        with driver:
            for _ in run(tick, share):
                if tick.protection.tripped:
                    # Heat derates and stops by right: these worlds are rendered without a pause.
                    if tick.protection.reason is not Trip.OVERHEATED:
                        trips.append(f"{world}: {tick.protection.reason.name}")
                    tick.engage()
    print(f"{name}: {hours:g} h of rendering on an imperfect device: {len(trips)} false trips {trips[:5]}")
    return not trips


def main() -> int:
    """Both devices; exit code 1 if a fault was found too late or a trip was false."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--faults", type=int, default=50)
    arguments = parser.parse_args()
    well = True
    for name in WORLDS:
        well &= detect(name, arguments.faults)
    for name in WORLDS:
        well &= rest(name, arguments.hours)
    print("kept" if well else "NOT kept", f": trip within {1e3 * LIMIT:.0f} ms, no false trip")
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
