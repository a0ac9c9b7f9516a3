"""Computing time of a simulated specimen, and its deviation from its file: figures of decision 19.

    python benchmarks/devices/simulated_specimens.py [omni] [pmsm] [planar] [--specimens 3] [--poses 100] [--json]

Each specimen is made, with tables where it has some. At random poses in the workspace its force per ampere (a motor's
torque) is computed, and so is the controller's, of the device file: times are medians over the poses, each the best of
five calls; the difference is rms over poses and coils, relative to the rms of the controller's. A motor's field at its
sensors is compared too. Then a driver of the simulation is read and written at `--rate` while the hand moves.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import Device, State, rotation_to_axis
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.devices.motor import SphericalMotor
from haptorb.estimation.types import HandGoal
from haptorb.rotations import quaternion, rotation_from_euler
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.simulation import motor_specimen
from haptorb.simulation.coil_array_specimen import draw_coils, draw_strength, fill_array_truth, make_array_truth
from haptorb.simulation.electromagnet_specimen import draw_electromagnet, fill_truth
from haptorb.simulation.motor_specimen import draw_motor, fill_field, fill_torque
from haptorb.simulation.registry import simulate

TICKS = 2000
Compute = Callable[[State], Array]  #: (3, m) of the force or torque per ampere


class Specimen(NamedTuple):
    """One member of the family of a device."""

    compute: Compute
    size: int  #: of its numbers [bytes]
    field: Compute | None = None  #: (k, 3) [T] of a motor's magnets at its sensors


def count_bytes(truth: Any) -> int:
    """Of all arrays of a named tuple, and of those in it."""
    if isinstance(truth, np.ndarray):
        return truth.nbytes
    return sum(count_bytes(part) for part in truth) if isinstance(truth, tuple) else 8


def make_specimen(device: Device, number: int) -> Specimen:
    """Number `number` of `device`."""
    matrix, passive = np.empty((6, device.channels)), np.empty(6)
    match device:
        case SphericalElectromagnet():
            coils = draw_electromagnet(device, number).compute_map(device.dome_radius)

            def force(state: State) -> Array:
                fill_truth(coils, state.R_SR, state.p, matrix, passive, np.empty((6, 3)))
                return matrix[:3]

            return Specimen(force, count_bytes(coils))
        case CoilArray():
            array = make_array_truth(device, draw_coils(device, number), draw_strength(device, number))

            def array_force(state: State) -> Array:
                fill_array_truth(array, np.vstack([state.R_SR, state.p]), matrix, passive)
                return matrix[:3]

            return Specimen(array_force, count_bytes(array))
        case SphericalMotor():
            built = draw_motor(device, number)
            motor, field = built.compile(), np.empty((device.sensors, 3))

            def torque(state: State) -> Array:
                fill_torque(motor, built.strength, state.R_SR, matrix[3:])
                return matrix[3:]

            def read(state: State) -> Array:
                fill_field(motor, built.strength, state.R_SR, field)
                return field

            return Specimen(torque, count_bytes(motor), read)
        case _:
            raise SystemExit(f"no specimens of a {device.kind.title} are drawn")


def draw_states(device: Device, count: int, rng: np.random.Generator) -> list[State]:
    """Poses in the workspace: of a motor at any spin, of a tool radial or upright."""
    states = []
    for _ in range(count):
        if isinstance(device, SphericalMotor):
            tilts = device.workspace_tilt * rng.uniform(-1, 1, 2)
            states.append(
                State.at(
                    (0, 0, 0), R_SR=rotation_from_euler(float(tilts[0]), float(tilts[1]), rng.uniform(0, 2 * np.pi))
                )
            )
        elif isinstance(device, CoilArray) and not device.surface.is_dome:
            side, up = np.array(device.surface.half_width), rng.uniform(0, device.surface.thickness)
            states.append(State.at((*rng.uniform(-side, side), device.contact_height + up), R_SR=np.eye(3)))
        else:
            assert device.shell is not None
            z, turn = rng.uniform(0.5, 1.0), rng.uniform(0, 2 * np.pi)
            axis = np.array([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
            away = device.shell.contact_distance + rng.uniform() * device.shell.thickness
            states.append(State.at(away * axis, R_SR=rotation_to_axis(axis)))
    return states


def time_best(call: Callable[[], object]) -> float:
    """Best of five [µs]."""
    times = []
    for _ in range(5):
        start = perf_counter()
        call()
        times.append(perf_counter() - start)
    return 1e6 * min(times)


def time_driver(device: Device, rate: float) -> float:
    """Time of reading and writing in a tick while the hand moves [µs]: the least of ten medians."""
    rest, times, still = device.rest_position, np.empty(TICKS), np.zeros(device.channels)

    def goal(now: float) -> HandGoal:
        away = 0.01 * np.array([np.sin(9 * now), np.cos(7 * now), 0.0])
        if isinstance(device, SphericalMotor):
            return HandGoal(np.zeros(3), quaternion(rotation_from_euler(20 * away[0], 20 * away[1], 0.0)), now, False)
        return HandGoal(rest + away, np.array([0.0, 0.0, 0.0, 1.0]), now, False)

    with SimDriver(simulate(device, 0), 1.0 / rate, goal, seed=0) as driver:
        for n in range(TICKS):
            start = perf_counter()
            driver.read(n / rate)
            driver.write(still)
            times[n] = perf_counter() - start
    return 1e6 * float(np.median(times.reshape(10, -1), axis=1).min())


def measure(name: str, specimens: int, poses: int, rate: float) -> dict[str, Any]:
    """All figures of one device."""
    device, making, off, size, field = load(name), [], [], 0.0, []
    states, times, own = draw_states(device, poses, np.random.default_rng(1)), [], []
    make_specimen(device, 0)  # compiles
    simulate(device, 0)
    for number in range(specimens):
        for tables in vars(motor_specimen).values():  # those of a motor are shared by its specimens
            getattr(tables, "cache_clear", int)()
        start = perf_counter()
        simulate(device, number)
        making.append(perf_counter() - start)
        one = make_specimen(device, number)
        for state in states:
            known = device.wrench_map(state, device.models[0])
            expected = known.torque if isinstance(device, SphericalMotor) else known.force
            off.append(one.compute(state) - expected)
            size += float((expected**2).mean()) / (poses * specimens)
            if one.field is not None:
                assert isinstance(device, SphericalMotor)
                field.append(one.field(state) - device.sensor_field(state.R_SR[None], "table")[0])
            if not number:
                times.append(time_best(lambda state=state, one=one: one.compute(state)))  # type: ignore[misc]
                model = device.tick_models[0]
                own.append(time_best(lambda state=state, model=model: device.wrench_map(state, model)))  # type: ignore[misc]
    return {
        "device": name,
        "making_s": min(making),
        "megabytes": 1e-6 * one.size,
        "map_us": float(np.median(times)),
        "controllers_map_us": float(np.median(own)),
        "driver_us": time_driver(device, rate),
        "off_percent": 100 * float(np.sqrt(np.mean(np.square(off)) / size)),
        "field_off_mt": 1e3 * float(np.sqrt(np.mean(np.square(field)))) if field else None,
    }


def main() -> None:
    """Print the figures of each device."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=["omni", "pmsm", "planar"])
    parser.add_argument("--specimens", type=int, default=3)
    parser.add_argument("--poses", type=int, default=100)
    parser.add_argument("--rate", type=float, default=4000.0, help="of the driver [Hz]")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    for name in given.names:
        one = measure(name, given.specimens, given.poses, given.rate)
        if given.json:
            print(json.dumps(one))
            continue
        print(f"{name}: made in {one['making_s']:.2f} s, {one['megabytes']:.1f} MB")
        print(f"  {one['off_percent']:.1f} % (rms) off its file")
        print(f"  a map in {one['map_us']:.0f} µs, the controller's in {one['controllers_map_us']:.0f} µs")
        print(f"  read and written in {one['driver_us']:.0f} µs at {given.rate:g} Hz")
        if one["field_off_mt"] is not None:
            print(f"  at its sensors the magnets' field is {one['field_off_mt']:.1f} mT (rms) off")


if __name__ == "__main__":
    main()
