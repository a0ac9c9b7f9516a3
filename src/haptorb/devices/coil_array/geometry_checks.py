"""Places of a coil array's file that cannot be, although every value by itself is well-formed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from haptorb.devices.coil_array.parts import ArrayMover, PlacedCoils
from haptorb.devices.state import rotation_to_axis
from haptorb.numerics.arrays import Array

__all__ = ["list_array_mistakes"]

_TOUCH = 1e-6  #: parts that touch do not overlap [m]
_STEPS = 48  #: points around a winding that are held against another one
_NAMED = 6  #: coils that one message names


def list_array_mistakes(
    names: Sequence[str], coils: PlacedCoils, tool: ArrayMover, core_radius: float, dome_radius: float, height: float
) -> list[str]:
    """Sentences; none is a pass. core_radius 0: no core; dome_radius 0: a plate at `height` [m].

    The mover is upright in the middle, 10 mm above contact.
    """
    found = []
    inside = [name for name, reach in zip(names, coils.nearest, strict=True) if reach < core_radius - _TOUCH]
    if inside:
        found.append(
            f"windings of coil {_join(inside)} reach into the core of {core_radius * 1e3:g} mm; move them out, or make "
            "the core smaller"
        )
    pairs = _list_overlaps(coils)
    if pairs:
        joined = [f"{names[i]} and {names[j]}" for i, j in pairs]
        found.append(f"windings of coils {_join(joined)} overlap; move them apart, or make them smaller")
    points = [_surface(coils, number) for number in range(len(names))]
    if dome_radius:
        far = [float(np.linalg.norm(at, axis=1).max()) for at in points]
        out = [name for name, reach in zip(names, far, strict=True) if reach > dome_radius]
        if out:
            found.append(
                f"windings of coil {_join(out)} reach out of the dome of {dome_radius * 1e3:g} mm, where the tool "
                "goes; move them in, or make the dome larger"
            )
    else:
        out = [name for name, at in zip(names, points, strict=True) if at[:, 2].max() > height + _TOUCH]
        if out:
            found.append(
                f"windings of coil {_join(out)} reach through the plate at {height * 1e3:g} mm, where the tool goes; "
                "move them down, or the plate up"
            )
    lowest = max(-float(magnet.charges(2, 32)[2].min()) for magnet in tool.magnets)
    if lowest > tool.tip_distance + _TOUCH:
        found.append(
            f"tool.tip_distance is {tool.tip_distance * 1e3:g} mm, but a magnet reaches {lowest * 1e3:.3g} mm below "
            "the tool's origin: it would go into the surface before the tip; give at least that"
        )
    rest = np.array([0.0, 0.0, (dome_radius or height) + tool.tip_distance + 10e-3])
    for number, magnet in enumerate(tool.magnets, 1):
        at = magnet.charges(5, 32)[:3].T + rest
        hit = [name for k, name in enumerate(names) if _contains(coils, k, at).any()]
        if hit:
            found.append(
                f"tool.magnets.{number} is inside coil {_join(hit)} when the tool rests 10 mm above contact; move the "
                "coil or the magnet"
            )
    return found


def _join(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


def _surface(coils: PlacedCoils, number: int) -> Array:
    """(n, 3) points in and on winding `number`, a hair inside its faces, stator frame [m]."""
    angle = 2 * np.pi * np.arange(_STEPS) / _STEPS
    inner, outer = float(coils.inner_radius[number]) + _TOUCH, float(coils.outer_radius[number]) - _TOUCH
    half = 0.5 * float(coils.length[number]) - _TOUCH
    rho, z, phi = np.meshgrid(np.linspace(inner, outer, 5), np.linspace(-half, half, 7), angle)
    own = np.stack([rho * np.cos(phi), rho * np.sin(phi), z], axis=-1).reshape(-1, 3)
    placed: Array = own @ rotation_to_axis(coils.axis[number]).T + coils.position[number]
    return placed


def _contains(coils: PlacedCoils, number: int, points: Array) -> Array:
    away = points - coils.position[number]
    along = away @ coils.axis[number]
    across = np.sqrt(np.maximum((away**2).sum(axis=1) - along**2, 0.0))
    inside: Array = (
        (across > coils.inner_radius[number]) & (across < coils.outer_radius[number])
        & (np.abs(along) < coils.length[number] / 2)
    )  # fmt: skip
    return inside


def _list_overlaps(coils: PlacedCoils) -> list[tuple[int, int]]:
    """Pairs of windings that share a place, by points a hair inside the one that are inside the other."""
    reach = np.hypot(coils.outer_radius, coils.length / 2)
    apart = np.linalg.norm(coils.position[:, None] - coils.position[None, :], axis=-1)
    near = np.argwhere(np.triu(apart < reach[:, None] + reach[None, :], 1))
    found = []
    for i, j in near.tolist():
        if _contains(coils, j, _surface(coils, i)).any() or _contains(coils, i, _surface(coils, j)).any():
            found.append((i, j))
    return found
