"""What a design will feel like, before anybody feels it: the force on the way in and out, and the numbers in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from haptorb.apps.feel.candidates import Candidate
from haptorb.devices.state import State
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.worlds import Outlet, SnapFit
from haptorb.worlds.own.failure import check_wrench, describe_failure
from haptorb.worlds.snap_fit.root_load import RootLoad

__all__ = ["InsertionForces", "course", "force_along", "world_wrench"]

OWN_REACH = 0.02  #: along X', over which a world of the user's own is computed [m]: 40° of handle move the part 17 mm


@dataclass(frozen=True)
class InsertionForces:
    """Moved straight along X' without hurry: forces are what the hand needs, positive in the direction of motion."""

    place: Array  #: (n,) X' of the part [m], from home outwards
    going_in: Array  #: (n,) [N]
    coming_out: Array  #: (n,) [N]
    root: RootLoad | None  #: what the hook's root bears where it is bent most; None for a world without a hook

    @property
    def numbers(self) -> dict[str, Any]:
        """The figures that designs are compared by, SI, units in the names."""
        step = np.gradient(self.place)
        return {
            "insertion_force_n": float(self.going_in.max()),
            "snap_home_force_n": float(max(-self.going_in.min(), 0.0)),
            "pull_out_force_n": float(self.coming_out.max()),
            "insertion_work_j": float((self.going_in * step).sum()),
            "pull_out_work_j": float((self.coming_out * step).sum()),
            **({} if self.root is None else self.root.numbers()),
        }


def course(design: Candidate, points: int = 400, speed: float = 0.1) -> InsertionForces:
    """The course of `design` at `points` places, sliding with `speed` [m/s] (well above the creep speed)."""
    world = design.world
    if isinstance(world, Outlet):
        reach = world.arm * 1.05
    elif isinstance(world, SnapFit):
        reach = (world.hook.tip - world.hook.base_length) * 1.15
    else:
        reach = OWN_REACH
    place = np.linspace(0.0, reach, points)
    forces = [np.array([force_along(design, x, motion) for x in place.tolist()]) for motion in (-speed, speed)]
    return InsertionForces(place, forces[0], -forces[1], design.root)


def force_along(design: Candidate, x: float, speed: float) -> float:
    """F_X' [N] on the part at X' = `x` [m], straight and in the middle, that moves with `speed` [m/s] outwards.

    Raises InputError with the place in the user's code if a world of their own fails there.
    """
    state = State(0.0, np.eye(3), np.array([x, 0.0, 0.0]), np.zeros(3), np.array([speed, 0.0, 0.0]))
    return float(world_wrench(design, state)[0])


def world_wrench(design: Candidate, state: State) -> Array:
    """(6,) on the part at `state` [N, N·m]; InputError as in `force_along`."""
    try:
        return check_wrench(design.world.wrench(state))
    except Exception as cause:
        raise InputError(f"world '{design.world.name}' failed: {describe_failure(design.world, cause)}") from cause
