"""A world with the clients' force added to it: the world keeps its name and its parameters."""

from __future__ import annotations

from haptorb.worlds.dynamic.remote import Remote
from haptorb.worlds.dynamic_world import DynamicSum
from haptorb.worlds.world import World

__all__ = ["join_remote", "split_remote"]


def split_remote(world: World) -> tuple[World, Remote | None]:
    """(the world, the clients' force) of a sum that ends with the clients' force; else (world, None).

    >>> from haptorb.worlds.maps.dome import Dome
    >>> split_remote(Dome(moment=1.0) + Remote())
    (Dome(summit=(0, 0, 1), half_width_deg=18, cut_off_deg=54, moment=1), Remote(limit=10))
    """
    if not isinstance(world, DynamicSum) or len(world.parts) < 2:
        return world, None
    *others, last = world.parts
    if not isinstance(last, Remote):
        return world, None
    plain = others[0]
    for other in others[1:]:
        plain = plain + other
    return plain, last


def join_remote(world: World, remote: Remote | None) -> World:
    """`world` plus the clients' force `remote`, if there is one and `world` is not the clients' force itself."""
    return world if remote is None or isinstance(world, Remote) else world + remote
