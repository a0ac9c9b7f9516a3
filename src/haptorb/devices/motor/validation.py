"""What can be wrong with a ball-joint motor although every value in its file is well-formed: its geometry and wiring.

Findings are sentences. They cover parts that overlap, a gap that is none, sensors in the way, groups that name coils
wrongly, pairs that do not face each other, and groups wired so that the motor cannot turn about every axis.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from haptorb.devices.motor.layouts import Layout
from haptorb.errors import GeometryError
from haptorb.numerics.arrays import Array
from haptorb.numerics.rotations import rotation_from_euler

if TYPE_CHECKING:
    from haptorb.devices.motor.spherical_motor import SphericalMotor

__all__ = ["WORST_CONDITION", "findings", "grouping", "workspace_sample"]

WORST_CONDITION = 100.0  #: a motor that is a hundred times weaker about some axis cannot be used there
_CHORDS = 2048  #: steps of a table of the pair's torque between no chord and a diameter
_FACING = np.radians(0.5)  #: how far from opposite a pair of coils may be and still count as facing


def grouping(groups: Sequence[Sequence[int]], count: int, winding: str) -> tuple[Array, list[str]]:
    """(count, m) current of every coil per ampere of every channel, and what is wrong with the groups.

    "series-opposed": every second coil of a group is wound the other way.

    >>> grouping([[1, 2]], 2, "series-opposed")[0].tolist()
    [[1.0], [-1.0]]
    >>> grouping([[1, 5]], 2, "series-aiding")[1]
    ['groups.coils: group 1 names EM5, but there are only 2 electromagnets', 'groups.coils: EM2 is in no group']
    """
    matrix = np.zeros((count, len(groups)))
    wrong = []
    for channel, members in enumerate(groups):
        for place, coil in enumerate(members):
            if not 1 <= coil <= count:
                wrong.append(
                    f"groups.coils: group {channel + 1} names EM{coil}, but there are only {count} electromagnets"
                )
                continue
            matrix[coil - 1, channel] = -1.0 if winding == "series-opposed" and place % 2 else 1.0
    used = Counter(coil for members in groups for coil in members)
    wrong += [f"groups.coils: EM{coil} appears {many} times" for coil, many in sorted(used.items()) if many > 1]
    wrong += [f"groups.coils: EM{coil} is in no group" for coil in range(1, count + 1) if coil not in used]
    return matrix, wrong


def findings(motor: SphericalMotor, groups: Sequence[Sequence[int]], *, antipodal: bool) -> list[str]:
    """Everything that geometry and wiring have against `motor`, as sentences; an empty list is a pass."""
    coil, magnet = motor.electromagnet, motor.magnet
    found = _overlaps("electromagnets", "EM", motor.electromagnets, coil.outer_radius, coil.length)
    found += _overlaps("magnets", "PM", motor.magnets, magnet.radius, magnet.length)
    found += _gap(motor)
    if antipodal:
        found += _list_not_facing(motor.electromagnets, groups)
    return found + _list_weaknesses(motor, groups)


def _overlaps(section: str, letters: str, layout: Layout, radius: float, length: float) -> list[str]:
    """Two equal radial cylinders touch where their inner rims meet: on the plane that halves the angle between them."""
    inner = layout.distance - 0.5 * length
    if inner <= 0:
        return [f"{section}: the parts reach through the centre; distance must be more than half their length"]
    span = 2 * np.arctan2(radius, inner)
    between = np.arccos(np.clip(layout.directions @ layout.directions.T, -1.0, 1.0))
    first, second = np.nonzero(np.triu(between < span, k=1))
    if not len(first):
        return []
    pairs = ", ".join(
        f"{letters}{i + 1} and {letters}{j + 1} ({np.degrees(between[i, j]):.1f}°)"
        for i, j in zip(first, second, strict=True)
    )
    return [f"{section}: parts overlap, each spans {np.degrees(span):.1f}° as seen from the centre: {pairs}"]


def _gap(motor: SphericalMotor) -> list[str]:
    coil, magnet = motor.electromagnet, motor.magnet
    found = []
    if motor.magnets.distance > motor.electromagnets.distance:  # the rotor is outside, Bai 2012
        inside = float(np.hypot(motor.electromagnets.distance + 0.5 * coil.length, coil.outer_radius))
        outside = motor.magnets.distance - 0.5 * magnet.length
    else:
        inside = float(np.hypot(motor.magnets.distance + 0.5 * magnet.length, magnet.radius))
        outside = motor.electromagnets.distance - 0.5 * coil.length
    if outside <= inside:
        found.append(
            f"magnets.distance: no gap between rotor and stator: the inner parts reach {inside * 1e3:.2f} mm from the "
            f"centre, the outer ones begin at {outside * 1e3:.2f} mm"
        )
    at = motor.sensor_layout.distance
    rim = float(np.hypot(motor.magnets.distance + 0.5 * magnet.length, magnet.radius))
    if motor.magnets.distance - 0.5 * magnet.length <= at <= rim:
        found.append(f"sensors.distance: at {at * 1e3:.2f} mm the magnets sweep through the sensors")
    frames, places = motor.electromagnets.frames, motor.electromagnets.positions
    for number, position in enumerate(motor.sensor_layout.positions):
        own = np.einsum("jba,jb->ja", frames, position - places)
        inside_coil = np.flatnonzero(coil.contains(own))
        found += [f"sensors: sensor {number + 1} sits inside EM{coil_number + 1}" for coil_number in inside_coil]
    return found


def _list_not_facing(layout: Layout, groups: Sequence[Sequence[int]]) -> list[str]:
    pairs = []
    for members in groups:
        if len(members) != 2:
            continue
        i, j = members
        away = np.pi - np.arccos(np.clip(layout.directions[i - 1] @ layout.directions[j - 1], -1.0, 1.0))
        if away > _FACING:
            pairs.append(f"EM{i} and EM{j} ({np.degrees(away):.1f}° off)")
    if not pairs:
        return []
    return [f"groups.coils: pairs that do not face each other across the centre: {', '.join(pairs)}"]


def workspace_sample(tilt: float, tilts: int, spins: int) -> Array:
    """(n, 3, 3) orientations over |ψ|, |λ| ≤ `tilt` (a square grid) and 0 ≤ φ < 360°.

    `tilt` in [rad].

    >>> workspace_sample(0.4, 3, 8).shape
    (72, 3, 3)
    """
    edge = np.linspace(-tilt, tilt, tilts)
    psi, lam, phi = np.meshgrid(edge, edge, 2 * np.pi * np.arange(spins) / spins, indexing="ij")
    return rotation_from_euler(psi.ravel(), lam.ravel(), phi.ravel())


def _list_weaknesses(motor: SphericalMotor, groups: Sequence[Sequence[int]]) -> list[str]:
    """Rank and condition of the grouped torque characteristic, at the dipole model: symmetry shows there as well."""
    R = workspace_sample(motor.workspace_tilt, 5, 48)
    single = motor.torque_characteristic(R, "dipole")
    grouped = single @ motor.groups
    scale = float(np.abs(single).max())
    reach = np.abs(grouped).max(axis=(0, 1))
    dead = np.flatnonzero(reach < 1e-6 * scale).tolist()
    if len(dead) == len(groups):
        return [
            "groups.winding: no group produces any torque at any orientation: the coils of every group cancel each "
            "other. "
            "Magnets polarized alike at opposite positions need 'series-aiding', unlike ones 'series-opposed', or the "
            "other polarity"
        ]
    found = [
        f"groups.coils: group {number + 1} (EM{' + EM'.join(str(coil) for coil in groups[number])}) produces no "
        "torque at any orientation: its coils cancel each other"
        for number in dead
    ]
    values = np.linalg.svd(grouped, compute_uv=False)
    weakest, strongest = values[:, 2], values[:, 0]
    worst = int(np.argmin(weakest / strongest))
    rank = int((values[worst] > 1e-6 * strongest[worst]).sum())
    if rank < 3:
        found.append(
            f"groups: the channels produce torque about {rank} of three axes (rank {rank}) somewhere in the workspace"
        )
    elif strongest[worst] > WORST_CONDITION * weakest[worst] and (times := _condition(motor, R)) > WORST_CONDITION:
        found.append(
            f"groups: {times:.0f} times weaker about one axis than about another within "
            f"the workspace; at most {WORST_CONDITION:.0f} times is allowed"
        )
    return found


def _condition(motor: SphericalMotor, R: Array) -> float:
    """Greatest over smallest torque per ampere by direction, in the worst of R (n, 3, 3), at the exact level.

    Dipoles tell which axes a motor has, but not how weak one is where wide parts pass each other closely. Slower, so
    it is asked only where dipoles object. Infinite where parts overlap, which is a finding of its own.
    """
    from haptorb.devices.tables.series_table import series_torque

    coils, chords = motor.electromagnets, np.linspace(0.0, 2.0, _CHORDS + 1)
    try:
        k = series_torque(
            motor.magnet, motor.magnets.distance, motor.electromagnet, coils.distance, 1 - 0.5 * chords**2
        )
    except GeometryError:
        return float("inf")
    greatest, slope = 0.0, np.diff(k)
    for part in np.array_split(R, max(len(R) // 100, 1)):
        u = np.einsum("nab,ib->nia", part, motor.magnets.directions)
        place = 0.5 * _CHORDS * np.sqrt(np.clip(2 - 2 * u @ coils.directions.T, 0.0, 4.0))
        below = np.minimum(place.astype(np.intp), _CHORDS - 1)
        strength = (k[below] + (place - below) * slope[below]) * motor.polarity[:, None]
        pull = np.swapaxes(strength, 1, 2) @ u  # (n, coils, 3): Σ k û
        single = np.swapaxes(np.cross(pull, coils.directions), 1, 2)
        values = np.linalg.svd(single @ motor.groups, compute_uv=False)
        greatest = max(greatest, float((values[:, 0] / np.maximum(values[:, 2], 1e-300)).max()))
    return greatest
