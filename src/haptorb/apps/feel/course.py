"""What a design will feel like, before anybody feels it: the force on the way in and out, and the numbers in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.apps.feel.candidates import Candidate
from haptorb.devices.state import State
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.physics.beams import compliance
from haptorb.worlds import Outlet, SnapFit
from haptorb.worlds.own.failure import check_wrench, describe_failure

__all__ = ["InsertionForces", "course", "force_along", "world_wrench"]

OWN_REACH = 0.02  #: along X', over which a world of the user's own is computed [m]: 40° of handle move the part 17 mm


@dataclass(frozen=True)
class InsertionForces:
    """Moved straight along X' without hurry: forces are what the hand needs, positive in the direction of motion."""

    place: Array  #: (n,) X' of the part [m], from home outwards
    going_in: Array  #: (n,) [N]
    coming_out: Array  #: (n,) [N]
    strain: float | None  #: greatest at the hook's root, bent over its whole height (outlet: by the plug)
    stress: float | None = None  #: there [Pa], as long as the material does not yield
    yield_margin: float | None = None  #: stress at yield over `stress`; below 1 it yields. None: not known

    @property
    def numbers(self) -> dict[str, float | None]:
        """The figures that designs are compared by, SI, units in the names."""
        step = np.gradient(self.place)
        return {
            "insertion_force_n": float(self.going_in.max()),
            "snap_home_force_n": float(max(-self.going_in.min(), 0.0)),
            "pull_out_force_n": float(self.coming_out.max()),
            "insertion_work_j": float((self.going_in * step).sum()),
            "pull_out_work_j": float((self.coming_out * step).sum()),
            "root_strain": self.strain,
            "root_stress_pa": self.stress,
            "yield_margin": self.yield_margin,
        }


def course(design: Candidate, points: int = 400, speed: float = 0.1) -> InsertionForces:
    """The course of `design` at `points` places, sliding with `speed` [m/s] (well above the creep speed)."""
    world, hook = design.world, design.hook
    if isinstance(world, Outlet):
        reach, bent = world.arm * 1.05, 0.5 * (world.plug_width - world.opening)
    elif isinstance(world, SnapFit):
        reach, bent = (world.hook.tip - world.hook.base_length) * 1.15, world.hook.height
    else:
        reach, bent = OWN_REACH, 0.0
    place = np.linspace(0.0, reach, points)
    forces = [np.array([force_along(design, x, motion) for x in place.tolist()]) for motion in (-speed, speed)]
    if hook is None or not isinstance(world, Outlet | SnapFit):
        return InsertionForces(place, forces[0], -forces[1], None)
    # at the root h = h₀: ε = M h₀/2EI = 6 F_y X, and F_y = Δ/Ω₊
    top = float(compliance(hook, hook.peak, world.beam).plus)
    strain = 6.0 * (hook.peak / hook.thickness) * (bent / hook.thickness) / top
    stress = hook.youngs_modulus * strain
    margin = None if design.yield_strength is None else design.yield_strength / stress
    return InsertionForces(place, forces[0], -forces[1], strain, stress, margin)


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
