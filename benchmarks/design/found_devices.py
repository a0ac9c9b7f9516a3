"""Devices found by searches against their base devices: figures of docs/explanation/found-devices.md.

    python benchmarks/design/found_devices.py [DEVICE ...] [--orientations 6000] [--trial] [--every 3] [--json]

All with the exact model. "as wound" is the Omni with the windings that its file assumes, at their true size, instead of
the point dipole with the moments that the paper prints. DEVICE: only these of the catalogue's found devices.
Motors: the worst of `--orientations` orientations, improved by a local search. --trial also runs the Hall tracker on
the simulated devices, with the lasting errors of the sensors that the device file states, without calibration, at
every third of the 64 positions of `sensing_error`: minutes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from haptorb.control.capability import motor_capability
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.estimation.sensor_calibration import without_errors
from haptorb_design.objectives import electromagnet_of, motor_of, quantity, shell_places
from haptorb_design.problem import DesignCandidate
from haptorb_papers.reproduce.zarate2020.hall_position import try_hall_tracker

MOTOR = (
    *("heat_per_torque_squared", "continuous_torque", "peak_torque", "torque_isotropy", "envelope_radius", "clearance"),
    *("spacing", "magnet_volume", "copper", "coil_stress", "orientation_error"),
    *("regulator_error", "regulator_hold", "regulator_volume", "regulator_pull"),
)
CORE = (
    *("core_pull", "continuous_force", "continuous_radial_force", "peak_force", "heat_per_force_squared", "copper"),
    *("clearance", "spacing"),
)
SENSORS = ("sensing_error", "sensor_clearance", "sensor_field")
PAIRS = (("pmsm", "pmsm-three-rings", MOTOR), ("omni", "omni-small-core", CORE), ("omni", "omni-sensor-ring", SENSORS))


def as_wound(device: SphericalElectromagnet) -> SphericalElectromagnet:
    """`device` with the moments of its windings, whose field is then theirs and not a point dipole's."""
    moments = device.predict_moments()
    assert moments is not None
    return replace(device, moment_per_current=moments, moments_from="windings")


def compare(names: Collection[str], orientations: int) -> dict[str, dict[str, tuple[float, float]]]:
    """Found device → quantity → (base's, its own)."""
    out: dict[str, dict[str, tuple[float, float]]] = {}
    for base_name, name, quantities in PAIRS:
        if name not in names:
            continue
        base, found = load(base_name), load(name)
        both = [DesignCandidate(device, base, {"orientations": orientations}) for device in (base, found)]
        rows = {one: tuple(quantity(one).compute(candidate) for candidate in both) for one in quantities}
        if quantities is MOTOR:  # as `haptorb inspect` has it: about X, Y and Z alone
            cards = [motor_capability(motor_of(candidate), 9, 48) for candidate in both]
            rows["card: continuous torque"] = tuple(float(card.continuous.min()) for card in cards)
            rows["card: peak torque"] = tuple(float(card.peak.min()) for card in cards)
            rows["card: heat"] = tuple(float(card.power.max()) for card in cards)
        if quantities is CORE:
            wound = DesignCandidate(as_wound(electromagnet_of(both[0])), base, {"places": 160})
            found_one = DesignCandidate(found, base, {"places": 160})
            for one in quantities:
                if "force" in one:
                    rows[f"as wound: {one}"] = (quantity(one).compute(wound), quantity(one).compute(found_one))
        out[name] = rows  # type: ignore[assignment]
    return out


def try_trackers(every: int) -> dict[str, float]:
    """Root mean square of the tracker's position error [m] at one of so many places of `sensing_error`."""
    places = shell_places(electromagnet_of(DesignCandidate(load("omni"), load("omni"), {})))[::every]
    found = {}
    for name in ("omni", "omni-sensor-ring"):
        device = electromagnet_of(DesignCandidate(load(name), load(name), {}))
        sensors = replace(device, tolerance=None)  # coils and magnet as in the file
        for what, one in (("lasting errors", sensors), ("noise only", without_errors(device))):
            errors = try_hall_tracker(one, places, 0.0)
            found[f"{name}, {what}"] = float(np.sqrt(np.nanmean(errors[:, 0] ** 2)))
    return found


def main() -> None:
    """Print the table."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = [name for _, name, _ in PAIRS]
    asked.add_argument("devices", nargs="*", metavar="DEVICE", help=", ".join(known))
    asked.add_argument("--orientations", type=int, default=6000)
    asked.add_argument("--trial", action="store_true")
    asked.add_argument("--every", type=int, default=3)
    asked.add_argument("--json", action="store_true")
    options = asked.parse_args()
    if unknown := set(options.devices) - set(known):
        asked.error(f"{min(unknown)} is none of the found devices: {', '.join(known)}")
    rows = compare(options.devices or known, options.orientations)
    trial = try_trackers(options.every) if options.trial else {}
    if options.json:
        print(json.dumps({"devices": rows, "trial": trial}))
        return
    for name, found in rows.items():
        print(name)
        for key, (before, after) in found.items():
            print(f"  {key:30} {before:12.5g} {after:12.5g}   {after / before if before else float('nan'):.3f}")
    for name, error in trial.items():
        print(f"{name}: tracker's position error {1e3 * error:.2f} mm rms")


if __name__ == "__main__":
    main()
