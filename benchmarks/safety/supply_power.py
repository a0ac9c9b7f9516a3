"""Power limit of the supply in 10⁶ random wrenches: in both layers, the allocators and the guard.

    python benchmarks/safety/supply_power.py [--wrenches N]

Allocators: the Omni with its exact model (force, torque, both) and its published one (force), two coil arrays (force,
torque, both), and the motor of Bai 2012 with 300 W, as its file has no limit. Poses are random over the workspace,
wrenches random in direction and about up to twice what one coil can give. Guard: currents of any sign up to one and a
half times every coil's limit, as a faulty allocator would ask for them, one after another through the slew limit.

Power is Σ R i², with R from the device file's resistance, temperature coefficient and stop temperature. An allocator
that scales a force or a motor's torque must also keep its direction to 10⁻⁶. Every case must meet the limit: a case
that never asks for more power than there is would prove nothing. Exit code 1 if one of these does not hold.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from haptorb.arrays import Array
from haptorb.control.allocation import Allocator, force_allocator, tool_choice, torque_allocator
from haptorb.control.array_allocation import array_choice
from haptorb.control.guard import limit_currents
from haptorb.control.protection import Protection
from haptorb.control.trip_reasons import GuardState
from haptorb.devices.api import electromagnet
from haptorb.devices.base import Device, State, WrenchMap
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.loader import load

PER_POSE = 500
DIRECTION_ERROR = 1e-6
ROUNDING = 1e-9  #: relative; the guard's own sum of squares has rounding errors
WRENCH_ROWS = {"force": slice(0, 3), "torque": slice(3, 6), "both": slice(0, 6)}

Draw = np.random.Generator
Maps = Callable[[Draw], WrenchMap]


@dataclass(frozen=True)
class Case:
    """One allocator: where its wrench maps come from, what is asked of it, and whether it keeps directions."""

    name: str
    device: Device
    maps: Maps
    allocator: Allocator
    part: str
    keeps_direction: bool


def hot_resistance(device: Device) -> Array:
    """(m,) of the windings at their stop temperature [Ω], from the device file's own values."""
    coils = device.coils
    return coils.resistance * (1.0 + coils.temperature_coefficient * (coils.heat.stop - coils.reference_temperature))


def tool_map(device: Device, model: str) -> Maps:
    """A tool upright within 60° of the vertical, from contact to 2 cm above it."""

    def draw_map(draw: Draw) -> WrenchMap:
        way = draw.normal(size=3) + np.array([0.0, 0.0, 2.0])
        return device.wrench_map(State.at(draw.uniform(0.05, 0.07) * way / np.linalg.norm(way)), model)

    return draw_map


def array_map(device: Device, height: float) -> Maps:
    """A tool that leans up to 30°, within 3 cm of the middle, from `height` [m] to 2 cm above it."""

    def draw_map(draw: Draw) -> WrenchMap:
        place = np.array([*draw.uniform(-0.03, 0.03, 2), height + draw.uniform(0.0, 0.02)])
        angle, about = np.radians(draw.uniform(0.0, 30.0)), draw.uniform(0.0, 2 * np.pi)
        x, y = np.cos(about), np.sin(about)
        K = np.array([[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]])
        turn = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
        return device.wrench_map(State.at(place, R_SR=turn), "exact")

    return draw_map


def rotor_map(device: Device, model: str) -> Maps:
    """A rotor in any orientation."""

    def draw_map(draw: Draw) -> WrenchMap:
        turn = np.linalg.qr(draw.normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        return device.wrench_map(State(0.0, turn, np.zeros(3), np.zeros(3), np.zeros(3)), model)

    return draw_map


def make_cases() -> list[Case]:
    """Every kind of device, and every allocator of it."""
    omni, pmsm = electromagnet(load("omni")), load("pmsm")
    weak = replace(pmsm, supply=replace(pmsm.supply, power=300.0))
    exact = tool_map(omni, "exact")
    cases = [
        Case(f"omni, exact, {part}", omni, exact, one, part, part == "force")
        for part, one in tool_choice(omni).allocators.items()
    ]
    cases.append(Case("omni, published", omni, tool_map(omni, "published"), force_allocator(omni), "force", True))
    for name in ("planar", "tetrahedron"):
        array = load(name)
        assert isinstance(array, CoilArray)
        scarce = replace(array, supply=replace(array.supply, power=0.5 * float(array.supply.power)))
        maps = array_map(scarce, array.contact_height)
        cases += [
            Case(f"{name}, {part}", scarce, maps, one, part, False)
            for part, one in array_choice(scarce).allocators.items()
        ]
    cases.append(Case("pmsm, 300 W", weak, rotor_map(weak, "table"), torque_allocator(weak), "torque", True))
    return cases


def try_allocator(case: Case, count: int, draw: Draw) -> tuple[float, float, int]:
    """(greatest power over the limit's, greatest error of direction, wrenches that met the limit) of `count`."""
    device, rows = case.device, WRENCH_ROWS[case.part]
    hot, limit = hot_resistance(device), device.supply.power
    most, turned, met = 0.0, 0.0, 0
    for _ in range(-(-count // PER_POSE)):
        known = case.maps(draw)
        size = np.ones(6)
        for part in (slice(0, 3), slice(3, 6)):
            size[part] = float((np.linalg.norm(known.matrix[part], axis=0) * device.coils.current_limit).max())
        wrench = np.zeros(6)
        for drawn in draw.uniform(0, 2, (PER_POSE, 1)) * draw.normal(size=(PER_POSE, 6)):
            wrench[rows] = (size * drawn)[rows]
            allocation = case.allocator.allocate(known, wrench)
            share = float(hot @ allocation.currents**2) / limit
            most, met = max(most, share), met + (share > 0.999)
            if case.keeps_direction:
                asked = wrench[rows] - known.passive[rows]
                gap = known.matrix[rows] @ allocation.currents - allocation.scale * asked
                turned = max(turned, float(np.linalg.norm(gap) / np.linalg.norm(asked)))
    return most, turned, met


def try_guard(device: Device, count: int, draw: Draw) -> tuple[float, float, int]:
    """The same of the guard's last limit before the coils, for `count` sets of currents."""
    protection = Protection(device, 1e-3)
    guard, heat, coils = protection.state["guard"], protection.state["heat"], protection.coils
    guard["state"], guard["gain"], guard["dt"] = GuardState.RUNNING, 1.0, 1e-3
    heat["hottest"] = 300.0
    hot, limit = hot_resistance(device), device.supply.power
    most, met = 0.0, 0
    for _ in range(-(-count // 20)):
        wanted = 1.5 * draw.uniform(-1, 1, device.channels) * device.coils.current_limit
        for _ in range(20):  # until the slew limit has let it through
            limit_currents(guard[0], heat[0], coils, wanted, True, False)
            share = float(hot @ coils["current_commanded"] ** 2) / limit
            most, met = max(most, share), met + (share > 0.999)
    return most, 0.0, met


def main() -> int:
    """All cases; exit code 1 if the limit was not kept, or a case never met it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wrenches", type=int, default=1_000_000, help="in all")
    wrenches = parser.parse_args().wrenches
    cases, draw = make_cases(), np.random.default_rng(0)
    guarded = {f"guard, {case.device.name}": case.device for case in cases}
    each = PER_POSE * max(1, round(wrenches / (len(cases) + len(guarded)) / PER_POSE))
    jobs = {case.name: lambda case=case: try_allocator(case, each, draw) for case in cases}
    jobs |= {name: lambda device=device: try_guard(device, each, draw) for name, device in guarded.items()}
    kept = True
    print(
        f"{'case':24} {'wrenches':>9} {'power/limit':>14} {'at the limit':>13} {'direction error':>16} {'time [s]':>9}"
    )
    for name, job in jobs.items():
        start = perf_counter()
        most, turned, met = job()
        good = most <= 1.0 + ROUNDING and turned <= DIRECTION_ERROR and met > 0
        kept &= good
        print(
            f"{name:24} {each:9d} {most:14.12f} {met / each:13.1%} {turned:16.1e} {perf_counter() - start:9.1f}"
            f"{'' if good else '  NOT kept' if met else '  NEVER at the limit'}",
            flush=True,
        )
    print(f"{'kept' if kept else 'NOT kept'}: never above the supply's power, forces never turned away")
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
