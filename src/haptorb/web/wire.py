"""The binary frames between page and server: one header of 48 bytes, then plain little-endian arrays.

The page's own copy of this description is `web/src/wire.ts`; the browser tests fail if they differ.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import InputError
from haptorb.recording.export import column_heads
from haptorb.recording.row import RowLayout

__all__ = ["COLUMNS", "Columns", "Pointer", "encode_force_frame", "mesh_frame", "pointer", "rows_frame"]

MAGIC = 0x48_4F_52_42  #: "HORB", read as a little-endian number
VERSION = 1
ROWS, MESH, FORCE_MAP = 1, 2, 3

#: magic, kind, version, count, width, t0, tick0, echo, dropped
_HEADER = struct.Struct("<IHHIIdddd")
_POINTER = struct.Struct("<9d")

#: what the page shows of a row, in this order; `t` and `tick` are sent relative to the header's t0 and tick0
COLUMNS = (
    *("t", "tick", "lateness", "missed", "guard", "trip", "coil_state", "gain", "world", "model", "valid", "age"),
    *("p", "q", "target", "target_q", "asked", "given", "wanted", "currents", "winding", "remaining"),
    *("saturated", "part", "memory"),
)

#: what it shows besides of a mover that moves a target through modes
MODED = ("mode", "engaged", "share", "object", "object_q", "object_wrench", "contacts")

#: a pose further away than this is not a hand at a device on a table [m]
REACH = 1.0


@dataclass(frozen=True)
class Columns:
    """Which numbers of a servo's row go to the page, and where they lie in a frame's row."""

    layout: RowLayout
    moded: bool = False  #: whether the device has modes, and a target

    @property
    def names(self) -> tuple[str, ...]:
        """The columns in their order."""
        return COLUMNS + MODED if self.moded else COLUMNS

    @property
    def index(self) -> Array:
        """(width,) positions in the servo's row."""
        return np.concatenate([np.arange(self.layout.width)[self.layout[name]] for name in self.names])

    def describe(self) -> list[dict[str, object]]:
        """Name, offset, width, unit, meaning and headings of each column, as the page reads them."""
        fields = {field.name: field for field in self.layout.fields}
        described, offset = [], 0
        for name in self.names:
            field = fields[name]
            facts = {"name": name, "offset": offset, "width": field.width, "unit": field.unit, "about": field.about}
            described.append({**facts, "heads": list(column_heads(field))})
            offset += field.width
        return described


def rows_frame(rows: Array, index: Array, t: int, tick: int, echo: float, dropped: int) -> bytes:
    """Every tick's sample of `rows` (n, width): columns `index` as float32.

    t, tick   columns of time and tick in the servo's row: sent as differences, for float32 cannot count an hour of
              milliseconds
    echo      the page's own time stamp of the pointer event that the newest row answers, NaN for none
    dropped   rows that this page never got because it was too slow, in total
    """
    t0, tick0 = rows[0, t], rows[0, tick]
    chosen = rows[:, index].copy()
    chosen[:, 0] -= t0
    chosen[:, 1] -= tick0
    header = _HEADER.pack(MAGIC, ROWS, VERSION, len(rows), len(index), t0, tick0, echo, dropped)
    return header + chosen.astype("<f4").tobytes()


def mesh_frame(directions: Array, triangles: Array) -> bytes:
    """The dome's vertices as unit vectors (n, 3) and its triangles (m, 3)."""
    header = _HEADER.pack(MAGIC, MESH, VERSION, len(directions), len(triangles), 0.0, 0.0, math.nan, 0.0)
    return header + directions.astype("<f4").tobytes() + triangles.astype("<u4").tobytes()


def encode_force_frame(force: Array, saturated: np.ndarray[tuple[int], np.dtype[np.bool_]], version: int) -> bytes:
    """The radial force (n,) [N] at each vertex, outward positive, and whether the device is at its limit there."""
    header = _HEADER.pack(MAGIC, FORCE_MAP, VERSION, len(force), 0, float(version), 0.0, math.nan, 0.0)
    return header + force.astype("<f4").tobytes() + saturated.astype(np.uint8).tobytes()


@dataclass(frozen=True)
class Pointer:
    """Where the page's pointer wants the mover."""

    stamp: float  #: the page's clock at the pointer's event [ms]; NaN: a refresh that wants no answer
    p: Array  #: (3,) [m]
    q: Array | None  #: (4,) quaternion (x, y, z, w), or None: the device's own way of holding it
    held: bool  #: True while a hand is on it, False when it was released and rests there


def pointer(message: bytes) -> Pointer:
    """The pointer in `message`; InputError if it is not one, not finite, or out of reach."""
    if len(message) != _POINTER.size:
        raise InputError(f"a pointer message has {_POINTER.size} bytes; got {len(message)}")
    stamp, x, y, z, *turned, held = _POINTER.unpack(message)
    p, q = np.array((x, y, z)), np.array(turned)
    if not math.hypot(x, y, z) <= REACH:
        raise InputError(f"a pointer's position must be finite and within {REACH:g} m; got {p.tolist()} m")
    if math.isinf(stamp):
        raise InputError("a pointer's time stamp must be finite, or NaN for none")
    if np.isnan(q).all():
        return Pointer(stamp, p, None, held == 1.0)
    if not abs(math.hypot(*turned) - 1) <= 1e-3:
        raise InputError(f"a pointer's orientation must be a unit quaternion; got {turned}")
    return Pointer(stamp, p, q, held == 1.0)
