"""Overview: minimum and maximum of each section as in all rows, and every event at its tick."""

from __future__ import annotations

import io
import json
import pickle
import struct
import subprocess
import sys

import numpy as np
import pytest

from haptorb.recording.mcap import Recorder
from haptorb.recording.recording import Recording
from haptorb.recording.row import RowLayout
from haptorb.web.overview import BINS, CHANNELS, Overview, OverviewBins
from oracles.made_recording import RATE, TRIP, WORLD, make_recording


def decode(encoded):
    """(what is told, ranges) of an overview as the page gets it."""
    (length,) = struct.unpack_from("<I", encoded)
    told = json.loads(encoded[4 : 4 + length])
    return told, np.frombuffer(encoded[4 + length :], "<f4").reshape(len(told["channels"]), 2, told["bins"])


@pytest.fixture(scope="module")
def recording(made):
    return Recording(made[0])


def test_ranges_are_those_of_all_rows(made, recording):
    _, rows = made
    layout = RowLayout(3, 9, 0, 32)
    bins = OverviewBins(recording, 3.0, 5.999)
    for first in range(0, 3000, 700):  # in pieces that fit no stretch
        bins.add(first, min(first + 700, 3000))
    place = np.minimum(((rows[:, layout["t"]][:, 0] - 3.0) / (2.999 / BINS)).astype(int), BINS - 1)
    force = np.linalg.norm(rows[:, layout["wrench_actual"]][:, :3], axis=1)
    current = rows[:, layout["current_measured"]]
    for k in (0, 17, 599, BINS - 1):
        mine = place == k
        names = [name for name, *_ in CHANNELS]
        np.testing.assert_allclose(
            bins.ranges[names.index("force delivered"), :, k], [force[mine].min(), force[mine].max()], rtol=1e-12
        )
        np.testing.assert_allclose(
            bins.ranges[names.index("currents"), :, k], [current[mine].min(), current[mine].max()], rtol=1e-12
        )


def test_events_are_at_their_ticks(recording):
    overview = Overview(recording, 3.0, 5.999)
    assert decode(overview.encode())[0]["done"] == 0
    overview.start()
    told, ranges = decode(overview.encode())
    assert told["done"] == told["rows"] == 3000
    assert [(one["kind"], round(one["t"] * RATE), one["code"]) for one in told["events"]] == [
        ("trip", TRIP, 1.0), ("world", WORLD, 1.0),
    ]  # fmt: skip
    assert np.isfinite(ranges).all()


def test_missing_ticks_are_a_gap_and_an_event(tmp_path):
    path = tmp_path / "gap.mcap"
    make_recording(path)
    recording = Recording(path)
    bins = OverviewBins(recording, 3.0, 5.999)
    bins.add(0, 1000)
    bins.add(1500, 3000)
    assert np.isnan(bins.ranges[0, 0, 420:580]).all()
    assert ("gap", pytest.approx(4.5), 500.0) in bins.events


def test_numbers_of_a_foreign_file_break_nothing(tmp_path):
    path, layout = tmp_path / "strange.mcap", RowLayout(3, 9, 0, 32)
    with path.open("wb") as file:
        recorder = Recorder(file, layout, 1000.0, 10**18)
        strange = np.random.default_rng(1).choice([np.nan, np.inf, -np.inf, 1e308, 0.0], (100, layout.width))
        strange[:, layout["wall"]] = 0.0
        recorder.append(strange)
        recorder.finish()
    overview = Overview(Recording(path), 3.0, 3.1)
    overview.start()
    decode(overview.encode())


def test_a_long_recording_is_looked_through_in_a_process_of_its_own(made):
    path, _ = made
    whole = Overview(Recording(path), 3.0, 5.999)
    whole.start()
    command = [sys.executable, "-m", "haptorb.web.overview_process", str(path), "3.0", "5.999"]
    # Its standard input stays open while it works, and a byte on it only has it rest.
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdin.write(b".")
        process.stdin.flush()
        said = io.BytesIO(process.stdout.read())
    answers = []
    while said.tell() < len(said.getvalue()):
        answers.append(pickle.load(said))
    done, rows, ranges, events = answers[-1]
    assert done == rows == 3000
    assert answers[0][0] == 0  # a sketch first
    told, wanted = decode(whole.encode())
    np.testing.assert_allclose(ranges, wanted, rtol=1e-6)
    assert len(events) == len(told["events"])
