"""Recordings: bit-exact, readable by other tools, and readable after truncation at any byte."""

from __future__ import annotations

import os
import struct
import threading
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from haptorb import Recording
from haptorb.errors import RecordingError, UnknownName
from haptorb.recording import destination
from haptorb.recording.mcap import Recorder, fields_of, schema
from haptorb.recording.row import RowLayout
from oracles.repetitions import repetitions

LAYOUT = RowLayout(channels=3, sensors=9)
RATE = 1000.0


def _rows(n: int, seed: int = 0) -> Any:
    rows = np.random.default_rng(seed).normal(size=(n, LAYOUT.width))
    rows[:, LAYOUT["tick"]] = np.arange(n)[:, None]
    rows[:, LAYOUT["t"]] = np.arange(n)[:, None] / RATE
    rows[:, LAYOUT["wall"]] = 5000.0 + np.arange(n)[:, None] / RATE
    rows[:, LAYOUT["lateness"]] = np.abs(rows[:, LAYOUT["lateness"]]) * 1e-5
    rows[:, LAYOUT["winding"]] = 300.0 + rows[:, LAYOUT["winding"]]
    rows[:, LAYOUT["boundary"]] = 297.0 + rows[:, LAYOUT["boundary"]]
    return rows


def _record(
    path: Path, rows: Any, layout: RowLayout = LAYOUT, rate: float = RATE, finish: bool = True, **device: str
) -> Path:
    with path.open("wb") as file:
        recorder = Recorder(file, layout, rate, 10**18)
        recorder.add_metadata("device", {"name": "omni", "title": "Omni", **device})
        recorder.add_metadata("world", {"change": "0", "tick": "0", "world": "{}"})
        for start in range(0, len(rows), 20):
            recorder.append(rows[start : start + 20])
        if finish:
            recorder.add_metadata("end", {"rows": str(len(rows))})
            recorder.finish()
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _record(tmp_path_factory.mktemp("recordings") / "whole.mcap", _rows(400))


def test_bit_for_bit(tmp_path: Path) -> None:
    rows = _rows(100)
    rows[7, 3:9] = np.nan, np.inf, -np.inf, -0.0, 5e-324, 1.7e308
    recording = Recording(_record(tmp_path / "a.mcap", rows))
    assert recording.rows.tobytes() == rows.tobytes()
    assert recording.layout == LAYOUT
    assert not recording.truncated
    assert recording["p"].shape == (100, 3)
    assert recording["tick"].shape == (100,)
    assert (recording["duty_applied"] == rows[:, LAYOUT["duty_applied"]]).all()
    assert (recording.t == rows[:, 1]).all()
    assert recording.metadata["device"]["name"] == "omni"
    assert recording.worlds == [{"change": "0", "tick": "0", "world": "{}"}]


def test_without_sensors_and_without_rows(tmp_path: Path) -> None:
    layout = RowLayout(channels=1, sensors=0)
    recording = Recording(_record(tmp_path / "a.mcap", np.ones((5, layout.width)), layout))
    assert recording.layout == layout
    assert recording["current_measured"].shape == (5,)
    empty = Recording(_record(tmp_path / "b.mcap", np.ones((0, layout.width)), layout))
    assert len(empty) == 0
    assert empty["p"].shape == (0, 3)
    with pytest.raises(RecordingError, match="no rows to plot"):
        empty.plot()


def test_other_tools_read_it(whole: Path) -> None:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    rows = _rows(400)
    with whole.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 400
        for (_, channel, message, decoded), row in zip(reader.iter_decoded_messages(), rows, strict=True):
            assert channel.topic == "/haptorb/tick"
            assert message.log_time == int(row[LAYOUT["wall"]][0] * 1e9) + 10**18
            assert decoded.t == row[1]
            assert list(decoded.p) == row[LAYOUT["p"]].tolist()
            assert list(decoded.field) == row[LAYOUT["field"]].tolist()


@given(share=st.floats(0.0, 1.0))
@settings(max_examples=repetitions(50, 150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_cut_at_any_byte(whole: Path, tmp_path: Path, share: float) -> None:
    data, rows = whole.read_bytes(), _rows(400)
    keep = int(share * len(data))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[:keep])
    try:
        recording = Recording(cut)
    except RecordingError as error:
        assert keep < len(data) // 5, "only a file without its first rows may be refused"
        assert "not an MCAP file" in str(error) or "cut short" in str(error)  # noqa: PT017
        return
    n = len(recording)
    assert recording.rows.tobytes() == rows[:n].tobytes()
    if keep < len(data) - 5000:
        assert recording.truncated
        # Chunks are as long as 40 ms at most: no more than one may be missing.
        assert n >= 400 * keep / len(data) - 2 * 40 - 20


@given(at=st.integers(8, 100_000), bit=st.integers(0, 7))
@settings(max_examples=repetitions(50, 150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_anywhere(whole: Path, tmp_path: Path, at: int, bit: int) -> None:
    """A flipped bit costs the rows of one chunk at most, and is named; the rows that are read are as written."""
    data, rows = bytearray(whole.read_bytes()), _rows(400)
    data[at % len(data)] ^= 1 << bit
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        recording = Recording(path)
    numbers = recording["tick"][:].astype(int)
    assert recording.rows.tobytes() == rows[numbers].tobytes()
    assert len(recording) >= 400 - 60
    assert sum(one.rows or 0 for one in recording.missing) == 400 - len(recording)
    assert bool(seen) == bool(recording.damage)
    assert bool(recording.damage) or len(recording) == 400
    assert not recording.truncated


def test_never_finished(tmp_path: Path) -> None:
    recording = Recording(_record(tmp_path / "a.mcap", _rows(400), finish=False))
    assert recording.truncated
    assert len(recording) >= 400 - 40 - 20


@pytest.mark.parametrize("rate", [50.0, 200.0, 1000.0, 4000.0])
def test_little_is_lost_at_any_rate(tmp_path: Path, rate: float) -> None:
    """Before the end, all but a tenth of a second is in the file."""
    layout = RowLayout(channels=3, sensors=0)
    n = int(rate)
    recording = Recording(_record(tmp_path / "a.mcap", np.zeros((n, layout.width)), layout, rate, finish=False))
    assert (n - len(recording)) / rate < 0.06  # and 20 ms until the recorder looks again


def test_foreign_files(tmp_path: Path) -> None:
    from mcap.writer import Writer

    with pytest.raises(RecordingError, match="cannot be read"):
        Recording(tmp_path / "nothing.mcap")
    with pytest.raises(RecordingError, match="cannot be read"):
        Recording(tmp_path)
    text = tmp_path / "text.mcap"
    text.write_text("time,force\n")
    with pytest.raises(RecordingError, match=r"is a table|not an MCAP file"):
        Recording(text)
    foreign = tmp_path / "foreign.mcap"
    with foreign.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/camera", "json", 0)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    with pytest.raises(RecordingError, match="topic /haptorb/tick is missing"):
        Recording(foreign)
    impostor = tmp_path / "impostor.mcap"
    with impostor.open("wb") as file:
        writer = Writer(file)
        writer.start()
        kind = writer.register_schema("other/msg/Tick", "ros2msg", b"int8 x")
        channel = writer.register_channel("/haptorb/tick", "cdr", kind)
        writer.add_message(channel, 0, struct.pack("<Ib", 256, 1), 0)
        writer.finish()
    with pytest.raises(RecordingError, match="another program wrote it"):
        Recording(impostor)


def test_unknown_field(whole: Path) -> None:
    with pytest.raises(UnknownName, match="did you mean 'current_measured'"):
        Recording(whole)["curent_measured"]


@given(channels=st.integers(1, 24), sensors=st.integers(0, 48))
def test_schema_there_and_back(channels: int, sensors: int) -> None:
    layout = RowLayout(channels, sensors)
    assert fields_of(schema(layout)) == tuple(field for field in layout.fields if field.width)


def test_schema_of_others() -> None:
    with pytest.raises(RecordingError, match="int32 x"):
        fields_of("float64 t  # [s] time\nint32 x\n")


def test_csv(whole: Path, tmp_path: Path) -> None:
    recording, path = Recording(whole), tmp_path / "a.csv"
    recording.to_csv(path)
    heads = path.read_text(encoding="utf-8").splitlines()[0].split(",")
    assert heads[:2] == ["tick", "t [s]"]
    assert {"p[2] [m]", "wrench_commanded[2] [N]", "wrench_commanded[5] [N·m]", "q[3]", "winding[0] [K]"} <= set(heads)
    values = np.loadtxt(path, delimiter=",", skiprows=1)
    assert values.tobytes() == recording.rows.tobytes()
    with pytest.raises(RecordingError, match="exists"):
        recording.to_csv(path)
    recording.to_csv(path, overwrite=True)
    with pytest.raises(RecordingError, match="cannot write"):
        recording.to_csv(tmp_path / "no" / "a.csv")
    assert list(tmp_path.glob("*.part")) == []


@pytest.mark.parametrize("ending", ["png", "svg"])
def test_plot(whole: Path, tmp_path: Path, ending: str) -> None:
    recording, path = Recording(whole), tmp_path / f"a.{ending}"
    figure = recording.plot(path)
    assert path.stat().st_size > 10_000
    force = figure.axes[0]
    styles = {line.get_linestyle() for line in force.lines}
    assert {"-", "--"} <= styles  # given solid, asked dashed
    assert (np.asarray(force.lines[0].get_ydata()) == recording["wrench_actual"][:, 0]).all()
    with pytest.raises(RecordingError, match="cannot write"):
        recording.plot(tmp_path / "a.nonsense")


@pytest.mark.parametrize("noted", ['["x", "y", "z $1$"]', '["x"]', "[", None])
def test_plot_names_coils_as_the_device_does(tmp_path: Path, noted: str | None) -> None:
    """Where the recording does not say, they are numbered."""
    shown = ["x", "y", "z $1$"] if noted and "y" in noted else ["1", "2", "3"]
    device = {} if noted is None else {"coils": noted}
    figure = Recording(_record(tmp_path / "a.mcap", _rows(50), **device)).plot()
    texts = [text for axes in figure.axes if (legend := axes.get_legend()) for text in legend.get_texts()]
    found = {text.get_text() for text in texts}
    assert {f"coil {name}" for name in shown} | {f"winding {name}" for name in shown} <= found
    assert not any(text.get_parse_math() for text in texts if "$1$" in text.get_text())


def test_plot_keeps_every_peak(tmp_path: Path) -> None:
    rows = _rows(30_000)
    rows[:, LAYOUT["wrench_actual"]] = 0.0
    rows[12_345, LAYOUT["wrench_actual"].start] = 9.0
    figure = Recording(_record(tmp_path / "a.mcap", rows)).plot()
    line = figure.axes[0].lines[0]
    assert np.asarray(line.get_ydata()).max() == 9.0
    assert len(np.asarray(line.get_ydata())) <= 4000


def test_existing_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("precious")
    with pytest.raises(RecordingError, match="exists"):
        destination.create_recording(path, overwrite=None)
    assert path.read_text() == "precious"


@pytest.mark.parametrize("place", ["no/such/folder/a.mcap", "", "\0"])
def test_place_that_cannot_be_written(tmp_path: Path, place: str) -> None:
    for overwrite in (None, tmp_path / "before"):
        with pytest.raises((RecordingError, ValueError)):
            destination.create_recording(tmp_path / place, overwrite=overwrite)


def test_a_recording_to_a_pipe_is_the_same(tmp_path: Path) -> None:
    """A pipe cannot say how much was written to it; in `benchmarks/safety/ends.py` it is the disk that blocks."""
    expected = _record(tmp_path / "file.mcap", _rows(300)).read_bytes()
    reading, writing = os.pipe()
    contents = list[bytes]()

    def read() -> None:
        with os.fdopen(reading, "rb") as pipe:
            contents.append(pipe.read())

    reader = threading.Thread(target=read)
    reader.start()
    _record(Path(f"/dev/fd/{writing}"), _rows(300))
    os.close(writing)
    reader.join(30)
    assert contents == [expected]
