"""Schema of the sections of every device file; each kind of device adds its own sections."""

from __future__ import annotations

import types
import typing
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sized
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Annotated, Any, Literal

import annotated_types as at
import numpy as np
from annotated_types import Ge, Gt, Len
from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic.fields import FieldInfo

from haptorb.devices import quantity as q
from haptorb.devices.base import (
    CONTACT_RATE,
    HANDOVER_TIME_S,
    ROOM_TEMPERATURE_K,
    Coils,
    Device,
    Heat,
    HeatCoupling,
    Limits,
    Supply,
)
from haptorb.devices.field_sensors import SensorErrors
from haptorb.devices.quantity import QuantityKind
from haptorb.devices.unit_conversion import convert, usual_units
from haptorb.errors import quote

__all__ = [
    "RIGHT_ANGLE",
    "BasedOn",
    "CommonFile",
    "Count",
    "CouplingSection",
    "DeviceSchema",
    "Drop",
    "FieldSensorsSection",
    "Form",
    "HeatSection",
    "KeyText",
    "LimitsSection",
    "Meaning",
    "Name",
    "Point",
    "Positive",
    "Section",
    "SensorQualitySection",
    "SupplySection",
    "Text",
    "ThermalSection",
    "ThermometerSection",
    "Unit",
    "Without",
    "bound_text",
    "check_wall",
    "explain_mistakes",
    "find_key",
    "find_table",
    "limit_currents",
    "list_keys",
    "list_limit_mistakes",
    "list_limit_remarks",
    "meaning_of",
    "unwrap",
]


# --------------------------------------------------------------------------------------------------
# Annotations of each key of a file, for the reference and for messages: meaning, unit, range and default.
#
# A key's annotation carries these marks next to its type and bounds; pydantic passes over them.
#
#     radius: Annotated[q.Length, Positive, Meaning("outer radius of the dome")]


@dataclass(frozen=True)
class Meaning:
    """Mark of a key that states its meaning, for the reference and for messages.

    Parameters
    ----------
    text : str
        The meaning, in a few words without a full stop.
    """

    text: str


@dataclass(frozen=True)
class Form:
    """Permitted values in words, where type and bounds are not readable enough."""

    text: str


@dataclass(frozen=True)
class Unit:
    """Unit of a plain number, which the file fixes: "deg", "s"."""

    name: str


@dataclass(frozen=True)
class Without:
    """Effect of omitting the key, instead of a default value."""

    text: str


def unwrap(annotation: Any, metadata: typing.Iterable[Any] = ()) -> tuple[Any, list[Any]]:
    """The bare type of `annotation`, without None, and all marks on it, those of `metadata` first."""
    marks = list(_flatten(metadata))
    while True:
        origin = typing.get_origin(annotation)
        if origin is Annotated:
            marks += _flatten(annotation.__metadata__)
            annotation = annotation.__origin__
        elif origin in (typing.Union, types.UnionType):
            inner = [part for part in typing.get_args(annotation) if part is not type(None)]
            if len(inner) > 1:
                return annotation, marks
            annotation = inner[0]
        else:
            return annotation, marks


def _flatten(metadata: typing.Iterable[Any]) -> Iterator[Any]:
    for mark in metadata:
        if isinstance(mark, FieldInfo):
            yield from _flatten(mark.metadata)
        else:
            yield mark


def find_table(annotation: Any) -> type[BaseModel] | None:
    """The table that a key of this type holds, or each element of its list or table; None for a plain value."""
    bare, _ = unwrap(annotation)
    if isinstance(bare, type) and issubclass(bare, BaseModel):
        return bare
    parts = [part for part in typing.get_args(bare) if part is not Ellipsis]
    return find_table(parts[-1]) if typing.get_origin(bare) in (tuple, dict) and parts else None


def find_key(model: type[BaseModel], path: typing.Iterable[int | str]) -> tuple[Any, list[Any]] | None:
    """Type and marks of the value at `path`, as pydantic's errors have it; None where the path leaves the model."""
    bare: Any = model
    marks: list[Any] = []
    for part in path:
        if isinstance(bare, type) and issubclass(bare, BaseModel):
            field = bare.model_fields.get(str(part))
            if field is None:
                return None
            bare, marks = unwrap(field.annotation, field.metadata)
            continue
        inner = [one for one in typing.get_args(bare) if one is not Ellipsis]
        if typing.get_origin(bare) not in (tuple, dict) or not inner:
            return None
        number = part if isinstance(part, int) and part < len(inner) else -1
        bare, marks = unwrap(inner[number])
    return bare, marks


Positive = Gt(0)  #: mark of a key whose value must be greater than zero
RIGHT_ANGLE = q.si("90 deg", "rad", "an angle")  #: rounded as every value is, so that "90 deg" is not beyond it [rad]
Name = Annotated[
    str,
    Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=64),
    Form("a lower-case letter, then at most 63 of them, digits and hyphens"),
]  #: it becomes part of files' names
Count = Annotated[int, Field(ge=1, le=1000, strict=True)]  #: whole number from 1 to 1000
Text = Annotated[
    str, Field(pattern=r"^[^\x00-\x1f\x7f-\x9f]*$", max_length=400), Form("one line, at most 400 characters")
]  #: one line of text, at most 400 characters
Point = Annotated[tuple[q.Length, ...], Len(3, 3)]  #: three lengths [m]
BasedOn = Annotated[
    str | None,
    Meaning("base device, whose values are used for missing keys"),
    Form("name in the catalogue, or path of a device file"),
    Without("none"),
]
Drop = Annotated[
    tuple[str, ...],
    Meaning("keys of the base device that do not hold for this one: as if its file did not have them"),
    Form('dotted keys, such as "electromagnet.moment_per_current"'),
    Without("none"),
]


def check_wall(inner_radius: float, outer_radius: float) -> None:
    """ValueError unless a ring of these radii [m] has a wall."""
    if inner_radius >= outer_radius:
        raise ValueError(
            f"inner_radius ({inner_radius * 1e3:g} mm) must be smaller than outer_radius ({outer_radius * 1e3:g} mm)"
        )


class Section(BaseModel):
    """Schema of one table of a device file (pydantic): unknown keys are refused, and values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _require(path: str, section: Section, keys: tuple[str, ...], *, computed: bool) -> None:
    """ValueError for the first of `keys` that `section` lacks, unless they are computed from the windings."""
    missing = [key for key in keys if getattr(section, key) is None]
    if missing and not computed:
        raise ValueError(f"{path}.{missing[0]} is missing: give it, or windings.wire to compute it from")


class HeatSection(Section):
    """[coils.heat]"""

    winding_capacity: Annotated[
        q.HeatCapacity | None,
        Positive,
        Meaning("heat capacity of one channel's winding"),
        Without("required, unless windings.wire or windings.fill gives the mass of the copper"),
    ] = None
    body_capacity: Annotated[
        q.HeatCapacity, Positive, Meaning("heat capacity of the parts around the winding: former, core, housing")
    ]
    winding_to_body: Annotated[q.Conductance, Positive, Meaning("heat conductance from winding to body")]
    body_to_air: Annotated[q.Conductance, Positive, Meaning("heat conductance from body to the air")]
    ambient: Annotated[q.Temperature, Positive, Meaning("temperature of the room"), Form("> 0 K, below warn")]
    warn: Annotated[
        q.Temperature,
        Positive,
        Meaning("winding temperature for the warning"),
        Form("between ambient and derate"),
    ]
    derate: Annotated[
        q.Temperature,
        Positive,
        Meaning("winding temperature from which the currents are reduced"),
        Form("between warn and stop"),
    ]
    stop: Annotated[
        q.Temperature,
        Positive,
        Meaning("winding temperature at which the coils are switched off"),
        Form("above derate"),
    ]

    @model_validator(mode="after")
    def _check_order(self) -> HeatSection:
        if not self.ambient < self.warn < self.derate < self.stop:
            raise ValueError("must have ambient < warn < derate < stop")
        return self

    def build(self, *, computed: bool = False) -> Heat:
        """Convert to the device's own form; values `computed` later are NaN. ValueError if one is missing."""
        _require("coils.heat", self, ("winding_capacity",), computed=computed)
        return Heat(**{**self.model_dump(), "winding_capacity": self.winding_capacity or np.nan})


class CoilsSection(Section):
    """[coils]"""

    names: Annotated[
        tuple[Annotated[Text, Len(1, 40)], ...],
        Len(1, 100),
        Meaning("name of each coil; their number is the number of channels"),
        Form("1 to 40 characters each, all different"),
    ]
    resistance: Annotated[
        tuple[Annotated[q.Resistance, Positive], ...] | None,
        Meaning("resistance of each coil at the reference temperature, one per name"),
        Without("required, unless windings.wire or windings.fill gives it"),
    ] = None
    inductance: Annotated[
        tuple[Annotated[q.Inductance, Positive], ...] | None,
        Meaning("inductance of each coil, one per name"),
        Without("required, unless windings.wire or windings.fill is given: then that of the windings"),
    ] = None
    current_limit: Annotated[
        tuple[Annotated[q.Current, Positive], ...] | None,
        Meaning("maximum commanded current in each coil, one per name"),
        Form("> 0, at most 1.25 times what the supply drives at 20 °C"),
        Without("what the supply drives at 20 °C"),
    ] = None
    temperature_coefficient: Annotated[
        q.InverseKelvin, Meaning("relative change of resistance per kelvin; copper: 3.93e-3 / K")
    ]
    reference_temperature: Annotated[
        q.Temperature, Positive, Meaning("reference temperature of the resistances"), Form("> 0 K")
    ]
    heat: Annotated[HeatSection, Meaning("thermal model of one channel, equal for all: winding, body, air")]

    @model_validator(mode="after")
    def _check_lengths(self) -> CoilsSection:
        for key in ("resistance", "inductance", "current_limit"):
            values = getattr(self, key)
            count = len(self.names) if values is None else len(values)
            if count != len(self.names):
                raise ValueError(f"has {len(self.names)} names but {count} values of {key}")
        if len(set(self.names)) != len(self.names):
            raise ValueError("has a duplicate name")
        return self

    def build(self, *, computed: bool = False) -> Coils:
        """Convert to the device's own form; values `computed` later are NaN. ValueError if one is missing."""
        _require("coils", self, ("resistance", "inductance"), computed=computed)
        unknown = (np.nan,) * len(self.names)
        return Coils(
            names=self.names,
            resistance=np.array(self.resistance or unknown),
            inductance=np.array(self.inductance or unknown),
            current_limit=np.array(self.current_limit or unknown),
            temperature_coefficient=self.temperature_coefficient,
            reference_temperature=self.reference_temperature,
            heat=self.heat.build(computed=computed),
        )


def limit_currents(coils: Coils, supply: Supply) -> Coils:
    """`coils` with a current limit where none is given (NaN): what the supply drives through the coil at 20 °C."""
    cold = coils.resistance_at(np.full(len(coils.names), ROOM_TEMPERATURE_K))
    given = coils.current_limit
    return replace(coils, current_limit=np.where(np.isnan(given), supply.voltage / cold, given))


class SupplySection(Section):
    """[supply]"""

    voltage: Annotated[q.Voltage, Positive, Meaning("voltage of the supply that drives the coils")]
    duty_bits: Annotated[
        int, Field(ge=1, le=24, strict=True), Meaning("resolution of the duty cycle's magnitude in bits")
    ]
    current_noise: Annotated[q.Current, Field(ge=0), Meaning("standard deviation of one current reading")]
    current_step: Annotated[q.Current, Field(ge=0), Meaning("resolution of a current reading")]
    power: Annotated[
        q.Power | None,
        Positive,
        Meaning("maximum power of the supply for all coils together, with windings at the stop temperature"),
        Without("no limit"),
    ] = None

    def build(self) -> Supply:
        """As the device has it."""
        values = self.model_dump()
        return Supply(**{**values, "power": np.inf if self.power is None else self.power})


class LimitsSection(Section):
    """[limits]"""

    force: Annotated[
        q.Force,
        Positive,
        Meaning("maximum force that the guard allows"),
        Form("> 0, at most 100 times what the coils of an electromagnet give"),
    ]
    torque: Annotated[
        q.Torque,
        Positive,
        Meaning("maximum torque that the guard allows"),
        Form("> 0, at most 100 times what the coils give"),
    ]
    slew: Annotated[q.Slew, Positive, Meaning("maximum slew rate of a channel's current")]
    expiry: Annotated[q.Duration, Positive, Meaning("maximum age of a pose at which force is allowed")]
    force_rate: Annotated[
        q.ForceRate | None,
        Positive,
        Meaning("maximum rate of a client's force, and of the force while another world takes over"),
        Without("150 N/s, a contact of 500 N/m at 0.3 m/s; more where `force` / 20 ms is more"),
    ] = None
    torque_rate: Annotated[
        q.TorqueRate | None,
        Positive,
        Meaning("maximum rate of the torque that a client's force causes, and while another world takes over"),
        Without("`torque` / 20 ms, the time in which the force of a lost client fades"),
    ] = None

    def build(self) -> Limits:
        """As the device has it."""
        values = self.model_dump()
        force_rate = self.force_rate or max(CONTACT_RATE, self.force / HANDOVER_TIME_S)
        return Limits(
            **{**values, "force_rate": force_rate, "torque_rate": self.torque_rate or self.torque / HANDOVER_TIME_S}
        )


class ThermometerSection(Section):
    """[thermometer]"""

    step: Annotated[q.TemperatureStep, Field(ge=0), Meaning("resolution of a coil thermometer")]
    noise: Annotated[q.TemperatureStep, Field(ge=0), Meaning("standard deviation of one reading")]


class DeviceSchema(Section, ABC):
    """Schema of a device file, whatever its sections."""

    @abstractmethod
    def build(self, assumed: dict[str, str], digest: str, *, override: bool = False) -> Device:
        """Build the device that this file describes; ValueError or DeviceError with all that contradicts itself.

        assumed: key → reason, of values that the source does not give. digest: SHA-256 of the whole text. override:
        build it, for study, even if its parts overlap or its wiring cannot work.
        """

    def list_idle(self) -> Iterator[tuple[str, str]]:
        """Yield keys that change nothing beside what else the file says, and why."""
        return iter(())


class CommonFile(DeviceSchema):
    """Schema of the sections of every device file; base class of the schema of a kind of device (pydantic).

    A subclass adds a section for each table of its file, and `build`, which returns the device and reports all mistakes
    at once.
    """

    name: Annotated[Name, Meaning("short name of the device; recordings and calibrations refer to it")]
    title: Annotated[Text, Meaning("title of the device")]
    source: Annotated[Text, Meaning("source of the values")]
    coils: Annotated[CoilsSection, Meaning("electrical data of the coils")]
    supply: Annotated[SupplySection, Meaning("supply of the coils")]
    limits: Annotated[LimitsSection, Meaning("limits that the guard enforces")]

    def common(self, *, computed: bool = False) -> dict[str, Any]:
        """The parts that every Device takes; `computed` as for `CoilsSection.build`."""
        return {
            "name": self.name,
            "title": self.title,
            "source": self.source,
            "coils": self.coils.build(computed=computed),
            "supply": self.supply.build(),
            "limits": self.limits.build(),
        }


# --------------------------------------------------------------------------------------------------
# Keys of a file as the reference lists them: value, unit, range and default in words, from type, bounds and marks.


@dataclass(frozen=True)
class KeyText:
    """One row of the reference; an empty text where nothing is known, which a test refuses."""

    path: str  #: coils.heat.ambient
    meaning: str
    value: str  #: length, list of 3 lengths, text, table
    unit: str  #: usual ones, "1" for a plain number, "none" for what has no unit
    range: str
    default: str  #: "required", the value, or what holds without the key


def list_keys(model: type[BaseModel], prefix: str = "") -> Iterator[KeyText]:
    """Every key of `model` and of the tables in it, in the order of the file; tables before their keys."""
    for name, field in model.model_fields.items():
        yield _describe_key(prefix + name, field)
        inner = find_table(field.annotation)
        if inner is not None:
            yield from list_keys(inner, f"{prefix}{name}.")


def meaning_of(marks: list[Any]) -> str:
    """The meaning of a key with these marks; empty where none is given."""
    return next((mark.text for mark in marks if isinstance(mark, Meaning)), "")


def bound_text(bound: float, marks: list[Any]) -> str:
    """`bound` of a value with these marks, in the first of its usual units.

    >>> from haptorb.devices import quantity as q
    >>> bound_text(0.5, unwrap(q.Length)[1]), bound_text(0, unwrap(q.Length)[1])
    ('500 mm', '0')
    """
    quantity = next((mark for mark in marks if isinstance(mark, QuantityKind)), None)
    if bound == 0 or quantity is None or quantity.unit == "":
        return f"{bound:.15g}"
    unit = usual_units(quantity.unit)[0]
    converted = convert(float(bound), quantity.unit, unit)
    return f"{bound:g} {quantity.unit}" if converted is None else f"{converted:.12g} {unit}"


def _describe_key(path: str, field: FieldInfo) -> KeyText:
    bare, marks = unwrap(field.annotation, field.metadata)
    value, unit, span = _describe_value(bare, marks)
    return KeyText(path, meaning_of(marks), value, unit, span, _describe_default(field, marks))


def _describe_default(field: FieldInfo, marks: list[Any]) -> str:
    without = next((mark.text for mark in marks if isinstance(mark, Without)), None)
    if without is not None:
        return without
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    if isinstance(default, bool | int | float):
        return str(default).lower() if isinstance(default, bool) else f"{default:g}"
    return f'"{default}"' if isinstance(default, str) else ""


def _describe_value(bare: Any, marks: list[Any]) -> tuple[str, str, str]:
    """Kind of value, unit and range."""
    form = next((mark.text for mark in marks if isinstance(mark, Form)), None)
    quantity = next((mark for mark in marks if isinstance(mark, QuantityKind)), None)
    unit = next((mark.name for mark in marks if isinstance(mark, Unit)), "1")
    if quantity is not None:
        usual = ", ".join(usual_units(quantity.unit)[:3]) or "1"
        return quantity.kind.removeprefix("an ").removeprefix("a ").removeprefix("plain "), usual, form or _span(marks)
    origin = typing.get_origin(bare)
    if find_table(bare) is not None:
        return (
            "list of tables" if origin is tuple else "table",
            "none",
            form or _key_text_length(marks) or "the keys below",
        )
    if origin is tuple:
        return _describe_list(bare, marks, form)
    if origin is Literal:
        return "text", "none", ", ".join(f'"{one}"' for one in typing.get_args(bare))
    if origin is dict:
        return "table", "none", form or ""
    plain = {bool: ("true or false", "none", "true, false"), str: ("text", "none", form or "")}
    if bare in plain:
        return plain[bare]
    if bare in (int, float):
        return "whole number" if bare is int else "number", unit, form or _span(marks)
    return "value", unit if any(isinstance(mark, Unit) for mark in marks) else "none", form or ""


def _describe_list(bare: Any, marks: list[Any], form: str | None) -> tuple[str, str, str]:
    parts = [part for part in typing.get_args(bare) if part is not Ellipsis]
    value, unit, span = _describe_value(*unwrap(parts[0]))
    unit = next((mark.name for mark in marks if isinstance(mark, Unit)), unit)
    count = f"{len(parts)} " if Ellipsis not in typing.get_args(bare) else f"{_key_text_length(marks)} ".lstrip()
    return f"list of {count}{_plural(value)}", unit, form or span


def _plural(value: str) -> str:
    """Of the first noun: lists of 3 lengths, moments of inertia, flux densities."""
    for link in (" of ", " per ", " or "):
        head, found, tail = value.partition(link)
        if found:
            return f"{_plural(head)}{found}{tail}"
    return f"{value[:-1]}ies" if value.endswith("ty") else f"{value}s"


def _key_text_length(marks: list[Any]) -> str:
    """How many elements: "3", "1 to 100"; empty where that is free."""
    low, high = 0, None
    for mark in marks:
        if isinstance(mark, at.Len | at.MinLen):
            low = mark.min_length
        if isinstance(mark, at.Len | at.MaxLen):
            high = mark.max_length
    if high is None:
        return f"at least {low}" if low else ""
    return f"{low}" if low == high else f"{low} to {high}"


def _span(marks: list[Any]) -> str:
    signs = ((at.Gt, "gt", ">"), (at.Ge, "ge", "≥"), (at.Lt, "lt", "<"), (at.Le, "le", "≤"))
    bounds = [
        f"{sign} {bound_text(getattr(mark, name), marks)}"
        for kind, name, sign in signs
        for mark in marks
        if isinstance(mark, kind)
    ]
    return ", ".join(bounds) or "any"


# --------------------------------------------------------------------------------------------------
# pydantic's errors as sentences: location, expected value in the file's own units, and actual value.


_BOUNDS = {
    "greater_than": ("gt", "greater than"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "at most"),
}
_KINDS = {
    "string_type": "text in quotes",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
}


def explain_mistakes(errors: Iterable[Any], model: type[BaseModel], most: int = 40) -> list[str]:
    """One sentence per error of `model`, each beginning with the key; elements of lists count from 1.

    After `most` of them the rest is counted. Left out: that a list is too short where only its elements are wrong,
    which pydantic says as well.
    """
    sentences = list(dict.fromkeys(_explain(error, model) for error in errors if not _is_echo(error)))
    if len(sentences) > most:
        sentences[most:] = [f"and {len(sentences) - most} more mistakes"]
    return sentences


def _is_echo(error: Any) -> bool:
    """Whether the list that "has 0 items" has enough of them in the file."""
    got, least = error.get("input"), error.get("ctx", {}).get("min_length")
    return error["type"] == "too_short" and isinstance(got, list | tuple | dict) and len(got) >= least


def _explain(error: Any, model: type[BaseModel]) -> str:
    path = [part for part in error["loc"] if part != "[key]"]
    where = ".".join(quote(part)[1:-1] if isinstance(part, str) else str(part + 1) for part in path)
    what = _explain_value(error, model, path)
    return f"{where} {what}" if where else what


def _explain_value(error: Any, model: type[BaseModel], path: list[Any]) -> str:
    kind, got, context = error["type"], error.get("input"), error.get("ctx", {})
    found = find_key(model, path)
    marks = [] if found is None else found[1]
    if kind == "extra_forbidden":
        known = _list_keys(model, path[:-1])
        near = get_close_matches(str(path[-1])[:60], known, n=1, cutoff=0.5)
        return "is not a known key" + (f"; did you mean '{near[0]}'?" if near else "")
    if kind == "missing":
        meaning = meaning_of(marks)
        return f"is missing: {meaning}" if meaning else "is missing"
    if kind == "value_error":
        return str(context["error"])
    if kind in ("too_short", "too_long"):
        return _mistakes_length(kind, got, context)
    if kind in _BOUNDS:
        name, words = _BOUNDS[kind]
        return f"must be {words} {bound_text(float(context[name]), marks)}; got {quote(got)}"
    form = next((mark.text for mark in marks if isinstance(mark, Form)), None)
    if kind.startswith("string_") and kind != "string_type" and form:
        return f"must be {form}; got {quote(got)}"
    if kind == "literal_error":
        near = get_close_matches(str(got)[:60], [part.strip(" '") for part in _alternatives(context)], n=1, cutoff=0.5)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        return f"must be {context['expected']}; got {quote(got)}{hint}"
    if kind in _KINDS:
        return f"must be {_KINDS[kind]}; got {quote(got)}"
    return f"{error['msg'].replace('Input should', 'must')}; got {quote(got)}"


def _mistakes_length(kind: str, got: Any, context: Mapping[str, Any]) -> str:
    """How many elements a list, or names a table, must have; never pydantic's count, which leaves out wrong ones."""
    word, bound = ("at least", "min_length") if kind == "too_short" else ("at most", "max_length")
    count = context[bound]
    things = "entry" if count == 1 else "entries"
    many = len(got) if isinstance(got, Sized) else 0
    return f"must have {word} {count} {things}; got {many or 'none'}"


def _alternatives(context: Mapping[str, Any]) -> list[str]:
    return str(context["expected"]).replace(" or ", ",").split(",")


def _list_keys(model: type[BaseModel], path: list[Any]) -> list[str]:
    found = find_key(model, path)
    inner = None if found is None else find_table(found[0])
    return [] if inner is None else list(inner.model_fields)


# --------------------------------------------------------------------------------------------------
# Limits of a device file against what supply, coils and windings can do: far above it they protect from nothing.
#
# Refused: a force or torque more than a hundred times what is possible, which is a wrong unit (N for mN), a current ten
# times what the supply drives, and one at which a winding passes its stop temperature before the coils of a stopped
# computer are off. Remarked: a force or torque ten times what is possible; a design may be there while it is made. A
# current that the supply cannot drive at 20 °C is one of the device's `build_checks`.


_WRONG_UNIT = 100.0
_NO_LIMIT = 10.0
_UNREACHABLE = 10.0  #: the supply's voltage over a resistance is no estimate
_COILS_OFF_TIME_S = 0.1  #: after which a board's watchdog has switched off at the latest when the computer stops [s]


def list_limit_mistakes(coils: Coils, supply: Supply, limits: Limits, force: float, torque: float) -> list[str]:
    """Rejected limits, as sentences. force, torque: the greatest that the coils give at full current [N, N·m]; 0 where
    they give none that a limit could hold."""
    found = []
    for key, unit, limit, most in _wrenches(limits, force, torque):
        if limit > _WRONG_UNIT * most:
            found.append(
                f"limits.{key} is {limit:g} {unit}, {limit / most:.0f} times what the coils give at full current "
                f"({most:.2g} {unit}): it would limit nothing; check its unit"
            )
    driven = supply.voltage / coils.resistance
    most = _greatest_power(coils, supply)
    if _WRONG_UNIT * supply.power < most:
        found.append(
            f"supply.power is {supply.power:g} W, but one coil at its current limit takes {most:.3g} W; check its unit"
        )
    heat = coils.heat
    alike: dict[str, list[str]] = {}
    for name, current, most, ohms in zip(coils.names, coils.current_limit, driven, coils.resistance, strict=True):
        if current > _UNREACHABLE * most:
            text = (
                f"is {current:g} A, but {supply.voltage:g} V drive at most "
                f"{most:.3g} A through its {ohms:g} Ω; check its unit"
            )
            alike.setdefault(text, []).append(name)
            continue
        power = min(current, most) ** 2 * ohms
        time = heat.winding_capacity * (heat.stop - heat.ambient) / power
        if time < _COILS_OFF_TIME_S:
            text = (
                f"lets {min(current, most):.3g} A ({power:.3g} W) heat the winding with its {heat.winding_capacity:g} "
                f"J/K past the stop temperature in {1e3 * time:.2g} ms, before the coils of a stopped computer are "
                f"off ({1e3 * _COILS_OFF_TIME_S:.0f} ms): reduce it, or correct coils.heat.winding_capacity"
            )
            alike.setdefault(text, []).append(name)
    return [*found, *(f"coils.current_limit of coil {', '.join(names)} {text}" for text, names in alike.items())]


def list_limit_remarks(coils: Coils, supply: Supply, limits: Limits, force: float, torque: float) -> list[str]:
    """Remarks on limits, as sentences; arguments as of `list_limit_mistakes`."""
    found = [
        f"limits.{key} is {limit:g} {unit}, {limit / most:.0f} times what the coils give at full current "
        f"({most:.2g} {unit}): it limits nothing"
        for key, unit, limit, most in _wrenches(limits, force, torque)
        if limit > _NO_LIMIT * most
    ]
    most = _greatest_power(coils, supply)
    if supply.power < most:
        found.append(
            f"supply.power is {supply.power:g} W, but one coil at its current limit takes {most:.3g} W: the limit is "
            "never reached, and the supply limits the peak forces"
        )
    return found


def _greatest_power(coils: Coils, supply: Supply) -> float:
    """Maximum power of any single coil, cold [W]."""
    current = np.minimum(coils.current_limit, supply.voltage / coils.resistance)
    return float((current**2 * coils.resistance).max())


def _wrenches(limits: Limits, force: float, torque: float) -> list[tuple[str, str, float, float]]:
    pairs = [("force", "N", limits.force, force), ("torque", "N·m", limits.torque, torque)]
    return [pair for pair in pairs if pair[3] > 0.0]


# --------------------------------------------------------------------------------------------------
# Keys that every table of field sensors has: how finely they read, and how they differ from ideal ones.


class SensorQualitySection(Section):
    """What [hall] and [sensors] have in common; a device file without an error's key has sensors without that error."""

    noise: Annotated[q.Polarization, Ge(0), Meaning("standard deviation of one reading, each axis")]
    step: Annotated[q.Polarization, Ge(0), Meaning("resolution of a reading")]
    range: Annotated[
        q.Polarization | None,
        Gt(0),
        Meaning("greatest field that an axis can read, either way"),
        Without("that of a converter of 16 bits with `step`; it is not checked against the fields that occur"),
    ] = None
    gain: Annotated[q.Number, Ge(0), Meaning("standard deviation of the relative gain error from sensor to sensor")] = (
        0.0
    )
    offset: Annotated[q.Polarization, Ge(0), Meaning("standard deviation of the offset from sensor to sensor")] = 0.0
    cross: Annotated[q.Number, Ge(0), Meaning("standard deviation of the cross-axis sensitivity")] = 0.0
    gain_drift: Annotated[
        q.InverseKelvin, Ge(0), Meaning("standard deviation of the relative change of gain per kelvin")
    ] = 0.0
    offset_drift: Annotated[q.FieldDrift, Ge(0), Meaning("standard deviation of the change of offset per kelvin")] = 0.0
    placement: Annotated[q.Length, Ge(0), Meaning("standard deviation of a sensor's position, each coordinate")] = 0.0
    angle: Annotated[q.Angle, Ge(0), Meaning("standard deviation of a sensor's rotation about each axis")] = 0.0
    warming: Annotated[
        q.Number, Ge(0), Meaning("temperature rise of the sensors as a share of the coils' rise at their boundary")
    ] = 0.0

    def errors(self) -> SensorErrors:
        """As the device has them."""
        return SensorErrors(
            self.gain, self.offset, self.cross, self.gain_drift, self.offset_drift, self.placement, self.angle
        )


class FieldSensorsSection(SensorQualitySection):
    """[hall]"""

    positions: Annotated[
        tuple[Point, ...],
        Len(0, 100),
        Meaning("position of each three-axis field sensor, stator frame, in the order of their numbers"),
        Form("0 to 100 positions x, y, z outside the core"),
    ]


# --------------------------------------------------------------------------------------------------
# Thermal data of all coils together in a device file: thermal coupling, and its uncertainty.


_FASTEST = 40.0  #: rate of a coupling that the guard's thermal model can follow [1/s]


class CouplingSection(Section):
    """[thermal.coupling]"""

    core_capacity: Annotated[
        q.HeatCapacity, Positive, Meaning("heat capacity of the core or former that lies between the windings")
    ]
    winding_to_core: Annotated[
        tuple[Annotated[q.Conductance, Positive], ...],
        Meaning("heat conductance from each winding to the core, one per coil"),
    ]


class ThermalSection(Section):
    """[thermal]"""

    tolerance: Annotated[
        q.Number,
        Field(ge=0, le=0.5),
        Meaning(
            "relative tolerance of capacities and conductances of the thermal model; the guard assumes the worst case"
        ),
    ] = 0.0
    coupling: Annotated[
        CouplingSection | None,
        Meaning("thermal coupling between the coils"),
        Without("none: no thermal coupling"),
    ] = None

    def complete(self, heat: Heat, channels: int) -> Heat:
        """`heat` of so many channels with what this table says; ValueError if it does not fit them."""
        if self.coupling is None:
            return replace(heat, tolerance=self.tolerance)
        count = len(self.coupling.winding_to_core)
        if count != channels:
            raise ValueError(f"thermal.coupling.winding_to_core has {count} values for {channels} coils; give one each")
        coupling = HeatCoupling(self.coupling.core_capacity, self.coupling.winding_to_core)
        rates = {
            "core_capacity": sum(coupling.winding_to_core) / coupling.core_capacity,
            "winding_to_core": max(coupling.winding_to_core) / heat.winding_capacity,
        }
        for key, rate in rates.items():
            if rate > _FASTEST:
                raise ValueError(
                    f"thermal.coupling.{key} gives a time constant of {1e3 / rate:.3g} ms; the guard's thermal model "
                    f"needs at least {1e3 / _FASTEST:.3g} ms: check its unit"
                )
        return replace(heat, tolerance=self.tolerance, coupling=coupling)
