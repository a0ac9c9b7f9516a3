"""Snapshots of the loop's state in a recording: named arrays of fixed types, in two kinds of metadata.

`haptorb/state_layout`, once, before the first state: `arrays`, JSON, a list of [name, type, shape]. Types are `<f8`,
`<i8` and `|b1`. `haptorb/state`: `tick`, after which it was so, and `arrays`: base64 of zlib of all arrays of the
layout in turn, in C order and without gaps.

Recordings are untrusted: everything is checked before an array is made, and nothing but arrays is made.
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
_MAX_STATE_BYTES: Final = 4_000_000  #: bytes of a state
_ARRAYS: Final = 4096
_TEXT: Final = 1_000_000  #: characters of a layout
_SIZES: Final = {"<f8": 8, "<i8": 8, "|b1": 1}


def describe_arrays(arrays: Mapping[str, NDArray[Any]]) -> str:
    """The layout of `arrays`, for the note."""
    return json.dumps([[name, one.dtype.str, list(one.shape)] for name, one in arrays.items()])


def pack_arrays(arrays: Mapping[str, NDArray[Any]]) -> str:
    """The numbers of `arrays`, for the note."""
    return b64encode(zlib.compress(b"".join(one.tobytes() for one in arrays.values()))).decode()


def unpack_arrays(layout: str, text: str) -> dict[str, NDArray[Any]]:
    """The arrays that `describe_arrays` and `pack_arrays` wrote, each number in its own unit.

    Raises RecordingError for anything else.
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
    """Name, type, shape and bytes of each array. Raises ValueError."""
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
    """Whether it is [name, type, shape] with a type that a state may have, and a shape without tricks."""
    match entry:
        case [str(), str(kind), list(shape)]:
            return (
                kind in _SIZES and len(shape) <= 8 and all(type(n) is int and 0 <= n <= _MAX_STATE_BYTES for n in shape)
            )
    return False
