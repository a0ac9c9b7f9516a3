"""Planar array of 100 coils: time of its exact wrench map and of its allocation, error of the map, late ticks.

    python benchmarks/devices/coil_array_speed.py [--seconds 10] [--poses 400]

The array is the catalogue's `planar` with 10 × 10 coils at the same pitch. Poses are random over the plate, upright to
20° askew, from contact to 30 mm above; times are the median over the poses, each the best of five calls. Allocated are
force, torque and both, of random direction and up to what the coils nearly give, so that limits are met. The error is
the greatest difference of a column from the same map with 3200 charges, relative to the greatest column. Then the servo
runs the array simulated at 1 kHz in a wall and records: with the tool at rest, and moving at up to 0.4 m/s. Late ticks
are listed with the time of each stage. Exit code 1 beyond 150 µs, 60 µs, or below 0.999 of ticks on time in either run.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from time import monotonic, perf_counter, sleep

import numpy as np

from haptorb.control.array_allocation import array_choice
from haptorb.devices.base import Coils, State, rotation_to_axis
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.coil_array_wrench_map import RULES, array_wrench
from haptorb.devices.loader import load
from haptorb.devices.placed_coils import PlacedCoils
from haptorb.recording.row import STAGES, RowLayout
from haptorb.runtime.servo import Servo
from haptorb.worlds.basic import Wall

SIDE, PITCH = 10, 35e-3
MAP, ALLOCATION, IN_TIME = 150e-6, 60e-6, 0.999


def enlarge(small: CoilArray) -> CoilArray:
    """`small` with SIDE × SIDE coils, each as its first."""
    along = PITCH * (np.arange(SIDE) - 0.5 * (SIDE - 1))
    places = np.array([(x, y, float(small.windings.position[0, 2])) for x in along for y in along])
    count, coils, electric = len(places), small.windings, small.coils

    def each(values: np.ndarray) -> np.ndarray:
        return np.full(count, float(values[0]))

    sizes = (each(getattr(coils, name)) for name in ("turns", "inner_radius", "outer_radius", "length"))
    windings = PlacedCoils(places, np.tile(coils.axis[0], (count, 1)), *sizes)
    names = tuple(f"{row}{column}" for row in "ABCDEFGHIJ" for column in range(SIDE))
    hundred = Coils(
        names, each(electric.resistance), each(electric.inductance), each(electric.current_limit),
        electric.temperature_coefficient, electric.reference_temperature, electric.heat,
    )  # fmt: skip
    surface = replace(small.surface, half_width=(0.5 * SIDE * PITCH, 0.5 * SIDE * PITCH))
    return replace(small, name="planar-100", coils=hundred, windings=windings, surface=surface)


def draw_states(device: CoilArray, count: int, draw: np.random.Generator) -> list[State]:
    """Upright to 20° askew, over the plate."""
    x, y = device.surface.half_width
    states = []
    for _ in range(count):
        height = device.contact_height + draw.uniform(1e-3, device.surface.thickness)
        lean = np.array([*draw.normal(0.0, 0.1, 2), 1.0])
        p = (draw.uniform(-x, x), draw.uniform(-y, y), height)
        states.append(State.at(p, R_SR=rotation_to_axis(lean)))
    return states


def best_of(call, repeats: int = 5) -> float:  # type: ignore[no-untyped-def]
    """[s]"""
    times = []
    for _ in range(repeats):
        start = perf_counter()
        call()
        times.append(perf_counter() - start)
    return min(times)


def find_error(device: CoilArray, states: list[State]) -> float:
    """Greatest relative difference from a map with many charges everywhere."""
    fine = np.hstack([magnet.charges(20, 80) for magnet in device.tool.magnets])
    rules = len(RULES)
    spans = fine.shape[1] * np.arange(rules + 1)[None, :]
    many = device.magnetics._replace(charges=np.ascontiguousarray(np.tile(fine, rules)), spans=spans)
    worst, matrix, passive, pose = 0.0, np.empty((6, device.channels)), np.empty(6), np.empty((4, 3))
    for state in states:
        pose[:3], pose[3] = state.R_SR, state.p
        array_wrench(many, pose, matrix, passive)
        off = np.abs(device.wrench_map(state, "exact").matrix - matrix)
        for part in (slice(0, 3), slice(3, 6)):
            worst = max(worst, float(off[part].max() / np.linalg.norm(matrix[part], axis=0).max()))
    return worst


def main() -> int:
    """Print the figures; 0 where all are within their limits."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="of the servo (default 10)")
    parser.add_argument("--poses", type=int, default=400, help="for the times (default 400)")
    arguments = parser.parse_args()
    device, draw = enlarge(load("planar")), np.random.default_rng(1)
    states = draw_states(device, arguments.poses, draw)
    choice = array_choice(device)
    device.wrench_map(states[0], "exact")
    maps, allocations = [], []
    for number, state in enumerate(states):
        known = device.wrench_map(state, "exact")
        maps.append(best_of(lambda state=state: device.wrench_map(state, "exact")))
        part = ("force", "torque", "both")[number % 3]
        asked = draw.normal(size=6) * np.array([1.0, 1.0, 1.0, 0.02, 0.02, 0.02])
        allocator = choice.allocators[part]
        allocator.allocate(known, asked)
        allocations.append(best_of(lambda known=known, asked=asked, a=allocator: a.allocate(known, asked)))
    error = find_error(device, states[:40])
    print(f"{device.channels} coils, {arguments.poses} poses, {len(device.tool.magnets)} magnet")
    print(f"exact wrench map   median {1e6 * np.median(maps):6.1f} µs   99 % {1e6 * np.quantile(maps, 0.99):6.1f} µs")
    print(
        f"allocation         median {1e6 * np.median(allocations):6.1f} µs   99 % "
        f"{1e6 * np.quantile(allocations, 0.99):6.1f} µs"
    )
    print(f"error of the map   {error:.1e} of the greatest column, against 3200 charges")
    shares = min(run_servo(device, arguments.seconds, moves) for moves in (False, True))
    return int(not (np.median(maps) <= MAP and np.median(allocations) <= ALLOCATION and shares >= IN_TIME))


def run_servo(device: CoilArray, seconds: float, moves: bool) -> float:
    """Share of ticks on time, with the tool pressed 6 mm into a wall, or going to and fro in front of it and in it."""
    rest, cursor, read = device.rest_position, 0, []
    wall = Wall(normal=(0.0, 0.0, 1.0), offset=float(rest[2]), stiffness=200.0)
    with Servo(device, world=wall, driver="sim") as servo:
        start = monotonic()
        while (now := monotonic() - start) < seconds:
            servo.check()
            way = (0.08 * np.sin(4 * now), 0.08 * np.sin(2.7 * now), 6e-3 * np.sin(5 * now) - 2e-3)
            servo.hand.point(rest + np.array(way if moves else (0.0, 0.0, -6e-3)), keep_alive=0.5)
            sleep(0.016)
            cursor, rows = servo.rows(cursor)
            read.append(rows.copy())
        layout = servo.layout
    list_late(np.concatenate(read), layout)
    report = servo.report()
    computing = report["compute_us"]
    name, share = ("moves" if moves else "at rest"), 100 * report["success_rate"]
    print(
        f"servo, tool {name:8s}   {share:.3f} % of {report['ticks']} ticks on time, computing p50 "
        f"{computing['p50']:.0f} µs, p99 {computing['p99']:.0f} µs, peak force {report['peak_force_n']:.2f} N, trips "
        f"{report['trip_count']}"
    )
    return float(report["success_rate"])


def list_late(rows: np.ndarray, layout: RowLayout, most: int = 10) -> None:
    """The ticks that did not end within their period, or that came after missed ones, with what took how long [µs]."""
    lateness, ahead, missed, tick = (rows[:, layout[name]][:, 0] for name in ("lateness", "ahead", "missed", "tick"))
    stages = rows[:, layout["stages"]]
    late = np.flatnonzero((lateness + stages[:, :-1].sum(axis=1) > 1e-3) | (missed > 0))
    for n in late[:most]:
        times = ", ".join(f"{name} {1e6 * took:.0f}" for name, took in zip(STAGES, stages[n], strict=True))
        print(
            f"  tick {tick[n]:.0f}: {1e6 * lateness[n]:.0f} late, {missed[n]:.0f} missed, ahead {1e6 * ahead[n]:.0f}, "
            f"{times}"
        )
    if len(late) > most:
        print(f"  and {len(late) - most} more")


if __name__ == "__main__":
    sys.exit(main())
