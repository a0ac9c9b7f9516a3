"""`haptorb keys`: print the keys of device, study and design files with meaning, unit, range and default."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from haptorb.errors import HaptorbError, InputError, UnknownName
from haptorb.terminal import make_console, notify, print_facts, print_json, print_text

if TYPE_CHECKING:
    from haptorb.devices.schema import KeyText

__all__ = ["FILES", "FileKeys", "KeySection", "register"]


class KeySection(NamedTuple):
    """The keys of one table of a file, or of the whole file."""

    title: str
    keys: tuple[KeyText, ...]


class FileKeys(NamedTuple):
    """One kind of file: description and keys."""

    text: str
    list_sections: Callable[[], list[KeySection]]


def list_device_sections() -> list[KeySection]:
    """List the keys of a device file, one section for each kind of device that has files."""
    from haptorb.devices.registry import find_file, has_file, kind_names
    from haptorb.devices.schema import list_keys

    sections = []
    for name in kind_names():
        try:
            if has_file(name):
                sections.append(KeySection(f'kind = "{name}"', tuple(list_keys(find_file(name, name)))))
        except HaptorbError as cause:  # of another package
            notify(str(cause))
    return sections


def list_mapping_sections() -> list[KeySection]:
    """List the keys of a mapping file."""
    from haptorb.devices.schema import list_keys
    from haptorb.runtime.trackers.formats import MappingFile

    return [KeySection("", tuple(list_keys(MappingFile)))]


#: the kinds of file; other packages add theirs where they register their commands
FILES: dict[str, FileKeys] = {
    "device": FileKeys("a device: haptorb run FILE, haptorb inspect FILE", list_device_sections),
    "mapping": FileKeys("poses of another program: haptorb run --tracker osc:9000,FILE.toml", list_mapping_sections),
}


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(keys)


def keys(
    file: Annotated[
        str | None, typer.Argument(help="Kind of file: device, study, design, feel or mapping; without it, list them.")
    ] = None,
    word: Annotated[str | None, typer.Argument(help="Print only keys with this text in their name or meaning.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List the keys of a kind of file with units and ranges: haptorb keys device heat."""
    if file is None:
        texts = {name: one.text for name, one in FILES.items()}
        if json:
            print_json(texts)
        else:
            print_facts(make_console(), texts.items())
        return
    if file not in FILES:
        raise UnknownName("kind of file", file, FILES)
    sections = _select(FILES[file].list_sections(), word)
    if not sections:
        raise InputError(
            f"no key of a {file} file has {word!r} in its name or meaning; `haptorb keys {file}` lists all keys"
        )
    if json:
        print_json([
            {"section": title, "key": key.path, "meaning": key.meaning, "value": key.value, "unit": key.unit,
             "range": key.range, "default": key.default}
            for title, found in sections for key in found
        ])  # fmt: skip
        return
    console = make_console()
    for number, (title, found) in enumerate(sections):
        if number:
            print_text(console)
        if title:
            print_text(console, title, "bold")
        for key in found:
            print_text(console, f"{key.path}  {_describe_value(key)}", indent="    ")
            print_text(console, f"    {key.meaning}", "dim", indent="    ")


def _select(sections: list[KeySection], word: str | None) -> list[KeySection]:
    if word is None:
        return sections
    part = word.casefold()
    found = [
        KeySection(title, tuple(key for key in keys if part in key.path.casefold() or part in key.meaning.casefold()))
        for title, keys in sections
    ]
    return [section for section in found if section.keys]


def _describe_value(key: KeyText) -> str:
    """Describe type, unit, range and default of a value."""
    unit = "" if key.unit in ("", "1", "none") else f" [{key.unit}]"
    span = "" if key.range in ("", "any", "the keys below") else f", {key.range}"
    default = "required" if key.default == "required" else f"default: {key.default}" if key.default else ""
    return f"{key.value}{unit}{span}{'; ' if default else ''}{default}"
