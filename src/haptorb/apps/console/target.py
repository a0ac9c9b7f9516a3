"""What a motor moves, for those who draw it: plug, socket, and how its hooks bend, as the world computes them.

All lengths in metres in the target's frame: X' out of the socket, Y' from one hook to the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from threading import Thread
from typing import Any

import numpy as np

from haptorb.errors import HaptorbError
from haptorb.numerics.arrays import Array
from haptorb.physics.beams import compliance, compute_bent_shape
from haptorb.physics.hook import Hook
from haptorb.worlds import Outlet, SnapFit, find_world

__all__ = ["prepare", "target_scene", "world_remarks"]

_PLACES = 7  #: along a wedge, where the deflection of a hook is sent; between them it is interpolated
_STEM = 0.8  #: of the gap between the wedges that the part of a snap-fit fills behind its edges: for the eye
_HEAD = 1.5e-3  #: thickness of that part's edge: for the eye [m]


def prepare() -> None:
    """Load, in a thread, what the first scenes need: it takes a second, and later a hand would wait for it."""
    Thread(target=lambda: [target_scene(name, {}) for name in ("outlet", "snap_fit")], daemon=True).start()


def target_scene(name: str, values: Mapping[str, Any]) -> dict[str, Any] | None:
    """Geometry of the world `name` with `values`; None where there is nothing to draw but the target itself.

    hooks     how many, the first at +Y'
    root      X' of their roots; they reach towards +X'
    back      |Y'| of the side of a hook that looks away from the plug
    width     of a hook, along Z'
    along     (k,) places on a hook from its root
    section   (k,) its thickness there
    at        (n,) places where it may be touched
    bends     (n, k) how far each place is bent per deflection at the touched place, outward positive
    outline   (j, 2) plug: X from its reference point, and half its width there
    floor     X' of the socket's floor
    force     a force of the order of those that come [N]
    """
    return _scene(name, _to_key(values))


def world_remarks(name: str, values: Mapping[str, Any]) -> list[str]:
    """What should be said about the world `name` with `values`: strain and stress of its hooks; else nothing."""
    return _remarks(name, _to_key(values))


def _to_key(values: Mapping[str, Any]) -> tuple[tuple[str, float], ...]:
    return tuple(sorted((key, value) for key, value in values.items() if isinstance(value, int | float)))


@lru_cache(maxsize=8)
def _remarks(name: str, values: tuple[tuple[str, float], ...]) -> list[str]:
    try:
        return list(find_world(name)().replace(**dict(values)).remarks)
    except HaptorbError:  # a world of the user's own that this process does not know by name
        return []


@lru_cache(maxsize=128)  # as many designs as a feel session has
def _scene(name: str, values: tuple[tuple[str, float], ...]) -> dict[str, Any] | None:
    try:
        world = find_world(name)().replace(**dict(values))
    except HaptorbError:  # a world of the user's own that this process does not know by name
        return None
    match world:
        case Outlet():
            hook, half = world.hook, 0.5 * world.plug_width
            return _describe_scene(
                hook,
                np.array([hook.peak]),
                hooks=2,
                root=world.arm - hook.peak,
                back=0.5 * world.opening + hook.height + hook.thickness,
                outline=[*world.outline.tolist(), [world.arm + 4e-3, half]],
                floor=0.0,
                force=world.stiffness * (half - 0.5 * world.opening),
            )
        case SnapFit():
            hook, half = world.hook, world.half_width
            stem = max(_STEM * (half + world.clearance - hook.height), 0.2 * half)
            places = np.linspace(hook.base_length, hook.tip, _PLACES)
            soft = compliance(hook, hook.peak, world.beam)
            return _describe_scene(
                hook,
                places,
                hooks=world.hooks,
                root=-hook.base_length,
                back=half + world.clearance + hook.thickness,
                outline=[[-_HEAD, half], [0.0, half], [0.0, stem], [hook.tip - hook.base_length + 6e-3, stem]],
                floor=-_HEAD,
                force=hook.youngs_modulus * hook.width * hook.height / float(soft.plus),
            )
    return None


def _describe_scene(hook: Hook, at: Array, **others: Any) -> dict[str, Any]:
    """The scene of `hook`, touched at `at` (n,), and what else there is."""
    corners = [hook.base_length, hook.ramp_end, hook.peak, hook.tip]
    along = np.unique(np.concatenate([np.linspace(0.0, hook.tip, 25), corners]))
    bends = []
    for place in at.tolist():
        shape = compute_bent_shape(hook, place, 1.0, points=65)
        bends.append(np.interp(along, shape[:, 0], shape[:, 1]).tolist())
    return {
        "width": hook.width,
        "along": along.tolist(),
        "section": hook.section(along).tolist(),
        "at": at.tolist(),
        "bends": bends,
        **others,
    }
