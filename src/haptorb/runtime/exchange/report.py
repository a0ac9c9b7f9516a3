"""What a run was like, in numbers: counted by the loop itself, so nothing that the host missed is missing."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from haptorb.control.protection.trip import CoilState, Trip
from haptorb.runtime.exchange.shared_memory import CAPACITY, TRIPS, SharedMemory, Word
from haptorb.runtime.memory.histogram import Histogram
from haptorb.runtime.row import STAGES
from haptorb.runtime.trackers.pose_source import describe_trip

__all__ = ["count_recorded", "loop_report"]


def loop_report(shared: SharedMemory, tracker: str = "pointer") -> dict[str, Any]:
    """Ticks, success rate, lateness, compute, stages, trips and peak force of the run so far; plain JSON types.

    success_rate: ticks that began and ended within their period, over all deadlines that passed. stage_us: medians
    over the last rows. coil_state: "off" (the device confirmed it), "on" or "unknown", by the last row. ahead_us:
    what the driver did before the deadlines of the last rows, which no tick waits for (a simulated device moves on
    there). peak_force_n, peak_torque_nm: of what is really on the mover where that is known, else of what is
    modelled. tracking: how well the poses came, see `tracking`. error: what the world or the driver said at the last
    trip that one of them caused. The trips' sentences are for those whose poses come from `tracker`.
    """
    words = shared.words
    ticks, missed = words[Word.TICKS], words[Word.MISSED]
    passed = ticks + missed
    _, facts = shared.facts.read()
    return {
        "ticks": ticks,
        "missed": missed,
        "success_rate": words[Word.ON_TIME] / passed if passed else None,
        "lateness_us": _percentiles(shared.lateness, (50.0, 99.0, 99.9)),
        "compute_us": _percentiles(shared.compute, (50.0, 99.0, 99.9)),
        "stage_us": _stages(shared),
        "ahead_us": _lead_percentiles(shared),
        "trips": trips(shared, tracker),
        "trip_count": words[Word.TRIPS],
        "coil_state": _coil_state(shared),
        "peak_force_n": shared.floats[Word.PEAK],
        "peak_torque_nm": shared.floats[Word.PEAK_TORQUE],
        "scheduler": json.loads(facts) if facts else {},
        "tracking": tracking(shared),
        "recorded": count_recorded(shared, over=False),
        "error": shared.error.read()[1],
    }


def _coil_state(shared: SharedMemory) -> str | None:
    """Of the newest row; None before the first."""
    row = shared.ring.latest()
    if row is None:
        return None
    state = float(row[shared.layout["coil_state"].start])
    return CoilState(int(state)).name.lower() if math.isfinite(state) else None


def count_recorded(shared: SharedMemory, *, over: bool) -> dict[str, int]:
    """Rows that are in the recording, and rows that will never be.

    over: the recorder writes no more, however it ended. As long as it may, rows that still wait for it are not lost.
    """
    words = shared.words
    rows, published = int(words[Word.WRITTEN]), int(words[Word.ROWS])
    if over:
        return {"rows": rows, "lost": max(published - rows, 0)}
    overwritten = published - int(words[Word.TAKEN]) - (CAPACITY - 1)
    return {"rows": rows, "lost": int(words[Word.LOST]) + (max(overwritten, 0) if words[Word.RECORDER_LOOKS] else 0)}


def trips(shared: SharedMemory, tracker: str) -> list[dict[str, Any]]:
    """The first trips in order: time on the loop's clock [s], code, and the sentence for people whose poses come from
    `tracker`."""
    found = []
    for t, code in shared.trips[: min(shared.words[Word.TRIPS], TRIPS)].tolist():
        trip = Trip(int(code))
        found.append({"t": t, "code": trip.name, "reason": describe_trip(trip, tracker)})
    return found


def tracking(shared: SharedMemory) -> dict[str, Any]:
    """How fresh the poses were that the loop used, over its last rows, and what the tracker's own process counted.

    poses_hz: different poses a second; age_ms: of the pose in use, 50th and 99th percentile. A tracker with a process
    of its own adds rate, jitter and latency [Hz, ms] of what arrived, and how many were accepted, lost and refused.
    """
    _, rows = shared.ring.read_since(0)
    at = shared.layout
    t, age = rows[:, at["t"].start], rows[:, at["age"].start]
    known = np.isfinite(t) & np.isfinite(age) & (rows[:, at["valid"].start] == 1.0)
    t, age = t[known], age[known]
    found: dict[str, Any] = {"poses_hz": None, "age_ms": None}
    if len(t) > 1 and t[-1] > t[0]:
        different = 1 + int((np.abs(np.diff(t - age)) > 1e-6).sum())
        found["poses_hz"] = different / float(t[-1] - t[0])
        found["age_ms"] = {f"p{p}": 1e3 * float(np.percentile(age, p)) for p in (50, 99)}
    return {**found, **tracker_facts(shared)}


def tracker_facts(shared: SharedMemory) -> dict[str, Any]:
    """What the tracker's own process counted last; empty if there is none, or before its first word."""
    _, facts = shared.tracker_facts.read()
    return dict(json.loads(facts)) if facts else {}


def _percentiles(histogram: Histogram, which: tuple[float, ...]) -> dict[str, float | None]:
    found = {}
    for percent in which:
        value = histogram.percentile(percent)
        found[f"p{percent:g}".replace(".", "")] = value if math.isfinite(value) else None
    return found


def _lead_percentiles(shared: SharedMemory) -> dict[str, float]:
    _, rows = shared.ring.read_since(0)
    times = rows[:, shared.layout["ahead"]]
    times = 1e6 * times[np.isfinite(times)]
    if not len(times):
        return {}
    return {f"p{percent}": round(float(np.percentile(times, percent)), 2) for percent in (50, 99)}


def _stages(shared: SharedMemory) -> dict[str, float]:
    _, rows = shared.ring.read_since(0)
    times = rows[:, shared.layout["stages"]]
    times = times[np.isfinite(times).all(axis=1)]
    if not len(times):
        return {}
    return dict(zip(STAGES, np.round(1e6 * np.median(times, axis=0), 2).tolist(), strict=True))
