"""Rows as OSC bundles, decoded by python-osc."""

from __future__ import annotations

import numpy as np
import pytest
from pythonosc.osc_bundle import OscBundle

from haptorb.recording.row import RowLayout
from haptorb.serve.osc import OUTGOING, RowBundle

LAYOUT = RowLayout(channels=3, sensors=0, memory=4)
UTC = 1.7e9


def make_row() -> np.ndarray:
    row = np.random.default_rng(5).normal(size=LAYOUT.width)
    row[LAYOUT["tick"]] = 123456
    row[LAYOUT["wall"]] = 4321.25
    for name in ("valid", "guard", "trip"):
        row[LAYOUT[name]] = 2
    return row


def read(data: bytes) -> dict[str, list[float]]:
    return {message.address: list(message.params) for message in OscBundle(data)}


def test_each_address_has_the_numbers_of_its_field() -> None:
    row = make_row()
    found = read(RowBundle(LAYOUT, UTC).pack(row))
    assert list(found) == [message.address for message in OUTGOING]
    assert found["/haptorb/position"] == pytest.approx(row[LAYOUT["p"]], rel=1e-6)
    assert found["/haptorb/orientation"] == pytest.approx(row[LAYOUT["q"]], rel=1e-6)
    assert found["/haptorb/force"] == pytest.approx(row[LAYOUT["wrench_model"]][:3], rel=1e-6)
    assert found["/haptorb/torque"] == pytest.approx(row[LAYOUT["wrench_model"]][3:], rel=1e-6)
    assert (
        found["/haptorb/force/commanded"]
        == found["/haptorb/force/asked"]
        == pytest.approx(row[LAYOUT["wrench_commanded"]][:3], rel=1e-6)
    )
    assert found["/haptorb/tick"] == [123456]
    assert isinstance(found["/haptorb/tick"][0], int)


def test_buttons_are_those_that_are_held() -> None:
    assert read(RowBundle(LAYOUT, UTC).pack(make_row()))["/haptorb/buttons"] == [0, 0, 0]
    assert read(RowBundle(LAYOUT, UTC).pack(make_row(), (True, False, True)))["/haptorb/buttons"] == [1, 0, 1]


def test_the_time_tag_is_when_the_tick_began() -> None:
    # python-osc's own reading is a float of seconds since 1970: good to some 0.2 µs here.
    assert OscBundle(RowBundle(LAYOUT, UTC).pack(make_row())).timestamp == pytest.approx(UTC + 4321.25, abs=1e-6)


def test_numbers_that_are_none_do_no_harm() -> None:
    row = make_row()
    row[LAYOUT["p"]] = np.nan, np.inf, 1e300
    row[LAYOUT["trip"]] = np.nan
    row[LAYOUT["tick"]] = 2.0**40 + 7
    found = read(RowBundle(LAYOUT, UTC).pack(row))
    assert np.isnan(found["/haptorb/position"]).all()
    assert found["/haptorb/trip"] == [-1]
    assert found["/haptorb/tick"] == [7]
