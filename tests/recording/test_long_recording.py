"""A recording above 32 MiB: identical numbers, read in pieces; damage is reported where it is read."""

from __future__ import annotations

import pickle
import tracemalloc
import zlib

import numpy as np
import pytest

from haptorb import Recording
from haptorb.errors import RecordingError
from haptorb.recording.mcap import CDR_HEADER, MESSAGE_OVERHEAD, Recorder
from haptorb.recording.row import RowLayout

LAYOUT = RowLayout(channels=3, sensors=16)
ROWS = 36_000
P = LAYOUT["p"]


def make_rows(first, last):
    """Numbers that cannot be compressed, the same for each tick whoever asks."""
    rows = np.random.default_rng([7, first]).normal(size=(last - first, LAYOUT.width))
    rows[:, LAYOUT["t"]] = 1e-3 * np.arange(first, last)[:, None]
    return rows


@pytest.fixture(scope="module")
def long_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("long") / "long.mcap"
    with path.open("wb") as file:
        recorder = Recorder(file, LAYOUT, 1000.0, 10**18)
        recorder.add_metadata("device", {"name": "omni"})
        for first in range(0, ROWS, 1000):
            for part in np.split(make_rows(first, first + 1000), 20):
                recorder.append(part)
        recorder.add_metadata("end", {"rows": str(ROWS)})
        recorder.finish()
    assert path.stat().st_size > 32 * 2**20
    return path


@pytest.fixture(scope="module")
def recording(long_file):
    return Recording(long_file)


def test_it_is_the_same_recording(recording):
    assert recording.long
    assert not recording.truncated
    assert len(recording) == ROWS
    assert recording.metadata["device"]["name"] == "omni"
    assert recording.metadata["end"]["rows"] == str(ROWS)
    assert recording.layout == LAYOUT


@pytest.mark.parametrize(
    "key",
    [0, -1, ROWS - 1, slice(5, 9), slice(999, 2003), slice(None, None, 977), slice(2100, 1900, -3), slice(50, 40),
     (slice(1010, 1020), 1), (slice(1010, 1020), slice(0, 2)), (-3, 2)],
)  # fmt: skip
def test_slices_are_those_of_the_whole_array(recording, key):
    whole = np.concatenate([make_rows(n, n + 1000)[:, P] for n in range(0, ROWS, 1000)])
    assert np.array_equal(recording["p"][key], whole[key])


def test_a_field_behaves_as_an_array(recording):
    t = recording["t"]
    assert t.shape == (ROWS,)
    assert (recording["p"].ndim, recording["p"].size) == (2, 3 * ROWS)
    assert np.array_equal(np.asarray(t), 1e-3 * np.arange(ROWS))
    assert t.max() == t[-1]
    assert (t + 1.0) - t == pytest.approx(1.0)
    assert np.isfinite(recording["p"]).all()
    with pytest.raises(IndexError):
        t[ROWS]
    assert "36000" in repr(t)
    assert sum(1 for _ in recording["p"]) == ROWS
    assert np.array_equal(pickle.loads(pickle.dumps(t)), t)


def test_a_slice_needs_little_memory(long_file):
    tracemalloc.start()
    try:
        part = Recording(long_file)["wrench_commanded"][20_000:20_100]
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert part.shape == (100, 6)
    assert most < 8 * 2**20 < long_file.stat().st_size


def test_a_file_that_was_cut_has_its_whole_chunks(long_file, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(long_file.read_bytes()[: 34 * 2**20])
    recording = Recording(cut)
    assert recording.long
    assert recording.truncated
    n = len(recording)
    assert 0 < n < ROWS
    last = make_rows((n - 1) // 1000 * 1000, (n - 1) // 1000 * 1000 + 1000)[(n - 1) % 1000, P]
    assert np.array_equal(recording["p"][-1], last)


def lie_about_a_chunk(data):
    """In the summary a chunk has one row less; the checksum is made good for it."""
    end = len(data) - 37
    start = int.from_bytes(data[end + 9 : end + 17], "little")
    at, seen = start, 0
    while seen < 100:
        length = int.from_bytes(data[at + 1 : at + 9], "little")
        seen += data[at] == 8
        last, at = at + 9 + length - 8, at + 9 + length
    less = int.from_bytes(data[last : last + 8], "little") - (MESSAGE_OVERHEAD + len(CDR_HEADER) + 8 * LAYOUT.width)
    data[last : last + 8] = less.to_bytes(8, "little")
    data[-12:-8] = zlib.crc32(data[start:-12]).to_bytes(4, "little")


def test_a_summary_that_was_damaged_is_not_asked(long_file, recording, tmp_path):
    data = bytearray(long_file.read_bytes())
    data[-3000] ^= 4
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data)
    walked = Recording(damaged)
    assert len(walked) == ROWS
    assert walked.notes == recording.notes
    assert walked.truncated == recording.truncated
    assert np.array_equal(walked["p"][::4999], recording["p"][::4999])


def test_a_summary_that_lies_is_found_out_where_it_does(long_file, recording, tmp_path):
    data = bytearray(long_file.read_bytes())
    lie_about_a_chunk(data)
    lying = tmp_path / "lying.mcap"
    lying.write_bytes(data)
    told = Recording(lying)
    assert np.array_equal(told["p"][:10], recording["p"][:10])
    with pytest.raises(RecordingError, match="damaged at row"):
        told["p"].max()


def test_damage_is_told_where_it_is_and_the_rest_is_read(long_file, tmp_path):
    data = bytearray(long_file.read_bytes())
    data[len(data) // 2] ^= 4
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data)
    recording = Recording(damaged)
    with pytest.raises(RecordingError, match="damaged at row") as caught:
        recording["p"].max()
    first = int(str(caught.value).split("damaged at row ")[1].split(":")[0])
    assert 0.3 * ROWS < first < 0.7 * ROWS
    assert np.array_equal(recording["p"][:10], make_rows(0, 1000)[:10, P])
    assert np.array_equal(recording["p"][-10:], make_rows(ROWS - 1000, ROWS)[-10:, P])
    assert np.isfinite(recording["p"][first - 10 : first]).all()


def test_a_file_that_changes_meanwhile_is_told(long_file, tmp_path):
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(long_file.read_bytes())
    recording = Recording(copy)
    with copy.open("r+b") as file:
        file.truncate(2**20)
    with pytest.raises(RecordingError, match="damaged"):
        recording["p"][-1]
    copy.unlink()
    with pytest.raises(RecordingError, match="cannot read"):
        recording["p"][0]
