"""Rows unpacked in another process are those of the recording, and damage is reported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from haptorb import Recording
from haptorb.errors import RecordingError
from haptorb.replay.rows import UnpackedRows
from oracles.recorded_chain import record_chain


@pytest.mark.parametrize("damaged", [False, True])
def test_rows_come_from_beside_bit_for_bit_or_not_at_all(
    damaged: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    whole = record_chain(tmp_path / "run.mcap", ticks=100)
    monkeypatch.setattr("haptorb.recording.recording._MAX_WHOLE_BYTES", 0)
    recording = Recording(whole.path)
    assert recording.long
    if damaged:
        content = bytearray(whole.path.read_bytes())
        with whole.path.open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None
        place = summary.chunk_indexes[2].chunk_start_offset + 60
        content[place : place + 8] = bytes(8)
        whole.path.write_bytes(content)
        with pytest.raises(RecordingError, match="damaged"):
            UnpackedRows(recording).wait_for_rows()
        assert capfd.readouterr().err == ""
    else:
        rows = UnpackedRows(recording).wait_for_rows()
        assert np.array_equal(rows.view(np.uint64), whole.rows.view(np.uint64))
