"""Accuracy of the tool's pose over the shell with 27 multiplexed field channels, through the emulated firmware.

    python benchmarks/hall_in_turns.py [--pace 0.15] [--places 4] [--ticks 300] [--json]

The emulated firmware reads the simulated device, whose tool is clamped at each place in turn; driver and tracker are
those of `haptorb run omni --driver serial:PORT --tracker hall`. Twice: with the coils off, and with currents that swing
between −5 and 5 A three times a second, each coil a third of a turn later, while the tracker believes a moment map that
is wrong by 0.1 % (standard deviation), as after `haptorb calibrate`.

Places: so many distances, angles from the summit and azimuths, each the middle of an equal share; the rms is weighted
by the share of the sphere that each stands for. Firmware time runs at `pace` of ours.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from haptorb.arrays import Array
from haptorb.devices.api import electromagnet
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.errors import DriverError
from haptorb.estimation.registry import make_estimator
from haptorb.estimation.sensor_calibration import without_errors
from haptorb.estimation.types import Estimator
from haptorb.runtime.drivers.emulator_process import EmulatedDevice, Emulator
from haptorb.runtime.drivers.serial import SerialDriver
from haptorb_papers.reproduce.zarate2020.hall_position import clamp_tool, shell_places

BUILD = Path(__file__).resolve().parents[1] / "firmware" / "build"
CALIBRATED = 1e-3  #: of each entry of the moment map, as a share of its column
DUTY, SWINGS = 0.25, 3.0  #: 5 A, times a second
SETTLED = 0.15  #: after which filter and currents are what they stay [s]


class _Run:
    """One emulated device, its driver open."""

    def __init__(self, device: SphericalElectromagnet, folder: str, pace: float) -> None:
        device = without_errors(device)  # what the turns cost, and not the sensors
        self.pace = pace
        self.trackers: dict[tuple[bool, int], Estimator] = {}
        self.goal = (np.array([0.0, 0.0, device.contact_distance + 2e-3]), np.array([0.0, 0.0, 0.0, 1.0]))
        self.emulated = EmulatedDevice(device, Path(folder, "physics"), lambda t: self.goal)
        self.emulated.place(*self.goal)
        self.emulator = Emulator(BUILD, Path(folder, "port"), physics=self.emulated)
        self.driver = SerialDriver(
            device, self.emulator.port, timeout=1.0, warm_up=90.0, hall_axes=3, clock=lambda: time.monotonic() * pace
        )
        self.driver.open()
        self.emulator.set_pace(pace)

    def close(self) -> None:
        """Driver first: it says OFF."""
        self.driver.close()
        self.emulator.close()
        self.emulated.close()


def tracker_of(device: SphericalElectromagnet, driving: bool, seed: int) -> Estimator:
    """A tracker that believes a moment map as wrong as a calibration leaves it, where the coils are driven."""
    rng = np.random.default_rng(seed)
    scale = CALIBRATED * driving * np.linalg.norm(device.moment_per_current, axis=0)
    moments = device.moment_per_current + scale * rng.standard_normal(device.moment_per_current.shape)
    return make_estimator(replace(without_errors(device), moment_per_current=moments), "hall", None, in_turns=True)


def errors(place: Array, driving: bool, run: _Run, ticks: int, number: int) -> Array:
    """(n, 2) errors of place [m] and axis [rad] in the ticks in which the tool at `place` (3,) [m] was found."""
    tracker = run.trackers[driving, number]
    run.goal = (place, Rotation.from_matrix(rotation_to_axis(place)).as_quat())
    run.emulated.place(*run.goal)
    found: list[tuple[float, float]] = []
    start = deadline = time.monotonic()
    for tick in range(ticks + round(SETTLED * 1e3)):
        deadline = max(deadline + 1e-3 / run.pace, time.monotonic() - 1e-3 / run.pace)
        time.sleep(max(0.0, deadline - time.monotonic()))
        now = (time.monotonic() - start) * run.pace  # the firmware's time passes so
        estimate = tracker.update(run.driver.read(now))
        true = run.emulated.pose(now)
        phase = 2 * np.pi * (SWINGS * now + np.arange(3) / 3)
        run.driver.write(DUTY * driving * np.sin(phase))
        if estimate.valid and tick >= SETTLED * 1e3:
            turned = float(np.arccos(np.clip(estimate.state.axis @ true.R_SR[:, 2], -1.0, 1.0)))
            found.append((float(np.linalg.norm(estimate.state.p - true.p)), turned))
    return np.array(found).reshape(-1, 2)


def again(once: Callable[[], Array], run: _Run) -> Array:
    """What `once` gives; tried anew where this computer was too busy for a watchdog of 15 ms of firmware time."""
    for _ in range(4):
        try:
            return once()
        except DriverError:
            run.driver.engage()
    return once()


def measure(pace: float, count: int, ticks: int) -> dict[str, float]:
    """rms and worst of both cases."""
    device = clamp_tool(electromagnet(load("omni")))
    places, weights = shell_places(device, count)
    figures: dict[str, float] = {"places": len(places)}
    with tempfile.TemporaryDirectory() as folder:
        run = _Run(device, folder, pace)
        try:
            cases = [(driving, n) for driving in (False, True) for n in range(len(places))]
            # made now: the firmware does not wait while they are
            run.trackers = {case: tracker_of(device, *case) for case in cases}
            for driving, case in ((False, "currents off"), (True, "currents swinging by 5 A")):
                each = [again(partial(errors, p, driving, run, ticks, n), run) for n, p in enumerate(places)]
                rms = np.array([np.sqrt((one**2).mean(axis=0)) if len(one) else (math.nan,) * 2 for one in each])
                figures[f"rms over the shell, {case} [mm]"] = 1e3 * float(np.sqrt(weights @ rms[:, 0] ** 2))
                figures[f"rms at the worst place, {case} [mm]"] = 1e3 * float(rms[:, 0].max())
                figures[f"worst of all ticks, {case} [mm]"] = 1e3 * max(float(one[:, 0].max(initial=0)) for one in each)
                figures[f"rms of the axis, {case} [deg]"] = math.degrees(float(np.sqrt(weights @ rms[:, 1] ** 2)))
                figures[f"ticks in which it was found, {case} [%]"] = 100 * float(
                    weights @ np.array([len(one) / ticks for one in each])
                )
        finally:
            run.close()
    return figures


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pace", type=float, default=0.15)
    parser.add_argument("--places", type=int, default=4, help="distances, angles and azimuths each")
    parser.add_argument("--ticks", type=int, default=300)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    result = measure(given.pace, given.places, given.ticks)
    if given.json:
        print(json.dumps(result))
        return
    for name, value in result.items():
        print(f"{name:60s} {value:9.3f}")


if __name__ == "__main__":
    main()
