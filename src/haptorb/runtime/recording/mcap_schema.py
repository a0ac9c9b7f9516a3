"""A row's layout as a ROS 2 message, the schema that MCAP tools know how to read; and back.

All fields are float64, so a message is four bytes that say "little-endian CDR" and the row's own bytes: what is read
back is bit for bit what the loop published.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from haptorb.errors import RecordingError, quote
from haptorb.files.foreign_text import foreign_text
from haptorb.runtime.row import Field, RowLayout

_WIDEST = 65_536  #: numbers in a row

__all__ = ["CDR_HEADER", "ENCODING", "MESSAGE_ENCODING", "NAME", "TOPIC", "describe_fields", "fields_of", "schema"]

NAME = "haptorb/msg/Tick"
ENCODING = "ros2msg"
MESSAGE_ENCODING = "cdr"
TOPIC = "/haptorb/tick"
CDR_HEADER = b"\x00\x01\x00\x00"

_LINE = re.compile(
    r"float64(?:\[(?P<width>[0-9]{1,6})\])? (?P<name>[a-z][a-z0-9_]{0,63})(?:  # \[(?P<unit>[^\]]*)\] (?P<about>.*))?"
)


def schema(layout: RowLayout) -> str:
    """The message definition of `layout`, with unit and meaning of every field; fields without numbers are left out.

    >>> schema(RowLayout(channels=3, sensors=0)).splitlines()[13]
    'float64 age  # [s] age of the pose'
    """
    return describe_fields(layout.fields)


def describe_fields(fields: Iterable[Field]) -> str:
    """The message definition of a row of `fields`."""
    lines = []
    for field in fields:
        if field.width:
            kind = "float64" if field.width == 1 else f"float64[{field.width}]"
            lines.append(f"{kind} {field.name}  # [{field.unit}] {field.about}")
    return "\n".join(lines) + "\n"


def fields_of(text: str) -> tuple[Field, ...]:
    """The fields that a `schema` describes. Raises RecordingError for anything but numbers of type float64."""
    fields: list[Field] = []
    for line in text.splitlines():
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        match = _LINE.fullmatch(line)
        if match is None:
            raise RecordingError(f"the recording's schema has a field not written by haptorb: {quote(line)}")
        width = int(match["width"] or 1)
        if not 1 <= width + sum(field.width for field in fields) <= _WIDEST or width < 1:
            raise RecordingError(
                f"the recording's schema has more than {_WIDEST} numbers in a row, or none: {quote(line)}"
            )
        if match["name"] in {field.name for field in fields}:
            raise RecordingError(f"the recording's schema has the field '{match['name']}' twice")
        unit, about = foreign_text(match["unit"] or "", 40), foreign_text(match["about"] or "", 1000)
        fields.append(Field(match["name"], width, unit, about))
    return tuple(fields)
