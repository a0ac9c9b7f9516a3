"""Tables of a study file: set-points, trials, conditions, levels, rating, mask, questions."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from haptorb.devices import schema as m
from haptorb.errors import InputError, quote
from haptorb_study.prompts import SCALE

__all__ = [
    "Condition",
    "Levels",
    "Mask",
    "Name",
    "Part",
    "Place",
    "Places",
    "ProcedureName",
    "Question",
    "RatingScale",
    "Real",
    "RenderChoice",
    "Trials",
    "Value",
    "Whole",
]


_MAX_REPLY_CHARACTERS = 4000  #: maximum length of a reply [characters]
_MAX_WHOLE_NUMBER = 1_000_000_000  #: maximum of a whole number


def _is_real(value: Any) -> bool:
    """Whether the value is a number, not a bool or a text, within the range of float."""
    return isinstance(value, int | float) and not isinstance(value, bool) and -1e300 <= value <= 1e300


def _check_value(value: Any) -> float | tuple[float, ...]:
    """Validate a number or a list of three; not bool or text."""
    parts = value if isinstance(value, list | tuple) and len(value) == 3 else [value]
    if not all(_is_real(part) for part in parts):
        raise ValueError(f"must be a number, or a list of three; got {quote(value)}")
    numbers = tuple(float(part) for part in parts)
    return numbers if len(numbers) == 3 else numbers[0]


Real = Annotated[float, Field(strict=True)]  #: neither bool nor text
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
    """Base class of tables: immutable, unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Place(Part):
    """A set-point of the study."""

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
    """Set-points: a built-in layout, or the study's own."""

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
    """Number and order of trials, breaks and time limit."""

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
        Whole, Field(ge=0, le=_MAX_WHOLE_NUMBER), m.Meaning("trials between two breaks; 0: no breaks"), m.Form("≥ 0")
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
    """A condition: a variant of the world."""

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
    """Varied parameter and its levels, for constant stimuli, staircase, bayesian and magnitude."""

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
    """Question and scale of a rating."""

    question: Annotated[str, m.Meaning("question that a trial asks"), m.Form("text")] = "How well does this feel?"
    low: Annotated[Whole, Field(ge=0), m.Meaning("least rating")] = SCALE[0]
    high: Annotated[Whole, Field(ge=1, le=100), m.Meaning("greatest rating"), m.Form("above low, ≤ 100")] = SCALE[1]

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.high <= self.low:
            raise ValueError(f"high must be greater than low; got {self.low} and {self.high}")
        return self


class Mask(Part):
    """Masking noise, played by the participant's page on headphones."""

    noise: Annotated[
        Literal["pink", "white"], m.Meaning("noise on the participant's headphones, so that nobody hears the device")
    ] = "pink"
    volume_db: Annotated[
        Real, Field(ge=-60, le=-12), m.Meaning("rms relative to a full-scale sine"), m.Unit("dB")
    ] = -20.0


class Question(Part):
    """A question: one of `choices`, a whole number from `low` to `high`, or free text."""

    name: Annotated[Name, m.Meaning("name of the question, and of its column in exports")]
    text: Annotated[str, Field(min_length=1), m.Meaning("the question"), m.Form("at least 1 character")]
    when: Annotated[Literal["before", "after"], m.Meaning("before or after the trials")] = "after"
    choices: Annotated[
        tuple[Annotated[str, Field(min_length=1, max_length=_MAX_REPLY_CHARACTERS)], ...],
        Field(max_length=200),
        m.Meaning("answers to choose from"),
        m.Form("at most 200, all different"),
        m.Without("none: low and high, or free text"),
    ] = ()
    low: Annotated[
        Annotated[Whole, Field(ge=-_MAX_WHOLE_NUMBER, le=_MAX_WHOLE_NUMBER)] | None,
        m.Meaning("lowest whole number that is accepted"),
        m.Form("any, with high"),
        m.Without("none: choices, or free text"),
    ] = None
    high: Annotated[
        Annotated[Whole, Field(ge=-_MAX_WHOLE_NUMBER, le=_MAX_WHOLE_NUMBER)] | None,
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
        """Validate `reply`, unchanged; InputError if it does not answer this question."""
        if not reply.strip():
            raise InputError("please answer the question first")
        if len(reply) > _MAX_REPLY_CHARACTERS:
            raise InputError(f"the answer must have at most {_MAX_REPLY_CHARACTERS} characters; got {len(reply)}")
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
        """The choice for `typed` text at a terminal: by its number, unless choices are numbers themselves."""
        numbered = not any(choice.strip().isdecimal() for choice in self.choices)
        if numbered and re.fullmatch("[1-9][0-9]{0,2}", typed) and int(typed) <= len(self.choices):
            return self.choices[int(typed) - 1]
        return typed
