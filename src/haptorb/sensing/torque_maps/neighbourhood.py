"""Which sensors each coil is judged by, and which coils may share one network because they see the same arrangement.

A network maps the field around a coil to that coil's torque per ampere, both in the coil's own frame (ϑ̂ southward,
φ̂ eastward, r̂ outward). Coils whose sensors lie alike in their own frames, up to half a turn about r̂, share it: on one
parallel of latitude by turning about the motor's axis, north and south by half a turn (Bai 2012 §2.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from haptorb.devices.motor.layouts import Layout
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array

__all__ = ["REACH", "Neighbourhood", "Numbers", "neighbourhoods"]

Numbers: TypeAlias = NDArray[np.intp]

REACH = float(np.radians(35.0))  #: of a coil's sensors from its axis: the nearest ring around it

_HALF_TURN = np.diag([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Neighbourhood:
    """Coils that share one network.

    coils     (c,) their numbers, from 0
    frames    (c, 3, 3) columns: each coil's own axes in the stator frame, turned so that all arrangements agree
    sensors   (c, s) numbers of each coil's sensors, from 0, in the order of the arrangement
    """

    coils: Numbers
    frames: Array
    sensors: Numbers

    def inputs(self, field: Array, member: int) -> Array:
        """(n, 3 s) what member number `member` sees of `field` (n, sensors, 3) [T], in its own frame."""
        own: Array = field[:, self.sensors[member]] @ self.frames[member]
        return own.reshape(len(field), -1)

    def outputs(self, K: Array, member: int) -> Array:
        """(n, 2) K (n, 3, coils) [N·m/A] of that member along its ϑ̂ and φ̂; along its axis a round coil has none."""
        own = np.einsum("nij,ia->nja", K, self.frames[member])
        out: Array = own[:, self.coils[member], :2]
        return out


def neighbourhoods(motor: SphericalMotor, reach: float = REACH) -> tuple[Neighbourhood, ...]:
    """Every coil in exactly one of them; InputError where a coil has no sensor within `reach` [rad] of its axis."""
    found: list[tuple[Array, list[tuple[int, Array, Numbers]]]] = []
    coils: Layout = motor.electromagnets
    for coil, frame in enumerate(coils.frames):
        near = np.flatnonzero(motor.sensor_layout.directions @ coils.directions[coil] >= np.cos(reach))
        if near.size == 0:
            raise InputError(
                f"device '{motor.name}': electromagnet {coil + 1} has no sensor within {np.degrees(reach):g}° of its "
                "axis: a network cannot know its torque"
            )
        for turn in (np.eye(3), _HALF_TURN):
            own = frame @ turn
            order, pattern = _sort_directions(motor.sensor_layout.directions[near] @ own)
            match = next((i for i, (known, _) in enumerate(found) if _are_equal(known, pattern)), None)
            if match is not None:
                found[match][1].append((coil, own, near[order]))
                break
        else:
            order, pattern = _sort_directions(motor.sensor_layout.directions[near] @ frame)
            found.append((pattern, [(coil, frame, near[order])]))
    return tuple(
        Neighbourhood(
            np.array([coil for coil, _, _ in members]),
            np.array([frame for _, frame, _ in members]),
            np.array([sensors for _, _, sensors in members]),
        )
        for _, members in found
    )


def _sort_directions(pattern: Array) -> tuple[Numbers, Array]:
    """A canonical order of the directions (s, 3), and the directions in it."""
    order = np.lexsort(np.round(pattern, 6).T + 0.0)
    return order, pattern[order]


def _are_equal(one: Array, other: Array) -> bool:
    return one.shape == other.shape and bool(np.abs(one - other).max() < 1e-6)
