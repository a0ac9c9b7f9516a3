"""What a replay has computed, as a recording: the notes of the recorded run, and what was replaced in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import final

from haptorb.errors import RecordingError
from haptorb.files.replace_file import replace_file
from haptorb.numerics.arrays import Array
from haptorb.runtime.recording.recorder import Recorder
from haptorb.runtime.recording.recording import Recording
from haptorb.runtime.recording.state_notes import LAYOUT_NOTE, STATE_NOTE
from haptorb.runtime.row import RowLayout

__all__ = ["ReplayFile", "check_replay_file", "write_replay"]

_OWN = frozenset(
    {
        "haptorb/layout",
        "haptorb/clock",
        "haptorb/end",
        "haptorb/gap",
        "haptorb/pause",
        "haptorb/resume",
        "haptorb/world",
        "haptorb/run",
    }
)

_STATES = frozenset({f"haptorb/{LAYOUT_NOTE}", f"haptorb/{STATE_NOTE}"})  #: of the recorded run, and of no other


def check_replay_file(path: Path, *, overwrite: bool) -> Path:
    """`path`, if a recording can be written there. Raises RecordingError if it exists and `overwrite` is not set."""
    if path.exists() and not overwrite:
        text = f"{path} exists; choose another name, or replace it"
        raise RecordingError(f"{text} with overwrite=True", command=f"{text} with --force")
    if path.is_dir() or not path.parent.is_dir():
        raise RecordingError(f"cannot write {path}: name a file in a folder that exists")
    return path


@final
class ReplayFile:
    """Writes rows of `layout` to the open `recorder`, with the notes of `recording` and those of the replay."""

    def __init__(
        self, recorder: Recorder, recording: Recording, rate: float, replaced: Mapping[str, str], world: str
    ) -> None:
        self._recorder = recorder
        for name, values in recording.notes:
            if name not in _OWN and not (replaced and name in _STATES):
                recorder.note(name.removeprefix("haptorb/"), values)
        changes = {key: text for key, text in replaced.items() if key in ("estimator", "model")}
        changes |= {"rate_hz": repr(rate)} if "rate" in replaced else {}
        recorder.note("run", {**recording.metadata.get("run", {}), **changes})
        recorder.note("replay", {"of": recording.path.name, **replaced})
        for note in [{"change": "0", "tick": "0", "world": world}] if world else recording.worlds:
            recorder.note("world", note)

    def append(self, rows: Array) -> None:
        """Add rows (n, width), each number in its field's unit [SI]."""
        self._recorder.append(rows)

    def finish(self) -> None:
        """Everything is there."""
        rows = str(self._recorder.written)
        self._recorder.note("end", {"rows": rows, "lost": "0", "reason": "replayed"})
        self._recorder.finish()


@contextmanager
def write_replay(
    path: Path, recording: Recording, layout: RowLayout, rate: float, replaced: Mapping[str, str], world: str = ""
) -> Iterator[ReplayFile]:
    """The file at `path` for rows of `layout` at `rate` [Hz]: whole at the end of the block, or not at all.

    Raises RecordingError if it cannot be written.

    replaced  part → what stands in for it; world: description of the one that stands in, if one does
    """
    offset = recording.metadata.get("clock", {}).get("unix_minus_monotonic_ns", "0")
    try:
        with replace_file(path) as part, part.open("wb") as file:
            recorder = Recorder(file, layout, rate, int(offset) if offset.lstrip("-").isdecimal() else 0)
            written = ReplayFile(recorder, recording, rate, replaced, world)
            yield written
            written.finish()
    except OSError as cause:
        raise RecordingError(f"cannot write {path}: {cause.strerror or cause}") from cause
