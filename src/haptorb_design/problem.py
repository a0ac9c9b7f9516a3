"""A design as data: a base device, free parameters, objectives and constraints."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, Literal, TypeVar, final

from haptorb.devices.base import Device, DeviceText
from haptorb.devices.based_on import lay_over_base
from haptorb.devices.loader import DeviceTables, build_tables, read_tables
from haptorb.devices.registry import find_file
from haptorb.devices.schema import find_key
from haptorb.errors import InputError, UnknownName, quote

__all__ = [
    "BUILD",
    "WHOLE",
    "Bound",
    "Design",
    "DesignCandidate",
    "DesignGoal",
    "DesignParameter",
    "DesignQuantity",
    "Evaluation",
    "ParameterPlace",
    "Sense",
    "Value",
    "build_device",
    "change_tables",
    "check_key",
    "is_own_code",
    "list_entries",
    "split_key",
    "write_device_text",
    "write_key",
]


# --------------------------------------------------------------------------------------------------
# Free parameter of a design: one number or choice, and the keys of the device file that it is written to.


WHOLE = "*"  #: key of a place whose choices are tables that replace values all over the device file


@dataclass(frozen=True)
class ParameterPlace:
    """Key of a device file to which the parameter's value is written, as factor × value + offset.

    key  dotted; lists are counted from 1, as messages about device files do: "electromagnets.rings.2.latitude"
    """

    key: str
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class DesignParameter:
    """One free parameter: a range (`low` to `high`, in `unit`, perhaps in steps), or `choices` by label.

    A choice may be anything that the key takes: a number, a text, or a whole list of tables. At the place `WHOLE` it is
    a table of tables, so that one choice writes several keys.
    """

    name: str
    places: tuple[ParameterPlace, ...]
    unit: str = ""
    low: float = 0.0
    high: float = 0.0
    step: float = 0.0  #: 0: continuous
    choices: tuple[tuple[str, Any], ...] = ()  #: (label, what is written)

    @property
    def labels(self) -> tuple[str, ...]:
        """The choices' labels; none for a range."""
        return tuple(label for label, _ in self.choices)

    def choice(self, label: str) -> Any:
        """What is written for `label`; InputError for another."""
        for one, value in self.choices:
            if one == label:
                return value
        raise InputError(f"parameter '{self.name}': '{label}' is not one of its choices: {', '.join(self.labels)}")

    def list_keys(self) -> dict[str, None]:
        """Every key that the parameter may write, in order."""
        found: dict[str, None] = {}
        for place in self.places:
            choices = [value for _, value in self.choices] if place.key == WHOLE else []
            found |= dict.fromkeys(key for value in choices for key, _ in list_entries(value))
            found |= {} if place.key == WHOLE else {place.key: None}
        return found


def list_entries(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted key and value of everything in `table`; a table with a "value" is a value.

    >>> list(list_entries({"coils": {"names": ["a"]}, "supply": {"voltage": {"value": "12 V"}}}))
    [('coils.names', ['a']), ('supply.voltage', {'value': '12 V'})]
    """
    for name, inner in table.items():
        if isinstance(inner, Mapping) and "value" not in inner:
            yield from list_entries(inner, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", inner


# --------------------------------------------------------------------------------------------------
# Candidate of a design: its device, and intermediate results shared by several objectives.


T = TypeVar("T")


@final
class DesignCandidate:
    """Device under evaluation, with cached intermediate results; passed to objectives of the user's own.

    Parameters
    ----------
    device : Device
        Device under evaluation.
    base : Device
        Device of the design file, with which envelope, copper and magnet volume are compared.
    options : Mapping
        Table `[evaluation]` of the design file, such as {"orientations": 400}.
    """

    def __init__(self, device: Device, base: Device, options: Mapping[str, Any]) -> None:
        self.device = device
        self.base = base
        self.options = dict(options)
        self._shared: dict[str, Any] = {}

    def share(self, name: str, compute: Callable[[], T]) -> T:
        """Compute once what several objectives use.

        Parameters
        ----------
        name : str
            Name of the result, the same for all of these objectives.
        compute : callable
            () → the result; called for the first of them only.

        Returns
        -------
        object
            The result.
        """
        if name not in self._shared:
            self._shared[name] = compute()
        found: T = self._shared[name]
        return found


# --------------------------------------------------------------------------------------------------
# Scalar quantity of a candidate: to be minimised or maximised, or bounded by a constraint.


Sense = Literal["minimise", "maximise"]


@dataclass(frozen=True)
class DesignQuantity:
    """A number of a candidate, in SI.

    name      as design files call it
    unit      in which it is shown and stored, such as "W/(N·m)²"; SI without prefix; "" for a plain number
    sense     sense of the optimisation, unless the design file states another
    text      one sentence: meaning, and the domain of the worst case or mean
    kinds     names of the kinds of device that have it
    compute   (DesignCandidate) → number; InputError where this device has no such number
    """

    name: str
    unit: str
    sense: Sense
    text: str
    kinds: tuple[str, ...]
    compute: Callable[[DesignCandidate], float]


@dataclass(frozen=True)
class DesignGoal:
    """An objective of a design, and its sense; `name` is that of the design file."""

    quantity: DesignQuantity
    sense: Sense
    name: str = ""

    def __post_init__(self) -> None:
        if not self.name:
            object.__setattr__(self, "name", self.quantity.name)


def is_own_code(quantity: DesignQuantity) -> bool:
    """Whether `quantity` is computed by a function of the user's own."""
    module = getattr(quantity.compute, "__module__", None) or type(quantity.compute).__module__
    return module.partition(".")[0] not in ("haptorb", "haptorb_design", "functools")


@dataclass(frozen=True)
class Bound:
    """A constraint of a design: `low` ≤ quantity ≤ `high`, SI; None where there is no bound."""

    name: str
    quantity: DesignQuantity
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Design:
    """Search problem of a design file: base device, parameters, objectives and constraints.

    `load_design` and `parse_design` make one.

    Parameters
    ----------
    name : str
        Name of the design.
    title : str
        Title in reports.
    base : str
        Name in the catalogue, or path, of the base device.
    parameters : tuple of DesignParameter
        Free parameters with their ranges or choices.
    goals : tuple of DesignGoal
        Objectives to minimise or maximise.
    bounds : tuple of Bound
        Constraints.
    options : Mapping
        Table `[evaluation]` of the file.
    text : str
        Text of the file.
    digest : str
        Digest of the file, of the user's own objectives with what they import from their folder, and of the base
        device; results belong to one digest.
    tables : DeviceTables, optional
        Tables of the base device's file; None: read when needed.
    base_values : Mapping, optional
        The base device's own numbers, as stored in results; None: not computed yet.
    """

    name: str
    title: str
    base: str
    parameters: tuple[DesignParameter, ...]
    goals: tuple[DesignGoal, ...]
    bounds: tuple[Bound, ...]
    options: Mapping[str, Any]
    text: str
    digest: str
    tables: DeviceTables | None = field(default=None, repr=False)
    base_values: Mapping[str, float] | None = field(default=None, repr=False)

    @property
    def base_tables(self) -> DeviceTables:
        """Tables of the base device's file."""
        return read_tables(self.base) if self.tables is None else self.tables

    @property
    def has_own_code(self) -> bool:
        """Whether an objective or constraint is a function of the user's own, which may end its process."""
        quantities = [goal.quantity for goal in self.goals] + [bound.quantity for bound in self.bounds]
        return any(is_own_code(one) for one in quantities)

    def parameter(self, name: str) -> DesignParameter:
        """Find a parameter by its name.

        Parameters
        ----------
        name : str
            Name of the parameter.

        Returns
        -------
        DesignParameter
            The parameter.

        Raises
        ------
        UnknownName
            If there is none; the message names the most similar one.
        """
        for one in self.parameters:
            if one.name == name:
                return one
        raise UnknownName(f"parameter of design '{self.name}'", name, [one.name for one in self.parameters])


# --------------------------------------------------------------------------------------------------
# Evaluation of one candidate: its numbers, or the reason of its rejection.


Value = float | str  #: of a parameter, in the parameter's own unit; a choice by its label


#: `refused_by` is "build: " and a condition for a device that cannot be built; in `constraints`, by how much in all its
#: parts miss their limits, relative
BUILD = "build"


@dataclass(frozen=True)
class Evaluation:
    """Result of one candidate: one row of a results file.

    Parameters
    ----------
    number : int
        Place in the run, from 0; the same seed gives the same values for the same number.
    values : Mapping
        Parameter → value.
    objectives : Mapping
        Objective → number in its unit; empty if the candidate was rejected.
    constraints : Mapping
        Constraint → number in its unit, as far as they were computed.
    refused_by : str
        Constraint that rejected the candidate, "build: " and the condition that a device which cannot be built misses
        most, "device" if the values make no device, "objective" if one gave no finite number; empty if it is valid.
    reason : str
        Reason of the rejection, in one line; empty if it is valid.
    seconds : float
        Processor time [s].
    """

    number: int
    values: Mapping[str, Value]
    objectives: Mapping[str, float]
    constraints: Mapping[str, float]
    refused_by: str = ""
    reason: str = ""
    seconds: float = 0.0

    @property
    def valid(self) -> bool:
        """Whether the design satisfies every constraint."""
        return not self.refused_by


# --------------------------------------------------------------------------------------------------
# Dotted keys of a device file: look-up, validation and writing.


_FIXED = frozenset({"kind", "name", "title", "source", "based_on"})  #: keys that identify the device


def split_key(key: str) -> list[str | int]:
    """Split a dotted key; numbers are indices of list entries from 1.

    >>> split_key("electromagnets.rings.2.latitude")
    ['electromagnets', 'rings', 2, 'latitude']
    """
    return [int(part) if part.isascii() and part.isdigit() else part for part in key.split(".")]


def check_key(tables: DeviceTables, key: str) -> None:
    """InputError, with the nearest key, unless the device of `tables` has `key`, or could have it."""
    path = split_key(key)
    if path[0] in _FIXED:
        raise InputError(f"'{key}' identifies the device; a parameter must change its construction")
    node: Any = tables.values
    for depth, part in enumerate(path):
        node = _strip(node)
        if isinstance(part, int) and isinstance(node, list):
            if not 1 <= part <= len(node):
                where = ".".join(map(str, path[:depth]))
                raise InputError(f"'{key}': {where} of device '{tables.name}' has {len(node)} entries, from 1")
            node = node[part - 1]
        elif isinstance(node, Mapping) and part in node:
            node = node[str(part)]
        else:
            _check_schema(tables, key, path)
            return


def write_key(values: dict[str, Any], path: list[str | int], value: Any, reason: str) -> list[str | int]:
    """Write `value` at `path` of the tables `values`, which must not be shared, with `reason` as its provenance.

    Returns the path of the outermost entry that a file laid over the old tables must name: lists are replaced whole.
    """
    node: Any = values
    outermost: list[str | int] | None = None
    for depth, part in enumerate(path[:-1]):
        if isinstance(node, dict) and "value" in node:  # with a unit for all its elements, and a reason that ends here
            node.pop("source", None)
            node["assumed"] = reason
            outermost = outermost or path[:depth]
            node = node["value"]
        if isinstance(node, list):
            outermost = outermost or path[:depth]
            node = node[int(part) - 1]
        else:
            node = node.setdefault(part, {})
    last = path[-1]
    if isinstance(node, dict) and "value" in node:
        node.pop("source", None)
        node["assumed"] = reason
        outermost = outermost or path[:-1]
        node = node["value"]
    if isinstance(node, list):
        node[int(last) - 1] = value
        return outermost or path[:-1]
    plain = isinstance(value, dict) or (isinstance(value, list) and any(isinstance(one, dict) for one in value))
    if isinstance(value, dict) and isinstance(node.get(last), dict) and "value" not in node[last]:
        node[last] = {**node[last], **value}
    else:
        node[last] = value if plain else {"value": value, "assumed": reason}
    return outermost or path


def _strip(node: Any) -> Any:
    return node["value"] if isinstance(node, Mapping) and "value" in node else node


def _check_schema(tables: DeviceTables, key: str, path: list[str | int]) -> None:
    """InputError unless the file of such a device may have the key, though this one has not."""
    kind = tables.values.get("kind")
    if isinstance(kind, str):
        model = find_file(kind, tables.name)
        if find_key(model, [part - 1 if isinstance(part, int) else part for part in path]) is not None:
            return
    known = list(dict.fromkeys(_list_keys(tables.values, "")))
    near = get_close_matches(key[:100], known, n=1, cutoff=0.5)
    hint = f"; did you mean '{near[0]}'?" if near else ""
    raise InputError(f"device '{tables.name}' has no key {quote(key)}{hint}")


def _list_keys(node: Any, prefix: str) -> Iterator[str]:
    node = _strip(node)
    if isinstance(node, Mapping):
        for name, inner in node.items():
            yield f"{prefix}{name}"
            yield from _list_keys(inner, f"{prefix}{name}.")
    elif isinstance(node, list):
        for number, inner in enumerate(node, 1):
            yield f"{prefix}{number}"
            yield from _list_keys(inner, f"{prefix}{number}.")


# --------------------------------------------------------------------------------------------------
# From parameter values to a device: the changed keys, the device file with them, and the device itself.


def build_device(
    design: Design, values: Mapping[str, Value], name: str = "candidate", *, override: bool = False
) -> Device:
    """Build the device with `values` (parameter → value); DeviceError if they form no valid device.

    It is the device that `haptorb.devices.loader.load` makes of the file `write_device_text`, digest included. With
    `override` also one that cannot be built: results of earlier versions hold some.
    """
    return build_tables(change_tables(design, values, name), override=override)


def change_tables(design: Design, values: Mapping[str, Value], name: str = "candidate") -> DeviceTables:
    """The base device's tables with `values` written to their places; InputError for values that the design lacks."""
    changes = _list_changes(design, values, name)
    base = design.base_tables
    own, file = _format(design, values, changes), None
    if base.file is not None:
        file = DeviceText(own, {design.base: base.file.own, **base.file.bases})
    return DeviceTables(name, lay_over_base(base.values, changes), base.text + own, file)


def write_device_text(design: Design, values: Mapping[str, Value], name: str) -> str:
    """Write a candidate as a device file, based on the design's base device.

    Parameters
    ----------
    design : Design
        The design.
    values : Mapping
        Parameter → value of the candidate.
    name : str
        Name of the new device.

    Returns
    -------
    str
        TOML text for `haptorb run`; every changed key is marked as chosen by the design.

    Raises
    ------
    InputError
        If the values do not belong to the parameters of the design.
    """
    return _format(design, values, _list_changes(design, values, name))


def _format(design: Design, values: Mapping[str, Value], changes: Mapping[str, Any]) -> str:
    import tomli_w

    units = {parameter.name: parameter.unit for parameter in design.parameters}
    pairs = ", ".join(f"{key} {value} {units.get(key, '')}".rstrip() for key, value in values.items())
    head = "".join(f"# {line}\n" for line in (f"Found by design '{design.name}': {pairs}".splitlines()))
    return f"{head}{tomli_w.dumps(changes)}"


def _list_changes(design: Design, values: Mapping[str, Value], name: str) -> dict[str, Any]:
    """The tables of a device file that is based on the design's base device."""
    base = design.base_tables
    whole = copy.deepcopy(dict(base.values))
    reason = f"chosen by design '{design.name}'"
    cut: list[list[str | int]] = []
    missing = {parameter.name for parameter in design.parameters} ^ set(values)
    if missing:
        raise InputError(f"design '{design.name}': the values must belong to its parameters; check '{min(missing)}'")
    for parameter in design.parameters:
        for key, written in _list_written(parameter, values[parameter.name]):
            try:
                cut.append(write_key(whole, split_key(key), written, reason))
            except (LookupError, TypeError, ValueError, AttributeError) as cause:  # a choice made another list
                raise InputError(f"'{key}' does not exist with these values") from cause
    title = f"{base.values.get('title', design.base)}, {design.name}: {name}"
    changes: dict[str, Any] = {"based_on": design.base, "name": name, "title": title[:400]}
    for path in cut:
        node, place_in = whole, changes
        for part in path[:-1]:
            node, place_in = node[str(part)], place_in.setdefault(str(part), {})
        place_in[str(path[-1])] = node[str(path[-1])]
    return changes


def _list_written(parameter: DesignParameter, value: Value) -> Iterator[tuple[str, Any]]:
    """Keys of the device file, with the entry that represents `value`."""
    for place in parameter.places:
        written = _write_value(parameter, place, value)
        if place.key == WHOLE:
            yield from list_entries(written)
        else:
            yield place.key, written


def _write_value(parameter: DesignParameter, place: ParameterPlace, value: Value) -> Any:
    """Entry of the device file for `value`: a text with its unit, an integer, a number, or a choice."""
    if parameter.choices:
        chosen = copy.deepcopy(parameter.choice(str(value)))
        if place.factor == 1.0 or isinstance(chosen, bool) or not isinstance(chosen, int | float):
            return chosen
        return type(chosen)(place.factor * chosen)
    if not isinstance(value, int | float):
        raise InputError(f"parameter '{parameter.name}' is a number; got '{value}'")
    number = float(f"{place.factor * value + place.offset:.12g}")
    if parameter.unit:
        return f"{number:.12g} {parameter.unit}"
    steps = (parameter.low, parameter.step, place.factor, place.offset)
    whole = parameter.step > 0 and all(float(part).is_integer() for part in steps)
    return int(number) if whole else number
