"""Kinds of guidance side by side: simulated persons of three grips on four paths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from haptorb.apps.guidance.moving_point import MovingPoint
from haptorb.apps.guidance.person import Habits
from haptorb.apps.guidance.trial import Trial, run_trial
from haptorb.control.stability.hand_grip import GRIPS, HandGrip
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.worlds.basic.guidance import Guidance
from haptorb.worlds.basic.nothing import Nothing
from haptorb.worlds.path_guidance.guidance_path import GuidancePath
from haptorb.worlds.path_guidance.path_guidance import PathGuidance
from haptorb.worlds.path_guidance.path_shapes import SHAPES, make_shape
from haptorb.worlds.world import World

__all__ = ["WAYS", "GuidanceComparison", "GuidanceRow", "compare_guidance"]

#: none: no force. valley: the world `guidance`, as stiff as it needs to be to use the planner's mean force. spring: to
#: a point that goes along by the clock. plan: the world `path_guidance`.
WAYS = ("none", "valley", "spring", "plan")
_STRENGTHS = {"none": 0.0, "valley": 0.35, "spring": 0.35, "plan": 1.0}  #: [N]
_WIDTH = 0.003  #: of a valley that needs no more than its greatest strength, 1 N, to be as stiff as it should be [m]
_STIFF = (2.0, 2000.0)  #: of valleys, least and greatest [N/m]
_TRIES = 8  #: to find the valley's stiffness
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
        """Error of the plan over that of the valley at equal mean force, or the best valley, over all paths."""
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
                    "strength_N": row.strength, "width_m": row.width if row.way == "valley" else None,
                    "tripped": row.tripped,
                }
                for row in self.rows
            ],
            "at_rest": [{"grip": g, "guidance": w, "way_m": way} for (g, w), way in self.drift.items()],
            "plan_over_valley": {grip: self.find_ratio(grip) for grip in grips},
        }  # fmt: skip


def _make_world(way: str, path: GuidancePath, grip: HandGrip, pace: float) -> World:
    if way == "none":
        return Nothing()
    if way == "valley":
        return _make_valley(path, _STRENGTHS[way] / _WIDTH)
    if way == "spring":
        return MovingPoint(path=path, strength=_STRENGTHS[way], pace=pace)
    return PathGuidance(
        path=path, strength=_STRENGTHS[way], hand_mass=max(_KNOWN * grip.mass, 0.05), hand_damping=_KNOWN * grip.damping
    )


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
    total, done = len(paths) * len(grips) * (3 + _TRIES) + len(grips) * len(WAYS), 0

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
            for way in WAYS:
                trial = found[way]
                strength, width = (valley.strength, valley.width) if way == "valley" else (_STRENGTHS[way], np.nan)
                rows.append(
                    GuidanceRow(
                        name, grip, way, trial.error, float(np.abs(trial.across).max()), trial.force, trial.heat,
                        strength, width, trial.tripped,
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
    stiffness, (low, high) = _STRENGTHS["valley"] / _WIDTH, _STIFF
    for _ in range(_TRIES):
        valley = _make_valley(path, stiffness)
        trial = run(valley)
        attempts.append((trial, valley))
        share = trial.force / max(force, 1e-9)
        if abs(share - 1.0) <= _NEAR:
            return attempts[-1]
        low, high = (stiffness, high) if share < 1.0 else (low, stiffness)
        # Towards an end that no trial has confirmed, the next step is not halfway, but follows the force.
        guess = stiffness * max(share, 1e-3) ** -1.5
        stiffness = guess if low < guess < high else (low * high) ** 0.5
    return min(attempts, key=lambda one: one[0].error)
