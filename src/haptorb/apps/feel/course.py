"""What a design will feel like, before anybody feels it: the force on the way in and out, and the numbers in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from haptorb.apps.feel.candidates import Candidate
from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.worlds import Outlet
from haptorb.worlds.snap_fit.root_load import RootLoad

__all__ = ["InsertionForces", "course"]


@dataclass(frozen=True)
class InsertionForces:
    """Moved straight along X' without hurry: forces are what the hand needs, positive in the direction of motion."""

    place: Array  #: (n,) X' of the part [m], from home outwards
    going_in: Array  #: (n,) [N]
    coming_out: Array  #: (n,) [N]
    root: RootLoad  #: what the hook's root bears where it is bent most

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
            **self.root.numbers(),
        }


def course(design: Candidate, points: int = 400, speed: float = 0.1) -> InsertionForces:
    """The course of `design` at `points` places, sliding with `speed` [m/s] (well above the creep speed)."""
    world, hook = design.world, design.hook
    if isinstance(world, Outlet):
        reach = world.arm * 1.05
    else:
        reach = (hook.tip - hook.base_length) * 1.15
    place = np.linspace(0.0, reach, points)

    def force(motion: float) -> Array:
        return np.array(
            [world.wrench(State(0.0, np.eye(3), np.array([x, 0, 0]), np.zeros(3), np.array([motion, 0, 0])))[0]
             for x in place]
        )  # fmt: skip

    return InsertionForces(place, force(-speed), -force(speed), world.root_load)
