"""What a trip says of its cause."""

from __future__ import annotations

from haptorb.control.protection.trip import Trip
from haptorb.worlds.own.failure import describe_failure
from haptorb.worlds.world import World

__all__ = ["explain_trip"]


def explain_trip(reason: Trip, cause: BaseException, world: World) -> str:
    """What a failed `world` or driver said, and where in a user's code."""
    if reason is Trip.MEMORY_NOT_FINITE:
        return str(cause)
    if reason is not Trip.WORLD_FAILED:
        return f"{type(cause).__name__}: {cause}"
    return describe_failure(world, cause)
