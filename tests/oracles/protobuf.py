"""Reads protobuf messages by their transmitted schema, without the sender's code.

Wire format and descriptors: https://protobuf.dev/programming-guides/encoding/ and descriptor.proto.
"""

from __future__ import annotations

import struct
from typing import Any

Raw = dict[int, list[Any]]

_DOUBLE, _FLOAT, _STRING, _MESSAGE, _BYTES = 1, 2, 9, 11, 12
_REPEATED = 3


def read_raw(data: bytes) -> Raw:
    """Field number → values: whole numbers for varints, bytes for all others."""
    found: Raw = {}
    at = 0
    while at < len(data):
        key, at = _read_varint(data, at)
        match key & 7:
            case 0:
                value, at = _read_varint(data, at)
            case 1:
                value, at = data[at : at + 8], at + 8
            case 2:
                size, at = _read_varint(data, at)
                value, at = data[at : at + size], at + size
            case 5:
                value, at = data[at : at + 4], at + 4
            case other:
                raise ValueError(f"wire type {other}")
        assert at <= len(data), "a message ends within a field"
        found.setdefault(key >> 3, []).append(value)
    return found


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
        shift += 7


class Schema:
    """The message types of a FileDescriptorSet."""

    def __init__(self, descriptors: bytes) -> None:
        self._types: dict[str, list[tuple[int, str, int, bool, str]]] = {}
        for file in read_raw(descriptors).get(1, []):
            parts = read_raw(file)
            package = parts.get(2, [b""])[0].decode()
            for message in parts.get(4, []):
                self._add(f".{package}", message)

    def _add(self, scope: str, message: bytes) -> None:
        parts = read_raw(message)
        name = f"{scope}.{parts[1][0].decode()}"
        fields = [read_raw(field) for field in parts.get(2, [])]
        self._types[name] = [
            (f[3][0], f[1][0].decode(), f[5][0], f.get(4, [1])[0] == _REPEATED, f.get(6, [b""])[0].decode())
            for f in fields
        ]
        for nested in parts.get(3, []):
            self._add(name, nested)

    def read(self, name: str, data: bytes) -> dict[str, Any]:
        """The message `data` of the type `name`, such as "foxglove.Log": fields by name; absent: 0 or None."""
        raw, found = read_raw(data), {}
        fields = self._types[f".{name.lstrip('.')}"]
        assert set(raw) <= {number for number, *_ in fields}, "a field that the schema does not have"
        for number, key, kind, repeated, type_name in fields:
            values = self._list_values(raw.get(number, []), kind, type_name)
            absent = None if kind == _MESSAGE else "" if kind == _STRING else 0
            found[key] = values if repeated else (values[-1] if values else absent)
        return found

    def _list_values(self, values: list[Any], kind: int, type_name: str) -> list[Any]:
        form = {_DOUBLE: "<d", _FLOAT: "<f", 7: "<I", 15: "<i", 6: "<Q", 16: "<q"}.get(kind)
        found: list[Any] = []
        for value in values:
            if kind == _MESSAGE:
                found.append(self.read(type_name, value))
            elif kind == _STRING:
                found.append(value.decode())
            elif form is not None:
                found += [one for (one,) in struct.iter_unpack(form, value)]  # packed, or one
            elif isinstance(value, bytes) and kind != _BYTES:
                at = 0
                while at < len(value):
                    one, at = _read_varint(value, at)
                    found.append(one)
            else:
                found.append(value)
        return found
