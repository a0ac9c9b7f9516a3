"""From a design file to a Design: read, checked as a whole against its base device, every mistake named."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from haptorb.design.candidate import DesignCandidate
from haptorb.design.design import Bound, Design, DesignGoal
from haptorb.design.device_changes import change_tables
from haptorb.design.device_keys import check_key, split_key
from haptorb.design.evaluate import compute_quantity, find_base
from haptorb.design.evaluation import Value
from haptorb.design.file_schema import BoundSection, DeviceDesignFile, GoalSection
from haptorb.design.file_values import is_base_share, make_parameter, read_bound
from haptorb.design.own_function import load_function
from haptorb.design.parameter import DesignParameter
from haptorb.design.quantity import DesignQuantity
from haptorb.devices.loader import DeviceTables, list_mistakes, read_tables
from haptorb.devices.schema.mistakes import explain_mistakes
from haptorb.errors import HaptorbError, InputError, UnknownName
from haptorb.files.file_kind import FileKind
from haptorb.files.text_file import parse_toml, read_text

__all__ = ["load_design", "parse_design"]

Announce: TypeAlias = Callable[[Path, str], None]


def load_design(path: str | Path, announce: Announce = lambda path, name: None) -> Design:
    """The design that the TOML file at `path` describes. Raises InputError with all mistakes of the file.

    announce  receives file and name of each function of the user's own before its code runs
    """
    found = Path(path).expanduser()
    text = read_text(found, "design file", InputError, kind=FileKind.DESIGN)
    return parse_design(text, str(path), found.absolute().parent, announce)


def parse_design(text: str, name: str, folder: Path, announce: Announce = lambda path, name: None) -> Design:
    """The design that the TOML `text` describes; `name` is the name for messages, `announce` as `load_design` has it.

    Paths in it, of a base device or a function, start at `folder`.
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
    if base.endswith(".toml") or "/" in base:
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
    """What `make` returns; None, with the mistake kept, if it raises."""
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
    """haptorb's own quantity, or one made of the user's function, whose code goes into `codes`."""
    try:
        if section.function is not None:
            function, source = load_function(section.function, folder, announce)
            codes[section.function] = source
            text = (function.__doc__ or f"function {section.function}").strip().splitlines()[0]
            return DesignQuantity(name, section.unit or "", "minimise", text, (kind,), function)
        from haptorb.design.objectives import quantity, quantity_names

        found = quantity(section.quantity or name)
        if kind not in found.kinds:
            raise UnknownName(f"quantity of a {kind}", found.name, quantity_names(kind))
    except HaptorbError as cause:
        raise InputError(f"{where}: {cause}") from cause
    return found


def _make_bound(design: Design, name: str, section: BoundSection, quantity: DesignQuantity) -> Bound:
    where, base = f"constraints.{name}", None
    if is_base_share(section.at_least) or is_base_share(section.at_most):
        device = find_base(design)
        base, reason = compute_quantity(quantity, DesignCandidate(device, device, design.options))
        if reason:
            raise InputError(f"{where}: the base device has no number for it: {reason}")
    low, high = (
        None if value is None else read_bound(value, quantity.unit, f"{where}.{key}", base)
        for key, value in (("at_least", section.at_least), ("at_most", section.at_most))
    )
    if low is not None and high is not None and low > high:
        raise InputError(f"{where}: at_least ({low:g}) is above at_most ({high:g})")
    return Bound(name, quantity, low, high)


def _list_mistakes(design: Design) -> list[str]:
    """Keys that the base device has not, or that two parameters write, and values that a key does not take."""
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
    """Those before `parameter` that write whole lists or tables, into which it may write."""
    before = design.parameters[: design.parameters.index(parameter)]
    return tuple(one for one in before if one.choices and isinstance(one.choices[0][1], list | dict))


def _make_tables(design: Design, parameter: DesignParameter) -> DeviceTables:
    """What `parameter` writes into: the base device's tables, with the first choice of those before it."""
    earlier = _list_earlier(design, parameter)
    if not earlier:
        return design.base_tables
    values = {one.name: one.labels[0] for one in earlier}
    tables = change_tables(replace(design, parameters=earlier), values)
    return replace(tables, name=design.base_tables.name)


def _try_value(design: Design, parameter: DesignParameter, label: str, value: Value) -> list[str]:
    """What the base device's file has against this one value at its own places; what it says elsewhere is for a run."""
    earlier = _list_earlier(design, parameter)
    values = {**{one.name: one.labels[0] for one in earlier}, parameter.name: value}
    tables = change_tables(replace(design, parameters=(*earlier, parameter)), values)
    places = [split_key(key) for key in parameter.list_keys()]
    found = []
    for path, sentence in list_mistakes(tables):
        if any(path[: len(place)] == place for place in places):
            found.append(f"parameters.{parameter.name}, {label}: {sentence}")
    return found
