"""What Foxglove receives about a topic before its first message: its name, and how its messages are read."""

from __future__ import annotations

import json
from base64 import b64encode
from dataclasses import dataclass
from typing import Any, final

__all__ = ["Topic", "make_json_schema", "make_topic"]

_TIME = {"type": "object", "title": "time", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}


@final
@dataclass(frozen=True)
class Topic:
    """A topic's name, the encoding of its messages, and their schema with its own encoding; `schema` is text."""

    name: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: str

    def describe(self, number: int) -> dict[str, Any]:
        """The channel `number`, as the protocol's message `advertise` has it."""
        return {
            "id": number,
            "topic": self.name,
            "encoding": self.encoding,
            "schemaName": self.schema_name,
            "schemaEncoding": self.schema_encoding,
            "schema": self.schema,
        }


def make_topic(name: str, kind: Any) -> Topic:
    """The topic of messages of one of Foxglove's own types, a class of `foxglove.messages`."""
    schema = kind.get_schema()
    return Topic(name, "protobuf", schema.name, schema.encoding, b64encode(schema.data).decode())


def make_json_schema(name: str, title: str, properties: dict[str, Any]) -> Topic:
    """The topic of JSON objects with these `properties` and a `timestamp` (sec, nsec since 1970-01-01 UTC)."""
    schema = {"title": title, "type": "object", "properties": {"timestamp": _TIME, **properties}}
    return Topic(name, "json", title, "jsonschema", json.dumps(schema, ensure_ascii=False))
