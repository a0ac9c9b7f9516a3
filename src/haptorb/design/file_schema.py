"""What a design file may say, table by table."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from annotated_types import Len
from pydantic import BeforeValidator, Field, model_validator

from haptorb.devices.schema import key as m
from haptorb.devices.schema.sections import Name, Section, Text
from haptorb.errors import quote

__all__ = ["BoundSection", "DeviceDesignFile", "GoalSection", "ParameterSection", "PlaceSection"]


def _check_number(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ValueError(f"must be a number, with its unit in quotes where it has one; got {quote(value)}")
    return value


Number = Annotated[str | float, BeforeValidator(_check_number)]  #: "18 deg", or a plain number
_NUMBER = m.Form("a number with its unit in quotes, or a plain number")
_BOUND = m.Form("a number with its unit, 'base', or a share of it: '0.9 base'")
Word = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=64)]


class PlaceSection(Section):
    """One of `places`, written as a table."""

    key: Annotated[str, m.Meaning("dotted key of the device file; entries of lists count from 1")]
    factor: Annotated[float, Field(allow_inf_nan=False), m.Meaning("factor for the value")] = 1.0
    offset: Annotated[Number, m.Meaning("offset to add, with its unit")] = 0.0


class ParameterSection(Section):
    """[parameters.NAME]: a range, or choices."""

    low: Annotated[Number | None, m.Meaning("least value"), _NUMBER, m.Without("none: `choices`")] = None
    high: Annotated[Number | None, m.Meaning("greatest value"), _NUMBER, m.Without("none: `choices`")] = None
    step: Annotated[Number | None, m.Meaning("step, from `low`"), _NUMBER, m.Without("continuous")] = None
    choices: Annotated[
        list[Any] | dict[str, Any] | None,
        m.Meaning("values to choose from"),
        m.Form("a list, or a table by label"),
        m.Without("none: `low` and `high`"),
    ] = None
    places: Annotated[
        list[str | PlaceSection],
        Len(1, 100),
        m.Meaning("keys of the device file that receive the value"),
        m.Form("1 to 100 keys of the device file"),
    ]

    @model_validator(mode="after")
    def _check_kind(self) -> ParameterSection:
        if self.choices is not None:
            if (self.low, self.high, self.step) != (None, None, None):
                raise ValueError("has choices, so it has no low, high or step")
            if not self.choices:
                raise ValueError("has an empty list of choices")
        elif self.low is None or self.high is None:
            raise ValueError("needs low and high, or choices")
        return self


class _QuantitySection(Section):
    quantity: Annotated[
        str | None,
        m.Meaning("name of the quantity to compute"),
        m.Form("a quantity of the list below"),
        m.Without("the name of the table"),
    ] = None
    function: Annotated[
        str | None, m.Meaning("a function of your own instead"), m.Form("'file.py:name'"), m.Without("none")
    ] = None
    unit: Annotated[
        Text | None,
        m.Meaning("unit of the result, SI without prefix"),
        m.Without("none: a plain number"),
    ] = None

    @model_validator(mode="after")
    def _check_source(self) -> _QuantitySection:
        if self.quantity is not None and self.function is not None:
            raise ValueError("has both a quantity and a function; give one")
        if self.unit is not None and self.function is None:
            raise ValueError("unit is for your own function; a quantity of haptorb has its own")
        return self


class GoalSection(_QuantitySection):
    """[objectives.NAME]"""

    sense: Annotated[
        Literal["minimise", "maximise"] | None, m.Meaning("sense of the objective"), m.Without("that of the quantity")
    ] = None


class BoundSection(_QuantitySection):
    """[constraints.NAME]"""

    at_least: Annotated[Number | None, m.Meaning("least value"), _BOUND, m.Without("none")] = None
    at_most: Annotated[Number | None, m.Meaning("greatest value"), _BOUND, m.Without("none")] = None

    @model_validator(mode="after")
    def _check_bound(self) -> BoundSection:
        if self.at_least is None and self.at_most is None:
            raise ValueError("needs at_least or at_most")
        return self


class DeviceDesignFile(Section):
    """A design file."""

    name: Annotated[Name, m.Meaning("short name of the design")]
    title: Annotated[Text, m.Meaning("title of the design")] = ""
    base: Annotated[str, m.Meaning("base device"), m.Form("name in the catalogue, or a path")]
    parameters: Annotated[
        dict[Word, ParameterSection], Len(1, 100), m.Meaning("free parameters"), m.Form("1 to 100 tables by name")
    ]
    objectives: Annotated[
        dict[Word, GoalSection], Len(1, 20), m.Meaning("objectives"), m.Form("1 to 20 tables by name")
    ]
    constraints: Annotated[
        dict[Word, BoundSection], Len(0, 100), m.Meaning("constraints"), m.Form("tables by name"), m.Without("none")
    ] = Field(default_factory=dict)
    evaluation: Annotated[
        dict[Word, Any],
        m.Meaning("settings of the computation"),
        m.Form("the keys named by the quantities below"),
        m.Without("their defaults"),
    ] = Field(default_factory=dict)
