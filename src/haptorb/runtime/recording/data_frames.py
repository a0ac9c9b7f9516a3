"""A recording for pandas and xarray, with the unit of every number in `attrs`.

Neither package is loaded, or needed, before the first call.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from haptorb.errors import InputError
from haptorb.files.foreign_text import foreign_text
from haptorb.numerics.arrays import Array
from haptorb.runtime.row import STAGES, Field

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

__all__ = ["column_heads", "column_names", "describe_notes", "make_data_frame", "make_dataset", "units_of"]

_PLACE, _TURN, _WRENCH = ("x", "y", "z"), ("x", "y", "z", "w"), ("F_x", "F_y", "F_z", "T_x", "T_y", "T_z")
_HOOK = ("deflection", "place", "point_x", "point_y", "point_z", "force_x", "force_y", "force_z")
#: fields with parts that have names: field → (dimension, names of the parts)
_PARTS: dict[str, tuple[str, tuple[str, ...]]] = {
    **dict.fromkeys(("p", "v", "w", "target", "object"), ("axis", _PLACE)),
    **dict.fromkeys(("q", "target_q", "object_q"), ("quaternion", _TURN)),
    **dict.fromkeys(("asked", "modelled", "given", "object_wrench"), ("component", _WRENCH)),
    "stages": ("stage", STAGES),
    "share": ("motion", ("translation", "rotation")),
    "contacts": ("hook", tuple(f"{part}_{hook}" for hook in (1, 2) for part in _HOOK)),
}
_CHANNELS = frozenset({"wanted", "currents", "duties", "resistance", "boundary", "winding"})


class RecordingNotes(Protocol):
    """What says of a recording how it was made."""

    path: Path
    truncated: bool
    damage: tuple[str, ...]

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """The device, the run and the versions."""


class Rows(RecordingNotes, Protocol):
    """What is read of a recording."""

    @property
    def columns(self) -> tuple[Field, ...]:
        """The fields, the memory of worlds by its own names."""

    def read(self, first: int, last: int, fields: Sequence[str]) -> Array:
        """(last − first, k) those columns side by side, in their own units [SI]."""

    def __len__(self) -> int:
        """Rows recorded."""


def units_of(field: Field) -> tuple[str, ...]:
    """The unit of each number of `field`: a wrench's "N, N·m" are three forces and three torques.

    >>> units_of(Field("asked", 6, "N, N·m", ""))
    ('N', 'N', 'N', 'N·m', 'N·m', 'N·m')
    """
    units = tuple(field.unit.split(", "))
    if len(units) == 1:
        return units * field.width
    if len(units) == 2 and field.width % 6 == 0:
        return tuple(unit for unit in units for _ in range(3)) * (field.width // 6)
    if len(units) == 4 and field.width % 8 == 0:  # of a hook: two lengths, a place, a force
        return tuple(unit for unit, many in zip(units, (1, 1, 3, 3), strict=True) for _ in range(many)) * (
            field.width // 8
        )
    return (field.unit,) * field.width


def column_names(field: Field) -> tuple[str, ...]:
    """The name of each number of `field`, in tables.

    >>> column_names(Field("p", 3, "m", ""))
    ('p[0]', 'p[1]', 'p[2]')
    """
    return (field.name,) if field.width == 1 else tuple(f"{field.name}[{i}]" for i in range(field.width))


def column_heads(field: Field) -> tuple[str, ...]:
    """The heading of each number of `field` in a CSV file: name, and the unit where there is one.

    >>> column_heads(Field("p", 3, "m", ""))[2], column_heads(Field("tick", 1, "1", ""))
    ('p[2] [m]', ('tick',))
    """
    pairs = zip(column_names(field), units_of(field), strict=True)
    return tuple(f"{name} [{unit}]" if unit not in ("", "1") else name for name, unit in pairs)


def make_data_frame(recording: Rows) -> DataFrame:
    """A DataFrame of all rows (n, width), one column per number; see `Recording.to_pandas`.

    Units [SI] are in `attrs`. Raises InputError if pandas is not there.
    """
    try:
        import pandas
    except ImportError as cause:
        raise InputError(f"to_pandas needs pandas ({cause}): pip install 'haptorb[notebook]'") from cause
    names, units, about = [], {}, {}
    for field in recording.columns:
        for name, unit in zip(column_names(field), units_of(field), strict=True):
            names.append(name)
            units[name], about[name] = unit, field.about
    numbers = recording.read(0, len(recording), [field.name for field in recording.columns])
    frame = pandas.DataFrame(numbers, columns=names)
    if "t" in names:
        frame = frame.set_index("t")
    frame.attrs = {**describe_notes(recording), "units": units, "about": about}
    return frame


def make_dataset(recording: Rows) -> Dataset:
    """A Dataset over `t` (n,) [s], one variable per field; see `Recording.to_xarray`.

    Raises InputError if xarray is not installed.
    """
    try:
        import xarray
    except ImportError as cause:
        raise InputError(f"to_xarray needs xarray ({cause}): pip install 'haptorb[notebook]'") from cause
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    start, numbers = 0, recording.read(0, len(recording), [field.name for field in recording.columns])
    for field in recording.columns:
        attributes = {"units": field.unit, "long_name": field.about}
        values = numbers[:, start] if field.width == 1 else numbers[:, start : start + field.width]
        start += field.width
        if field.name == "t":
            coordinates["t"] = ("t", values, attributes)
            continue
        if values.ndim == 1:
            variables[field.name] = ("t", values, attributes)
            continue
        dimension, labels = _PARTS.get(field.name, ("", ()))
        if len(labels) == field.width:
            coordinates[dimension] = (dimension, list(labels))
        else:
            dimension = "channel" if field.name in _CHANNELS else f"{field.name}_part"
            if field.name in _CHANNELS:
                coordinates[dimension] = (dimension, list(range(1, field.width + 1)))
        variables[field.name] = (("t", dimension), values, attributes)
    return xarray.Dataset(variables, coordinates, describe_notes(recording))


def describe_notes(recording: RecordingNotes) -> dict[str, str]:
    """What ran, for the metadata of a table: file, device, driver, rate [Hz] and model, and what is missing of it."""
    device, run = recording.metadata.get("device", {}), recording.metadata.get("run", {})
    known = {
        "recording": recording.path.name,
        "device": device.get("name", ""),
        "driver": run.get("driver", ""),
        "rate_hz": run.get("rate_hz", ""),
        "model": run.get("model", ""),
        "damage": "; ".join(recording.damage),
        "truncated": "true" if recording.truncated else "",
        "repaired": recording.metadata.get("repair", {}).get("damage", ""),
    }
    return {key: foreign_text(value) for key, value in known.items() if value}
