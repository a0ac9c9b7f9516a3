"""Coverage of the band of `haptorb inspect omni --errors --calibration` by calibrated simulated devices.

    python benchmarks/calibrated_budget.py [--devices 500] [--estimator tracker] [--seed 1000] [--into FILE] [--json]

Each device is drawn and built as in `error_budget.py`, and calibrated by the lines of `haptorb calibrate`, by its own
current sensors and field sensors, which are wrong. The loop believes what was found. With `--estimator hall` the field
sensors are calibrated as well (steps `fields` and `sensors`), which takes half a minute for each device. The band comes
from the calibration of one simulated device, specimen SEED, for half of its smallest peak force: what a calibration
leaves hardly differs from device to device, and the force that is asked for does by 10 mN.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from error_budget import Errors, NoWrench, Trial, print_coverage, run_loop, try_electromagnets
from haptorb.cli.calibration_dialog import check_steps, guide_calibration
from haptorb.cli.calibration_measurement import Pace, hold_tool, make_driver
from haptorb.cli.error_report import report_errors
from haptorb.devices.api import electromagnet
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.estimation.calibration_file import Calibration
from haptorb.estimation.registry import make_estimator
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.sim import SimDriver

STEPS = {
    "tracker": ("rest", "currents", "magnetic"),
    "hall": ("rest", "currents", "magnetic", "fields", "tool", "sensors"),
}
READING = 2e-3  #: from one reading of the calibration to the next [s]


def find_calibration(device: SphericalElectromagnet, driver: Driver, pace: Pace, estimator: str) -> Calibration:
    """What `haptorb calibrate` finds through `driver`."""
    with tempfile.TemporaryDirectory() as folder:
        found = guide_calibration(
            device, driver, Path(folder, "found.json"), steps=check_steps(STEPS[estimator]), pace=pace
        )
    assert found is not None
    return found


def calibrate_trial(device: SphericalElectromagnet, trial: Trial, seed: int, estimator: str) -> Calibration:
    """The calibration of that device, before its wrench is tried."""
    driver = SimDriver(trial.simulation, READING, seed=seed)
    hold_tool(driver, device, "away")
    return find_calibration(device, driver, Pace.for_simulation(), estimator)


def count_coverage(
    device: SphericalElectromagnet, devices: int, seed: int, samples: int, estimator: str, path: Path | None = None
) -> dict[str, Any]:
    """How often the true error lies in the band, by region and component, from `devices` calibrated devices."""
    own = find_calibration(device, *make_driver("sim", device, seed), estimator)
    budget = report_errors(device, estimator=estimator, calibration=own, samples=samples).budget
    errors = Errors(budget, seed, path)
    first = len(errors.found)
    trials = try_electromagnets(device, budget.asked, seed, first)
    for number in range(first, devices):
        trial = next(trials)
        believed = calibrate_trial(device, trial, seed + number, estimator).apply(device)
        try:
            error = run_loop(believed, make_estimator(believed, estimator, None), trial, seed + number)
        except NoWrench:
            errors.add(trial.region, None)
            continue
        errors.add(trial.region, error)
    return errors.count(budget, ((2,), (0, 1)))


def main() -> None:
    """Print the coverage."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--samples", type=int, default=2000, help="devices of the band in each region")
    parser.add_argument("--estimator", choices=tuple(STEPS), default="tracker")
    parser.add_argument("--into", type=Path, help="file of the devices tried so far, which is continued")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    device = electromagnet(load("omni"))
    result = count_coverage(device, given.devices, given.seed, given.samples, given.estimator, given.into)
    if given.json:
        print(json.dumps(result))
    else:
        print_coverage(result, f"{result['device']}, {result['estimator']}, calibrated")


if __name__ == "__main__":
    main()
