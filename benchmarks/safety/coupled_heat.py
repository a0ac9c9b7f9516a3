"""Thermally coupled coils within tolerance: comparison of true and observed winding temperature.

    python benchmarks/safety/coupled_heat.py [--devices N] [--minutes M]

Each of the Omnis has capacities and conductances of its own, every one at one end of the file's tolerance. The guard of
the loop drives them for minutes in simulated time, at 100 Hz: full current is asked of one, of two, of all coils, or of
each at random. The thermometers read the bodies, nothing reads windings and core. Limits: no winding more than 0.1 K
hotter than is observed, none above the stop temperature. Exit code 1 if one was not kept.

Last comes the price for a device that is exactly as its file: the current that the guard leaves after an hour where the
current is asked that lasts by the file, and how long it leaves the full current.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np

from haptorb.arrays import Array
from haptorb.control.protection import Protection
from haptorb.devices.api import electromagnet
from haptorb.devices.base import Device, State, WrenchMap, endurance
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.estimation.types import Estimate, Pose, Sample
from haptorb.thermal import ThermalNetwork

DT, BELOW = 0.01, 0.1
SLOW = 0.02  #: a tick where nothing changes quickly [s]
ASKED = {"one coil": (1, 0, 0), "two coils": (1, 1, 0), "all coils": (1, 1, 1), "at random": None}


def corner_network(device: Device, draw: np.random.Generator) -> ThermalNetwork:
    """A network with every value at one end of the tolerance, drawn by itself."""
    heat, network = device.coils.heat, device.coils.heat.network(device.channels)

    def shift(values: Array) -> Array:
        shifted: Array = values * (1.0 + heat.tolerance * draw.choice((-1.0, 1.0), values.shape))
        return shifted

    between = np.triu(shift(network.exchange))
    return replace(
        network, capacity=shift(network.capacity), exchange=between + between.T, to_air=shift(network.to_air)
    )


class DrivenDevice:
    """A device with coils of its own, behind the guard of the loop; a tick lasts `dt` [s]."""

    def __init__(self, device: Device, network: ThermalNetwork, dt: float) -> None:
        self._device, self._step, self._dt, self._ticks = device, network.step(dt), dt, 0
        self.rises = np.zeros(network.nodes)  #: of windings, bodies and core [K]
        self.protection = Protection(device, dt)
        place = State.at((0.0, 0.0, 0.05))
        self._estimate = Estimate(place, WrenchMap(np.zeros((6, device.channels)), np.zeros(6)), True, 0.0)
        self._pose = Pose(0.0, place.R_SR, place.p, place.w, place.v, True)

    def tick(self, asked: Array) -> Array:
        """(m,) the currents that the guard lets flow of `asked` (m,) [A]; SystemExit if it trips."""
        device, heat, rises, c = self._device, self._device.coils.heat, self.rises, self.protection.coils
        m = device.channels
        self.protection.protect_wrench(np.zeros(6), self._estimate, self._ticks * self._dt)
        if self._ticks == 0:
            self.protection.engage()
        self._ticks += 1
        held = c["current_commanded"].copy()
        rises[:] = self._step @ np.concatenate([rises, held**2 * device.coils.resistance_at(heat.ambient + rises[:m])])
        volts = held * c["cold"] * (1.0 + c["coefficient"] * (c["winding"] - c["reference"]))
        sample = Sample(0.0, held, heat.ambient + rises[m : 2 * m], np.zeros((0, 3)), self._pose, 0.0)
        self.protection.protect_currents(asked, self._estimate, sample, volts / device.supply.voltage)
        if self.protection.tripped:
            raise SystemExit(f"tripped: {self.protection.reason.name}")
        return held

    def gaps(self) -> Array:
        """(m,) by how much each winding is hotter than is observed [K]."""
        m = self._device.channels
        gaps: Array = self._device.coils.heat.ambient + self.rises[:m] - self.protection.coils["winding"]
        return gaps


def try_device(device: Device, network: ThermalNetwork, asked: Array, switches: bool, seed: int) -> tuple[float, ...]:
    """(most above observed [K], hottest winding over the stop [K], greatest excess of the observed [K])."""
    m, heat, draw = device.channels, device.coils.heat, np.random.default_rng(seed)
    driven, on = DrivenDevice(device, network, DT), np.ones(m)
    below, above, excess = -np.inf, -np.inf, -np.inf
    for amperes in asked:
        if switches and draw.random() < DT / 3.0:
            on = (draw.random(m) < 0.5).astype(float)
        driven.tick(amperes * on)
        gap = driven.gaps()
        below, excess = max(below, float(gap.max())), max(excess, float(-gap.min()))
        above = max(above, heat.ambient + float(driven.rises[:m].max()) - heat.stop)
    return below, above, excess


def find_lasting(device: SphericalElectromagnet, which: Array) -> tuple[float, float]:
    """Current that lasts in the coils `which` (m,) of a device that is exactly as its file: by the file, and as the
    guard leaves it after an hour of asking for that [A]."""
    lasting = device.sustained_current if which.sum() == 1 else device.sustained_current_together
    driven = DrivenDevice(device, device.coils.heat.network(device.channels), SLOW)
    for _ in range(round(3600 / SLOW)):
        held = driven.tick(lasting * which)
    return float((lasting * which).max()), float(held.max())


def find_peak_time(device: SphericalElectromagnet) -> tuple[float, float]:
    """How long the full current in one coil of such a device lasts from cold: by the file, and under the guard [s]."""
    driven, full = DrivenDevice(device, device.coils.heat.network(device.channels), DT), np.array(ASKED["one coil"])
    ticks = 0
    while driven.protection.coils["winding"].max() < device.coils.heat.derate:
        driven.tick(device.coils.current_limit * full)
        ticks += 1
    return endurance(device)[0][1], ticks * DT


def main() -> int:
    """All cases; exit code 1 if a limit was not kept."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", type=int, default=50, help="in each case")
    parser.add_argument("--minutes", type=float, default=4.0, help="of simulated time for each device")
    options = parser.parse_args()
    omni, well = electromagnet(load("omni")), True
    ticks = round(60 * options.minutes / DT)
    print(f"{'asked of':12} {'devices':>8} {'above observed':>15} {'above stop':>12} {'observed in excess':>19}")
    for name, which in ASKED.items():
        worst = np.full(3, -np.inf)
        for number in range(options.devices):
            draw = np.random.default_rng([number, len(name)])
            asked = np.tile(20.0 * np.array(which or (1, 1, 1), dtype=np.float64), (ticks, 1))
            found = try_device(omni, corner_network(omni, draw), asked, which is None, number)
            worst = np.maximum(worst, found)
        good = bool(worst[0] <= BELOW and worst[1] <= 0.0)
        well &= good
        print(
            f"{name:12} {options.devices:8d} {worst[0]:13.2f} K {worst[1]:10.1f} K {worst[2]:17.1f} K"
            f"{'' if good else '  NOT kept'}",
            flush=True,
        )
    for name, which in list(ASKED.items())[0:3:2]:
        by_file, left = find_lasting(omni, np.array(which, dtype=np.float64))
        print(f"continuous, {name}: {by_file:.2f} A by the file, {left:.2f} A left by the guard")
    by_file, left = find_peak_time(omni)
    print(f"full current in one coil, from cold: {by_file:.2f} s by the file, {left:.2f} s under the guard")
    print("kept" if well else "NOT kept", f": at most {BELOW:g} K above what is observed, never above stop")
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
