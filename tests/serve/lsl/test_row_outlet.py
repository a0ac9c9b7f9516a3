"""Rows in a real LSL inlet, with labels, units, times and clock offsets."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from time import monotonic, time

import numpy as np
import pylsl
import pytest

from haptorb.recording.row import RowLayout
from haptorb.serve.lsl import NAME, RowOutlet, list_channels

LAYOUT = RowLayout(channels=2, sensors=1, memory=4)
FACTS = {"device": "test-of-rows", "driver": "sim", "version": "0"}


@pytest.fixture
def stream():
    outlet = RowOutlet(LAYOUT, 1000.0, FACTS)
    found = pylsl.resolve_bypred(f"name='{NAME}' and source_id='haptorb-test-of-rows-sim'", 1, timeout=5.0)
    inlet = pylsl.StreamInlet(found[0])
    inlet.open_stream(timeout=5.0)
    yield outlet, inlet
    inlet.close_stream()
    outlet.close()


def make_rows(count: int) -> np.ndarray:
    rows = np.random.default_rng(3).normal(size=(count, LAYOUT.width))
    rows[:, LAYOUT["wall"].start] = monotonic() + 1e-3 * np.arange(count)
    rows[:, LAYOUT["wrench_actual"]] = np.nan
    return rows


def test_every_number_arrives_at_the_time_of_its_tick(stream) -> None:
    outlet, inlet = stream
    rows = make_rows(300)
    for part in np.array_split(rows, 7):
        outlet.send(part)
    outlet.send(rows[:0])
    samples, stamps = [], []
    end = monotonic() + 5.0
    while len(samples) < 300 and monotonic() < end:
        more, times = inlet.pull_chunk(timeout=0.2, max_samples=1000)
        samples += list(more)
        stamps += list(times)
    np.testing.assert_array_equal(np.array(samples), rows)
    ahead = pylsl.local_clock() - monotonic()
    assert np.asarray(stamps) == pytest.approx(rows[:, LAYOUT["wall"].start] + ahead, abs=1e-3)
    assert outlet.sent == 300
    assert outlet.watched


def test_the_description_names_channels_units_and_clocks(stream) -> None:
    _, inlet = stream
    described = ET.fromstring(inlet.info(timeout=5.0).as_xml())
    assert described.findtext("nominal_srate", "").startswith("1000.0")
    assert described.findtext("channel_format") == "double64"
    channels = described.findall("desc/channels/channel")
    labels = {node.findtext("label"): node.findtext("unit") for node in channels}
    assert [node.findtext("label") for node in channels] == [one.label for one in list_channels(LAYOUT)]
    assert (labels["p[0]"], labels["wrench_commanded[0]"], labels["wrench_commanded[5]"]) == ("m", "N", "N·m")
    assert (labels["current_measured[1]"], labels["winding[0]"]) == ("A", "K")
    utc = float(described.findtext("desc/clocks/monotonic_to_utc/offset", "nan"))
    assert utc + monotonic() == pytest.approx(time(), abs=0.05)
    layer = float(described.findtext("desc/clocks/monotonic_to_lsl/offset", "nan"))
    assert layer + monotonic() == pytest.approx(pylsl.local_clock(), abs=0.05)
    assert float(described.findtext("desc/clocks/monotonic_to_lsl/uncertainty", "nan")) < 1e-3
    assert described.findtext("desc/run/device") == "test-of-rows"
    assert described.findtext("desc/synchronization/can_drop_samples") == "true"


def test_a_reader_that_does_not_read_holds_nobody_up(stream) -> None:
    outlet, _ = stream
    rows = make_rows(20)
    for _ in range(200):
        outlet.send(rows)
    assert outlet.sent == 4000
