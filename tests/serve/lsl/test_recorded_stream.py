"""The stream of rows as stored by LabRecorder and read by pyxdf: names, units, numbers and times."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from haptorb.recording.row import RowLayout
from haptorb.serve.lsl import ClockOffset, Clocks, list_channels, make_stream_info

LAYOUT = RowLayout(channels=3, sensors=2)


def write_chunk(file: Any, tag: int, content: bytes) -> None:
    """One chunk of an XDF file: bytes of the length, the length, the tag, and the content."""
    file.write(b"\x04" + struct.pack("<I", len(content) + 2) + struct.pack("<H", tag) + content)


def test_pyxdf_reads_names_units_and_numbers_of_the_stream(tmp_path: Path) -> None:
    import pylsl
    import pyxdf

    clocks = Clocks(ClockOffset(0.0, 1e-6), ClockOffset(1.7e9, 1e-6))
    info = make_stream_info(pylsl, LAYOUT, 1000.0, {"device": "omni <3>", "driver": "sim"}, clocks)
    rows = np.random.default_rng(1).normal(size=(50, LAYOUT.width))
    path = tmp_path / "session.xdf"
    with path.open("wb") as file:
        file.write(b"XDF:")
        write_chunk(file, 1, b"<?xml version='1.0'?><info><version>1.0</version></info>")
        write_chunk(file, 2, struct.pack("<I", 1) + info.as_xml().encode())
        samples = b"".join(b"\x08" + struct.pack("<d", 10.0 + n / 1000) + row.tobytes() for n, row in enumerate(rows))
        write_chunk(file, 3, struct.pack("<I", 1) + b"\x04" + struct.pack("<I", len(rows)) + samples)
        write_chunk(
            file, 6, struct.pack("<I", 1) + b"<?xml version='1.0'?><info><sample_count>50</sample_count></info>"
        )
    (stream,), _ = pyxdf.load_xdf(path, dejitter_timestamps=False)
    about = stream["info"]
    assert about["name"] == ["haptorb-rows"]
    assert about["desc"][0]["run"][0]["device"] == ["omni <3>"]
    listed = [(one["label"][0], one["unit"][0] or "") for one in about["desc"][0]["channels"][0]["channel"]]
    assert listed == [(one.label, one.unit) for one in list_channels(LAYOUT)]
    assert stream["time_series"].tobytes() == rows.tobytes()
    assert np.array_equal(stream["time_stamps"], 10.0 + np.arange(50) / 1000)
