"""Design file (TOML): parsed, validated against its base device with every mistake reported, made into a Design."""

from __future__ import annotations

import hashlib
import math
import re
import sys
import traceback
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Literal, TypeAlias

from annotated_types import Len
from pydantic import BeforeValidator, Field, model_validator

from haptorb.devices import schema as m
from haptorb.devices.loader import DeviceTables, list_mistakes, read_tables
from haptorb.devices.schema import Name, Section, Text, explain_mistakes
from haptorb.devices.unit_conversion import convert
from haptorb.errors import HaptorbError, InputError, UnknownName, quote
from haptorb.file_kind import FileKind
from haptorb.files import parse_toml, read_text
from haptorb.own_code import find_imports, list_modules
from haptorb_design.problem import (
    WHOLE,
    Bound,
    Design,
    DesignGoal,
    DesignParameter,
    DesignQuantity,
    ParameterPlace,
    Value,
    change_tables,
    check_key,
    split_key,
)

__all__ = [
    "BoundSection",
    "DeviceDesignFile",
    "GoalSection",
    "ParameterSection",
    "PlaceSection",
    "is_base_share",
    "load_design",
    "load_function",
    "make_parameter",
    "parse_design",
    "read_bound",
    "read_number",
    "split_function",
]


# --------------------------------------------------------------------------------------------------
# Tables of a design file.


def _check_number(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ValueError(f"must be a number, with its unit in quotes where it has one; got {quote(value)}")
    return value


Number = Annotated[str | float, BeforeValidator(_check_number)]  #: "18 deg", or a plain number
_FILE_SCHEMA_NUMBER = m.Form("a number with its unit in quotes, or a plain number")
_BOUND = m.Form("a number with its unit, 'base', or a share of it: '0.9 base'")
Word = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=64)]


class PlaceSection(Section):
    """An entry of `places`, written as a table."""

    key: Annotated[str, m.Meaning("dotted key of the device file; entries of lists count from 1")]
    factor: Annotated[float, Field(allow_inf_nan=False), m.Meaning("factor for the value")] = 1.0
    offset: Annotated[Number, m.Meaning("offset to add, with its unit")] = 0.0


class ParameterSection(Section):
    """[parameters.NAME]: a range, or choices."""

    low: Annotated[Number | None, m.Meaning("least value"), _FILE_SCHEMA_NUMBER, m.Without("none: `choices`")] = None
    high: Annotated[Number | None, m.Meaning("greatest value"), _FILE_SCHEMA_NUMBER, m.Without("none: `choices`")] = (
        None
    )
    step: Annotated[Number | None, m.Meaning("step, from `low`"), _FILE_SCHEMA_NUMBER, m.Without("continuous")] = None
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
        m.Form("1 to 100 keys of the device file; '*' for the whole file, where every choice is a table of tables"),
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


# --------------------------------------------------------------------------------------------------
# Values of a design file: ranges with a unit, places, and bounds in the unit of their quantity.


_FILE_VALUES_NUMBER = re.compile(r"\s*([+-]?(?:\d{1,40}\.?\d{0,40}|\.\d{1,40})(?:[eE][+-]?\d{1,3})?)\s*(.*?)\s*")
_PLACE = re.compile(r"\s*(-)?\s*(?:(\d+\.?\d*|\.\d+)\s*\*)?\s*([A-Za-z_][\w.-]*)\s*")
_BASE = re.compile(r"\s*(?:(\d+\.?\d*|\.\d+)\s*\*?\s*)?base\s*")


def read_number(value: str | float, unit: str | None = None) -> tuple[float, str]:
    """Parse a number with its unit, or convert it to `unit` if that is given; ValueError for another unit.

    >>> read_number("18 deg"), read_number("1 cm", "mm")
    ((18.0, 'deg'), (10.0, 'mm'))
    """
    match = _FILE_VALUES_NUMBER.fullmatch(value) if isinstance(value, str) and len(value) <= 100 else None
    if isinstance(value, str):
        if match is None:
            raise ValueError(f"must be a number with its unit; got {quote(value)}")
        number, name = float(match[1]), match[2]
    else:
        number, name = float(value), ""
    if not math.isfinite(number):
        raise ValueError(f"must be a finite number; got {quote(value)}")
    if unit is None or name == unit:
        return number, name
    if number == 0.0 and name == "":
        return number, unit
    found = convert(number, name, unit)
    if found is None:
        raise ValueError(f"must be {f'in {unit}, or a unit like it' if unit else 'a plain number'}; got {quote(value)}")
    return float(f"{found:.12g}"), unit


def make_parameter(name: str, section: ParameterSection) -> DesignParameter:
    """The parameter of [parameters.NAME]; InputError names the key."""
    where = f"parameters.{name}"
    unit, low, high, step = "", 0.0, 0.0, 0.0
    if section.choices is None:
        low, unit = _read(section.low, None, f"{where}.low")
        high = _read(section.high, unit, f"{where}.high")[0]
        step = 0.0 if section.step is None else _read(section.step, unit, f"{where}.step")[0]
        if not low < high:
            raise InputError(f"{where}.high must be greater than low ({section.low}); got {section.high}")
        if step < 0 or step > high - low or (section.step is not None and step == 0):
            raise InputError(f"{where}.step must be greater than 0 and at most high - low; got {section.step}")
    places = tuple(_make_place(place, unit, f"{where}.places") for place in section.places)
    choices = _label(section.choices, where)
    tables = bool(choices) and all(isinstance(value, dict) for _, value in choices)
    if not tables and any(place.key == WHOLE for place in places):
        raise InputError(
            f"{where}.places has '{WHOLE}', the whole device file: so every choice must be a table of tables"
        )
    return DesignParameter(name, places, unit, low, high, step, choices)


def read_bound(value: str | float, unit: str, where: str, base: float | None) -> float:
    """A bound in the `unit` of its quantity; "0.9 base" is that share of the `base` device's value."""
    match = _BASE.fullmatch(value) if isinstance(value, str) else None
    if match is not None:
        if base is None:
            raise InputError(f"{where}: '{value}', but the base device has no such value")
        return float(match[1] or 1.0) * base
    try:
        number, name = read_number(value)
        if name in ("", unit) or name == unit.replace("·", "*"):
            return number
        found = convert(number, name, unit) if unit else None
    except ValueError as cause:
        raise InputError(f"{where} {cause}") from cause
    if found is None:
        wanted = f"a number in {unit}" if unit else "a plain number"
        raise InputError(f"{where} must be {wanted}, 'base' or '0.9 base'; got {quote(value)}")
    return found


def is_base_share(value: str | float | None) -> bool:
    """Whether the bound `value` is relative to the base device."""
    return isinstance(value, str) and _BASE.fullmatch(value) is not None


def _read(value: str | float | None, unit: str | None, where: str) -> tuple[float, str]:
    try:
        return read_number(0.0 if value is None else value, unit)
    except ValueError as cause:
        raise InputError(f"{where} {cause}") from cause


def _make_place(place: str | PlaceSection, unit: str, where: str) -> ParameterPlace:
    if isinstance(place, PlaceSection):
        return ParameterPlace(place.key, place.factor, _read(place.offset, unit, f"{where}.offset")[0])
    if place.strip() == WHOLE:
        return ParameterPlace(WHOLE)
    match = _PLACE.fullmatch(place)
    if match is None:
        raise InputError(f"{where} must be a key, '-key' or '0.5*key'; got {quote(place)}")
    factor = float(match[2] or 1.0)
    return ParameterPlace(match[3], -factor if match[1] else factor)


def _label(choices: list[Any] | Mapping[str, Any] | None, where: str) -> tuple[tuple[str, Any], ...]:
    """Label → choice; a list of texts and numbers is its own labels, other entries are numbered."""
    if choices is None:
        return ()
    if isinstance(choices, Mapping):
        return tuple(choices.items())
    plain = all(isinstance(one, str | int | float) for one in choices)
    labels = [str(one) if plain else str(number) for number, one in enumerate(choices, 1)]
    if len(set(labels)) != len(labels):
        raise InputError(f"{where}.choices: '{max(labels, key=labels.count)}' appears twice")
    return tuple(zip(labels, choices, strict=True))


# --------------------------------------------------------------------------------------------------
# A user's own objective `mine.py:cost`: a function of a candidate that returns a number, sent along with its code.


_modules: dict[Path, tuple[str, ModuleType]] = {}


def split_function(text: str, folder: Path) -> tuple[Path, str]:
    """Split "file.py:name"; a relative path starts at `folder`. InputError for anything else.

    >>> split_function("mine.py:cost", Path("/designs"))
    (PosixPath('/designs/mine.py'), 'cost')
    """
    path, found, name = text.rpartition(":")
    if not found or not path.lower().endswith(".py") or not name.isidentifier():
        raise InputError(f"function must be 'file.py:name'; got '{text}'")
    return folder / Path(path).expanduser(), name


def load_function(
    text: str, folder: Path, announce: Callable[[Path, str], None] = lambda path, name: None
) -> tuple[Callable[..., Any], str]:
    """The function "file.py:name", and the text of its file and of the files beside it that it imports.

    The file is run once; `announce` receives it, and the name, before that. Raises InputError, with file and line, if
    it cannot be read or fails, UnknownName if it has no such function.
    """
    path, name = split_function(text, folder)
    source = read_text(path, "file of an objective", InputError, kind=FileKind.WORLD)
    known = _modules.get(path)
    if known is not None and known[0] == source:
        module = known[1]
    else:
        announce(path, name)
        module = _run(path, source)
    _modules[path] = (source, module)
    beside = find_imports(path, source)
    _send_along(module, *list_modules(beside))
    function = vars(module).get(name)
    if not callable(function):
        names = [key for key, value in vars(module).items() if callable(value) and not key.startswith("_")]
        raise UnknownName(f"function in {path}", name, names)
    return function, "\0".join((source, *beside.values()))


def _send_along(*modules: ModuleType) -> None:
    """Pickle the code of `modules` by value, since other processes and machines may not have their files."""
    import cloudpickle

    for module in modules:
        cloudpickle.register_pickle_by_value(module)


def _run(path: Path, source: str) -> ModuleType:
    module = ModuleType(f"haptorb_objective_{path.stem}")
    module.__file__ = str(path)
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # for modules beside it; last, so that they shadow nothing
    sys.modules[module.__name__] = module  # dataclasses look it up there
    try:
        exec(compile(source, str(path), "exec"), module.__dict__)
    except BaseException as cause:  # the user's code may also call sys.exit
        if isinstance(cause, KeyboardInterrupt):
            raise
        frames = [one for one in traceback.extract_tb(cause.__traceback__) if one.filename == str(path)]
        line = frames[-1].lineno if frames else getattr(cause, "lineno", None)
        where = f", line {line}" if line else ""
        raise InputError(f"objective's file {path}{where}: {type(cause).__name__}: {cause}") from cause
    return module


Announce: TypeAlias = Callable[[Path, str], None]


def load_design(path: str | Path, announce: Announce = lambda path, name: None) -> Design:
    """Load a design file.

    Parameters
    ----------
    path : str or Path
        TOML file.
    announce : callable
        Receives file and name of each function of the user's own before its code runs.

    Returns
    -------
    Design
        The design.

    Raises
    ------
    InputError
        With all mistakes of the file.
    """
    found = Path(path).expanduser()
    text = read_text(found, "design file", InputError, kind=FileKind.DESIGN)
    return parse_design(text, str(path), found.absolute().parent, announce)


def parse_design(text: str, name: str, folder: Path, announce: Announce = lambda path, name: None) -> Design:
    """Make a design from the text of a design file.

    Parameters
    ----------
    text : str
        TOML text.
    name : str
        Name of the file in messages.
    folder : Path
        Folder at which paths of a base device or a function start.
    announce : callable
        Receives file and name of each function of the user's own before its code runs.

    Returns
    -------
    Design
        The design.

    Raises
    ------
    InputError
        With all mistakes of the text.
    """
    from pydantic import ValidationError

    try:
        file = DeviceDesignFile.model_validate(parse_toml(text))
    except ValidationError as cause:
        lines = explain_mistakes(cause.errors(), DeviceDesignFile)
        raise InputError("\n".join(f"design file '{name}': {line}" for line in lines)) from cause
    except ValueError as cause:
        raise InputError(f"design file '{name}': not a TOML file: {cause}") from cause
    try:
        return _build(file, text, folder, announce)
    except HaptorbError as cause:
        if str(cause).startswith("design file"):
            raise
        lines = str(cause).splitlines()
        raise InputError("\n".join(f"design file '{name}': {line}" for line in lines)) from cause


def _build(file: DeviceDesignFile, text: str, folder: Path, announce: Announce) -> Design:
    base = file.base
    if base.lower().endswith(".toml") or "/" in base:
        base = str(folder / Path(base).expanduser())
    tables = read_tables(base)
    kind = str(tables.values.get("kind"))
    mistakes: list[str] = []
    codes: dict[str, str] = {}
    parameters = [_collect(mistakes, make_parameter, key, section) for key, section in file.parameters.items()]
    goals = [
        _collect(mistakes, _make_goal, key, section, kind, folder, codes, announce)
        for key, section in file.objectives.items()
    ]
    quantities = {
        key: _collect(mistakes, _find_quantity, f"constraints.{key}", key, section, kind, folder, codes, announce)
        for key, section in file.constraints.items()
    }
    whole = "\0".join((text, *codes.values(), tables.text))
    design = Design(
        name=file.name,
        title=file.title or file.name,
        base=base,
        parameters=tuple(filter(None, parameters)),
        goals=tuple(filter(None, goals)),
        bounds=(),
        options=file.evaluation,
        text=text,
        digest=hashlib.sha256(whole.encode()).hexdigest(),
        tables=tables,
    )
    mistakes += _list_mistakes(design)
    if mistakes:
        raise InputError("\n".join(mistakes))
    bounds = [
        _make_bound(design, key, section, quantity)
        for (key, section), quantity in zip(file.constraints.items(), quantities.values(), strict=True)
        if quantity is not None
    ]
    return replace(design, bounds=tuple(bounds))


def _collect(mistakes: list[str], make: Any, *arguments: Any) -> Any:
    """Result of `make`; None, with the mistake recorded, if it raises."""
    try:
        return make(*arguments)
    except HaptorbError as cause:
        mistakes.append(str(cause))
        return None


def _make_goal(
    name: str, section: GoalSection, kind: str, folder: Path, codes: dict[str, str], announce: Announce
) -> DesignGoal:
    quantity = _find_quantity(f"objectives.{name}", name, section, kind, folder, codes, announce)
    return DesignGoal(quantity, section.sense or quantity.sense, name)


def _find_quantity(
    where: str, name: str, section: GoalSection | BoundSection, kind: str, folder: Path, codes: dict[str, str],
    announce: Announce,
) -> DesignQuantity:  # fmt: skip
    """haptorb's own quantity, or one from the user's function, whose code is added to `codes`."""
    try:
        if section.function is not None:
            function, source = load_function(section.function, folder, announce)
            codes[section.function] = source
            text = (function.__doc__ or f"function {section.function}").strip().splitlines()[0]
            return DesignQuantity(name, section.unit or "", "minimise", text, (kind,), function)
        from haptorb_design.objectives import quantity, quantity_names

        found = quantity(section.quantity or name)
        if kind not in found.kinds:
            raise UnknownName(f"quantity of a {kind}", found.name, quantity_names(kind))
    except HaptorbError as cause:
        raise InputError(f"{where}: {cause}") from cause
    return found


def _make_bound(design: Design, name: str, section: BoundSection, quantity: DesignQuantity) -> Bound:
    where, base = f"constraints.{name}", None
    if is_base_share(section.at_least) or is_base_share(section.at_most):
        from haptorb_design.workers import compute_base_quantities

        found = compute_base_quantities(design, {name: quantity})[name]
        if isinstance(found, str):
            raise InputError(f"{where}: the base device has no number for it: {found}")
        base = found
    low, high = (
        None if value is None else read_bound(value, quantity.unit, f"{where}.{key}", base)
        for key, value in (("at_least", section.at_least), ("at_most", section.at_most))
    )
    if low is not None and high is not None and low > high:
        raise InputError(f"{where}: at_least ({low:g}) is above at_most ({high:g})")
    return Bound(name, quantity, low, high)


def _list_mistakes(design: Design) -> list[str]:
    """Mistakes of the parameters: unknown keys, keys written twice, and invalid values."""
    mistakes: list[str] = []
    writers: dict[str, str] = {}
    for parameter in design.parameters:
        tables = _make_tables(design, parameter) if not mistakes else design.base_tables
        for key in parameter.list_keys():
            try:
                check_key(tables, key)
            except InputError as cause:
                mistakes.append(f"parameters.{parameter.name}.places: {cause}")
                continue
            other = writers.setdefault(key, parameter.name)
            if other != parameter.name:
                mistakes.append(f"parameters.{parameter.name}.places: '{key}' is also written by '{other}'")
    if mistakes:
        return mistakes
    for parameter in design.parameters:
        ends: dict[str, Value] = {label: label for label in parameter.labels} or {
            "low": parameter.low, "high": parameter.high
        }  # fmt: skip
        for label, value in ends.items():
            mistakes += _try_value(design, parameter, label, value)
    return list(dict.fromkeys(mistakes))


def _list_earlier(design: Design, parameter: DesignParameter) -> tuple[DesignParameter, ...]:
    """Parameters before `parameter` that write whole lists or tables, into which it may write."""
    before = design.parameters[: design.parameters.index(parameter)]
    return tuple(one for one in before if one.choices and isinstance(one.choices[0][1], list | dict))


def _make_tables(design: Design, parameter: DesignParameter) -> DeviceTables:
    """Tables that `parameter` writes into: the base device's, with the first choice of earlier parameters."""
    earlier = _list_earlier(design, parameter)
    if not earlier:
        return design.base_tables
    values = {one.name: one.labels[0] for one in earlier}
    tables = change_tables(replace(design, parameters=earlier), values)
    return replace(tables, name=design.base_tables.name)


def _try_value(design: Design, parameter: DesignParameter, label: str, value: Value) -> list[str]:
    """Mistakes of the base device's file with this one value; those at other places are found by a run."""
    earlier = _list_earlier(design, parameter)
    values = {**{one.name: one.labels[0] for one in earlier}, parameter.name: value}
    tables = change_tables(replace(design, parameters=(*earlier, parameter)), values)
    places = [split_key(key) for key in parameter.list_keys()]
    found = []
    for path, sentence in list_mistakes(tables):
        if any(path[: len(place)] == place for place in places):
            found.append(f"parameters.{parameter.name}, {label}: {sentence}")
    return found
