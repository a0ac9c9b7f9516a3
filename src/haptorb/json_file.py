"""Strict parsing of JSON files: one format, with all of its keys and no others."""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import CalibrationError, quote
from haptorb.files import parse_json

__all__ = ["numbers", "parse_document"]

_MAX_NUMBER = 1e15  #: largest accepted value in SI units: above measured values, and products do not overflow


def parse_document(
    text: str, name: str, kind: str, wanted: str, keys: Set[str], remedy: str, optional: Set[str] = frozenset()
) -> Mapping[str, Any]:
    """Parse `text`, a `kind` of format `wanted` with `keys`; `name` is the file's name in messages.

    `optional` keys may be missing, in files of an older version.

    Raises CalibrationError, with the remedy, for anything else.

    >>> parse_document('{"format": "a 1", "x": 2}', "FILE", "a", "a 1", {"format", "x"}, "make it again")["x"]
    2
    """
    try:
        raw = parse_json(text)
    except ValueError as cause:
        raise CalibrationError(f"{name} is not JSON: {cause}") from cause
    if not isinstance(raw, Mapping) or raw.get("format") != wanted:
        found = raw.get("format") if isinstance(raw, Mapping) else type(raw).__name__
        raise CalibrationError(
            f"{name} is not a {kind} that this version can read: format must be '{wanted}'; got {quote(found)}"
        )
    missing, strange = keys - set(raw), set(raw) - keys - optional
    if missing or strange:
        what = f"{min(missing)} is missing" if missing else f"{quote(min(strange))} is not a known key"
        raise CalibrationError(f"{name}: {what}; {remedy}")
    return raw


def numbers(raw: Mapping[str, Any], key: str, name: str, shape: tuple[int | None, ...]) -> Array:
    """Return the array of `shape`, such as (3, 3) or (3, n) with None for n, that `raw` has under `key` [SI].

    `name` is the file's name in messages.

    Raises CalibrationError unless they are finite numbers of that shape and of a plausible size.
    """
    if not _numeric(raw[key]):
        raise CalibrationError(f"{name}: {key} must be numbers; got {quote(raw[key])}")
    try:
        values = np.array(raw[key], dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as cause:
        raise CalibrationError(f"{name}: {key} must be numbers; got {quote(raw[key])}") from cause
    fits = values.ndim == len(shape) and all(want in (None, got) for want, got in zip(shape, values.shape, strict=True))
    if not fits or not (np.abs(values) <= _MAX_NUMBER).all():
        raise CalibrationError(f"{name}: {key} must be finite numbers of shape {shape}; got shape {values.shape}")
    return values


def _numeric(value: Any) -> bool:
    """Whether all elements are numbers or null; numpy would also accept texts and booleans."""
    if isinstance(value, list):
        return all(_numeric(part) for part in value)
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))
