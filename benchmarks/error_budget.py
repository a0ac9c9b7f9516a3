"""Coverage of the band of `haptorb inspect DEVICE --errors` by simulated devices.

python benchmarks/error_budget.py [omni] [pmsm] [planar] [--devices 1500] [--seed 1000] [--into FILE] [--json]

Each device is drawn by itself, from the standard uncertainties of the device file and a seed of its own, and built:
other magnets, coils, resistances and supply in the simulation, errors in what its current sensors, field sensors and
tracker say. The whole loop then runs on it for half a second: driver, estimator, allocator, guard, drive; all of them
believe the device file. The error is the simulation's true wrench less the wrench asked for. The band comes from
another seed and from code that this file does not call but for the band itself. Each device is tried once, at a place
and in a direction of its own. With --into the errors are kept in a file, and a later call with more devices continues
there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from changed_readings import ChangedReadings
from haptorb.analysis.error_budget import COVERAGE, ErrorBudget, WrenchBand
from haptorb.arrays import Array
from haptorb.cli.error_report import report_errors
from haptorb.cli.progress import build_tables
from haptorb.control.registry import make_allocator
from haptorb.devices.base import Device, rotation_to_axis
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.devices.motor import SphericalMotor
from haptorb.estimation.registry import make_estimator
from haptorb.estimation.types import Estimator, HandGoal, Pose, Sample
from haptorb.rotations import quaternion, rotation_from_euler
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.tick import Tick
from haptorb.simulation.base import Simulation
from haptorb.simulation.coil_array import SimulatedCoilArray
from haptorb.simulation.electromagnet import SimulatedElectromagnet
from haptorb.simulation.motor import SimulatedMotor
from haptorb.worlds.user_world import FunctionWorld

RATE = 1000.0  #: of the loop [Hz]
TICKS = 450  #: the guard's ramp takes 300; the resistances are learned in 50
FREQUENCY = 10.0  #: at which a force turns, as in the budget [Hz]
ROOM = 1e-3  #: by which an array's true surface is lower: a tool in contact would get a force from it [m]
FIRM = 100.0  #: times as stiff as the device file's is the hand: the mover stays where it is put


class NoWrench(Exception):
    """The guard does not let the wrench through: the mover is lost, or a reading is implausible."""


@dataclass(frozen=True)
class Reading:
    """How the sensors and the tracker of one device are wrong."""

    gain: Array  #: (m,) of the current sensors, relative
    offset: Array  #: (m,) of the current sensors [A]
    place: Array  #: (3,) tracked less true place [m]
    turn: Array  #: (3, 3) from the true to the tracked orientation

    def apply(self, true: Sample) -> Sample:
        """What is read instead of the `true` sample."""
        pose = true.pose
        tracked = Pose(pose.t, self.turn @ pose.R_SR, pose.p + self.place, pose.w, pose.v, pose.valid)
        currents = (1 + self.gain) * true.currents + self.offset
        return Sample(true.t, currents, true.temperatures, true.field, tracked)


@dataclass(frozen=True)
class Trial:
    """One device, where its mover is, and what is asked there."""

    region: int
    simulation: Simulation  #: with wrong readings
    p: Array  #: (3,) [m]
    R: Array  #: (3, 3)
    wrench: Array  #: (2, 6) asked at the end and a quarter of a turn later [N, N·m]; the second zero: at rest
    axes: Array  #: (3, 3) whose columns are the axes of the components


def draw_wrong_reading(device: Device, rng: np.random.Generator, place: float, turn: float) -> Reading:
    """What current sensors and tracker do; place [m] and turn [rad] are standard uncertainties per axis."""
    known, m = device.uncertainty, device.channels  # type: ignore[attr-defined]
    x, y, z = turn * rng.standard_normal(3)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation = np.linalg.solve(np.eye(3) - skew / 2, np.eye(3) + skew / 2)
    return Reading(
        known.current_gain * rng.standard_normal(m), known.current_offset * rng.standard_normal(m),
        place * rng.standard_normal(3), rotation,
    )  # fmt: skip


def draw_direction(rng: np.random.Generator) -> Array:
    """(3,) any unit vector."""
    z, turn = rng.uniform(-1, 1), rng.uniform(0, 2 * np.pi)
    return np.array([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])


def draw_turning(asked: float, rng: np.random.Generator) -> Array:
    """(2, 6) a force of `asked` [N] in any direction, and one into which it turns."""
    first, other = draw_direction(rng), draw_direction(rng)
    across = np.cross(first, other)
    across /= np.linalg.norm(across)
    return asked * np.hstack([np.stack([first, across]), np.zeros((2, 3))])


def magnetise_core(simulated: SimulatedElectromagnet, seed: int) -> None:
    """A history: some currents of any size, and none in the end."""
    rng = np.random.default_rng([seed, 1])
    state = simulated.state()
    for size in (1.0, 0.5, 0.2):
        simulated.advance(5e-3, size * rng.uniform(-1, 1, 3), state.p, quaternion(state.R_SR))
    simulated.advance(10e-3, np.zeros(3), state.p, quaternion(state.R_SR))
    simulated.cool()


def draw_electronics(device: Device, rng: np.random.Generator) -> dict[str, Any]:
    """Resistances and supply as they could be."""
    known, coils = device.uncertainty, device.coils  # type: ignore[attr-defined]
    resistance = coils.resistance * (1 + known.resistance * rng.standard_normal(device.channels))
    voltage = device.supply.voltage * (1 + known.supply * rng.standard_normal())
    return {"coils": replace(coils, resistance=resistance), "supply": replace(device.supply, voltage=voltage)}


def try_electromagnets(device: SphericalElectromagnet, asked: float, seed: int, first: int = 0) -> Iterator[Trial]:
    """One electromagnet after the other from number `first`, the regions in turn. The simulation draws coils, core and
    magnet."""
    known = device.uncertainty
    for number in count(first):
        rng = np.random.default_rng([seed, number])
        region = number % 3
        tool, kelvin = device.tool, known.magnet_temperature * rng.standard_normal()
        shift = known.core_place * rng.standard_normal(3)
        true = replace(
            device,
            tool=replace(tool, remanence=tool.remanence * (1 + known.remanence_drift * kelvin)),
            hand=replace(device.hand, stiffness=FIRM * device.hand.stiffness, damping=30 * device.hand.damping),
            dome_radius=device.dome_radius - 1e-3,  # a tool in contact may be nearer to a core that is off its place
            # The simulation has core and coils at its origin: instead of them, tool and sensors are off, the other way.
            hall=replace(device.hall, positions=device.hall.positions - shift),
            **draw_electronics(device, rng),
        )
        wrong = draw_wrong_reading(device, rng, known.place, known.axis)
        wrong = replace(wrong, place=wrong.place + shift)
        upper = rng.uniform() if region else 0.0
        height = (upper + max(region - 1, 0)) / 2 * device.shell_thickness
        lowest = np.cos(device.workspace_half_angle)
        z, turn = rng.uniform(lowest, 1.0), rng.uniform(0, 2 * np.pi)
        axis = np.array([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
        R = rotation_to_axis(axis)
        simulated = SimulatedElectromagnet(true, number, specimen=seed + number)
        wrongly = ChangedReadings(simulated, wrong.apply, partial(magnetise_core, simulated))
        turning = draw_turning(asked, rng)
        yield Trial(region, wrongly, (device.contact_distance + height) * axis - shift, R, turning, R)


def try_motors(device: SphericalMotor, asked: float, seed: int, first: int = 0) -> Iterator[Trial]:
    """One motor after the other from number `first`, the regions in turn. The simulation draws magnets, coils,
    regulator, weight and field sensors."""
    known = device.uncertainty
    for number in count(first):
        rng = np.random.default_rng([seed, number])
        region = number % 3
        warm = 1 + known.remanence_drift * known.magnet_temperature * rng.standard_normal()
        true = replace(device, polarity=device.polarity * warm, **draw_electronics(device, rng))
        wrong = draw_wrong_reading(device, rng, 0.0, 0.0)
        while True:
            tilts = rng.uniform(-1, 1, 2)
            if int(3 * np.abs(tilts).max()) == region:
                break
        R = rotation_from_euler(*(device.workspace_tilt * tilts), rng.uniform(0, 2 * np.pi))
        wrench = np.append(np.zeros(3), asked * draw_direction(rng))
        turning = np.stack([wrench, np.zeros(6)])
        firm = replace(device.hand, stiffness=FIRM * device.hand.stiffness, damping=30 * device.hand.damping)
        simulation = ChangedReadings(SimulatedMotor(true, seed + number, grasp=firm), wrong.apply)
        yield Trial(region, simulation, np.zeros(3), R, turning, np.eye(3))


def try_arrays(device: CoilArray, asked: float, seed: int, first: int = 0) -> Iterator[Trial]:
    """One coil array after the other from number `first`, the regions in turn. The simulation draws coils and magnets;
    the force is at rest."""
    known, surface = device.uncertainty, device.surface
    for number in count(first):
        rng = np.random.default_rng([seed, number])
        region = number % 3
        warm = 1 + known.remanence_drift * known.magnet_temperature * rng.standard_normal()
        magnets = tuple(replace(magnet, remanence=magnet.remanence * warm) for magnet in device.tool.magnets)
        radius = surface.dome_radius and surface.dome_radius - ROOM
        true = replace(
            device,
            tool=replace(device.tool, magnets=magnets),
            surface=replace(surface, dome_radius=radius, height=surface.height - ROOM),
            hand=replace(
                device.hand,
                stiffness=FIRM * device.hand.stiffness,
                damping=30 * device.hand.damping,
                turn_stiffness=FIRM * device.hand.turn_stiffness,
                turn_damping=30 * device.hand.turn_damping,
            ),
            **draw_electronics(device, rng),
        )
        wrong = draw_wrong_reading(device, rng, known.place, known.axis)
        height = surface.thickness * (rng.uniform() + region - 1) / 2 if region else 0.0
        if surface.is_dome:
            z, turn = rng.uniform(np.cos(surface.half_angle), 1.0), rng.uniform(0, 2 * np.pi)
            axis = np.array([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
            p, R = (device.contact_height + height) * axis, rotation_to_axis(axis)
        else:
            side = np.array(surface.half_width)
            p, R = np.array([*rng.uniform(-side, side), device.contact_height + height]), np.eye(3)
        force = np.append(asked * draw_direction(rng), np.zeros(3))
        simulated = SimulatedCoilArray(true, number, specimen=seed + number)
        yield Trial(region, ChangedReadings(simulated, wrong.apply), p, R, np.stack([force, np.zeros(6)]), R)


def run_loop(device: Device, estimator: Estimator, trial: Trial, seed: int) -> Array:
    """(3,) the error of the true wrench [N or N·m] along the trial's axes, after the loop has settled.

    A wrench that turns comes late: the true one is held against what a loop without errors gives, the mean over a tick
    of currents that go exponentially from the last tick's to this one's.
    """
    goal = HandGoal(trial.p, quaternion(trial.R), 0.0, False)
    driver = SimDriver(trial.simulation, 1 / RATE, lambda now: goal, seed=seed)

    def ask(tick: int) -> Array:
        angle = 2 * np.pi * FREQUENCY * (tick - TICKS) / RATE if trial.wrench[1].any() else 0.0
        wrench: Array = np.cos(angle) * trial.wrench[0] + np.sin(angle) * trial.wrench[1]
        return wrench

    world = FunctionWorld(lambda state: ask(round(state.t * RATE)))
    tick = Tick(device, world, driver, estimator, make_allocator(device), 1 / RATE)
    row = np.empty(tick.layout.width)
    with driver:
        for number in range(TICKS):
            tick.step(row, number / RATE)
        total = driver.wrench_actual()
    if tick.protection.tripped or not row[tick.layout["gain"]] >= 1.0:
        raise NoWrench(tick.protection.reason.name)
    # The last read advanced the device under the duties of the tick before.
    x = float(np.mean(device.coils.resistance / device.coils.inductance)) / RATE
    share = 1 / -np.expm1(-x) - 1 / x
    error = total - (share * ask(TICKS - 2) + (1 - share) * ask(TICKS - 3))
    part = error[3:] if device.kind.name == "spherical-motor" else error[:3]
    return trial.axes.T @ part


def find_places(band: WrenchBand, components: tuple[tuple[int, ...], ...], error: Array) -> Iterator[tuple[int, bool]]:
    """(component, whether it lies in the band) for each axis of each component; the size counts as the last one."""
    for number, axes in enumerate(components):
        for axis in axes:
            yield number, band.contains(number, float(error[axis]))
    yield len(components), bool(np.linalg.norm(error) <= band.size)


class Errors:
    """Errors of the devices tried so far, (3,) or None where the guard refused; kept in a file of JSON lines, if
    `path` is given.

    SystemExit for a file of another device, estimator, wrench or seed.
    """

    def __init__(self, budget: ErrorBudget, seed: int, path: Path | None) -> None:
        self._path, self.found, self.commits = path, list[tuple[int, Array | None]](), set[str]()
        self._known = {
            "device": budget.device, "estimator": budget.estimator, "asked": budget.asked, "seed": seed,
        }  # fmt: skip
        command = ["git", "describe", "--always", "--dirty"]
        found = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
        self._commit = found.stdout.strip()
        if path is None or not path.exists():
            return
        for line in path.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            if other := {key: row[key] for key, value in self._known.items() if row[key] != value}:
                raise SystemExit(f"{path} has other trials, with {other}; expected {self._known}: give another file")
            self.commits.add(row["commit"])
            self.found.append((row["region"], None if row["error"] is None else np.array(row["error"])))

    def add(self, region: int, error: Array | None) -> None:
        """Add the next device."""
        self.found.append((region, error))
        self.commits.add(self._commit)
        if self._path is not None:
            plain = None if error is None else error.tolist()
            row = {**self._known, "number": len(self.found) - 1, "region": region, "error": plain}
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({**row, "commit": self._commit}) + "\n")

    def count(self, budget: ErrorBudget, components: tuple[tuple[int, ...], ...]) -> dict[str, Any]:
        """How often they lie in the bands of `budget`, by region and component."""
        names = (*budget.components, "size")
        inside, tried = (np.zeros((len(budget.bands), len(names))) for _ in range(2))
        kept = [(region, error) for region, error in self.found if error is not None]
        for own, error in kept:
            for region in (own, len(budget.bands) - 1):
                for component, within in find_places(budget.bands[region], components, error):
                    inside[region, component] += within
                    tried[region, component] += 1
        share = inside / np.maximum(tried, 1)
        sizes = 100 / budget.asked * np.linalg.norm([error for _, error in kept] or np.zeros((1, 3)), axis=1)
        return {
            "device": budget.device,
            "estimator": budget.estimator,
            "devices": len(self.found),
            "refused": len(self.found) - len(kept),
            "size": budget.bands[-1].size,
            "unit": budget.unit,
            "error_percent_of_asked": {
                "median": round(float(np.median(sizes)), 2),
                "95": round(float(np.quantile(sizes, 0.95)), 2),
            },
            "standard_deviation_percent": round(100 * np.sqrt(COVERAGE * (1 - COVERAGE) / max(len(kept), 1)), 2),
            "coverage_percent": {
                band.region: {name: round(100 * float(share[r, n]), 1) for n, name in enumerate(names)}
                for r, band in enumerate(budget.bands)
            },
        }


def print_coverage(found: dict[str, Any], title: str) -> None:
    """Print what `Errors.count` found."""
    error = found["error_percent_of_asked"]
    print(f"{title}: {found['devices']} devices, {found['refused']} refused by the guard; error {error['median']} % of "
          f"what was asked (median), 95 % below {error['95']} %; size of the band {1e3 * found['size']:.2f} "
          f"m{found['unit']}")  # fmt: skip
    print(f"in the 95 % band, known to {found['standard_deviation_percent']:.1f} % (one standard deviation) [%]:")
    for region, shares in found["coverage_percent"].items():
        print(f"  {region:32s}" + "".join(f"{part}: {share:5.1f}   " for part, share in shares.items()))


def count_coverage(
    device: Device, budget: ErrorBudget, devices: int, seed: int, path: Path | None = None
) -> dict[str, Any]:
    """How often the true error lies in the band, by region and component, from `devices` devices."""
    errors = Errors(budget, seed, path)
    first = len(errors.found)
    components: tuple[tuple[int, ...], ...] = ((2,), (0, 1))
    match device:
        case SphericalMotor():
            trials, components = try_motors(device, budget.asked, seed, first), ((0,), (1,), (2,))
        case CoilArray():
            trials = try_arrays(device, budget.asked, seed, first)
        case SphericalElectromagnet():
            trials = try_electromagnets(device, budget.asked, seed, first)
        case _:
            raise SystemExit(f"'{device.name}' is a {device.kind.title}: no devices of that kind are drawn here")
    estimator = make_estimator(device, budget.estimator, None)
    for number in range(first, devices):
        # a motor's takes long to make, and finds its way from one motor to the next
        if not isinstance(device, SphericalMotor):
            estimator = make_estimator(device, budget.estimator, None)
        trial = next(trials)
        try:
            errors.add(trial.region, run_loop(device, estimator, trial, seed + number))
        except NoWrench:
            errors.add(trial.region, None)
    return errors.count(budget, components)


def main() -> None:
    """Print the coverage."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=["omni", "pmsm"])
    parser.add_argument("--devices", type=int, default=1500)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--samples", type=int, default=2000, help="devices of the band in each region")
    parser.add_argument("--estimator", help="instead of the device's first")
    parser.add_argument("--into", type=Path, help="file of the devices tried so far, which is continued")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    if given.into is not None and len(given.names) != 1:
        parser.error("--into is for one device")
    for name in given.names:
        device = load(name)
        build_tables(device)
        budget = report_errors(device, estimator=given.estimator, samples=given.samples).budget
        result = count_coverage(device, budget, given.devices, given.seed, given.into)
        if given.json:
            print(json.dumps(result))
        else:
            print_coverage(result, f"{result['device']}, {result['estimator']}")


if __name__ == "__main__":
    main()
