"""The planar array against published data of Berkelman et al., and its force per ampere by two methods.

    python benchmarks/devices/published_array.py [--json]

Published: a single magnet over 16 coils moves in 30 × 90 × 120 mm (Berkelman and Dzadovsky 2010); 16 coils give a
handle several newtons within approximately 25 mm of the display above them (Berkelman, Miyasaka and Anderson 2012).
Neither source, as far as it could be read, states dimensions or a force per ampere: the dimensions of `planar` are
assumed.

Range: how far along x (y = 0) and y (x = 0) the coils carry the magnet's own weight without a torque, with at most 4 A
per coil. Force: in the worst direction over the middle, among the normals of all facets and 2000 more, with the supply
of the device file and with an unlimited one. Force per ampere: of one coil on the magnet above it, half a coil aside,
from the product's wrench map, and from the magnet's field (closed form) on the coil's filaments.
"""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

import numpy as np

from haptorb.arrays import Array, cap_directions
from haptorb.control.array_allocation import ArrayAllocator
from haptorb.devices.base import State, require
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.loader import load
from haptorb.devices.placed_coils import place_coils
from haptorb.magnetics.interaction import wrench
from haptorb.magnetics.magnets import CylinderMagnet
from haptorb.magnetics.source import PlacedSource
from haptorb_design.objectives import greatest_force

PUBLISHED = (30e-3, 90e-3, 120e-3)  #: range up, along y, along x [m]
DENSITY = 7500.0  #: sintered NdFeB [kg/m³]
AXIS = (0.0, 0.0, 1.0)


def carries(device: CoilArray, place: tuple[float, float, float]) -> bool:
    """Whether the coils carry the magnet's weight there, upright, without a torque."""
    magnet = device.tool.magnets[0]
    weight = DENSITY * np.pi * magnet.outer_radius**2 * magnet.length * 9.80665
    allocator = ArrayAllocator(device.coils.current_limit, device.coils.resistance, "both")
    there = device.wrench_map(State.at(place, axis=AXIS), "exact")
    asked = np.array([0.0, 0.0, weight, 0.0, 0.0, 0.0])
    given = there.wrench(allocator.allocate(there, asked).currents)
    return bool(np.abs(given - asked)[:3].max() < 2e-3 * weight and np.abs(given[3:]).max() < 1e-4)


def find_range(device: CoilArray) -> list[dict[str, float]]:
    """For heights up to the published one: the span along x and along y in which the magnet is carried [m]."""
    rows = []
    for up in np.linspace(0.0, PUBLISHED[0], 4).tolist():
        z = device.contact_height + up
        reach = {}
        for name, one in (("x", (1.0, 0.0)), ("y", (0.0, 1.0))):
            steps = np.arange(0.0, 0.1001, 2.5e-3).tolist()
            carried = [r for r in steps if carries(device, (one[0] * r, one[1] * r, z))]
            reach[name] = 2 * max(carried, default=0.0)
        rows.append({"above_contact_m": up, "along_x_m": reach["x"], "along_y_m": reach["y"]})
    return rows


def find_normals(force: Array) -> Array:
    """(n, 3) normals of all facets of the polytope of forces: a pair of coils (3, m) spans each; the least force in any
    direction without a limit of the supply is at one of them, exactly."""
    first, second = np.triu_indices(force.shape[1], 1)
    normals = np.cross(force[:, first], force[:, second], axis=0).T
    size = np.linalg.norm(normals, axis=1)
    facets: Array = normals[size > 1e-9 * size.max()] / size[size > 1e-9 * size.max(), None]
    return facets


def find_forces(device: CoilArray) -> list[dict[str, float]]:
    """For distances of the magnet from the tops of the coils: force in the worst direction over the middle [N]."""
    directions, coils, magnet = cap_directions(np.pi, 2000), device.coils, device.tool.magnets[0]
    rows = []
    for gap in (5e-3, 10e-3, 15e-3, 20e-3, 25e-3):
        here = device.wrench_map(State.at((0.0, 0.0, gap + magnet.length / 2), axis=AXIS), "exact").force
        normals = find_normals(here)
        force = [
            float(
                greatest_force(
                    np.vstack([normals, directions]) @ here, coils.current_limit, coils.resistance, power
                ).min()
            )
            for power in (device.supply.power, np.inf)
        ]
        rows.append({"magnet_above_coils_m": gap, "force_n": force[0], "force_any_supply_n": force[1]})
    return rows


def find_force_per_ampere(device: CoilArray) -> list[dict[str, Any]]:
    """Coil B2 on the magnet above it: from the map and from the filaments [N/A]."""
    magnet, number = device.tool.magnets[0], device.coils.names.index("B2")
    placed = place_coils(device.windings)[number]
    rows = []
    for gap in (5e-3, 10e-3, 20e-3, 30e-3):
        at = device.windings.position[number] + np.array([0.016, 0.0, 15e-3 + gap + magnet.length / 2])
        source = PlacedSource(CylinderMagnet(magnet.outer_radius, magnet.length, magnet.remanence), at, np.eye(3))
        found = device.wrench_map(State.at(at, axis=AXIS), "exact").force[:, number]
        other = -wrench(source, placed.source, placed.position, placed.turn, about=at, precision=1e-6).value[:3]
        off = float(np.linalg.norm(found - other) / np.linalg.norm(other))
        rows.append({"magnet_above_coil_m": gap, "map_n_per_a": found.tolist(), "filaments_n_per_a": other.tolist(),
                     "relative_difference": off})  # fmt: skip
    return rows


def main() -> int:
    """Print it; 1 if the range in contact is less than the published one, or the two forces differ by 1e-3."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    device = require(load("planar"), CoilArray, "this benchmark")
    reach, forces, pairs = find_range(device), find_forces(device), find_force_per_ampere(device)
    if options.json:
        print(json.dumps({"range": reach, "force": forces, "force_per_ampere": pairs}))
    else:
        for row in reach:
            print("carried {above_contact_m:.3f} m above contact: {along_x_m:.3f} m by {along_y_m:.3f} m".format(**row))
        for row in forces:
            print("magnet {magnet_above_coils_m:.3f} m above the coils: {force_n:.2f} N in the worst direction, "
                  "{force_any_supply_n:.2f} N with an unlimited supply".format(**row))  # fmt: skip
        for pair in pairs:
            print("one coil, {magnet_above_coil_m:.3f} m below: {map_n_per_a} N/A, from filaments different by "
                  "{relative_difference:.1e}".format(**pair))  # fmt: skip
    in_range = reach[0]["along_x_m"] >= PUBLISHED[2] and reach[0]["along_y_m"] >= PUBLISHED[1]
    return int(not in_range or max(pair["relative_difference"] for pair in pairs) > 1e-3)


if __name__ == "__main__":
    sys.exit(main())
