"""The supply's power limit in 10⁶ random wrenches: never above it, always along the wrench, with the reason stated.

    python benchmarks/supply_power.py [--wrenches N]

The Omni with its exact and its published model, where the file's limit holds; and the motor of Bai 2012 with 300 W, as
its file has none. Poses are random over the shell and over all orientations, wrenches random in direction and about up
to twice what one coil can give. Power is Σ R i² with every winding at its stop temperature. Exit code 1 if any is above
the limit, or turned away from the wrench by more than 10⁻⁶ of it.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from time import perf_counter

import numpy as np

from haptorb.control.allocation.allocator import Allocator, Saturation
from haptorb.control.allocation.for_device import force_allocator, torque_allocator
from haptorb.devices.device import Device
from haptorb.devices.loader import load
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap

PER_POSE = 500
DRIFT = 1e-6


def tool_maps(device: Device, model: str, draw: np.random.Generator) -> Iterator[WrenchMap]:
    """Maps of a radial tool over the upper half of the shell."""
    while True:
        way = draw.normal(size=3) + np.array([0.0, 0.0, 2.0])
        yield device.wrench_map(State.at(draw.uniform(0.05, 0.07) * way / np.linalg.norm(way)), model)


def rotor_maps(device: Device, model: str, draw: np.random.Generator) -> Iterator[WrenchMap]:
    """Maps of a rotor in any orientation."""
    while True:
        turn = np.linalg.qr(draw.normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        yield device.wrench_map(State(0.0, turn, np.zeros(3), np.zeros(3), np.zeros(3)), model)


def try_case(
    device: Device, maps: Iterator[WrenchMap], allocator: Allocator, part: int, count: int, seed: int
) -> tuple[float, float, Counter[Saturation]]:
    """(greatest power over the limit's, greatest error of direction, how often each limit held) of `count` wrenches."""
    draw = np.random.default_rng(seed)
    hot, rows = device.greatest_resistance, slice(part, part + 3)
    most, drift, reasons = 0.0, 0.0, Counter[Saturation]()
    for _ in range(-(-count // PER_POSE)):
        known = next(maps)
        strength = float((np.linalg.norm(known.matrix[rows], axis=0) * device.coils.current_limit).max())
        wrench = np.zeros(6)
        for asked in strength * draw.uniform(0, 2, (PER_POSE, 1)) * draw.normal(size=(PER_POSE, 3)):
            wrench[rows] = asked
            allocation = allocator.allocate(known, wrench)
            most = max(most, float(hot @ allocation.currents**2) / device.supply.power)
            gap = known.matrix[rows] @ allocation.currents - allocation.scale * (asked - known.passive[rows])
            drift = max(drift, float(np.linalg.norm(gap) / np.linalg.norm(asked - known.passive[rows])))
            reasons[allocation.saturated] += 1
    return most, drift, reasons


def main() -> int:
    """All cases; exit code 1 if the limit was not kept."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wrenches", type=int, default=1_000_000, help="in all")
    each = max(PER_POSE, parser.parse_args().wrenches // 3)
    omni, pmsm = load("omni"), load("pmsm")
    weak = replace(pmsm, supply=replace(pmsm.supply, power=300.0))
    draw, well = np.random.default_rng(0), True
    cases = {
        "omni, exact": (omni, tool_maps(omni, "exact", draw), force_allocator(omni), 0),
        "omni, published": (omni, tool_maps(omni, "published", draw), force_allocator(omni), 0),
        "pmsm, table, 300 W": (weak, rotor_maps(weak, "table", draw), torque_allocator(weak), 3),
    }
    heads = f"{'free':>8} {'current':>8} {'power':>8} {'s':>6}"
    print(f"{'case':18} {'wrenches':>9} {'power/limit':>14} {'direction':>10} {heads}")
    for seed, (name, (device, maps, allocator, part)) in enumerate(cases.items()):
        start = perf_counter()
        most, drift, reasons = try_case(device, maps, allocator, part, each, seed)
        good = most <= 1.0 and drift <= DRIFT
        well &= good
        shares = " ".join(f"{reasons[reason]:8d}" for reason in Saturation)
        print(
            f"{name:18} {reasons.total():9d} {most:14.12f} {drift:10.1e} {shares} {perf_counter() - start:6.0f}"
            f"{'' if good else '  NOT kept'}",
            flush=True,
        )
    print("kept" if well else "NOT kept", ": never above the supply's power, never turned away from the wrench")
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
