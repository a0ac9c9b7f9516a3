"""Accuracy of the tool's pose by the field sensors over the shell: simulated, calibrated devices.

    python benchmarks/sensing_accuracy.py [--specimens 3] [--first 0] [--places 16] [--dead 5] [--earth] [--turned]
                                          [--json]

Nothing here is from the formulas of `haptorb inspect --sensing`. Each specimen has its own lasting errors, drawn from
the device file's distributions, and a tool magnet 1 % stronger than the file says. Three trackers read the same
simulation: one that knows nothing of the errors, one with the step `magnetic` only, one with `fields` and `sensors`.
--dead N lets sensor N fail before the calibration. --earth adds the earth's field, 0.05 mT, which dips by 60°, to what
all sensors read, concentrated by the core; with --turned the device is turned by 180° about the vertical between its
calibration and its use.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from changed_readings import ChangedReadings
from haptorb.arrays import Array
from haptorb.cli.calibration_dialog import check_steps, guide_calibration
from haptorb.cli.calibration_measurement import Pace, hold_tool
from haptorb.devices.api import electromagnet
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.estimation.calibration_file import Calibration
from haptorb.estimation.hall_tracker import HallTracker
from haptorb.estimation.types import Sample
from haptorb.magnetics import dipole
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.simulation.base import Simulation
from haptorb.simulation.electromagnet import SimulatedElectromagnet
from haptorb_papers.reproduce.zarate2020.hall_position import clamp_tool, shell_places

STRONGER = 1.01  #: of the tool's magnet, relative to the file
EARTH = 0.05e-3 * np.array([0.5, 0.0, -np.sqrt(0.75)])  #: [T]
STEPS = ("rest", "currents", "magnetic", "fields", "tool", "sensors")
SETTLED, TICKS = 60, 120


class UniformField:
    """A field (3,) [T] that is the same everywhere, but for the core of an electromagnet, which concentrates it."""

    def __init__(self, device: SphericalElectromagnet, field: Array) -> None:
        moment = 4 * np.pi * device.core_radius**3 * field / dipole.MU0  # permeability infinite
        at = device.hall.positions
        self._field = field + dipole.field(np.broadcast_to(moment, at.shape), at)

    def add(self, read: Sample) -> Sample:
        """What is read, the uniform field included."""
        alive = read.field.any(axis=1, keepdims=True)
        return Sample(read.t, read.currents, read.temperatures, read.field + alive * self._field, read.pose)


@dataclass(frozen=True)
class Case:
    """What is tried: `dead` sensor, from 1 (0: none), and the uniform field (3,) [T] in calibration and use."""

    dead: int
    before: Array
    after: Array


def simulate(device: SphericalElectromagnet, seed: int, specimen: int, dead: int, uniform: Array) -> Simulation:
    """Device number `specimen`, with sensor `dead`, from 1, failed (0: none), in the `uniform` field (3,) [T]."""
    stronger = replace(device, tool=replace(device.tool, remanence=STRONGER * device.tool.remanence))
    if device.tolerance is not None:  # coils and core are not as in the file, and the earth's field is `uniform`
        stronger = replace(stronger, tolerance=device.tolerance.model_copy(update={"earth_field": 0.0}))
    world = SimulatedElectromagnet(stronger, seed, specimen=specimen)
    if dead:
        world.fail([dead - 1])
    return ChangedReadings(world, UniformField(stronger, uniform).add)


def calibrate(device: SphericalElectromagnet, specimen: int, case: Case) -> Calibration:
    """What the guided calibration finds of it."""
    driver = SimDriver(simulate(device, specimen, specimen, case.dead, case.before), 2e-3, seed=specimen)
    hold_tool(driver, device, "away")
    with tempfile.TemporaryDirectory() as folder:
        found = guide_calibration(
            device, driver, Path(folder, "found.json"), steps=check_steps(STEPS), pace=Pace.for_simulation()
        )
    assert found is not None
    return found


def read(
    believed: SphericalElectromagnet, offsets: Array | None, device: SphericalElectromagnet, duty: float,
    places: Array, specimen: int, case: Case,
) -> Array:  # fmt: skip
    """(n, 3) mean squares of the errors of place [m²] and axis [rad²], and share of ticks in which it was found."""
    out = np.full((len(places), 3), np.nan)
    still = clamp_tool(device)
    for row, p in zip(out, places, strict=True):
        world = simulate(still, specimen, specimen, case.dead, case.after)
        q = Rotation.from_matrix(rotation_to_axis(p)).as_quat()
        world.place(p, q)
        tracker, squares = HallTracker(believed, offsets=offsets), []
        for tick in range(TICKS):
            world.advance(1e-3, np.full(device.channels, duty), p, q)
            found = tracker.update(world.sample(1e-3 * tick, 1e-3 * tick, True))
            if tick >= SETTLED and found.valid:
                far, true = found.state.p - world.state().p, world.state().axis
                squares.append((far @ far, np.arccos(np.clip(found.state.axis @ true, -1, 1)) ** 2))
        row[2] = len(squares) / (TICKS - SETTLED)
        if squares:
            row[:2] = np.mean(squares, axis=0)
    return out


def measure(device: SphericalElectromagnet, specimens: range, count: int, case: Case) -> list[dict[str, Any]]:
    """One row for each tracker and current."""
    every, weights = shell_places(device)
    chosen = np.unique(np.linspace(0, len(every) - 1, count).round().astype(int))
    places, share = every[chosen], weights[chosen] / weights[chosen].sum()
    gathered: dict[tuple[str, float], list[Array]] = {}
    for specimen in specimens:
        found = calibrate(device, specimen, case)
        moments = replace(device, moment_per_current=found.moment_per_current)
        trackers = {
            "not calibrated": (device, None),
            "magnetic": (moments, found.offsets),
            "fields and sensors": (found.apply(device), None),
        }
        for name, (believed, offsets) in trackers.items():
            for duty in (0.0, 1.0):
                errors = read(believed, offsets, device, duty, places, specimen, case)
                gathered.setdefault((name, duty), []).append(errors)
    rows = []
    for (name, duty), errors in gathered.items():
        squares = np.stack(errors)
        finite = np.isfinite(squares[:, :, 0])
        weight = np.where(finite, share, 0.0)
        mean = [float((weight * np.nan_to_num(squares[:, :, part])).sum() / weight.sum()) for part in (0, 1)]
        rows.append(
            {
                "calibration": name,
                "duty": duty,
                "place_mm": 1e3 * math.sqrt(mean[0]),
                "axis_deg": math.degrees(math.sqrt(mean[1])),
                "found": float((share * squares[:, :, 2]).sum() / len(squares)),
            }
        )
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--specimens", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="number of the first specimen")
    parser.add_argument("--places", type=int, default=16)
    parser.add_argument("--dead", type=int, default=0)
    parser.add_argument("--earth", action="store_true")
    parser.add_argument("--turned", action="store_true")
    parser.add_argument("--json", action="store_true")
    words = parser.parse_args()
    field = EARTH if words.earth else np.zeros(3)
    case = Case(words.dead, field, field * (-1.0, -1.0, 1.0) if words.turned else field)
    specimens = range(words.first, words.first + words.specimens)
    rows = measure(electromagnet(load("omni")), specimens, words.places, case)
    if words.json:
        print(json.dumps(rows, indent=1))
        return
    print("calibration            duty  place [mm]  axis [°]  found [%]")
    for row in rows:
        print(f"{row['calibration']:22} {row['duty']:4.0f}  {row['place_mm']:10.2f}  {row['axis_deg']:8.2f}  "
              f"{100 * row['found']:9.1f}")  # fmt: skip


if __name__ == "__main__":
    main()
