"""Loads a Device from a device file of the catalogue or a path; all mistakes are reported together."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from haptorb.devices.base import Device, DeviceText
from haptorb.devices.based_on import drop_keys, has_key, is_table, lay_over_base
from haptorb.devices.build_checks import BuildError
from haptorb.devices.quantity import strip_provenance
from haptorb.devices.registry import find_file, is_kind, kind_names
from haptorb.devices.schema import DeviceSchema, explain_mistakes
from haptorb.errors import DeviceError, UnknownName, quote
from haptorb.file_kind import FileKind, find_kind
from haptorb.files import parse_toml, read_text

__all__ = [
    "DeviceTables",
    "build_tables",
    "catalogue",
    "find_device",
    "in_catalogue",
    "list_mistakes",
    "load",
    "parse",
    "read_tables",
]

_FOLDER = Path(__file__).parent / "catalogue"


@dataclass(frozen=True)
class DeviceTables:
    """Tables of a device file merged with its base devices, before any check.

    name    name for messages
    values  the tables
    text    complete text of all files: the device's digest is computed from it
    file    the same text, file by file; None where there is no file
    """

    name: str
    values: Mapping[str, Any] = field(repr=False)
    text: str = field(repr=False)
    file: DeviceText | None = field(default=None, repr=False)


def catalogue() -> dict[str, str]:
    """Name → title of every device that comes with the package."""
    titles = {}
    for path in sorted(_FOLDER.glob("*.toml")):
        titles[path.stem] = str(parse_toml(path.read_text(encoding="utf-8"))["title"])
    return titles


def in_catalogue(name: str) -> bool:
    """Whether a device of this name comes with the package."""
    return name in (path.stem for path in _FOLDER.glob("*.toml"))


def load(name: str | Path, *, override: bool = False) -> Device:
    """Load a device from the catalogue or from a device file.

    Parameters
    ----------
    name : str or Path
        Name in the catalogue (`haptorb devices` lists it), or path of a TOML file.
    override : bool
        Build a device whose parts overlap, or whose wiring cannot work, for study.

    Returns
    -------
    Device
        The device, all quantities in SI units.

    Raises
    ------
    UnknownName
        If the catalogue has no device of this name; the message names the most similar one.
    DeviceError
        If the file does not describe a device; the message lists file, key, value and what was expected.

    Examples
    --------
    >>> load("omni").channels
    3
    """
    return build_tables(read_tables(name), override=override)


def find_device(device: Device | str | Path) -> Device:
    """`device` itself, or the one of that name in the catalogue or of that device file; errors as `load`.

    >>> find_device("omni").name
    'omni'
    """
    return device if isinstance(device, Device) else load(device)


def _read(text: str) -> tuple[str, str]:
    """The file's content, and the name that mistakes are reported under."""
    if not text.lower().endswith(".toml") and "/" not in text:
        if not in_catalogue(text):
            if find_kind(text) is None:
                raise UnknownName("device", text, catalogue())
            return read_text(text, "device file", DeviceError, kind=FileKind.DEVICE), text
        return read_text(_FOLDER / f"{text}.toml", "device file", DeviceError), text
    name = quote(text, 400)[1:-1]
    if len(text) > 4096:
        raise DeviceError(f"device file {name}: cannot be read (file name too long)")
    return read_text(text, "device file", DeviceError, kind=FileKind.DEVICE), name


def parse(content: str, name: str, *, bases: Mapping[str, str] | None = None, override: bool = False) -> Device:
    r"""Build a device from the text of a device file.

    Parameters
    ----------
    content : str
        TOML text of the device file.
    name : str
        Name of the file in messages.
    bases : Mapping, optional
        Files that the device may be based on besides the catalogue, by the text of `based_on`; then no other file is
        read. None: any file.
    override : bool
        As for `haptorb.load`.

    Returns
    -------
    Device
        The device, all quantities in SI units.

    Raises
    ------
    DeviceError
        With all mistakes of the text.

    Examples
    --------
    >>> parse('based_on = "omni"\nname = "mine"\n[tool]\nlength = "30 mm"', "mine.toml").tool.length
    0.03
    """
    return build_tables(_lay_over_bases(content, name, bases), override=override)


def read_tables(name: str | Path) -> DeviceTables:
    """The tables of the device of that name in the catalogue, or in the TOML file at that path; errors as `load`."""
    content, source = _read(str(name))
    return _lay_over_bases(content, source, None)


def build_tables(tables: DeviceTables, *, override: bool = False) -> Device:
    """The device that `tables` describe. Raises DeviceError with all mistakes; `override` as for `load`."""
    from pydantic import ValidationError

    name = tables.name
    kind = tables.values.get("kind")
    if not isinstance(kind, str) or not is_kind(kind):
        raise DeviceError(f"device '{name}': kind must be one of {', '.join(kind_names())}; got {quote(kind)}")
    assumed: dict[str, str] = {}
    file_class = find_file(kind, name)
    try:
        # sizes that overflow, or divide by nothing, are refused here and not carried on as NaN
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            plain = {key: strip_provenance(value, key, assumed) for key, value in tables.values.items()}
            file = file_class.model_validate(plain)
            if tables.file is not None:
                _refuse_idle(tables.file, file)
            digest = hashlib.sha256(tables.text.encode()).hexdigest()
            device = replace(file.build(assumed, digest, override=override), text=tables.file)
    except BuildError as cause:  # whose device knows its name, but not the file that the person wrote
        raise cause.rename(name) from cause
    except ValidationError as cause:
        lines = [f"device '{name}': {line}" for line in explain_mistakes(cause.errors(), file_class)]
        raise DeviceError("\n".join(lines)) from cause
    except (ArithmeticError, np.linalg.LinAlgError, MemoryError) as cause:
        raise DeviceError(
            f"device '{name}': its values are too large, or too far apart, to compute with ({cause}); "
            "expected the size of a desktop device"
        ) from cause
    except ValueError as cause:
        raise DeviceError(f"device '{name}': {cause}") from cause
    return device


def _refuse_idle(text: DeviceText, file: DeviceSchema) -> None:
    """ValueError for a value of the file itself, not of its base, that changes nothing beside what else it says."""
    for key, reason in file.list_idle():
        if not _is_stated(file, key):
            continue
        inherited = text.inheritance
        if inherited is None or any(one == key or one.startswith(f"{key}.") for one in inherited.own):
            raise ValueError(f"{key} has no effect: {reason}; leave it out")


def _is_stated(file: Any, key: str) -> bool:
    for part in key.split("."):
        if part not in file.model_fields_set:
            return False
        file = getattr(file, part)
    return True


def list_mistakes(tables: DeviceTables) -> list[tuple[list[str | int], str]]:
    """(path, sentence) of each invalid value; entries of lists count from 1 in a path.

    Only checks of single values; `build_tables` finds overlaps and wiring errors.
    """
    from pydantic import ValidationError

    file_class = find_file(str(tables.values["kind"]), tables.name)
    try:
        file_class.model_validate({key: strip_provenance(value, key, {}) for key, value in tables.values.items()})
    except ValidationError as cause:
        return [
            ([part + 1 if isinstance(part, int) else part for part in error["loc"]], sentence)
            for error in cause.errors()
            for sentence in explain_mistakes([error], file_class)
        ]
    return []


def _lay_over_bases(content: str, name: str, bases: Mapping[str, str] | None) -> DeviceTables:
    values, whole, found = _load_with_base(content, name, bases, 0)
    return DeviceTables(name, values, whole, DeviceText(content, found))


def _load_with_base(
    content: str, name: str, bases: Mapping[str, str] | None, depth: int
) -> tuple[dict[str, Any], str, dict[str, str]]:
    """The file's tables, laid over those of the device it is `based_on`; all text that went into them; and the files
    that it is based on."""
    try:
        raw = parse_toml(content)
    except ValueError as cause:
        raise DeviceError(f"device '{name}': not a TOML file: {cause}") from cause
    base = raw.get("based_on")
    drop = raw.pop("drop", [])
    if base is None:
        if drop:
            raise DeviceError(f"device '{name}': drop is for a device that is based on another one; it has no based_on")
        return raw, content, {}
    if not isinstance(base, str) or depth > 8:
        raise DeviceError(f"device '{name}': based_on must name another device, without a cycle; got {quote(base)}")
    text, below_name = _read_base(base, name, bases)
    below, whole, found = _load_with_base(text, below_name, bases, depth + 1)
    if raw.get("name", below.get("name")) == below.get("name"):
        raise DeviceError(
            f"device '{name}': name must be a name of its own, other than {quote(below.get('name'))} of the device "
            "that it is based on: recordings and calibrations refer to a device by its name"
        )
    raw.setdefault("title", f"{below.get('title')} ({raw['name']})")
    try:
        below = drop_keys(below, drop)
        again = [key for key in drop if has_key(raw, key) and not is_table(raw, key)]
        if again:
            raise ValueError(f"drop: {quote(again[0])} has no effect: the file states this key itself; leave one out")
    except ValueError as cause:
        raise DeviceError(f"device '{name}': {cause}") from cause
    return lay_over_base(below, raw), whole + content, {base: text, **found}


def _read_base(base: str, name: str, bases: Mapping[str, str] | None) -> tuple[str, str]:
    if bases is None:
        return _read(base)
    if base in bases:
        return bases[base], base
    if base not in catalogue():
        raise DeviceError(f"device '{name}': the file of {quote(base)}, which it is based on, is missing")
    return _read(base)
