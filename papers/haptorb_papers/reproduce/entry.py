"""A value stored in the package: in a device file, in a world or in a table of constants, instead of computed.

A statement whose value is an `Entry` can only be a transcription: an entry is found by a path of names, so no formula
can hide in it. What the device file marks as assumed is known to be assumed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["Entry", "read_count", "read_entry"]

_STEP = re.compile(r"(\w+)((?:\[[^\[\]]+\])*)")


@dataclass(frozen=True)
class Entry:
    """A stored value and its location.

    value     in the unit of the statement
    place     holder and path, as "omni: tool.outer_radius"
    assumed   the device file's reason for having assumed it; empty where it is printed
    """

    value: float
    place: str
    assumed: str = ""

    def __float__(self) -> float:
        return float(self.value)


def read_entry(holder: Any, path: str, per: float = 1.0) -> Entry:
    """The number at `path` of `holder`, times `per`: a change of unit, and a radius's diameter at most.

    >>> from haptorb.devices.loader import load
    >>> omni = load("omni")
    >>> read_entry(omni, "coils.resistance[0]")
    Entry(value=0.6, place='omni: coils.resistance[0]', assumed='')
    >>> read_entry(omni, "tool.remanence").assumed.split(" for ")[0]
    'follows from 48 mN/A at 50 mm'
    """
    return Entry(per * float(_follow(holder, path)), f"{_name(holder)}: {path}", _find_reason(holder, path))


def read_count(holder: Any, path: str) -> Entry:
    """Number of entries of the list at `path` of `holder`.

    >>> from haptorb.devices.loader import load
    >>> read_count(load("omni"), "coils.names").value
    3.0
    """
    return Entry(float(len(_follow(holder, path))), f"{_name(holder)}: number of {path}")


def _follow(holder: Any, path: str) -> Any:
    value = holder
    for step in path.split("."):
        match = _STEP.fullmatch(step)
        if match is None:
            raise ValueError(f"'{path}' is no path of names and [keys]")
        value = getattr(value, match[1])
        for key in re.findall(r"\[([^]]+)\]", match[2]):
            value = value[int(key) if key.lstrip("-").isdigit() else key]
    return value


def _name(holder: Any) -> str:
    """The device's or world's own name, else that of its module or class."""
    for key in ("name", "__name__"):
        if isinstance(found := getattr(holder, key, None), str):
            return found.removeprefix("haptorb.")
    return type(holder).__name__


def _find_reason(holder: Any, path: str) -> str:
    reasons: Mapping[str, str] = getattr(holder, "assumed", {})
    return str(reasons.get(re.sub(r"\[[^]]+\]", "", path), ""))
