"""The tables of a study file: set-points, trials, conditions, levels, questions; each refuses what it cannot be."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from haptorb.apps.asking.rating import SCALE
from haptorb.errors import InputError

__all__ = [
    "Condition",
    "Levels",
    "Mask",
    "Name",
    "Part",
    "Place",
    "Places",
    "Question",
    "RatingScale",
    "Real",
    "Trials",
    "Value",
    "Whole",
]

_LONGEST = 4000  #: characters of a reply
_MOST = 1_000_000_000  #: of a whole number that is counted with

Real = Annotated[float, Field(strict=True)]  #: no truth and no text
Whole = Annotated[int, Field(strict=True)]
Value = Real | tuple[Real, Real, Real]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,40}$")]


class Part(BaseModel):
    """A table with no keys but its own."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Place(Part):
    """A set-point of the study's own."""

    number: Annotated[Whole, Field(ge=1, le=999)]
    theta_deg: Annotated[Real, Field(ge=0, le=180)]
    phi_deg: Annotated[Real, Field(ge=-360, le=360)] = 0.0


class Places(Part):
    """A built-in layout, or points."""

    layout: Literal["published", "1-8-8-8"] | None = None
    points: Annotated[tuple[Place, ...], Field(max_length=999)] = ()

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

    repetitions: Annotated[Whole, Field(ge=1, le=1000)] = 2
    order: Literal["random", "blocked", "counter-balanced"] = "random"
    seed: Annotated[Whole, Field(ge=0, le=2**63 - 1)] = 0
    practice: Annotated[Whole, Field(ge=0, le=200)] = 0
    break_every: Annotated[Whole, Field(ge=0, le=_MOST)] = 0
    break_seconds: Annotated[Real, Field(ge=0, le=3600)] = 60.0
    time_limit: Annotated[Real, Field(gt=0, le=3600)] | None = None
    expected_seconds: Annotated[Real, Field(gt=0, le=3600)] = 12.0
    pause_seconds: Annotated[Real, Field(ge=0, le=600)] = 2.0


class Condition(Part):
    """A variant of the world."""

    name: Name
    parameters: dict[str, Value] = {}


class Levels(Part):
    """What is varied against a reference: for constant stimuli, staircases and the adaptive procedure."""

    parameter: str = "moment"
    reference: Real
    values: Annotated[tuple[Real, ...], Field(max_length=200)] = ()
    start: Annotated[Real, Field(gt=0)] | None = None
    least: Annotated[Real, Field(gt=0)] | None = None
    most: Annotated[Real, Field(gt=0)] | None = None
    step: Annotated[Real, Field(gt=1, le=10)] = 1.5
    reversals: Annotated[Whole, Field(ge=4, le=100)] = 10
    trials: Annotated[Whole, Field(ge=4, le=2000)] = 60


class RatingScale(Part):
    """The scale of a rating."""

    question: str = "How well does this feel?"
    low: Annotated[Whole, Field(ge=0)] = SCALE[0]
    high: Annotated[Whole, Field(ge=1, le=100)] = SCALE[1]

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.high <= self.low:
            raise ValueError(f"high must be greater than low; got {self.low} and {self.high}")
        return self


class Mask(Part):
    """Noise on the participant's headphones, so that nobody hears the device; the participant's page plays it."""

    noise: Literal["pink", "white"] = "pink"
    volume_db: Annotated[
        Real, Field(ge=-60, le=-12)
    ] = -20.0  #: effective value over the loudest sine's [dB]; louder clips


class Question(Part):
    """What is asked in words: one of `choices`, a whole number from `low` to `high`, or free text."""

    name: Name
    text: Annotated[str, Field(min_length=1)]
    when: Literal["before", "after"] = "after"  #: the trials
    choices: Annotated[tuple[Annotated[str, Field(min_length=1, max_length=_LONGEST)], ...], Field(max_length=200)] = ()
    low: Annotated[Whole, Field(ge=-_MOST, le=_MOST)] | None = None
    high: Annotated[Whole, Field(ge=-_MOST, le=_MOST)] | None = None

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
        """`reply` without spaces about it; InputError if it does not answer this question."""
        told = reply.strip()
        if not told:
            raise InputError("please answer the question first")
        if len(told) > _LONGEST:
            raise InputError(f"the answer must have at most {_LONGEST} characters; got {len(told)}")
        if any("\ud800" <= letter <= "\udfff" or letter == "\0" for letter in told):
            raise InputError("the answer contains an invalid character: please type it again")
        if self.choices and told not in self.choices:
            raise InputError(f"the answer must be one of {', '.join(self.choices)}; got '{told}'")
        if self.low is not None and self.high is not None:
            number = int(told) if told.removeprefix("-").isdecimal() and told.isascii() else None
            if number is None or not self.low <= number <= self.high:
                raise InputError(f"the answer must be a whole number from {self.low} to {self.high}; got '{told}'")
        return told
