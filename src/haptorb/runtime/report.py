"""What a run was like, in numbers: counted by the loop itself, so nothing that the host missed is missing."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from haptorb.control.trip import Trip
from haptorb.runtime.histogram import Histogram
from haptorb.runtime.row import STAGES
from haptorb.runtime.shared import TRIPS, Shared, Word

__all__ = ["loop_report"]


def loop_report(shared: Shared) -> dict[str, Any]:
    """Ticks, success rate, lateness, compute, stages, trips and peak force of the run so far; plain JSON types.

    success_rate: ticks that began and ended within their period, over all deadlines that passed. stage_us: medians
    over the last rows. peak_force_n, peak_torque_nm: of what is really on the mover where that is known, else of what
    is modelled.
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
        "trips": trips(shared),
        "trip_count": words[Word.TRIPS],
        "peak_force_n": shared.floats[Word.PEAK],
        "peak_torque_nm": shared.floats[Word.PEAK_TORQUE],
        "scheduler": json.loads(facts) if facts else {},
        "recorded": {"rows": words[Word.WRITTEN], "lost": words[Word.LOST]},
    }


def trips(shared: Shared) -> list[dict[str, Any]]:
    """The first trips in order: time on the loop's clock [s], code, and the sentence for people."""
    found = []
    for t, code in shared.trips[: min(shared.words[Word.TRIPS], TRIPS)].tolist():
        trip = Trip(int(code))
        found.append({"t": t, "code": trip.name, "reason": trip.text})
    return found


def _percentiles(histogram: Histogram, which: tuple[float, ...]) -> dict[str, float | None]:
    found = {}
    for percent in which:
        value = histogram.percentile(percent)
        found[f"p{percent:g}".replace(".", "")] = value if math.isfinite(value) else None
    return found


def _stages(shared: Shared) -> dict[str, float]:
    _, rows = shared.ring.since(0)
    times = rows[:, shared.layout["stages"]]
    times = times[np.isfinite(times).all(axis=1)]
    if not len(times):
        return {}
    return dict(zip(STAGES, np.round(1e6 * np.median(times, axis=0), 2).tolist(), strict=True))
