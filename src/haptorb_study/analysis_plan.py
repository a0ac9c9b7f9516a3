"""Analysis plan of a study: number of participants, tests, and smallest effects of interest.

The plan is part of the study file. It does not affect the trials, so it is excluded from the study's digest and has
a digest of its own, which every session stores: a plan that changes after the first session is detected.
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from haptorb.devices import schema as m
from haptorb_study.statistics.significance import Correction, PairTest
from haptorb_study.study_tables import Name, Part, Real, Whole

__all__ = ["CLAIMS", "MEASURES", "AnalysisPlan", "HandAngle", "PlannedTest", "check_plan", "unit_of"]


#: procedure → measures, one value per participant and condition; the first is the default
MEASURES = {
    "identification": ("error", "accuracy", "upward-bias", "error-slope"),
    "localisation": ("error", "upward-bias", "error-slope"),
    "rating": ("rating",),
    "constant": ("threshold", "midpoint"),
    "staircase": ("threshold",),
    "bayesian": ("threshold",),
    "forced-choice": ("choice",),
    "magnitude": ("magnitude", "exponent"),
}
#: measure that can be tested against zero, without a second condition → hypothesis
CLAIMS = {"upward-bias": "answers go higher", "error-slope": "error grows with θ"}
_UNITS = {"error": "mm", "upward-bias": "deg", "error-slope": "mm/deg", "magnitude": "log10"}

HandAngle = Annotated[
    Annotated[Real, Field(ge=-360, le=360)] | None,
    m.Meaning("direction from the device's axis to the hand that holds the tool, about the vertical axis from +x"),
    m.Unit("deg"),
    m.Without("not known: errors away from the hand are not computed"),
]


class PlannedTest(Part):
    """Planned test over participants: two conditions, or a measure against zero."""

    measure: Annotated[
        str,
        m.Meaning("measure to test"),
        m.Form(", ".join(dict.fromkeys(one for known in MEASURES.values() for one in known)) + "; by procedure"),
    ]
    between: Annotated[
        tuple[Name, Name] | None,
        m.Meaning("the two conditions; the difference is the first minus the second"),
        m.Without("against zero, over all conditions: only upward-bias and error-slope"),
    ] = None
    smallest_effect: Annotated[
        Annotated[Real, Field(gt=0)] | None,
        m.Meaning("smallest difference, of either sign, that would matter"),
        m.Unit("that of the measure: mm, deg, mm/deg, log10, that of the level, or shares and points as plain numbers"),
        m.Without("none is stated"),
    ] = None


class AnalysisPlan(Part):
    """Analysis plan of a study."""

    participants: Annotated[
        Whole, Field(ge=2, le=10_000), m.Meaning("planned number of participants who finish"), m.Form("2 to 10000")
    ]
    alpha: Annotated[Real, Field(gt=0, lt=0.5), m.Meaning("significance level of the tests together")] = 0.05
    correction: Annotated[Correction, m.Meaning("correction of p for several planned tests")] = "holm"
    test: Annotated[PairTest, m.Meaning("test over people: Student's of the mean, or of signs")] = "t"
    tests: Annotated[
        tuple[PlannedTest, ...],
        Field(min_length=1, max_length=100),
        m.Meaning("planned tests; all others are reported as exploratory"),
        m.Form("1 to 100, all different"),
    ]

    @model_validator(mode="after")
    def _check_tests(self) -> Self:
        known = [(test.measure, frozenset(test.between or ())) for test in self.tests]
        if len(set(known)) < len(known):
            raise ValueError("planned tests must differ: each measure and pair of conditions once")
        return self

    @property
    def digest(self) -> str:
        """Digest of the whole plan."""
        return sha256(self.model_dump_json().encode()).hexdigest()[:16]

    @property
    def strictest_alpha(self) -> float:
        """Significance level of a single test under the plan's correction, for the power estimate."""
        return self.alpha if self.correction == "none" else self.alpha / len(self.tests)

    @property
    def sentence(self) -> str:
        """Summary for users."""
        count = f"{len(self.tests)} test{'' if len(self.tests) == 1 else 's'}"
        return (
            f"plan {self.digest}: {self.participants} participants, {count} ({self.test}), α = {self.alpha:g}, "
            f"correction {self.correction}"
        )

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {"digest": self.digest, **self.model_dump(mode="json")}

    def find(self, measure: str, a: str, b: str) -> PlannedTest | None:
        """The planned test of `measure` between `a` and `b`, in either order; both empty: against zero."""
        wanted = (measure, {a, b} - {""})
        return next((test for test in self.tests if (test.measure, set(test.between or ())) == wanted), None)


def unit_of(measure: str, level_unit: str) -> str:
    """Unit of `measure`; empty for shares, ratings and plain numbers.

    >>> unit_of("error", ""), unit_of("threshold", "A·m²"), unit_of("accuracy", "")
    ('mm', 'A·m²', '')
    """
    return level_unit if measure in ("threshold", "midpoint") else _UNITS.get(measure, "")


def check_plan(procedure: str, conditions: Sequence[str], plan: AnalysisPlan | None) -> None:
    """Raise ValueError unless `procedure` and `conditions` permit every test of `plan`."""
    known = MEASURES.get(procedure, ())
    for number, test in enumerate(plan.tests if plan else (), 1):
        where = f"plan.tests, number {number}:"
        if test.measure not in known:
            raise ValueError(
                f"{where} procedure '{procedure}' has no measure '{test.measure}'; known: {', '.join(known)}"
            )
        if test.between is None and test.measure not in CLAIMS:
            raise ValueError(
                f"{where} '{test.measure}' needs between = [condition, condition]; known: {', '.join(conditions)}"
            )
        for name in test.between or ():
            if name not in conditions:
                raise ValueError(f"{where} there is no condition '{name}'; known: {', '.join(conditions)}")
        if test.between is not None and test.between[0] == test.between[1]:
            raise ValueError(f"{where} a condition cannot be compared with itself ('{test.between[0]}')")
