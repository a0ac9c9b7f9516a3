"""Prompt of a trial and its answer, with validation, and the rating scale."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from math import isfinite
from typing import Any

from haptorb.errors import InputError

__all__ = ["SCALE", "Answer", "Prompt", "rating", "read_value"]


@dataclass(frozen=True)
class Prompt:
    """One trial before its answer; plain values, stored as they are."""

    phase: str = "main"  #: "practice" is stored, but excluded from analysis
    condition: str = ""  #: condition that is rendered
    other: str = ""  #: forced choice between conditions: the one in the other interval
    set_point: int = 0  #: number; 0: none
    level: float = 0.0  #: value of the varied parameter in the comparison interval
    interval: int = 0  #: 1 or 2: interval of the comparison (or of `condition`); 0: a single interval
    low: int = 0  #: smallest and
    high: int = 0  #: largest number that may be answered; both 0: the answer is the position
    decimal: bool = False  #: whether any number above `low` and up to `high` may be answered, not only whole ones
    numbers: tuple[int, ...] = ()  #: numbers that may be answered, if they are not a range
    pause: float = 0.0  #: break before this trial [s]

    @classmethod
    def read(cls, stored: dict[str, Any]) -> Prompt:
        """From a stored `row`."""
        known = {field.name for field in fields(cls)}
        values = {key: value for key, value in stored.items() if key in known}
        values["numbers"] = tuple(values.get("numbers", ()))
        return cls(**values)

    def row(self) -> dict[str, Any]:
        """As plain JSON types; `decimal`, unknown to older versions, only where it is set."""
        stored = {**asdict(self), "numbers": list(self.numbers)}
        return stored if self.decimal else {key: value for key, value in stored.items() if key != "decimal"}

    @property
    def wants_number(self) -> bool:
        """Whether the answer is a number, besides the position."""
        return bool(self.numbers) or self.high > 0

    def check_answer(self, answer: Answer) -> Answer:
        """Validate `answer`; InputError if it is not permitted."""
        value = answer.value
        if not self.wants_number:
            if value is not None:
                raise InputError("the answer to this trial is the tool's position, not a number: leave out the number")
            if answer.position is None:
                raise InputError("the answer to this trial is the tool's position, but no position is known")
        elif self.decimal:
            if isinstance(value, bool) or not isinstance(value, int | float) or not self.low < value <= self.high:
                raise InputError(f"answer must be a number above {self.low}, up to {self.high}; got {value!r}")
        elif isinstance(value, bool) or not isinstance(value, int):
            raise InputError(f"answer must be a whole number; got {value!r}")
        elif self.numbers and value not in self.numbers:
            raise InputError(f"answer must be the number of a set-point, {_list_numbers(self.numbers)}; got {value}")
        elif not self.numbers and not self.low <= value <= self.high:
            raise InputError(f"answer must be a whole number from {self.low} to {self.high}; got {value}")
        return answer


@dataclass(frozen=True)
class Answer:
    """Value answered, position of the tool's magnet [m, frame S], and response time [s]."""

    value: int | float | None = None
    position: tuple[float, float, float] | None = None
    seconds: float = 0.0

    def __post_init__(self) -> None:
        if self.position is not None and (len(self.position) != 3 or not all(map(isfinite, self.position))):
            raise InputError(f"position of an answer must be 3 finite numbers; got {self.position!r}")
        if not (isfinite(self.seconds) and self.seconds >= 0):
            raise InputError(f"duration of an answer must be 0 s or more; got {self.seconds!r}")


def read_value(stored: float | None) -> int | float | None:
    """Answer from its database column, which holds whole and decimal numbers.

    >>> read_value(7.0), read_value(2.5), read_value(None)
    (7, 2.5, None)
    """
    return int(stored) if stored is not None and stored == int(stored) else stored


def _list_numbers(numbers: tuple[int, ...]) -> str:
    if numbers == tuple(range(numbers[0], numbers[-1] + 1)):
        return f"{numbers[0]} to {numbers[-1]}"
    return ", ".join(map(str, numbers))


# --------------------------------------------------------------------------------------------------
# Rating scale, shared by studies and feel sessions.


SCALE = (1, 7)  #: from "not at all" to "just right", unless a study file sets another


def rating(of: str, scale: tuple[int, int] = SCALE, set_point: int = 0) -> Prompt:
    """Prompt for a whole number on `scale`, for the condition `of`.

    >>> from haptorb_study.procedures import Answer
    >>> rating("soft").check_answer(Answer(7)).value
    7
    """
    low, high = scale
    return Prompt(condition=of, set_point=set_point, low=low, high=high)
