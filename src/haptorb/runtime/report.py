"""Report of a run: figures that the loop itself counts, so that they are complete even if the host was late."""

from __future__ import annotations

import json
import math
from typing import Any, final

import numpy as np

from haptorb.control.trip_reasons import CoilState, GuardState, Trip
from haptorb.display import facts_html, format_beside, format_quantity
from haptorb.recording.row import STAGES
from haptorb.runtime.shared_memory import CAPACITY, TRIPS, Histogram, SharedMemory, Word
from haptorb.runtime.trackers.pose_filter import describe_trip

__all__ = [
    "RunReport",
    "count_recorded",
    "describe_detail",
    "describe_slow_world",
    "find_program",
    "is_tripped",
    "loop_report",
    "read_detail",
    "read_servers",
    "world_failure",
]


def loop_report(shared: SharedMemory, tracker: str = "pointer") -> dict[str, Any]:
    """Ticks, success rate, lateness, compute, stages, trips and peak force of the run so far; plain JSON types.

    success_rate: ticks that began and ended within their period, over all deadlines that passed. stage_us: medians
    over the last rows. coil_state: "off" (the device confirmed it), "on" or "unknown", by the last row. ahead_us:
    time of the driver's work before the deadlines of the last rows, which delays no tick (a simulated device advances
    there). peak_force_n, peak_torque_nm: of the actual wrench on the mover where that is known, else of the
    model's. tracking: quality of the poses, see `tracking`. error: message of the world or the driver at the last
    trip that one of them caused. Trips are explained for the tracker `tracker`.
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
    """Coil state in the newest row; None before the first."""
    row = shared.ring.latest()
    if row is None:
        return None
    state = float(row[shared.layout["coil_state"].start])
    return CoilState(int(state)).name.lower() if math.isfinite(state) else None


def count_recorded(shared: SharedMemory, *, over: bool) -> dict[str, int]:
    """Count the rows in the recording, and the lost rows.

    over: the recorder has ended, normally or not. Before that, pending rows are not lost.
    """
    words = shared.words
    rows, published = int(words[Word.WRITTEN]), int(words[Word.ROWS])
    if over:
        return {"rows": rows, "lost": max(published - rows, 0)}
    overwritten = published - int(words[Word.TAKEN]) - (CAPACITY - 1)
    return {"rows": rows, "lost": int(words[Word.LOST]) + (max(overwritten, 0) if words[Word.RECORDER_LOOKS] else 0)}


def trips(shared: SharedMemory, tracker: str) -> list[dict[str, Any]]:
    """List the first trips in order: time on the loop's clock [s], code, and explanation for the tracker `tracker`;
    `program` commanded then, "" for none."""
    found, facts = [], tracker_facts(shared)
    for t, code in shared.trips[: min(shared.words[Word.TRIPS], TRIPS)].tolist():
        trip = Trip(int(code))
        found.append({"t": t, "code": trip.name, "reason": describe_trip(trip, tracker, facts),
                      "program": find_program(shared, t)})  # fmt: skip
    return found


_FADE_S = 0.07  #: a command lasts and fades for so long after the last one [s]


def read_servers(shared: SharedMemory) -> list[dict[str, Any]]:
    """The last report of each server for other programs, in the order of the `--serve` options."""
    return [json.loads(text) for text in (slot.read()[1] for slot in shared.server_facts) if text]


def find_program(shared: SharedMemory, t: float) -> str:
    """Name of the program that commanded at `t` on the loop's clock [s], or whose force was fading; empty: none."""
    for server in read_servers(shared):
        for hold in reversed(server.get("programs", ())):
            end = math.inf if hold["end_s"] is None else hold["end_s"]
            if hold["start_s"] <= t <= end + _FADE_S:
                return str(hold["name"]) or f"a program of {server['server']}"
    return ""


def tracking(shared: SharedMemory) -> dict[str, Any]:
    """Age of the poses that the loop used, over its last rows, and the counts of the tracker's own process.

    poses_hz: different poses a second; age_ms: of the pose in use, 50th and 99th percentile. A tracker with its own
    process adds rate, jitter and latency [Hz, ms] of received poses, and how many were accepted, lost and rejected.
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
    """Last counts of the tracker's own process; empty without one, or before its first report."""
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


# --------------------------------------------------------------------------------------------------
# The report as a dict of plain JSON types whose repr shows the main figures.


_SHARES = {"p50": "50 %", "p99": "99 %", "p999": "99.9 %"}


@final
class RunReport(dict[str, Any]):
    """Report of a run, as returned by `Servo.report`. `dict(report)` shows everything.

    >>> RunReport(device="omni", world="dome", ticks=5000, missed=0, trip_count=0, peak_force_n=0.25)
    <RunReport of omni, world dome: 5000 ticks, deadlines missed 0, trips 0, largest force 250 mN>
    """

    def __repr__(self) -> str:
        parts = [f"{self.get('ticks', 0)} ticks", f"deadlines missed {self.get('missed', 0)}"]
        parts += [f"trips {self.get('trip_count', 0)}", *(f"{name} {text}" for name, text in self._largest())]
        return f"<RunReport of {self.get('device')}, world {self.get('world')}: {', '.join(parts)}>"

    def _repr_html_(self) -> str:
        share = self.get("success_rate")
        trips = ", ".join(str(trip.get("code")) for trip in self.get("trips", ())) or "none"
        recorded = self.get("recorded") or {}
        facts = [
            ("device", f"{self.get('device')}, driver {self.get('driver')}, tracker {self.get('tracker')}"),
            ("world", str(self.get("world"))),
            ("rate", f"{self.get('rate_hz', float('nan')):g} Hz"),
            ("ticks", f"{self.get('ticks', 0)}, {self.get('missed', 0)} deadlines missed"),
            ("on time", "unknown" if share is None else f"{format_beside(100 * share, 100.0, 3)} %"),
            ("lateness", _list_percentiles(self.get("lateness_us"))),
            ("computing", _list_percentiles(self.get("compute_us"))),
            *self._largest(),
            ("trips", trips),
            ("coils", str(self.get("coil_state") or "unknown")),
            ("recorded", f"{recorded.get('rows', 0)} rows, {recorded.get('lost', 0)} lost"),
            ("warning", str(self.get("warning") or "")),
            ("error", str(self.get("error") or "")),
        ]
        return facts_html(f"Run of {self.get('device')}", [(name, text) for name, text in facts if text])

    def _largest(self) -> list[tuple[str, str]]:
        """Peak force and torque, where they are not zero."""
        found = (("largest force", "peak_force_n", "N"), ("largest torque", "peak_torque_nm", "N·m"))
        return [(name, format_quantity(self[key], unit)) for name, key, unit in found if self.get(key)]


def _list_percentiles(shares: Any) -> str:
    """Format percentiles of the ticks' times [µs], as `p50` … of the report; empty without any."""
    if not isinstance(shares, dict):
        return ""
    return ", ".join(f"{_SHARES.get(name, name)} up to {value:.0f} µs" for name, value in shares.items() if value)


# --------------------------------------------------------------------------------------------------
# Reduced detail of a scene, read from its memory in the rows.


def read_detail(shared: SharedMemory) -> dict[str, Any]:
    """Read from a rendered scene: `detail` (0: full), `lighter_ticks` with less, and the lag `behind_s` of its time
    [s]; empty for every other world."""
    changes, row = shared.worlds_since(shared.words[Word.WORLD] - 1), shared.ring.latest()
    if not changes or row is None:
        return {}
    at, start = {}, shared.layout["memory"].start
    for field in json.loads(changes[-1][1]).get("memory", []):
        at[field["name"]] = start
        size = 1
        for length in field["shape"]:
            size *= length
        start += size
    if not {"detail", "lighter", "behind"} <= at.keys() or not (row[at["lighter"]] >= 0.0):
        return {}
    return {
        "detail": int(row[at["detail"]]),
        "lighter_ticks": int(row[at["lighter"]]),
        "behind_s": float(row[at["behind"]]),
    }


def describe_detail(found: dict[str, Any], *, now: bool = False) -> str:
    """Describe the result of `read_detail` in one sentence; empty while a scene had full detail.

    now: only while it has less.
    """
    if not found or not found["lighter_ticks"] or (now and not found["detail"]):
        return ""
    text = f"the scene took too long for its tick and reduced its detail in {found['lighter_ticks']} ticks"
    if found["behind_s"] > 0.0:
        text += f"; its time is {found['behind_s']:.3g} s behind"
    return f"{text}. Use fewer bodies and contacts, a longer timestep, fewer solver iterations, or a lower --rate"


# --------------------------------------------------------------------------------------------------
# Faults of a world's code, read from the rows: it failed, or it takes too long for a tick.


_MEDIAN_ROWS = 64  #: number of last rows for the median
_MAX_PERIOD_SHARE = 0.5  #: share of a period that a world may take; the rest of the tick needs about 0.2 ms
_STAGE = STAGES.index("world")


def is_tripped(shared: SharedMemory, reason: Trip) -> bool:
    """Whether the coils are off because of `reason`."""
    row = shared.ring.latest()
    if row is None:
        return False
    guard, trip = row[shared.layout["guard"].start], row[shared.layout["trip"].start]
    return bool(guard == GuardState.TRIPPED and trip == reason)


def world_failure(shared: SharedMemory) -> str:
    """Error of the world's code with its place, or the value in its memory that is not finite, if that has switched
    the coils off; else empty."""
    failed = is_tripped(shared, Trip.WORLD_FAILED) or is_tripped(shared, Trip.MEMORY_NOT_FINITE)
    if not failed or not (error := shared.error.read()[1]):
        return ""  # the row is published shortly before the error
    return f"world '{shared.world_now()}' failed: {error}"


def describe_slow_world(shared: SharedMemory, rate: float) -> str:
    """Warning that the world takes more than half of a tick at `rate` [Hz], with both times; else empty."""
    _, rows = shared.ring.read_since(max(shared.words[Word.ROWS] - _MEDIAN_ROWS, 0))
    times = rows[:, shared.layout["stages"].start + _STAGE]
    times = times[np.isfinite(times)]
    if len(times) < _MEDIAN_ROWS // 4 or not (took := float(np.median(times))) > _MAX_PERIOD_SHARE / rate:
        return ""
    return (
        f"world '{shared.world_now()}' takes {1e3 * took:.2g} ms in each tick, and a tick at {rate:g} Hz has "
        f"{1e3 / rate:.2g} ms for everything: make its code faster, or lower the loop's rate."
    )
