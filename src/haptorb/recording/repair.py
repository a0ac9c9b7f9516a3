"""Repair of a damaged or truncated recording: copies every readable row and metadata record, with a new index."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

from haptorb.errors import RecordingError
from haptorb.files import replace_file
from haptorb.recording.mcap import CHUNK, ENCODING, MESSAGE_ENCODING, NAME, TOPIC, Block, describe_fields
from haptorb.recording.recording import Recording, list_losses
from haptorb.version import __version__

__all__ = ["check_place", "repair_recording"]


def check_place(source: Path, out: Path, *, overwrite: bool) -> None:
    """Raise RecordingError unless `out` can be written and is not the file `source`."""
    try:
        if out.exists() and source.exists() and out.samefile(source):  # safety: repair-keeps-input
            raise RecordingError(f"{out} is the recording itself: choose another name for the repaired one")
        if out.exists() and not overwrite:
            text = f"{out} exists; choose another name, or replace it"
            raise RecordingError(f"{text} with overwrite=True", command=f"{text} with --force")
        if out.is_dir() or not out.parent.is_dir():
            raise RecordingError(f"cannot write {out}: name a file in a folder that exists")
    except OSError as cause:
        raise RecordingError(f"cannot write {out}: {cause.strerror}") from cause


def repair_recording(
    recording: Recording, out: Path, report: Callable[[float], None] = lambda share: None, *, overwrite: bool = False
) -> None:
    """Copy the readable rows, messages of other topics and metadata records of `recording` to `out`, atomically.

    Times and sequence numbers are kept. The metadata record "haptorb/repair" of `out` states the losses. `report`
    receives the completed fraction.

    Raises RecordingError if `out` is the recording itself, exists and `overwrite` is not set, or cannot be written.
    """
    check_place(recording.path, out, overwrite=overwrite)
    recording.check()
    try:
        with replace_file(out) as part, part.open("wb") as file:
            writer = Writer(file, chunk_size=CHUNK, compression=CompressionType.ZSTD)
            writer.start(profile="ros2", library=f"haptorb {__version__}")
            _copy_messages(recording, writer, report)
            for name, values in recording.notes:
                writer.add_metadata(name, values)
            losses = {
                "of": recording.path.name,
                "rows": str(len(recording)),
                "damage": "; ".join(list_losses(recording)),
            }
            writer.add_metadata("haptorb/repair", losses)
            writer.finish()  # type: ignore[no-untyped-call]
    except OSError as cause:
        raise RecordingError(f"cannot write {out}: {cause.strerror or cause}") from cause


def _copy_messages(recording: Recording, writer: Writer, report: Callable[[float], None]) -> None:
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    rows, done = max(len(recording), 1), 0
    known: dict[int, Schema] = {}

    def add_channel(one: Channel) -> None:
        if one.schema_id not in schemas and one.schema_id in known:
            kind = known[one.schema_id]
            schemas[one.schema_id] = writer.register_schema(kind.name, kind.encoding, kind.data)
        if one.id not in channels and one.schema_id in schemas:
            channels[one.id] = writer.register_channel(
                one.topic, one.message_encoding, schemas[one.schema_id], dict(one.metadata)
            )

    for number, contents in enumerate(recording.list_contents()):
        if number == 0:
            # The fields that the reader has determined; one of the schema's copies in the file may be damaged.
            schema = writer.register_schema(NAME, ENCODING, describe_fields(recording.fields).encode())
            channels[recording.channel] = writer.register_channel(TOPIC, MESSAGE_ENCODING, schema)
        for one in contents:
            if isinstance(one, Schema):
                known[one.id] = one
            elif isinstance(one, Channel):
                add_channel(one)
            elif isinstance(one, Block) and one.channel in channels:
                done += _write_block(writer, channels[one.channel], one)
        report(min(done / rows, 1.0))


def _write_block(writer: Writer, channel: int, block: Any) -> int:
    for sequence, log_time, publish_time, data in block.messages():
        writer.add_message(channel, log_time, data, publish_time, sequence)
    return len(block.records)
