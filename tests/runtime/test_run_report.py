"""Report of a run: all keys of a dict, and its main figures in text."""

from __future__ import annotations

import json
import pickle
from typing import Any
from xml.etree import ElementTree

from haptorb.runtime.report import RunReport

FOUND: dict[str, Any] = {
    "device": "omni", "world": "dome", "driver": "sim", "tracker": "pointer", "rate_hz": 1000.0, "ticks": 5000,
    "missed": 2, "success_rate": 0.9996, "lateness_us": {"p50": 2.0, "p99": 31.0, "p999": None},
    "compute_us": {"p50": 50.0, "p99": 80.0, "p999": 120.0}, "trips": [{"code": "POSE_STALE"}], "trip_count": 1,
    "coil_state": "off", "peak_force_n": 0.251, "peak_torque_nm": 0.0, "recorded": {"rows": 5000, "lost": 0},
    "warning": "a < b", "error": None,
}  # fmt: skip


def test_it_is_a_dict_for_programs() -> None:
    report = RunReport(FOUND)
    assert report["peak_force_n"] == 0.251
    assert json.loads(json.dumps(report)) == FOUND
    assert pickle.loads(pickle.dumps(report)) == FOUND


def test_people_see_its_main_figures() -> None:
    report = RunReport(FOUND)
    assert repr(report) == (
        "<RunReport of omni, world dome: 5000 ticks, deadlines missed 2, trips 1, largest force 251 mN>"
    )
    html = report._repr_html_()
    ElementTree.fromstring(html)
    for text in ("99.960 %", "99 % up to 31 µs", "99.9 % up to 120 µs", "POSE_STALE", "251 mN", "a &lt; b"):
        assert text in html
    assert "error" not in html


def test_one_without_keys_is_shown_too() -> None:
    assert repr(RunReport()).startswith("<RunReport of None")
    ElementTree.fromstring(RunReport()._repr_html_())
