"""The bodies of a world with memory for the page: sizes, and which numbers of the memory say where they are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from haptorb.worlds import World, find_world
from haptorb.worlds.dynamic_world import DynamicWorld
from haptorb.worlds.memory import find_number

__all__ = ["list_shapes"]


def list_shapes(name: str, values: Mapping[str, Any], own: Mapping[str, World]) -> list[dict[str, Any]]:
    """Bodies of the world `name` with `values`, one of the catalogue or of the `own` ones; none of any other world.

    size [m] as `worlds.shape.SHAPES` says; place and attitude are indices in the row's memory.
    """
    try:
        world = own[name] if name in own else find_world(name)()
        if not isinstance(world, DynamicWorld):
            return []
        changed = world.replace(**values)
        fields = changed.memory_fields
        return [
            {
                "name": shape.name,
                "kind": shape.kind,
                "size": list(shape.size),
                "role": shape.role,
                "at": list(shape.at),
                "points": list(shape.points),
                "corners": list(shape.corners),
                "place": find_number(fields, shape.place, shape.row) if shape.place else None,
                "attitude": find_number(fields, shape.attitude, shape.row) if shape.attitude else None,
            }
            for shape in changed.shapes
        ]
    except Exception:  # a world that this process does not know by name, or the user's code: only its picture is lost
        return []
