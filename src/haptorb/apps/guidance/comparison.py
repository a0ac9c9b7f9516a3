"""Kinds of guidance side by side: simulated persons of three grips on four paths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from haptorb.apps.guidance.moving_point import MovingPoint
from haptorb.apps.guidance.person import Habits
from haptorb.apps.guidance.trial import Trial, run_trial
from haptorb.control.stability.hand_grip import GRIPS
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.worlds.basic.guidance import Guidance
from haptorb.worlds.basic.nothing import Nothing
from haptorb.worlds.path_guidance.guidance_path import GuidancePath
from haptorb.worlds.path_guidance.path_guidance import PathGuidance
from haptorb.worlds.path_guidance.path_shapes import SHAPES, make_shape
from haptorb.worlds.world import World

__all__ = ["WAYS", "GuidanceComparison", "GuidanceRow", "compare_guidance"]

#: none: no force. valley: the world `guidance`, as strong as it needs to be to use the planner's mean force. spring: to
#: a point that goes along by the clock. plan: the world `path_guidance`.
WAYS = ("none", "valley", "spring", "plan")
_STRENGTHS = {"none": 0.0, "valley": 0.35, "spring": 0.35, "plan": 0.5}  #: the worlds' own [N]
_TRIES = 4  #: to find the valley's strength
_NEAR = 0.03  #: two mean forces that differ by less are equal
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
        """Error of the plan over that of the valley at equal mean force, over all paths; NaN without one."""
        errors = {way: [row.error for row in self.rows if row.grip == grip and row.way == way] for way in WAYS}
        return float(np.mean(errors["plan"]) / np.mean(errors["valley"])) if all(errors.values()) else float("nan")

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
                    "strength_N": row.strength, "tripped": row.tripped,
                }
                for row in self.rows
            ],
            "at_rest": [{"grip": g, "guidance": w, "way_m": way} for (g, w), way in self.drift.items()],
            "plan_over_valley": {grip: self.find_ratio(grip) for grip in grips},
        }  # fmt: skip


def _make_world(way: str, path: GuidancePath, strength: float, pace: float) -> World:
    if way == "none":
        return Nothing()
    if way == "valley":
        return Guidance(strength=strength, path=tuple(map(tuple, path.places[::4].tolist())))
    if way == "spring":
        return MovingPoint(path=path, strength=strength, pace=pace)
    return PathGuidance(path=path, strength=strength)


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
    total, done = len(paths) * len(grips) * (3 + _TRIES) + len(grips) * len(WAYS), 0

    def go_on(steps: int = 1) -> None:
        nonlocal done
        done += steps
        report(done / total)

    for name in paths:
        path = make_shape(name, radius=shell.contact_distance)
        for grip in grips:

            def run(way: str, strength: float) -> Trial:
                world = _make_world(way, path, strength, habits.pace)  # noqa: B023
                return run_trial(device, world, path, GRIPS[grip], habits, seconds, seed, sensing=sensing)  # noqa: B023

            found: dict[str, tuple[Trial, float]] = {}
            for way in ("none", "spring", "plan"):
                found[way] = run(way, _STRENGTHS[way]), _STRENGTHS[way]
                go_on()
            found["valley"] = _equal_force(lambda strength: run("valley", strength), found["plan"][0].force)
            go_on(_TRIES)
            for way in WAYS:
                trial, strength = found[way]
                rows.append(
                    GuidanceRow(
                        name, grip, way, trial.error, float(np.abs(trial.across).max()), trial.force, trial.heat,
                        strength, trial.tripped,
                    )
                )  # fmt: skip
                if name == paths[0]:
                    courses[grip, way] = trial.across[::10]
    drift = {}
    start, first, last = _RESTS
    path = make_shape(paths[0], radius=shell.contact_distance)
    for grip in grips:
        for way in WAYS:
            world = _make_world(way, path, _STRENGTHS[way], habits.pace)
            still = replace(habits, rest_after=start)
            trial = run_trial(device, world, path, GRIPS[grip], still, last + 0.2, seed, sensing=sensing)
            begins = round(1000 * (first - 1.0))
            places = trial.places
            drift[grip, way] = float(
                np.linalg.norm(places[-200:].mean(axis=0) - places[begins : begins + 200].mean(axis=0))
            )
            go_on()
    return GuidanceComparison(device.name, seconds, seed, sensing, tuple(rows), drift, courses)


def _equal_force(run: Callable[[float], Trial], force: float) -> tuple[Trial, float]:
    """The trial, and its strength [N], whose mean force is nearest to `force` [N]."""
    attempts: list[tuple[float, Trial, float]] = []
    strength = _STRENGTHS["valley"]
    for _ in range(_TRIES):
        trial = run(strength)
        attempts.append((abs(trial.force / max(force, 1e-9) - 1.0), trial, strength))
        if attempts[-1][0] <= _NEAR:
            break
        strength = min(max(strength * (force / max(trial.force, 1e-6)) ** 1.3, 0.002), 1.0)
    best = min(attempts, key=lambda one: one[0])
    return best[1], best[2]
