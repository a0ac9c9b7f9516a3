"""What a recording's file says beside its rows: their fields, the notes, and whether the file has an end."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from mcap.records import Channel, Footer, Metadata, Schema
from numpy.typing import NDArray

from haptorb.errors import RecordingError
from haptorb.numerics.arrays import Array
from haptorb.runtime.recording.mcap_rows import Block, open_messages
from haptorb.runtime.recording.mcap_schema import CDR_HEADER, NAME, TOPIC, fields_of
from haptorb.runtime.row import Field

__all__ = ["Contents"]


@final
class Contents:
    """Collects the records of a file, in order; `add` hands over the rows of the haptorb topic.

    fields     as the file's own schema describes them; none before its channel was read
    notes      every metadata record: (name, values), in order
    width      numbers in a row
    truncated  no end was found: the recorder was killed, or still writes
    """

    def __init__(self) -> None:
        self.fields: tuple[Field, ...] = ()
        self.width = 0
        self.notes: list[tuple[str, dict[str, str]]] = []
        self.truncated = True
        self._schemas: dict[int, Schema] = {}
        self._channel = -1

    def add(self, found: Any) -> Array | None:
        """Take a record in; (n, width) rows if it holds some, numbers in the units [SI] of their fields.

        Raises RecordingError if the topic is of another kind, or there twice.
        """
        if isinstance(found, Block) and found.channel == self._channel and self.fields:
            return self._decode(found.data)
        if isinstance(found, Schema):
            self._schemas[found.id] = found
        elif isinstance(found, Channel) and found.topic == TOPIC:
            self._take_channel(found)
        elif isinstance(found, Metadata):
            self.notes.append((found.name, dict(found.metadata)))
        elif isinstance(found, Footer):
            self.truncated = False
        return None

    def open_rows(self, data: bytes) -> Array | None:
        """(n, width) the rows of the chunk `data` [SI], if there is nothing else in it; None otherwise."""
        messages = open_messages(data, self._channel, len(CDR_HEADER) + 8 * self.width) if self.fields else None
        return None if messages is None else self._decode(messages)

    def _take_channel(self, channel: Channel) -> None:
        kind = self._schemas.get(channel.schema_id)
        if kind is None or kind.name != NAME:
            raise RecordingError(f"topic {TOPIC} is not of type {NAME}; another program wrote it")
        fields = fields_of(kind.data.decode("utf-8", "replace"))
        if self.fields and fields != self.fields:
            raise RecordingError(f"topic {TOPIC} appears twice, with different fields")
        self.fields, self._channel = fields, channel.id
        self.width = sum(field.width for field in fields)

    def _decode(self, block: NDArray[np.uint8]) -> Array:
        """Rows (n, width) from messages (n, bytes): four bytes of CDR header, then the row itself."""
        if block.shape[1] != len(CDR_HEADER) + 8 * self.width:
            raise RecordingError(f"a message has {block.shape[1]} bytes; its schema says {4 + 8 * self.width}")
        decoded: Array = np.ascontiguousarray(block[:, len(CDR_HEADER) :]).view("<f8")
        return decoded
