"""Predicted forces of a design: force over displacement during insertion and pull-out, and its peaks."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb.beams import balance_face, compliance, compute_handbook_force
from haptorb.devices.base import State
from haptorb.errors import InputError
from haptorb.worlds import DynamicWorld, Outlet, SnapFit, World
from haptorb.worlds.dynamic import bind_world
from haptorb.worlds.snap_fit import RootLoad
from haptorb.worlds.user_world import check_wrench, describe_failure
from haptorb_study.feel.designs import Candidate

__all__ = ["InsertionForces", "PeakShares", "course", "explain_peaks", "force_along", "world_wrench"]

OWN_WORLD_RANGE_M = 0.02  #: along X', range computed for a user's own world [m]: 40° of handle move the part 17 mm
_TIME_STEP_S = 1e-3  #: time step of a world with memory [s]
_MAX_TICKS = 20_000  #: ticks of one slow motion at most


@dataclass(frozen=True)
class InsertionForces:
    """Forces of the hand for slow straight motion along X', positive in the direction of motion."""

    place: Array  #: (n,) X' of the part [m], from home outwards
    going_in: Array  #: (n,) [N]
    coming_out: Array  #: (n,) [N]
    root: RootLoad | None  #: load of the hook's root at its largest deflection; None for a world without a hook

    @property
    def numbers(self) -> dict[str, Any]:
        """Quantities that designs are compared by, in SI with units in the names."""
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
    """Forces of `design` at `points` positions, at the sliding speed `speed` [m/s] (well above the creep speed)."""
    world = design.world
    if isinstance(world, Outlet):
        reach = world.arm * 1.05
    elif isinstance(world, SnapFit):
        reach = (world.hook.tip - world.hook.base_length) * 1.15
    else:
        reach = OWN_WORLD_RANGE_M
    place = np.linspace(0.0, reach, points)
    if isinstance(world, DynamicWorld):
        out, back = _move_memory(design, (0.0, reach, 0.0), speed)
        inward = np.interp(place, back[::-1, 0], back[::-1, 1])
        return InsertionForces(place, inward, -np.interp(place, out[:, 0], out[:, 1]), design.root)
    forces = [np.array([force_along(design, x, motion) for x in place.tolist()]) for motion in (-speed, speed)]
    return InsertionForces(place, forces[0], -forces[1], design.root)


_LATERAL_OFFSET_M = 1e-4  #: lateral offset [m] that shows the coupling of two hooks on one rigid part


@dataclass(frozen=True)
class PeakShares:
    """Contributions to the peak force of a snap-fit in one direction, beginning with the handbook's formula [N]."""

    way: str  #: "insertion" or "pull_out"
    handbook: float  #: P (μ + tan α)/(1 − μ tan α): hooks bent by the lateral force only
    pull_bends: float  #: added because the pull bends the hook, too
    face_turns: float  #: added because the bent face is inclined
    edges_rounded: float  #: added by the rounded edges of the wedge
    off_middle: float  #: not in the sum: added by the coupling of the hooks with the part 0.1 mm off centre

    @property
    def sharp(self) -> float:
        """Peak with sharp edges [N]."""
        return self.handbook + self.pull_bends + self.face_turns

    @property
    def total(self) -> float:
        """Rendered peak: straight motion, centred, full friction [N]."""
        return self.sharp + self.edges_rounded

    def numbers(self) -> dict[str, float]:
        """As plain JSON types, with units in the names."""
        return {
            "handbook_n": self.handbook, "pull_bends_n": self.pull_bends, "face_turns_n": self.face_turns,
            "edges_rounded_n": self.edges_rounded, "total_n": self.total, "off_middle_n": self.off_middle,
        }  # fmt: skip


def explain_peaks(world: SnapFit) -> tuple[PeakShares, PeakShares]:
    """Contributions to the insertion and pull-out peaks of `world`.

    >>> insertion, pull_out = explain_peaks(SnapFit())
    >>> round(insertion.sharp, 2), round(pull_out.sharp, 2)
    (9.61, 8.22)
    """
    return _explain_peak(world, "insertion"), _explain_peak(world, "pull_out")


def _explain_peak(world: SnapFit, way: str) -> PeakShares:
    hook, sign = world.hook, 1.0 if way == "pull_out" else -1.0
    slope, place = (hook.rear, hook.ramp_end) if sign > 0 else (hook.front, hook.peak)
    bent = max(hook.height - world.clearance, 0.0)
    soft = compliance(hook, place, world.beam)
    push = world.hooks * hook.youngs_modulus * hook.width * bent / float(soft.plus)
    handbook = compute_handbook_force(push, slope, world.friction)
    ratio = sign * math.tan(slope + math.atan(world.friction))
    pulled = sign * push * ratio / (1.0 + ratio * float(soft.minus / soft.plus))
    held = balance_face(hook, place, bent, sign * slope, sign * world.friction, world.beam)
    sharp = sign * world.hooks * float(held.pull)
    straight, aside = (_find_peak(world, sign, y) for y in (0.0, _LATERAL_OFFSET_M))
    coupling = aside - straight if world.hooks > 1 else 0.0
    return PeakShares(way, handbook, pulled - handbook, sharp - pulled, straight - sharp, coupling)


def _find_peak(world: SnapFit, sign: float, y: float) -> float:
    """Peak force of the hand [N] with the part `y` [m] off centre, moved outwards (`sign` 1) or inwards."""
    fast = np.array([sign * 1e3 * world.creep, 0.0, 0.0])

    def find_pull(x: float) -> float:
        return -sign * float(world.wrench(State(0.0, np.eye(3), np.array([x, y, 0.0]), np.zeros(3), fast))[0])

    places = np.linspace(0.0, (world.hook.tip - world.hook.base_length) * 1.05, 600)
    for _ in range(2):  # refined, since a peak may be narrower than the spacing
        pulls = [find_pull(x) for x in places.tolist()]
        at = int(np.argmax(pulls))
        places = np.linspace(places[max(at - 1, 0)], places[min(at + 1, len(places) - 1)], 41)
    return max(pulls)


def force_along(design: Candidate, x: float, speed: float) -> float:
    """F_X' [N] on the centred part at X' = `x` [m], moving outwards at `speed` [m/s].

    A world with memory is computed along a motion that leads there: from home, or, inwards, from home to the farthest
    position and back. Raises InputError with the place in the user's code if a world of their own fails there.
    """
    if isinstance(design.world, DynamicWorld):
        turns = (0.0, x) if speed > 0.0 else (0.0, OWN_WORLD_RANGE_M, x)
        return float(_move_memory(design, turns, abs(speed))[-1][-1, 1])
    return float(world_wrench(design, _state_at(x, speed))[0])


def _state_at(x: float, speed: float) -> State:
    return State(0.0, np.eye(3), np.array([x, 0.0, 0.0]), np.zeros(3), np.array([speed, 0.0, 0.0]))


def _move_memory(design: Candidate, turns: Sequence[float], speed: float) -> list[Array]:
    """For each section between two `turns` [m], at `speed` [m/s] in ticks: (n, 2) X' [m] and F_X' [N]. The memory of
    the world lasts over all sections."""
    world = design.world
    bound = bind_world(world, _TIME_STEP_S)
    assert bound is not None
    found = []
    for start, end in pairwise(turns):
        count = min(max(math.ceil(abs(end - start) / max(speed, 1e-9) / _TIME_STEP_S), 1), _MAX_TICKS)
        pace = math.copysign(speed, end - start)
        rows = np.empty((count + 1, 2))
        for n, x in enumerate(np.linspace(start, end, count + 1).tolist()):
            rows[n] = x, _evaluate_world(world, bound.wrench, _state_at(x, pace))[0]
        found.append(rows)
    return found


def world_wrench(design: Candidate, state: State) -> Array:
    """(6,) wrench on the part at `state` [N, N·m]; InputError as in `force_along`."""
    return _evaluate_world(design.world, design.world.wrench, state)


def _evaluate_world(world: World, wrench: Callable[[State], Array], state: State) -> Array:
    try:
        return check_wrench(wrench(state))
    except Exception as cause:
        raise InputError(f"world '{world.name}' failed: {describe_failure(world, cause)}") from cause
