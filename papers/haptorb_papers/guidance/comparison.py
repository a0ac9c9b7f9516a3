"""Comparison of kinds of guidance: simulated persons with three grips on four paths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from haptorb.analysis.stability import GRIPS, HandGrip
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.worlds.base import World
from haptorb.worlds.basic import Nothing
from haptorb.worlds.guidance import Guidance
from haptorb.worlds.path import SHAPES, GuidancePath, make_shape
from haptorb.worlds.path_guidance import PathGuidance
from haptorb_papers.guidance.person import Habits
from haptorb_papers.guidance.trial import MovingPoint, Trial, run_trial

__all__ = ["WAYS", "GuidanceComparison", "GuidanceRow", "compare_guidance"]

#: none: no force. valley: the world `guidance`, as stiff as it needs to be to use the planner's mean force. spring: to
#: a point that goes along by the clock. plan: the world `path_guidance`.
WAYS = ("none", "valley", "spring", "plan")
_STRENGTHS = {"none": 0.0, "valley": 0.35, "spring": 0.35, "plan": 1.0}  #: [N]
_WIDTH = 0.003  #: of a valley that needs no more than its greatest strength, 1 N, to be as stiff as it should be [m]
_STIFF = (2.0, 2000.0)  #: of valleys, least and greatest [N/m]
_TRIES = 10  #: to find the valley's stiffness, or the plan's tolerance
_TOLERANCES = (5e-4, 1e-2)  #: of plans, the default and the widest [m]
_NEAR = 0.03  #: two mean forces that differ by less are equal
_KNOWN = 0.7  #: what the plan takes for the hand's mass and damping, as a share of what they are
_RESTS = (2.0, 3.0, 8.0)  #: the hand stops; the time in which its way is measured begins, and ends [s]


@dataclass(frozen=True)
class GuidanceRow:
    """One way of guidance, one path, one grip: means over the trial's ticks from its first second on."""

    path: str
    grip: str
    way: str
    error: float  #: mean size of the deviation across the path [m]
    largest: float  #: of it [m]
    force: float  #: mean size [N]
    heat: float  #: mean power in the coils [W]
    strength: float  #: of the world: most force [N]
    width: float  #: of the valley, over which its force rises; NaN for the others [m]
    tolerance: float  #: of the plan; NaN for the others [m]
    tripped: bool


@dataclass(frozen=True)
class GuidanceComparison:
    """All rows, and how far a hand at rest was moved.

    drift  (grip, way) → way in the 5 s that begin one second after the hand stopped [m]
    courses  (grip, way) → (n,) deviation [m], every tenth tick, on the first path
    """

    device: str
    seconds: float
    seed: int
    sensing: str
    rows: tuple[GuidanceRow, ...]
    drift: dict[tuple[str, str], float]
    courses: dict[tuple[str, str], Any]

    def find_row(self, path: str, grip: str, way: str) -> GuidanceRow:
        """The row of these three."""
        return next(row for row in self.rows if (row.path, row.grip, row.way) == (path, grip, way))

    def find_ratio(self, grip: str) -> float:
        """Error of the plan over that of the valley at equal mean force, over all paths."""
        errors = {way: [row.error for row in self.rows if row.grip == grip and row.way == way] for way in WAYS}
        return float(np.mean(errors["plan"]) / np.mean(errors["valley"])) if all(errors.values()) else float("nan")

    def find_inequality(self, grip: str) -> float:
        """The largest difference of the mean forces of plan and valley over the paths, relative to the valley's [1]."""
        forces = {way: [row.force for row in self.rows if row.grip == grip and row.way == way] for way in WAYS}
        return max(abs(a / b - 1.0) for a, b in zip(forces["plan"], forces["valley"], strict=True))

    def numbers(self) -> dict[str, Any]:
        """For JSON: SI units in the keys."""
        grips = dict.fromkeys(row.grip for row in self.rows)
        return {
            "device": self.device,
            "seconds": self.seconds,
            "seed": self.seed,
            "sensing": self.sensing,
            "trials": [
                {
                    "path": row.path, "grip": row.grip, "guidance": row.way, "error_m": row.error,
                    "largest_error_m": row.largest, "force_N": row.force, "heat_W": row.heat,
                    "strength_N": row.strength, "width_m": row.width if row.way == "valley" else None,
                    "tolerance_m": row.tolerance if row.way == "plan" else None, "tripped": row.tripped,
                }
                for row in self.rows
            ],
            "at_rest": [{"grip": g, "guidance": w, "way_m": way} for (g, w), way in self.drift.items()],
            "plan_over_valley": {grip: self.find_ratio(grip) for grip in grips},
            "force_inequality": {grip: self.find_inequality(grip) for grip in grips},
        }  # fmt: skip


def _make_world(way: str, path: GuidancePath, grip: HandGrip, pace: float) -> World:
    if way == "none":
        return Nothing()
    if way == "valley":
        return _make_valley(path, _STRENGTHS[way] / _WIDTH)
    if way == "spring":
        return MovingPoint(path=path, strength=_STRENGTHS[way], pace=pace)
    return _make_plan(path, grip, _TOLERANCES[0])


def _make_plan(path: GuidancePath, grip: HandGrip, tolerance: float) -> PathGuidance:
    return PathGuidance(
        path=path, strength=_STRENGTHS["plan"], tolerance=tolerance, hand_mass=max(_KNOWN * grip.mass, 0.05),
        hand_damping=_KNOWN * grip.damping,
    )  # fmt: skip


def _make_valley(path: GuidancePath, stiffness: float) -> Guidance:
    """The valley of `stiffness` [N/m]: its strength as it is needed, then narrower."""
    strength = min(stiffness * _WIDTH, 1.0)
    return Guidance(strength=strength, width=strength / stiffness, path=tuple(map(tuple, path.places[::4].tolist())))


def compare_guidance(
    device: SphericalElectromagnet,
    *,
    paths: Sequence[str] = SHAPES,
    grips: Sequence[str] = tuple(GRIPS),
    seconds: float = 8.0,
    seed: int = 0,
    sensing: str = "tracker",
    habits: Habits | None = None,
    report: Callable[[float], None] = lambda share: None,
) -> GuidanceComparison:
    """Every way of guidance on each of `paths` with each of `grips` for `seconds` [s] of motion; report: share done."""
    habits = habits or Habits()
    shell = device.shell
    assert shell is not None
    rows: list[GuidanceRow] = []
    courses: dict[tuple[str, str], Any] = {}
    total, done = len(paths) * len(grips) * (3 + 2 * _TRIES) + len(grips) * len(WAYS), 0

    def go_on(steps: int = 1) -> None:
        nonlocal done
        done += steps
        report(done / total)

    for name in paths:
        path = make_shape(name, radius=shell.contact_distance)
        for grip in grips:

            def run(world: World) -> Trial:
                return run_trial(device, world, path, GRIPS[grip], habits, seconds, seed, sensing=sensing)  # noqa: B023

            found: dict[str, Trial] = {}
            for way in ("none", "spring", "plan"):
                found[way] = run(_make_world(way, path, GRIPS[grip], habits.pace))
                go_on()
            found["valley"], valley = _find_valley(path, run, found["plan"].force)
            go_on(_TRIES)
            found["plan"], plan = _find_plan(path, run, GRIPS[grip], found["plan"], found["valley"].force)
            go_on(_TRIES)
            for way in WAYS:
                trial = found[way]
                strength, width = (valley.strength, valley.width) if way == "valley" else (_STRENGTHS[way], np.nan)
                tolerance = plan.tolerance if way == "plan" else np.nan
                rows.append(
                    GuidanceRow(
                        name, grip, way, trial.error, float(np.abs(trial.across).max()), trial.force, trial.heat,
                        strength, width, tolerance, trial.tripped,
                    )
                )  # fmt: skip
                if name == paths[0]:
                    courses[grip, way] = trial.across[::10]
    drift = {}
    start, first, last = _RESTS
    path = make_shape(paths[0], radius=shell.contact_distance)
    for grip in grips:
        for way in WAYS:
            world = _make_world(way, path, GRIPS[grip], habits.pace)
            still = replace(habits, rest_after=start)
            trial = run_trial(device, world, path, GRIPS[grip], still, last + 0.2, seed, sensing=sensing)
            begins = round(1000 * (first - 1.0))
            places = trial.places
            drift[grip, way] = float(
                np.linalg.norm(places[-200:].mean(axis=0) - places[begins : begins + 200].mean(axis=0))
            )
            go_on()
    return GuidanceComparison(device.name, seconds, seed, sensing, tuple(rows), drift, courses)


def _find_valley(path: GuidancePath, run: Callable[[World], Trial], force: float) -> tuple[Trial, Guidance]:
    """The valley whose mean force is `force` [N], and its trial.

    A valley that is too stiff for hand and tracker oscillates, and its force jumps. Where none has that force, it is
    the valley with the least error, at any force.
    """
    attempts: list[tuple[Trial, Guidance]] = []
    stiffness, (low, high) = _STRENGTHS["valley"] / _WIDTH, (0.0, np.inf)
    for _ in range(_TRIES):
        valley = _make_valley(path, stiffness)
        trial = run(valley)
        attempts.append((trial, valley))
        if abs(trial.force / max(force, 1e-9) - 1.0) <= _NEAR:
            return attempts[-1]
        low, high = (stiffness, high) if trial.force < force else (low, stiffness)
        if not low or high == np.inf:  # no trial on both sides yet
            stiffness = min(max(2.0 * stiffness if high == np.inf else 0.5 * stiffness, _STIFF[0]), _STIFF[1])
        else:
            stiffness = (low * high) ** 0.5
    return min(attempts, key=lambda one: one[0].error)


def _find_plan(
    path: GuidancePath, run: Callable[[World], Trial], grip: HandGrip, first: Trial, force: float
) -> tuple[Trial, PathGuidance]:
    """The plan whose mean force is `force` [N], and its trial; `first` is that of the narrowest tolerance.

    If no valley has the plan's force, the plan gets a wider tolerance, until its force is that of the valley.
    """
    attempts, (low, high) = [(first, _make_plan(path, grip, _TOLERANCES[0]))], _TOLERANCES
    while abs(attempts[-1][0].force / max(force, 1e-9) - 1.0) > _NEAR and len(attempts) <= _TRIES:
        tolerance = (low * high) ** 0.5
        plan = _make_plan(path, grip, tolerance)
        trial = run(plan)
        attempts.append((trial, plan))
        low, high = (tolerance, high) if trial.force > force else (low, tolerance)
    return min(attempts, key=lambda one: abs(one[0].force - force))
