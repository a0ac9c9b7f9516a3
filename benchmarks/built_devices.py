"""Actual against commanded force of devices with tolerances, before and after calibration.

    python benchmarks/built_devices.py [--devices 1000] [--seed 1000] [--asked 0.15] [--all-steps] [--json]

Each device is a member of the family that [tolerance] and [uncertainty] of the file describe: other windings, coils and
core off their places, another core, another magnet, in the earth's field (`haptorb.simulation.electromagnet_specimen`).
`haptorb calibrate` finds its moments with its own sensors, which are wrong, too. Then forces in any direction are asked
for anywhere in the shell, where the tool is known to be; what comes is computed by filaments. With `--all-steps` the
field sensors are calibrated as well, half a minute for each device.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

from calibrated_budget import READING, STEPS, find_calibration
from error_budget import draw_direction
from haptorb.arrays import Array
from haptorb.cli.calibration_measurement import Pace, hold_tool
from haptorb.control.allocation import force_allocator
from haptorb.devices.api import electromagnet
from haptorb.devices.base import State, rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.simulation.electromagnet import SimulatedElectromagnet
from haptorb.simulation.electromagnet_specimen import ElectromagnetSpecimen, fill_truth

PLACES = 12  #: for each device


def find_errors(
    believed: SphericalElectromagnet, built: ElectromagnetSpecimen, asked: float, rng: np.random.Generator
) -> Array:
    """(n,) size of the difference between the force of `built` and the one asked for, relative to it."""
    allocator, truth = force_allocator(believed), built.compute_map(believed.dome_radius)
    matrix, passive, errors = np.empty((6, believed.channels)), np.empty(6), np.empty(PLACES)
    lowest, wrench = np.cos(believed.workspace_half_angle), np.zeros(6)
    for number in range(PLACES):
        z, turn = rng.uniform(lowest, 1.0), rng.uniform(0, 2 * np.pi)
        axis = np.array([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
        distance = believed.contact_distance + rng.uniform() * believed.shell_thickness
        state = State.at(distance * axis, R_SR=rotation_to_axis(axis))
        wrench[:3] = asked * draw_direction(rng)
        currents = allocator.allocate(believed.wrench_map(state, "exact"), wrench).currents
        fill_truth(truth, state.R_SR, state.p, matrix, passive, np.empty((6, 3)))
        errors[number] = np.linalg.norm((matrix @ currents + passive - wrench)[:3]) / asked
    return errors


def measure(device: SphericalElectromagnet, devices: int, seed: int, asked: float, steps: str) -> dict[str, Any]:
    """Median and 95 % of the relative errors, before and after."""
    before, after = np.empty((devices, PLACES)), np.empty((devices, PLACES))
    for number in range(devices):
        simulated = SimulatedElectromagnet(device, seed + number)
        driver = SimDriver(simulated, READING, seed=seed + number)
        hold_tool(driver, device, "away")
        found = find_calibration(device, driver, Pace.for_simulation(), steps)
        for out, believed in ((before, device), (after, found.apply(device))):
            rng = np.random.default_rng([seed, number])
            out[number] = find_errors(believed, simulated.built, asked, rng)

    def share(errors: Array) -> dict[str, float]:
        median, most = np.quantile(100 * errors, (0.5, 0.95)).round(2).tolist()
        return {"median": median, "95": most}

    return {
        "device": device.name, "devices": devices, "asked_n": asked, "steps": STEPS[steps],
        "before_percent": share(before), "after_percent": share(after),
    }  # fmt: skip


def main() -> None:
    """Print both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--asked", type=float, default=0.15, help="force [N]")
    parser.add_argument("--all-steps", action="store_true")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    steps = "hall" if given.all_steps else "tracker"
    found = measure(electromagnet(load("omni")), given.devices, given.seed, given.asked, steps)
    if given.json:
        print(json.dumps(found))
        return
    done = ", ".join(found["steps"])
    print(f"{found['device']}, {found['devices']} devices, {1e3 * found['asked_n']:g} mN, after {done}:")
    for name in ("before", "after"):
        one = found[f"{name}_percent"]
        print(f"  {name:7s} calibration: median {one['median']:.2f} %, 95 % below {one['95']:.2f} %")


if __name__ == "__main__":
    main()
