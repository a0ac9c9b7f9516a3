"""What a study file says: what is asked, of what, how often and in which order."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from math import cos, radians, sin
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, ValidationError, model_validator

from haptorb import worlds
from haptorb.arrays import Array
from haptorb.cli.own_code import start_world_file
from haptorb.devices import schema as m
from haptorb.devices.electromagnet import SphericalElectromagnet, electromagnet
from haptorb.devices.loader import load
from haptorb.devices.schema import explain_mistakes
from haptorb.errors import InputError, quote
from haptorb.file_kind import FileKind
from haptorb.files import parse_toml, read_bytes, read_text
from haptorb.terminal import announce_wait
from haptorb.worlds.base import Parameter, World, check_names, parameters
from haptorb.worlds.user_world import WorldFile, fit_world, is_world_file, parse_world_file, try_world
from haptorb_study.procedures import SCALE
from haptorb_study.statistics import Correction, PairTest

__all__ = [
    "CLAIMS",
    "MEASURES",
    "PUBLISHED_ERRORS",
    "AnalysisPlan",
    "Condition",
    "HandAngle",
    "Levels",
    "Mask",
    "Name",
    "Part",
    "Place",
    "Places",
    "PlannedTest",
    "ProcedureName",
    "Question",
    "RatingScale",
    "Real",
    "RenderChoice",
    "SetPoint",
    "Study",
    "Trials",
    "Value",
    "Whole",
    "angles_between",
    "check_levels",
    "check_plan",
    "check_study",
    "directions",
    "list_equal_rings",
    "list_older",
    "list_published",
    "nearest",
    "read_study",
    "study_of",
    "unit_of",
]


# --------------------------------------------------------------------------------------------------
# The tables of a study file: set-points, trials, conditions, levels, questions; each refuses what it cannot be.


_LONGEST = 4000  #: characters of a reply
_MOST = 1_000_000_000  #: of a whole number that is counted with


def _is_real(value: Any) -> bool:
    """No truth, no text, and of a size that a float has."""
    return isinstance(value, int | float) and not isinstance(value, bool) and -1e300 <= value <= 1e300


def _check_value(value: Any) -> float | tuple[float, ...]:
    """A number, or three of them, as float; no truth and no text."""
    parts = value if isinstance(value, list | tuple) and len(value) == 3 else [value]
    if not all(_is_real(part) for part in parts):
        raise ValueError(f"must be a number, or a list of three; got {quote(value)}")
    numbers = tuple(float(part) for part in parts)
    return numbers if len(numbers) == 3 else numbers[0]


Real = Annotated[float, Field(strict=True)]  #: no truth and no text
Whole = Annotated[int, Field(strict=True)]
ProcedureName = Literal[
    "identification", "localisation", "constant", "staircase", "bayesian", "forced-choice", "rating", "magnitude"
]  # fmt: skip
RenderChoice = Annotated[
    Literal["", "force", "torque", "both"],
    m.Meaning("part of the world's wrench to render"),
    m.Without("the part that the world defines"),
]
Value = Annotated[float | tuple[float, float, float], BeforeValidator(_check_value)]
Name = Annotated[
    str,
    Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,40}$"),
    m.Form("at most 41 letters, digits, hyphens and underscores, a letter or digit first"),
]


class Part(BaseModel):
    """A table with no keys but its own."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Place(Part):
    """A set-point of the study's own."""

    number: Annotated[Whole, Field(ge=1, le=999), m.Meaning("the set-point's number, which participants answer")]
    theta_deg: Annotated[
        Real,
        Field(ge=0, le=180),
        m.Meaning("angle from the summit of the dome"),
        m.Unit("deg"),
        m.Form("0 to the device's workspace"),
    ]
    phi_deg: Annotated[Real, Field(ge=-360, le=360), m.Meaning("direction of that angle, from +x"), m.Unit("deg")] = 0.0


class Places(Part):
    """A built-in layout, or points."""

    layout: Annotated[
        Literal["published", "1-8-8-8"] | None,
        m.Meaning("the 25 set-points of Zárate et al. 2020, 1 + 4 + 8 + 12; or 25 on equal rings"),
        m.Without("none: points gives them"),
    ] = None
    points: Annotated[
        tuple[Place, ...],
        Field(max_length=999),
        m.Meaning("the study's own set-points"),
        m.Form("at most 999, each with its own number"),
        m.Without("none: layout gives them"),
    ] = ()

    @model_validator(mode="after")
    def _check_points(self) -> Self:
        if bool(self.points) == (self.layout is not None):
            raise ValueError('give either layout = "published" or points, not both and not neither')
        numbers = [point.number for point in self.points]
        twice = sorted({n for n in numbers if numbers.count(n) > 1})
        if twice:
            raise ValueError(
                f"number {twice[0]} belongs to more than one set-point; each set-point needs its own number"
            )
        return self


class Trials(Part):
    """How often, in which order, and with what rests."""

    repetitions: Annotated[
        Whole, Field(ge=1, le=1000), m.Meaning("presentations of each set-point or level in each condition")
    ] = 2
    order: Annotated[
        Literal["random", "blocked", "counter-balanced"],
        m.Meaning("order of the conditions: each participant's own by a Williams square, mixed, or as in the file"),
    ] = "counter-balanced"
    seed: Annotated[
        Whole,
        Field(ge=0, le=2**63 - 1),
        m.Meaning("seed of the random order; each participant's own order follows from it"),
        m.Form("≥ 0"),
    ] = 0
    practice: Annotated[
        Whole,
        Field(ge=0, le=200),
        m.Meaning("number of practice trials; for staircase and bayesian at the greatest difference"),
    ] = 0
    break_every: Annotated[
        Whole, Field(ge=0, le=_MOST), m.Meaning("trials between two breaks; 0: no breaks"), m.Form("≥ 0")
    ] = 0
    break_seconds: Annotated[Real, Field(ge=0, le=3600), m.Meaning("duration of a break"), m.Unit("s")] = 60.0
    time_limit: Annotated[
        Annotated[Real, Field(gt=0, le=3600)] | None,
        m.Meaning("longest time for an answer"),
        m.Unit("s"),
        m.Without("no limit"),
    ] = None
    expected_seconds: Annotated[
        Real,
        Field(gt=0, le=3600),
        m.Meaning("assumed duration of a trial, for the forecasts of `haptorb study check`"),
        m.Unit("s"),
    ] = 12.0
    pause_seconds: Annotated[
        Real,
        Field(ge=0, le=600),
        m.Meaning("pause before each trial but the first"),
        m.Unit("s"),
    ] = 2.0


class Condition(Part):
    """A variant of the world."""

    name: Annotated[Name, m.Meaning("name of the condition, also used in the data")]
    parameters: Annotated[
        dict[str, Value],
        m.Meaning("parameters of the world in this condition, over those of [parameters]"),
        m.Form("NAME = number or [x, y, z]; `haptorb worlds NAME` lists them"),
        m.Without("none"),
    ] = {}
    no_force: Annotated[
        bool,
        Field(strict=True),
        m.Meaning("control condition: the world renders no force and no torque, on purpose; checked before a study"),
    ] = False


class Levels(Part):
    """What is varied: for constant stimuli, staircases, the adaptive procedure and magnitude estimation."""

    parameter: Annotated[
        str,
        m.Meaning("parameter of the world that is varied"),
        m.Form("as `haptorb worlds NAME` lists them"),
    ] = "moment"
    reference: Annotated[
        Real,
        m.Meaning("value of that parameter in the reference interval; magnitude: level whose estimate is 1"),
        m.Unit("that of the parameter"),
    ]
    values: Annotated[
        tuple[Real, ...],
        Field(max_length=200),
        m.Meaning("values to compare with the reference, or to estimate"),
        m.Unit("that of the parameter"),
        m.Form("2 to 200, not all equal, with procedure constant; above 0 with magnitude"),
        m.Without("none: for the other procedures"),
    ] = ()
    start: Annotated[
        Annotated[Real, Field(gt=0)] | None,
        m.Meaning("first difference from the reference of a staircase"),
        m.Unit("that of the parameter"),
        m.Form("between least and most"),
        m.Without("none: required with procedure staircase"),
    ] = None
    least: Annotated[
        Annotated[Real, Field(gt=0)] | None,
        m.Meaning("least difference from the reference"),
        m.Unit("that of the parameter"),
        m.Without("none: required with procedures staircase and bayesian"),
    ] = None
    most: Annotated[
        Annotated[Real, Field(gt=0)] | None,
        m.Meaning("greatest difference from the reference"),
        m.Unit("that of the parameter"),
        m.Form("above least"),
        m.Without("none: required with procedures staircase and bayesian"),
    ] = None
    step: Annotated[Real, Field(gt=1, le=10), m.Meaning("factor by which a staircase changes the difference")] = 1.5
    reversals: Annotated[Whole, Field(ge=4, le=100), m.Meaning("reversals after which a staircase ends")] = 10
    trials: Annotated[
        Whole, Field(ge=4, le=2000), m.Meaning("trials of the adaptive procedure; most trials of a staircase")
    ] = 60


class RatingScale(Part):
    """The scale of a rating."""

    question: Annotated[str, m.Meaning("question that a trial asks"), m.Form("text")] = "How well does this feel?"
    low: Annotated[Whole, Field(ge=0), m.Meaning("least rating")] = SCALE[0]
    high: Annotated[Whole, Field(ge=1, le=100), m.Meaning("greatest rating"), m.Form("above low, ≤ 100")] = SCALE[1]

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.high <= self.low:
            raise ValueError(f"high must be greater than low; got {self.low} and {self.high}")
        return self


class Mask(Part):
    """Noise on the participant's headphones, which masks the device; the participant's page plays it."""

    noise: Annotated[
        Literal["pink", "white"], m.Meaning("noise on the participant's headphones, so that nobody hears the device")
    ] = "pink"
    volume_db: Annotated[
        Real, Field(ge=-60, le=-12), m.Meaning("rms relative to a full-scale sine"), m.Unit("dB")
    ] = -20.0


class Question(Part):
    """What is asked in words: one of `choices`, a whole number from `low` to `high`, or free text."""

    name: Annotated[Name, m.Meaning("name of the question, and of its column in exports")]
    text: Annotated[str, Field(min_length=1), m.Meaning("the question"), m.Form("at least 1 character")]
    when: Annotated[Literal["before", "after"], m.Meaning("before or after the trials")] = "after"
    choices: Annotated[
        tuple[Annotated[str, Field(min_length=1, max_length=_LONGEST)], ...],
        Field(max_length=200),
        m.Meaning("answers to choose from"),
        m.Form("at most 200, all different"),
        m.Without("none: low and high, or free text"),
    ] = ()
    low: Annotated[
        Annotated[Whole, Field(ge=-_MOST, le=_MOST)] | None,
        m.Meaning("lowest whole number that is accepted"),
        m.Form("any, with high"),
        m.Without("none: choices, or free text"),
    ] = None
    high: Annotated[
        Annotated[Whole, Field(ge=-_MOST, le=_MOST)] | None,
        m.Meaning("highest whole number that is accepted"),
        m.Form("≥ low, with low"),
        m.Without("none: choices, or free text"),
    ] = None

    @model_validator(mode="after")
    def _check_answers(self) -> Self:
        if (self.low is None) != (self.high is None) or (self.low or 0) > (self.high or 0):
            raise ValueError(f"low and high go together, low first; got {self.low} and {self.high}")
        if self.choices and self.low is not None:
            raise ValueError("give either choices or low and high, not both")
        if len(set(self.choices)) < len(self.choices):
            raise ValueError("choices must differ")
        return self

    def check_reply(self, reply: str) -> str:
        """`reply` as it was given; InputError if it does not answer this question. Nothing of it is changed."""
        if not reply.strip():
            raise InputError("please answer the question first")
        if len(reply) > _LONGEST:
            raise InputError(f"the answer must have at most {_LONGEST} characters; got {len(reply)}")
        if any("\ud800" <= letter <= "\udfff" or letter in "\0\ufffd" for letter in reply):
            raise InputError("the answer contains an invalid character: please type it again")
        if self.choices and reply not in self.choices:
            raise InputError(f"the answer must be one of {', '.join(self.choices)}; got {quote(reply)}")
        if self.low is not None and self.high is not None:
            number = int(reply) if re.fullmatch("-?[0-9]{1,10}", reply) else None
            if number is None or not self.low <= number <= self.high:
                raise InputError(
                    f"the answer must be a whole number from {self.low} to {self.high}; got {quote(reply)}"
                )
        return reply

    def choice_of(self, typed: str) -> str:
        """What `typed` at a terminal stands for: a choice by its number, unless the choices are numbers themselves."""
        numbered = not any(choice.strip().isdecimal() for choice in self.choices)
        if numbered and re.fullmatch("[1-9][0-9]{0,2}", typed) and int(typed) <= len(self.choices):
            return self.choices[int(typed) - 1]
        return typed


# --------------------------------------------------------------------------------------------------
# Where on the dome people are asked to find something: numbered directions, 25 of them built in.


#: θ [deg] → mean and standard deviation of the error [mm], Zárate 2020 §IV
PUBLISHED_ERRORS = {0.0: (2.5, 1.4), 18.0: (5.7, 4.6), 36.0: (6.5, 5.2), 54.0: (7.2, 5.1)}


@dataclass(frozen=True)
class SetPoint:
    """A place on the dome under the number that people answer with."""

    number: int
    theta_deg: float  #: from the top [deg]
    phi_deg: float  #: about the vertical, from +x towards +y [deg]

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector from the centre, frame S."""
        theta, phi = radians(self.theta_deg), radians(self.phi_deg)
        return sin(theta) * cos(phi), sin(theta) * sin(phi), cos(theta)


@cache
def list_published() -> tuple[SetPoint, ...]:
    """The 25 of Zárate 2020 Fig. 8: 1 + 4 + 8 + 12 at θ = 0, 18, 36 and 54 deg, nearest neighbours 18.0 deg apart.

    "25 evenly separated by 18°" and the four rings of Fig. 9 agree so; which number belongs where the figure alone
    gives, so they are counted from the top, ring by ring.

    >>> [sum(p.theta_deg == ring for p in list_published()) for ring in (0, 18, 36, 54)]
    [1, 4, 8, 12]
    """
    return _list_rings((4, 8, 12))


@cache
def list_equal_rings() -> tuple[SetPoint, ...]:
    """25 as well, 1 + 8 + 8 + 8: what haptorb called published before erratum E17 was withdrawn."""
    return _list_rings((8, 8, 8))


def _list_rings(counts: tuple[int, ...]) -> tuple[SetPoint, ...]:
    """One on top, then so many on each ring, 18 deg further down each time, the first of a ring at φ = 0."""
    rings = [(18.0 * (n + 1), 360.0 * k / count) for n, count in enumerate(counts) for k in range(count)]
    return tuple(SetPoint(n + 1, theta, phi) for n, (theta, phi) in enumerate([(0.0, 0.0), *rings]))


def directions(points: tuple[SetPoint, ...]) -> Array:
    """(n, 3) unit vectors."""
    return np.array([point.direction for point in points]).reshape(-1, 3)


def angles_between(a: Array, b: Array) -> Array:
    """(n,) angles between directions (n, 3) and (n, 3) [deg]; NaN where one is."""
    cosine = np.sum(a * b, axis=-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
    angles: Array = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return angles


def nearest(points: tuple[SetPoint, ...], position: Array) -> int:
    """Number of the set-point in whose direction `position` (3,) lies most nearly.

    >>> nearest(list_published(), np.array([0.1, 0.0, 1.0]))
    1
    """
    return points[int(np.argmax(directions(points) @ position))].number


# --------------------------------------------------------------------------------------------------
# What the tables of a study file must be together: levels for its procedure, and worlds that its device can render.


class _Study(Protocol):
    """What the checks read of a `Study`, whose module imports this one."""

    @property
    def world(self) -> str: ...

    @property
    def procedure(self) -> str: ...

    @property
    def model(self) -> str | None: ...

    @property
    def parameters(self) -> dict[str, Any]: ...

    @property
    def conditions(self) -> Sequence[Condition]: ...

    @property
    def levels(self) -> Levels | None: ...

    @property
    def own_world(self) -> World | None: ...

    @property
    def points(self) -> tuple[SetPoint, ...]: ...

    def load_device(self) -> SphericalElectromagnet: ...

    def model_on(self, device: SphericalElectromagnet) -> str | None: ...

    def make_world(self, condition: str, number: int = 0, level: float | None = None) -> World: ...


def check_levels(study: _Study) -> None:
    """ValueError unless [levels] fit the procedure, one that varies a level."""
    levels = study.levels
    if levels is None:
        raise ValueError(f"procedure '{study.procedure}' needs [levels] with at least parameter and reference")
    if study.procedure == "constant":
        if len(set(levels.values)) < 2:
            raise ValueError("constant stimuli need at least two different levels.values")
    elif study.procedure == "magnitude":
        if len(set(levels.values)) < 2 or min(levels.values) <= 0 or levels.reference <= 0:
            raise ValueError(
                "magnitude estimation needs two different levels.values or more, all above 0; reference too"
            )
    elif levels.least is None or levels.most is None or not levels.least < levels.most:
        raise ValueError(f"procedure '{study.procedure}' needs levels.least < levels.most, both differences > 0")
    elif study.procedure == "staircase" and (levels.start is None or not levels.least <= levels.start <= levels.most):
        raise ValueError("a staircase needs levels.start between levels.least and levels.most")


def check_study(study: _Study) -> None:
    """InputError unless the device can render every condition, level and set-point."""
    kind = worlds.find_world(study.world) if study.own_world is None else type(study.own_world)
    for condition in study.conditions:
        check_names(kind, {**study.parameters, **condition.parameters})
        if "summit" in {**study.parameters, **condition.parameters}:
            raise InputError("parameters.summit is set by the set-points; leave it out")
    if "summit" not in parameters(kind):
        raise InputError(
            f"world '{study.world}' has no summit to move to a set-point; a study needs a world with a summit: dome"
        )
    device = study.load_device()
    if study.model:
        device.check_tick_model(study.model_on(device) or study.model)
    limit = device.workspace_half_angle * 180 / 3.141592653589793
    for point in study.points:
        if point.theta_deg > limit + 1e-9:
            raise InputError(
                f"set-point {point.number} at θ = {point.theta_deg:g} deg lies outside the workspace of device "
                f"'{device.name}', which ends at {limit:g} deg"
            )
    shown: list[float | None] = [None]
    if study.levels is not None:
        if study.levels.parameter not in parameters(kind):
            check_names(kind, {study.levels.parameter: 0.0})
        more = [level for level in (study.levels.least, study.levels.most, study.levels.start) if level is not None]
        shown = [study.levels.reference, *study.levels.values, *(study.levels.reference + m for m in more)]
    for condition in study.conditions:
        for level in shown:
            fit_world(study.make_world(condition.name, study.points[0].number, level), device)


# --------------------------------------------------------------------------------------------------
# What is decided before anybody takes part: how many people, which tests of what, and the smallest effect of interest.
#
# The plan stands in the study file. It says nothing about how trials run, so it is no part of the study's digest: it
# has one of its own, which every session keeps. A plan that changes after the first session is so detected.


#: procedure → what may be compared, one value per person and condition; the first by default
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
#: measure that may be tested against zero, without a second condition → what it claims
CLAIMS = {"upward-bias": "answers go higher", "error-slope": "error grows with θ"}
_UNITS = {"error": "mm", "upward-bias": "deg", "error-slope": "mm/deg", "magnitude": "log10"}

HandAngle = Annotated[
    Annotated[Real, Field(ge=-360, le=360)] | None,
    m.Meaning("direction from the device's axis to the hand that holds the tool, about the vertical axis from +x"),
    m.Unit("deg"),
    m.Without("not known: errors away from the hand are not computed"),
]


class PlannedTest(Part):
    """One test over people: two conditions, or a measure against zero."""

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
    """The plan of a study's analysis."""

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
        """Of everything in the plan."""
        return sha256(self.model_dump_json().encode()).hexdigest()[:16]

    @property
    def strictest_alpha(self) -> float:
        """Level that a single test must reach regardless of the others; for power."""
        return self.alpha if self.correction == "none" else self.alpha / len(self.tests)

    @property
    def sentence(self) -> str:
        """For people."""
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


class _WithConditions(Protocol):
    """What the check reads of a study, whose module imports this one."""

    @property
    def procedure(self) -> str: ...

    @property
    def conditions(self) -> Any: ...


def unit_of(measure: str, level_unit: str) -> str:
    """Unit of `measure`; empty for shares, ratings and plain numbers.

    >>> unit_of("error", ""), unit_of("threshold", "A·m²"), unit_of("accuracy", "")
    ('mm', 'A·m²', '')
    """
    return level_unit if measure in ("threshold", "midpoint") else _UNITS.get(measure, "")


def check_plan(study: _WithConditions, plan: AnalysisPlan | None) -> None:
    """ValueError unless every test of `plan` is one that `study` can give."""
    known, names = MEASURES.get(study.procedure, ()), [condition.name for condition in study.conditions]
    for number, test in enumerate(plan.tests if plan else (), 1):
        where = f"plan.tests, number {number}:"
        if test.measure not in known:
            raise ValueError(
                f"{where} procedure '{study.procedure}' has no measure '{test.measure}'; known: {', '.join(known)}"
            )
        if test.between is None and test.measure not in CLAIMS:
            raise ValueError(
                f"{where} '{test.measure}' needs between = [condition, condition]; known: {', '.join(names)}"
            )
        for name in test.between or ():
            if name not in names:
                raise ValueError(f"{where} there is no condition '{name}'; known: {', '.join(names)}")
        if test.between is not None and test.between[0] == test.between[1]:
            raise ValueError(f"{where} a condition cannot be compared with itself ('{test.between[0]}')")


#: left out of the digest where they are not used, as is no_force of a condition: studies begun before them continue
_LATER = (
    "mask", "questions", "model", "render", "world_digest", "published_layout", "order_version", "model_version",
    "hand_deg",
)  # fmt: skip
_LEVELLED = ("constant", "staircase", "bayesian", "magnitude")


class Study(Part):
    """One study; `text` is the file as it was read, kept with the data."""

    name: Annotated[Name, m.Meaning("name of the study")]
    device: Annotated[
        str, m.Meaning("device that the participants use"), m.Form("name in the catalogue, or path of a device file")
    ] = "omni"
    world: Annotated[
        str,
        m.Meaning("world to render; it must have a parameter summit"),
        m.Form("name in the catalogue, or FILE.py:NAME beside the study file"),
    ] = "dome"
    world_digest: Annotated[
        str,
        Field(pattern="^([0-9a-f]{64})?$"),
        m.Meaning("SHA-256 of the world's file; added by haptorb"),
        m.Form("64 hexadecimal digits"),
        m.Without("computed"),
    ] = ""
    published_layout: Annotated[
        Literal["", "1-4-8-12"],
        m.Meaning('meaning of the layout "published"; added by haptorb; a stored study without it has 1 + 8 + 8 + 8'),
        m.Without("computed"),
    ] = ""
    order_version: Annotated[
        Literal["", "2"],
        m.Meaning("version of the rules for the order of trials; added by haptorb; without it, the older rules apply"),
        m.Without("computed"),
    ] = ""
    model_version: Annotated[
        Literal["", "2"],
        m.Meaning('version of the models; added by haptorb; in a stored study without it "exact" is "point-coils"'),
        m.Without("computed"),
    ] = ""
    model: Annotated[
        str,
        m.Meaning("controller model"),
        m.Form("one of the device's models that a loop can use"),
        m.Without("the device's first model"),
    ] = ""
    render: RenderChoice = ""
    procedure: Annotated[
        ProcedureName,
        m.Meaning("procedure: the question of each trial"),
    ] = "identification"
    instructions: Annotated[str, m.Meaning("text that the participant reads first"), m.Form("text")] = (
        "Find the place where the dome pushes hardest, then answer with its number."
    )
    consent: Annotated[
        str,
        m.Meaning("text that the participant agrees to before the first trial"),
        m.Form("text"),
        m.Without("none is asked for"),
    ] = ""
    parameters: Annotated[
        dict[str, Value],
        m.Meaning("parameters of the world in every condition"),
        m.Form("NAME = number or [x, y, z]; `haptorb worlds NAME` lists them"),
        m.Without("the world's defaults"),
    ] = Field(default_factory=dict)
    set_points: Annotated[
        Places, m.Meaning("places on the dome that trials present"), m.Without("the published layout")
    ] = Places(layout="published")
    trials: Annotated[Trials, m.Meaning("repetitions, order and breaks"), m.Without("the defaults below")] = Trials()
    conditions: Annotated[
        tuple[Condition, ...],
        Field(max_length=100),
        m.Meaning("variants of the world to compare"),
        m.Form("1 to 100, each with its own name; 2 or more for forced-choice"),
        m.Without("one, called base"),
    ] = (Condition(name="base"),)
    levels: Annotated[
        Levels | None,
        m.Meaning("parameter that a comparison varies"),
        m.Without("none: required with procedures constant, staircase, bayesian and magnitude"),
    ] = None
    rating: Annotated[RatingScale, m.Meaning("question and scale of a rating"), m.Without("the defaults below")] = (
        RatingScale()
    )
    mask: Annotated[Mask | None, m.Meaning("noise for the participant's headphones"), m.Without("none")] = None
    questions: Annotated[
        tuple[Question, ...],
        Field(max_length=200),
        m.Meaning("questions before or after the trials"),
        m.Form("at most 200, each with its own name"),
        m.Without("none"),
    ] = ()
    hand_deg: HandAngle = None
    plan: Annotated[
        AnalysisPlan | None, m.Meaning("plan of the analysis, decided before data exist"), m.Without("none")
    ] = None
    _text: str = PrivateAttr("")
    _own: World | None = PrivateAttr(None)

    @model_validator(mode="before")
    @classmethod
    def _keep_older_order(cls, raw: Any) -> Any:
        """A study of older rules that names no order is in random order, as it was run."""
        if isinstance(raw, dict) and not raw.get("order_version") and isinstance(raw.get("trials", {}), dict):
            return {**raw, "trials": {"order": "random", **raw.get("trials", {})}}
        return raw

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        names = [condition.name for condition in self.conditions]
        if not names:
            raise ValueError("conditions must not be empty; leave out the key for a single condition")
        if len(set(names)) < len(names):
            raise ValueError(f"condition names must differ; got {', '.join(names)}")
        asked = [question.name for question in self.questions]
        if len(set(asked)) < len(asked):
            raise ValueError(f"names of questions must differ; got {', '.join(asked)}")
        if self.procedure in _LEVELLED:
            check_levels(self)
        elif self.levels is not None:
            raise ValueError(f"[levels] needs procedure {', '.join(_LEVELLED)}; this study has '{self.procedure}'")
        if self.procedure == "forced-choice" and len(names) < 2:
            raise ValueError("a forced choice needs at least two conditions to choose between")
        check_plan(self, self.plan)
        return self

    @property
    def text(self) -> str:
        """The study file, word for word; before it the digest of a world's file, and the layout called published."""
        return self._text

    @property
    def own_world(self) -> World | None:
        """The world of FILE.py:NAME; None for one of the catalogue, and for a study out of a database."""
        return self._own

    @property
    def world_name(self) -> str:
        """What a servo calls the world."""
        return self.world if self._own is None else self._own.name

    @property
    def known_parameters(self) -> dict[str, Parameter]:
        """The world's parameters by name; none for a user's own where its file was not read."""
        if is_world_file(self.world):
            return {} if self._own is None else parameters(type(self._own))
        return parameters(worlds.find_world(self.world))

    @property
    def digest(self) -> str:
        """Of all that decides how it runs: sessions of one study share it. The plan of the analysis has its own."""
        unused = {"plan"} | {name for name in _LATER if getattr(self, name) in (None, "", ())}
        felt = {n: {"no_force"} for n, condition in enumerate(self.conditions) if not condition.no_force}
        text = self.model_dump_json(exclude={**dict.fromkeys(unused, True), "conditions": felt})
        return sha256(text.encode()).hexdigest()[:16]

    @property
    def points(self) -> tuple[SetPoint, ...]:
        """The set-points, built in or its own."""
        if self.set_points.layout == "published" and self.published_layout:
            return list_published()
        if self.set_points.layout:
            return list_equal_rings()
        return tuple(SetPoint(p.number, p.theta_deg, p.phi_deg) for p in self.set_points.points)

    def with_text(self, text: str, update: dict[str, Any]) -> Study:
        """With other values under the keys of `update`, and the matching `text`."""
        found = self.model_copy(update=update)
        found._text = text
        return found

    def with_world(self, world: World) -> Study:
        """With the `world` of its FILE.py:NAME."""
        found = self.model_copy()
        found._own = world
        return found

    def point(self, number: int) -> SetPoint:
        """The set-point called `number`."""
        return next(point for point in self.points if point.number == number)

    def values(self, condition: str, number: int = 0, level: float | None = None) -> dict[str, Any]:
        """The world's parameters in `condition`, with the summit at a set-point and the varied one at `level`."""
        chosen = next(c for c in self.conditions if c.name == condition)
        values: dict[str, Any] = {**self.parameters, **chosen.parameters}
        if number:
            values["summit"] = self.point(number).direction
        if level is not None and self.levels is not None:
            values[self.levels.parameter] = level
        return values

    @property
    def level_unit(self) -> str:
        """Unit of the parameter that the levels vary; empty for plain numbers, and where nothing is varied."""
        known = None if self.levels is None else self.known_parameters.get(self.levels.parameter)
        return "" if known is None else known.unit

    def make_world(self, condition: str, number: int = 0, level: float | None = None) -> World:
        """The world of one trial. Raises InputError for a user's own whose file was not read."""
        if self._own is None and is_world_file(self.world):
            raise InputError(f"world '{self.world}' is loaded only with its study file, not from a database")
        fresh = worlds.find_world(self.world)() if self._own is None else self._own
        return fresh.replace(**self.values(condition, number, level))

    def load_device(self) -> SphericalElectromagnet:
        """The device; InputError if it has no dome to find places on."""
        return electromagnet(load(self.device), "a study with set-points on a dome")

    def model_on(self, device: SphericalElectromagnet) -> str | None:
        """The controller model on `device`; None: its first. What was begun with coils that are points stays so."""
        if not self.model_version and self.model in ("", "exact"):
            return "point-coils"
        return self.model or None


# --------------------------------------------------------------------------------------------------
# Read a study file (TOML), with what haptorb adds to it and the world's code; refused before anyone sits down.


#: what "published" means today; a stored study without the key ran with 1 + 8 + 8 + 8
_PUBLISHED = "1-4-8-12"
#: how trials are ordered today; a stored study without the key keeps the earlier order, at random by default
_ORDER = "2"
#: what "exact" means today; a stored study without the key ran with coils that are points
_MODELS = "2"
_MISTAKES = 20  #: reported at once
_CODE = 1 << 20  #: bytes of a world's file


def read_study(path: str | Path) -> Study:
    """The study in the file `path`, with its world if that is in a file of its own, whose code is run.

    Raises InputError saying what is wrong, where, and what was expected.
    """
    return study_of(
        read_text(path, "study file", InputError, kind=FileKind.STUDY), str(path), Path(path).expanduser().parent
    )


def study_of(text: str, where: str = "study", folder: Path | None = None, *, stored: bool = False) -> Study:
    """The study that `text` (TOML) describes; `where` names it in messages.

    folder   of the study file, where a world's file is looked for; None: no file is read and no code is run, as for
             what a database holds
    stored   it is what a database holds: nothing is added to it, so it means what it meant when it was run
    """
    try:
        raw = parse_toml(text)
    except ValueError as cause:
        raise InputError(f"study file {where} is not TOML: {cause}") from cause
    for key, newest in (("order_version", _ORDER), ("model_version", _MODELS)):
        if not stored and key not in raw:
            raw[key], text = newest, f'{key} = "{newest}"\n{text}'
    try:
        study = Study.model_validate(raw).with_text(text, {})
        if not stored and study.set_points.layout == "published" and not study.published_layout:
            study = _add_key(study, "published_layout", _PUBLISHED)
        if is_world_file(study.world):
            if folder is None:
                return study
            study = _load_world(study, parse_world_file(study.world, folder))
        check_study(study)
    except ValidationError as cause:
        mistakes = explain_mistakes(cause.errors(), Study, _MISTAKES)
        lines = f" {mistakes[0]}" if len(mistakes) == 1 else "\n  ".join(["", *mistakes])
        raise InputError(f"study file {where}:{lines}") from cause
    except InputError as cause:
        raise InputError(f"study file {where}: {cause}") from cause
    return study


def _load_world(study: Study, file: WorldFile) -> Study:
    """`study` with the world in `file` and the digest of its code: sessions with other code are another study's."""
    with announce_wait(f"World file {file.path} has not returned from loading and its first call"):
        world = try_world(start_world_file(file), study.load_device())
    digest = sha256(read_bytes(file.path, _CODE, "world file", InputError)).hexdigest()
    if study.world_digest not in ("", digest):
        raise InputError(f"world_digest is not that of {file.path}: the file has changed; leave out the key")
    found = study if study.world_digest else _add_key(study, "world_digest", digest)
    return found.with_world(world)


def _add_key(study: Study, key: str, value: str) -> Study:
    """`study` with a key of its own that its file does not have; it stands before the file's text in a database."""
    return study.with_text(f'{key} = "{value}"\n{study.text}', {key: value})


# --------------------------------------------------------------------------------------------------
# A study file as older versions of haptorb understood it: a study continues as it began.


def list_older(study: Study) -> list[Study]:
    """As older versions ran the same file, newest first: with coils that are points, then with their order of trials
    too, then with 1 + 8 + 8 + 8 as published too.

    Empty where the file itself says what it means.
    """
    found, older = [], study
    # The keys stand before the file's own text; the digest of a world's file may stand before them.
    for key in ("model_version", "order_version", "published_layout"):
        lines, added = older.text.splitlines(keepends=True), f'{key} = "{getattr(older, key)}"\n'
        if not getattr(older, key) or added not in lines[:4]:
            continue
        lines.remove(added)
        update: dict[str, object] = {key: ""}
        if key == "order_version" and "order" not in study.trials.model_fields_set:
            update["trials"] = study.trials.model_copy(update={"order": "random"})
        older = older.with_text("".join(lines), update)
        found.append(older)
    return found
