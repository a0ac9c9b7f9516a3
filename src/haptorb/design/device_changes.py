"""From a parameter's values to a device: the changed keys, the device file that says them, and the device itself."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from typing import Any

from haptorb.design.design import Design
from haptorb.design.device_keys import split_key, write_key
from haptorb.design.evaluation import Value
from haptorb.design.parameter import WHOLE, DesignParameter, ParameterPlace, list_entries
from haptorb.devices.device import Device
from haptorb.devices.device_text import DeviceText
from haptorb.devices.loader import DeviceTables, build_tables, lay_over
from haptorb.errors import InputError

__all__ = ["build_device", "change_tables", "write_device_text"]


def build_device(design: Design, values: Mapping[str, Value], name: str = "candidate") -> Device:
    """The device that `values` (parameter → value) make of the base device; DeviceError if they make none.

    It is the device that `haptorb.devices.loader.load` makes of the file `write_device_text`, digest included.
    """
    return build_tables(change_tables(design, values, name))


def change_tables(design: Design, values: Mapping[str, Value], name: str = "candidate") -> DeviceTables:
    """The base device's tables with `values` written to their places; InputError for values that the design has not."""
    changes = _list_changes(design, values, name)
    base = design.base_tables
    own, file = _format(design, values, changes), None
    if base.file is not None:
        file = DeviceText(own, {design.base: base.file.own, **base.file.bases})
    return DeviceTables(name, lay_over(base.values, changes), base.text + own, file)


def write_device_text(design: Design, values: Mapping[str, Value], name: str) -> str:
    """A device file, based on the design's base device, that says what `values` change."""
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
    """Keys of the device file, and what stands there for `value`."""
    for place in parameter.places:
        written = _write_value(parameter, place, value)
        if place.key == WHOLE:
            yield from list_entries(written)
        else:
            yield place.key, written


def _write_value(parameter: DesignParameter, place: ParameterPlace, value: Value) -> Any:
    """What stands in the device file for `value`: a text with its unit, a whole number, a number, or a choice."""
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
