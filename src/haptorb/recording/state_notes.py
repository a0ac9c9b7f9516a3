"""Snapshots of the loop's state in a recording: named arrays of fixed types, in two kinds of metadata records.

`haptorb/state_layout` is written once, before the first snapshot. Its `arrays` is a JSON list of [name, type, shape];
the types are `<f8`, `<i8` and `|b1`. `haptorb/state` is one snapshot: `tick` is the tick after which it was taken, and
`arrays` is base64 of the zlib-compressed arrays in the order of the layout, C-contiguous and without padding.

Recordings are untrusted: everything is checked before an array is created, and no other objects are created.
"""

from __future__ import annotations

import json
import zlib
from base64 import b64decode, b64encode
from collections.abc import Mapping
from math import prod
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from haptorb.errors import RecordingError

__all__ = ["LAYOUT_NOTE", "STATE_NOTE", "describe_arrays", "pack_arrays", "unpack_arrays"]

LAYOUT_NOTE: Final = "state_layout"
STATE_NOTE: Final = "state"
_MAX_STATE_BYTES: Final = 4_000_000  #: limit of the size of a snapshot [bytes]
_ARRAYS: Final = 4096  #: limit of the number of arrays in a layout
_TEXT: Final = 1_000_000  #: limit of the length of a layout [characters]
_SIZES: Final = {"<f8": 8, "<i8": 8, "|b1": 1}


def describe_arrays(arrays: Mapping[str, NDArray[Any]]) -> str:
    """Encode names, types and shapes of `arrays` for `haptorb/state_layout`."""
    return json.dumps([[name, one.dtype.str, list(one.shape)] for name, one in arrays.items()])


def pack_arrays(arrays: Mapping[str, NDArray[Any]]) -> str:
    """Encode the values of `arrays` for `haptorb/state`."""
    return b64encode(zlib.compress(b"".join(one.tobytes() for one in arrays.values()))).decode()


def unpack_arrays(layout: str, text: str) -> dict[str, NDArray[Any]]:
    """Decode the arrays from the texts that `describe_arrays` and `pack_arrays` wrote, in their original units.

    Raises RecordingError for any other text.
    """
    try:
        entries = _read_layout(layout)
        total = sum(size for _, _, _, size in entries)
        if total > _MAX_STATE_BYTES:
            raise ValueError(f"its arrays are {total} bytes long")
        content = zlib.decompressobj().decompress(b64decode(text, validate=True), total + 1)
        if len(content) != total:  # safety: state-length
            raise ValueError(f"its arrays are {total} bytes long, and there are {len(content)}")
        found: dict[str, NDArray[Any]] = {}
        at = 0
        for name, kind, shape, size in entries:
            piece = content[at : at + size]
            if kind == "|b1" and not set(piece) <= {0, 1}:
                raise ValueError(f"'{name}' is neither true nor false")
            found[name] = np.frombuffer(piece, kind).reshape(shape)
            at += size
    except (ValueError, zlib.error, RecursionError) as cause:
        raise RecordingError(f"a state of the loop in the recording was not written by haptorb: {cause}") from cause
    return found


def _read_layout(text: str) -> list[tuple[str, str, tuple[int, ...], int]]:
    """Name, type, shape and size [bytes] of each array. Raises ValueError for an invalid layout."""
    if len(text) > _TEXT:
        raise ValueError("its layout is too long")
    raw = json.loads(text)
    if not isinstance(raw, list) or len(raw) > _ARRAYS:
        raise ValueError("its layout is no list of arrays")
    found = []
    for entry in raw:
        if not _is_array(entry):  # safety: state-types
            raise ValueError("its layout has an entry that is no array of numbers")
        name, kind, shape = entry
        size = _SIZES[kind] * prod(shape)
        if size > _MAX_STATE_BYTES:
            raise ValueError(f"'{name[:100]}' is {size} bytes long")
        found.append((name, kind, tuple(shape), size))
    if len({name for name, _, _, _ in found}) < len(found):
        raise ValueError("its layout has a name twice")
    return found


def _is_array(entry: Any) -> bool:
    """Whether `entry` is [name, type, shape] with one of the three types and a valid shape."""
    match entry:
        case [str(), str(kind), list(shape)]:
            return (
                kind in _SIZES and len(shape) <= 8 and all(type(n) is int and 0 <= n <= _MAX_STATE_BYTES for n in shape)
            )
    return False
