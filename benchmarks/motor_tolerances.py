"""How much the torque per ampere of a motor's coil differs within [tolerance], against `uncertainty.coil`.

    python benchmarks/motor_tolerances.py [pmsm] [pmsm-three-rings] [--places 100] [--seed 1]

Nothing is drawn and nothing is simulated. At random orientations in the workspace the torque of one coil is
differentiated by every place, axis, edge and number of turns, from the closed form of the magnets' field. Each
derivative times its standard deviation is one part; the parts are independent, and are summed by squares.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from haptorb.arrays import Array
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.loader import load
from haptorb.devices.motor import SphericalMotor
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.wire import overall_diameter, wind, wire_diameter
from haptorb.rotations import rotation_from_euler

SEGMENTS, LOOPS = 40, (4, 5)  #: of a loop; and loops of a coil, across and along
NEAR = 8  #: magnets nearest to a coil that act on it; the nearer half may be off
PARTS = (
    "places of coils", "axes of coils", "edges of coils", "places of magnets", "axes of magnets", "turns of each layer",
)  # fmt: skip
STEP = 1e-4  #: of a derivative [m, rad]


def compute_torque(
    device: SphericalMotor, coil: tuple[Array, Array, Array], magnets: tuple[Array, Array, Array]
) -> Array:
    """(3,) [N·m/A] on `magnets` (places, axes, polarity) of a coil (place, axis, excess of its edges [m])."""
    place, axis, edges = coil
    known = device.electromagnet
    size = (known.inner_radius + edges[0], known.outer_radius + edges[1], known.length + edges[2])
    radii, heights, turns = Coil(known.turns, *map(float, size)).filaments(*LOOPS)
    angle = 2 * np.pi * (np.arange(SEGMENTS) + 0.5) / SEGMENTS
    cosine, sine, step = np.cos(angle), np.sin(angle), 2 * np.pi / SEGMENTS * radii * turns
    rim = np.stack([np.outer(radii, cosine), np.outer(radii, sine), np.repeat(heights[:, None], SEGMENTS, 1)], -1)
    along = np.stack([-np.outer(step, sine), np.outer(step, cosine), np.zeros_like(rim[..., 0])], -1)
    frame = rotation_to_axis(axis)
    points, field = rim.reshape(-1, 3) @ frame.T + place, np.zeros((rim[..., 0].size, 3))
    for at, direction, sign in zip(*magnets, strict=True):
        own = rotation_to_axis(direction)
        field += sign * device.magnet.field((points - at) @ own) @ own.T
    torque: Array = -np.cross(points, np.cross(along.reshape(-1, 3) @ frame.T, field)).sum(axis=0)
    return torque


def find_parts(device: SphericalMotor, places: int, seed: int) -> dict[str, float]:
    """Relative standard deviation of a coil's torque per ampere, rms over the workspace, by PARTS."""
    tolerance, known = device.tolerance, device.electromagnet
    assert tolerance is not None
    series = float(np.abs(device.groups).sum(axis=0)[0])
    copper = wire_diameter(known, float(device.coils.resistance[0]) / series, device.coils.copper_resistivity)
    layers = wind(known.turns, known.inner_radius, known.length, overall_diameter(copper))
    assert layers is not None
    rng, whole, sums = np.random.default_rng(seed), 0.0, dict.fromkeys(PARTS, 0.0)
    for _ in range(places):
        psi, lam = device.workspace_tilt * rng.uniform(-1.0, 1.0, 2)
        R = rotation_from_euler(float(psi), float(lam), rng.uniform(0, 2 * np.pi))
        number = int(rng.integers(len(device.electromagnets)))
        size, squares = differentiate(device, R, number)
        squares["turns of each layer"] = tolerance.turns_per_layer**2 * layers.layers / known.turns**2 * size
        whole += size
        for name in PARTS:
            sums[name] += squares[name]
    return {name: float(np.sqrt(part / whole)) for name, part in sums.items()}


def differentiate(device: SphericalMotor, R: Array, number: int) -> tuple[float, dict[str, float]]:
    """Square of coil `number`'s torque per ampere at R (3, 3) [(N·m/A)²], and its variance by each of PARTS but the
    last."""
    tolerance = device.tolerance
    assert tolerance is not None
    at, axis = device.electromagnets.positions[number], device.electromagnets.directions[number]
    near = np.argsort(-(device.magnets.directions @ R.T @ axis))[:NEAR]
    where, direction = device.magnets.positions[near] @ R.T, device.magnets.directions[near] @ R.T
    sign, none = np.array(device.polarity, dtype=np.float64)[near], np.zeros(3)
    magnets = (where, direction, sign)

    def turn(vectors: Array, by: Array) -> Array:
        turned: Array = Rotation.from_rotvec(by).apply(vectors)
        return turned

    def vary(standard: float, torque: Callable[[Array], Array]) -> float:
        slopes = [(torque(STEP * unit) - torque(-STEP * unit)) / (2 * STEP) for unit in np.eye(3)]
        return standard**2 * float(sum(slope @ slope for slope in slopes))

    def move_magnet(k: int, by: Array) -> Array:
        moved = where.copy()
        moved[k] += by
        return compute_torque(device, (at, axis, none), (moved, direction, sign))

    def turn_magnet(k: int, by: Array) -> Array:
        turned = direction.copy()
        turned[k] = turn(turned[k], by)
        return compute_torque(device, (at, axis, none), (where, turned, sign))

    torque = compute_torque(device, (at, axis, none), magnets)
    return float(torque @ torque), {
        "places of coils": vary(tolerance.position, lambda s: compute_torque(device, (at + s, axis, none), magnets)),
        "axes of coils": vary(tolerance.tilt, lambda s: compute_torque(device, (at, turn(axis, s), none), magnets)),
        "edges of coils": vary(tolerance.winding, lambda s: compute_torque(device, (at, axis, s), magnets)),
        "places of magnets": sum(vary(tolerance.magnet_position, partial(move_magnet, k)) for k in range(NEAR // 2)),
        "axes of magnets": sum(vary(tolerance.magnet_tilt, partial(turn_magnet, k)) for k in range(NEAR // 2)),
    }


def main() -> None:
    """Print the parts, and their sum by squares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=["pmsm", "pmsm-three-rings"])
    parser.add_argument("--places", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    for name in given.names:
        device = load(name)
        assert isinstance(device, SphericalMotor)
        parts = find_parts(device, given.places, given.seed)
        whole = float(np.sqrt(sum(part**2 for part in parts.values())))
        print(f"{name}: torque per ampere of a coil within {100 * whole:.1f} % (one standard deviation); the file says "
              f"{100 * device.uncertainty.coil:g} %")  # fmt: skip
        for part, size in parts.items():
            print(f"  {part:20s} {100 * size:.2f} %")


if __name__ == "__main__":
    main()
