"""Binary frames between page and server: a header of 48 bytes, then little-endian arrays.

The page's copy of this format is `web/src/wire.ts`; the browser tests fail if the two differ.
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

__all__ = ["COLUMNS", "Columns", "PointerMessage", "encode_force_frame", "mesh_frame", "pointer", "rows_frame"]

MAGIC = 0x48_4F_52_42  #: "HORB" as a little-endian integer
VERSION = 1
ROWS, MESH, FORCE_MAP = 1, 2, 3

#: magic, kind, version, count, width, t0, tick0, echo, dropped
_HEADER = struct.Struct("<IHHIIdddd")
_POINTER = struct.Struct("<9d")

#: columns sent to the page, in this order; `t` and `tick` are sent relative to the header's t0 and tick0
COLUMNS = (
    *("t", "tick", "lateness", "missed", "guard", "trip", "coil_state", "gain", "world", "model", "valid", "age"),
    *(
        "p",
        "q",
        "hand_goal",
        "hand_goal_q",
        "wrench_commanded",
        "wrench_actual",
        "current_commanded",
        "current_measured",
        "winding",
        "remaining",
    ),
    *("saturated", "part", "memory"),
)

#: further columns of a device with modes, whose mover moves an object
MODED = ("mode", "engaged", "clutch_share", "object", "object_q", "object_wrench", "contacts")

#: largest distance of a valid pointer pose from the origin [m]
MAX_DISTANCE_M = 1.0


@dataclass(frozen=True)
class Columns:
    """Columns of a servo's row that are sent to the page, and their layout in a frame."""

    layout: RowLayout
    moded: bool = False  #: whether the device has modes, and an object

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, in order."""
        return COLUMNS + MODED if self.moded else COLUMNS

    @property
    def index(self) -> Array:
        """Indices (width,) of the columns in the servo's row."""
        return np.concatenate([np.arange(self.layout.width)[self.layout[name]] for name in self.names])

    def describe(self) -> list[dict[str, object]]:
        """Name, offset, width, unit, meaning and headings of each column, in the format of the page."""
        fields = {field.name: field for field in self.layout.fields}
        described, offset = [], 0
        for name in self.names:
            field = fields[name]
            facts = {"name": name, "offset": offset, "width": field.width, "unit": field.unit, "about": field.about}
            described.append({**facts, "heads": list(column_heads(field))})
            offset += field.width
        return described


def rows_frame(rows: Array, index: Array, t: int, tick: int, echo: float, dropped: int) -> bytes:
    """Encode `rows` (n, width): columns `index` as float32.

    t, tick   columns of time and tick in the servo's row: sent relative to the first row, because float32 cannot
              resolve milliseconds over an hour
    echo      the page's time stamp of the pointer event that the newest row answers; NaN: none
    dropped   total of rows that were not sent because this page was too slow
    """
    t0, tick0 = rows[0, t], rows[0, tick]
    chosen = rows[:, index].copy()
    chosen[:, 0] -= t0
    chosen[:, 1] -= tick0
    header = _HEADER.pack(MAGIC, ROWS, VERSION, len(rows), len(index), t0, tick0, echo, dropped)
    return header + chosen.astype("<f4").tobytes()


def mesh_frame(directions: Array, triangles: Array) -> bytes:
    """Encode the mesh of the dome: vertices as unit vectors (n, 3) and triangles (m, 3)."""
    header = _HEADER.pack(MAGIC, MESH, VERSION, len(directions), len(triangles), 0.0, 0.0, math.nan, 0.0)
    return header + directions.astype("<f4").tobytes() + triangles.astype("<u4").tobytes()


def encode_force_frame(force: Array, saturated: np.ndarray[tuple[int], np.dtype[np.bool_]], version: int) -> bytes:
    """Encode the force map: radial force (n,) [N] per vertex, outward positive, and whether a limit is reached."""
    header = _HEADER.pack(MAGIC, FORCE_MAP, VERSION, len(force), 0, float(version), 0.0, math.nan, 0.0)
    return header + force.astype("<f4").tobytes() + saturated.astype(np.uint8).tobytes()


@dataclass(frozen=True)
class PointerMessage:
    """Hand goal from the page's pointer."""

    stamp: float  #: the page's time of the pointer event [ms]; NaN: a refresh without echo
    p: Array  #: (3,) [m]
    q: Array | None  #: (4,) quaternion (x, y, z, w), or None: the device's default orientation
    held: bool  #: True during a drag, False when released at rest


def pointer(message: bytes) -> PointerMessage:
    """Decode a pointer message. Raises InputError if it is malformed, not finite or out of reach."""
    if len(message) != _POINTER.size:
        raise InputError(f"a pointer message has {_POINTER.size} bytes; got {len(message)}")
    stamp, x, y, z, *turned, held = _POINTER.unpack(message)
    p, q = np.array((x, y, z)), np.array(turned)
    if not math.hypot(x, y, z) <= MAX_DISTANCE_M:
        raise InputError(f"a pointer's position must be finite and within {MAX_DISTANCE_M:g} m; got {p.tolist()} m")
    if math.isinf(stamp):
        raise InputError("a pointer's time stamp must be finite, or NaN for none")
    if np.isnan(q).all():
        return PointerMessage(stamp, p, None, held == 1.0)
    if not abs(math.hypot(*turned) - 1) <= 1e-3:
        raise InputError(f"a pointer's orientation must be a unit quaternion; got {turned}")
    return PointerMessage(stamp, p, q, held == 1.0)
