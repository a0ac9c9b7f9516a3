"""Validation of a tracker's poses: order, finiteness and plausibility; adds velocities.

Rejected poses are counted by reason, so that a sender's mistake can be found; the last valid pose then ages, and the
guard handles its expiry. After a jump either that pose or the one before is wrong, so the tool counts as lost until
successive poses are consistent again.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from math import exp, isfinite, sqrt
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.control.trip_reasons import Trip
from haptorb.runtime.shared_memory import PoseBlock, PoseRecord
from haptorb.runtime.trackers.base import Feed, RawPose, RejectedPose
from haptorb.runtime.trackers.registry import has_feed
from haptorb.runtime.trackers.sender_clock import RESTART_GAP_S

__all__ = ["REASONS", "PoseFilter", "describe_missing_pose", "describe_source", "describe_trip"]


#: reasons of rejection, as named in the report
REASONS = {
    "garbage": "not a message of the documented layout",
    "stranger": "without the token",
    "other_message": "about another object, or to another address",
    "another_account": "from another account of this computer, or from a port of unknown owner or open to others",
    "another_sender": "from another sender than the poses before",
    "not_finite": "a number that is not finite",
    "no_rotation": "a quaternion whose length is not 1",
    "too_far": "farther than 5 m away: millimetres instead of metres?",
    "out_of_order": "not newer than the last pose",
    "jump": "farther from the last pose than a hand can move the tool",
}

_MAX_DISTANCE_M = 5.0  #: largest distance of a tool; a position in millimetres exceeds it
_MAX_LENGTH_ERROR = 0.1  #: largest deviation of a quaternion's length from 1
_MAX_SPEED = 3.0  #: speed limit of the tool: faster motion is a jump [m/s]
_MAX_RATE = 30.0  #: the same for its angular velocity [rad/s]
_MIN_ARRIVAL_STEP_S = 0.010  #: smallest time between two poses without timestamps, which may arrive in bursts
_MIN_STAMP_STEP_S = 0.004  #: the same for poses with timestamps, converted between clocks
_RECOVERY_TIME_S = 0.05  #: after a jump: time for which poses must be consistent, and at least three of them
_VELOCITY_TIME_CONSTANT_S = 0.010  #: time constant of the velocity filter
_MAX_INTERVAL_S = 0.05  #: longest time between two poses; a longer one is a gap
_MIN_BESIDE_M = 0.01  #: distance from the centre below which the position is not checked
_POSTURE_TIME_S = 1.0  #: time after which an implausible posture is reported
_LENGTH = 2048  #: number of intervals and delays for the percentiles


@final
class PoseFilter:
    """Checks the poses of `feed` and writes valid ones to `block`."""

    def __init__(self, feed: Feed, block: PoseBlock) -> None:
        self._feed, self._block = feed, block
        self._last: PoseRecord | None = None  # the last valid pose; None after a loss
        self._arrival = float("-inf")  # of the last accepted message
        self._stamp = float("-inf")
        self._unconfirmed: PoseRecord | None = None  # last pose since a jump, until confirmed
        self._since, self._alike = 0.0, 0  # start and number of the consistent poses
        self.accepted = 0
        self.lost = 0  #: losses of the tool that the tracker reported
        self.gaps = 0  #: silences above 50 ms
        self.refused: Counter[str] = Counter()
        self._suspected, self._suspected_since, self._posture = "", 0.0, ""
        self._intervals: deque[float] = deque(maxlen=_LENGTH)
        self._delays: deque[float] = deque(maxlen=_LENGTH)

    def listen(self, timeout: float) -> None:
        """Process the messages that arrive within `timeout` [s]."""
        for one in self._feed.receive(timeout):
            if isinstance(one, RejectedPose):
                self.refused[one.why] += 1
            else:
                self._accept(one)

    def _accept(self, raw: RawPose) -> None:
        why = "" if isfinite(raw.stamp) and isfinite(raw.arrival) else "not_finite"
        if not why and raw.arrival - self._arrival > RESTART_GAP_S:
            self._stamp = float("-inf")
        if not why and raw.valid:
            why = _find_fault(raw)
        if not why and not raw.stamp > self._stamp:  # safety: pose-late
            why = "out_of_order"
        if why:
            self.refused[why] += 1
            return
        passed = raw.arrival - self._arrival
        if isfinite(passed):
            self._intervals.append(passed)
            self.gaps += passed > _MAX_INTERVAL_S
        self._arrival, self._stamp = raw.arrival, raw.stamp
        if not raw.valid:
            self.lost += self._last is not None
            before, self._last, self._unconfirmed = self._last, None, None
            if before is not None:
                self._block.write(before._replace(valid=False, stamp=raw.stamp))  # safety: tool-lost
            return
        p, q = np.array(raw.p, dtype=np.float64), np.array(raw.q, dtype=np.float64)
        pose = PoseRecord(True, p, q / sqrt(float(q @ q)), np.zeros(3), np.zeros(3), raw.stamp)
        least = _MIN_ARRIVAL_STEP_S if raw.stamp >= raw.arrival else _MIN_STAMP_STEP_S
        if self._feed.one_tool and self._is_unconfirmed(pose, least):
            self.refused["jump"] += 1
            return
        self.accepted += 1
        self._check_posture(pose)
        self._delays.append(raw.arrival - raw.stamp)
        self._last = self._add_velocity(pose)
        self._block.write(self._last)

    def _check_posture(self, pose: PoseRecord) -> None:
        """Detect a tool that points down, or is beside the device, for a second: a sign of another pose convention."""
        remark = _explain_posture(pose.p, pose.q) if self._feed.one_tool else ""
        if remark != self._suspected:
            self._suspected, self._suspected_since = remark, pose.stamp
        self._posture = remark if pose.stamp - self._suspected_since >= _POSTURE_TIME_S else ""

    def _is_unconfirmed(self, pose: PoseRecord, least: float) -> bool:
        """Whether `pose` has jumped, or follows one that has; `least` [s]: smallest time between two stamps."""
        last = self._unconfirmed or self._last
        jumped = last is not None and _is_jump(last, pose, max(pose.stamp - last.stamp, least))
        if self._unconfirmed is None:
            if not jumped:
                return False
            assert self._last is not None
            self.lost += 1
            self._block.write(self._last._replace(valid=False, stamp=pose.stamp))  # safety: jumped-lost
            self._last = None
        if jumped:
            self._since, self._alike = pose.stamp, 0
        self._alike += 1
        self._unconfirmed = pose
        if self._alike < 3 or pose.stamp - self._since < _RECOVERY_TIME_S:
            return True
        self._unconfirmed = None
        return False

    def _add_velocity(self, pose: PoseRecord) -> PoseRecord:
        """Add the filtered velocities since the pose before; zero after a loss, a gap or a jump."""
        p, q, v, w = pose.p, pose.q, pose.v, pose.w
        last = self._last
        if last is not None and 0.0 < pose.stamp - last.stamp <= _MAX_INTERVAL_S:
            passed = pose.stamp - last.stamp
            rate, turn = (p - last.p) / passed, _rotation_between(last.q, q) / passed
            share = 1.0 - exp(-passed / _VELOCITY_TIME_CONSTANT_S)
            if float(rate @ rate) <= _MAX_SPEED**2 and float(turn @ turn) <= _MAX_RATE**2:
                v, w = last.v + share * (rate - last.v), last.w + share * (turn - last.w)
        return pose._replace(v=v, w=w)

    def facts(self) -> dict[str, Any]:
        """Statistics of the poses, as plain JSON types; rates and times over the last 2048 poses."""
        intervals, delays = np.array(self._intervals), 1e3 * np.array(self._delays)
        middle = float(np.median(intervals)) if len(intervals) else None
        return {
            "rate_hz": None if not middle else float(1.0 / intervals.mean()),
            "jitter_ms": None if middle is None else 1e3 * float(np.percentile(np.abs(intervals - middle), 99)),
            "latency_ms": None if not len(delays) else _percentiles(delays),
            "accepted": self.accepted,
            "lost": self.lost,
            "gaps": self.gaps,
            "refused": dict(self.refused),
            "remark": (self._feed.remark or self._posture),
        }


def _find_fault(raw: RawPose) -> str:
    """Reason to reject the pose; empty if it is valid."""
    if len(raw.p) != 3 or len(raw.q) != 4:
        return "garbage"
    if not isfinite(sum(map(abs, raw.p)) + sum(map(abs, raw.q))):  # safety: pose-finite
        return "not_finite"
    if sqrt(sum(x * x for x in raw.p)) > _MAX_DISTANCE_M:  # safety: pose-millimetres
        return "too_far"
    length = sqrt(sum(x * x for x in raw.q))
    return "" if abs(length - 1.0) <= _MAX_LENGTH_ERROR else "no_rotation"


def _is_jump(before: PoseRecord, pose: PoseRecord, passed: float) -> bool:
    """Whether the motion between the poses within `passed` [s] exceeds the speed limits."""
    way, turn = pose.p - before.p, _rotation_between(before.q, pose.q)
    # safety: jump-seen
    return bool(float(way @ way) > (_MAX_SPEED * passed) ** 2 or float(turn @ turn) > (_MAX_RATE * passed) ** 2)


def _explain_posture(p: Array, q: Array) -> str:
    """Explain why the pose `p` (3,) [m], `q` (4,) of a tool is implausible; empty if it is plausible.

    >>> _explain_posture(np.array([0.0, 0.0, 0.05]), np.array([1.0, 0.0, 0.0, 0.0]))
    'the tool points down: if the quaternion is sent with w first, add ,w-first to the tracker'
    >>> _explain_posture(np.array([0.0, 0.05, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]))
    'the tool is beside the device, along +y: if y is up where the poses come from, add ,y-up to the tracker'
    """
    if 1.0 - 2.0 * float(q[0] ** 2 + q[1] ** 2) < -0.5:
        w_first = 1.0 - 2.0 * float(q[1] ** 2 + q[2] ** 2) > 0.5
        hint = "the quaternion is sent with w first, add ,w-first to" if w_first else "it does not, check the axes of"
        return f"the tool points down: if {hint} the tracker"
    distance = sqrt(float(p @ p))
    if distance > _MIN_BESIDE_M and float(p[1]) > 0.9 * distance:
        return "the tool is beside the device, along +y: if y is up where the poses come from, add ,y-up to the tracker"
    return ""


def _rotation_between(before: Array, q: Array) -> Array:
    """Rotation vector (3,) [rad], stator frame: the shortest rotation between two unit quaternions (x, y, z, w)."""
    a, b = before, q
    v = np.array(
        [
            -b[3] * a[0] + b[0] * a[3] - b[1] * a[2] + b[2] * a[1],
            -b[3] * a[1] + b[1] * a[3] - b[2] * a[0] + b[0] * a[2],
            -b[3] * a[2] + b[2] * a[3] - b[0] * a[1] + b[1] * a[0],
        ]
    )
    c = float(a @ b)
    v = v if c >= 0.0 else -v
    s = sqrt(float(v @ v))
    scale = 2.0 * float(np.arctan2(s, abs(c))) / s if s > 1e-12 else 2.0
    turn: Array = scale * v
    return turn


def _percentiles(values: Array) -> dict[str, float]:
    return {"p50": float(np.percentile(values, 50)), "p99": float(np.percentile(values, 99))}


# --------------------------------------------------------------------------------------------------
# Messages on the source of poses: missing, expired and lost poses.


_POSE = (Trip.POSE_EXPIRED, Trip.POSE_LOST)
_EXPIRED = {
    "pointer": (
        "The page that held the mover was closed, hidden or too busy, or its program stopped sending the pointer's "
        "position. Keep the page in view, re-engage, then take hold again."
    ),
    "hall": (
        "The field sensors' readings arrived too late, or the page that held the mover was closed, hidden or too busy. "
        "Check the cable, keep the page in view, then re-engage."
    ),
    "replay": "The recording has ended, or has a gap there. Start it again, or re-engage when it has poses again.",
}
_LOST = {
    "pointer": "The pointer no longer holds the mover. Take hold of it on the page, then re-engage.",
    "hall": (
        "The field sensors cannot locate the mover: it is too far away, or another magnet is near. Put it back "
        "over the device, then re-engage."
    ),
    "replay": "The recording has no pose there. Start it again, or re-engage when it has poses again.",
    "natnet": "The cameras lost the mover's markers. Bring them back into view, uncovered, then re-engage.",
}


def describe_source(tracker: str) -> str:
    """Describe the source of the poses of `tracker`, as in `--tracker`.

    >>> describe_source("osc:9109"), describe_source("pointer")
    ('OSC port 9109', 'the pointer')
    """
    kind, _, where = tracker.partition(":")
    match kind:
        case "osc":
            return f"OSC port {where.rpartition(':')[2].replace(',', ' as ', 1)}"
        case "lsl":
            return f"the LSL stream '{where}'"
        case "natnet":
            server, _, body = where.partition("/")
            return f"the OptiTrack server {server}" + (f", rigid body {body}" if body else "")
        case "replay":
            return f"the recording {where}"
        case "hall":
            return "the field sensors"
        case _:
            return "the pointer"


def describe_trip(trip: Trip, tracker: str, facts: Mapping[str, Any] | None = None) -> str:
    """Explain a trip and what to do, for the tracker `tracker`.

    facts   `PoseFilter.facts`: accepted and rejected poses are stated where poses are missing

    >>> describe_trip(Trip.POSE_EXPIRED, "osc:9109")[:58]
    'No new pose arrived in time from OSC port 9109. Check the '
    >>> describe_trip(Trip.STOPPED, "osc:9109") == Trip.STOPPED.text
    True
    >>> describe_trip(Trip.POSE_EXPIRED, "osc:9109", {"accepted": 3, "refused": {"too_far": 7}})[:71]
    'No valid pose arrived in time from OSC port 9109: 3 accepted, 7 refused'
    """
    if trip not in _POSE:
        return trip.text
    if has_feed(tracker) and facts and (sum(facts.get("refused", {}).values()) or facts.get("remark")):
        what = "No valid pose arrived in time" if trip is Trip.POSE_EXPIRED else "The mover was lost"
        todo = "Check the program that sends the poses, then re-engage."
        return f"{what} from {describe_source(tracker)}: {_count(facts)}. {todo}"
    special = (_EXPIRED if trip is Trip.POSE_EXPIRED else _LOST).get(tracker.partition(":")[0])
    if special is not None:
        return special
    source = describe_source(tracker)
    if trip is Trip.POSE_EXPIRED:
        return f"No new pose arrived in time from {source}. Check the program that sends the poses, then re-engage."
    return (
        f"The tracker lost the mover: {source} reported it, or its poses jumped. Bring the mover back into view, then "
        "re-engage."
    )


def describe_missing_pose(tracker: str, facts: Mapping[str, Any]) -> str:
    """Describe the missing pose while none is valid; empty for a tracker without its own process.

    facts   `PoseFilter.facts`, empty before the first report of the tracker's process

    >>> describe_missing_pose("osc:9109", {})
    'waiting for a pose on OSC port 9109: none yet'
    >>> describe_missing_pose("osc:9109", {"accepted": 0, "lost": 0, "refused": {"too_far": 7}})
    'waiting for a pose on OSC port 9109: 7 refused (7 farther than 5 m away: millimetres instead of metres?)'
    >>> describe_missing_pose("natnet:lab", {"accepted": 90, "lost": 2, "refused": {}})
    'waiting for a pose from the OptiTrack server lab: 90 accepted, mover lost 2 times'
    """
    if not has_feed(tracker):
        return ""
    place = "on" if tracker.startswith("osc:") else "from"
    return f"waiting for a pose {place} {describe_source(tracker)}: {_count(facts) or 'none yet'}"


def _count(facts: Mapping[str, Any]) -> str:
    """Counts of accepted and rejected poses, with the reasons; empty if nothing arrived."""
    counts = []
    if accepted := facts.get("accepted", 0):
        counts.append(f"{accepted} accepted")
    if lost := facts.get("lost", 0):
        counts.append("mover lost once" if lost == 1 else f"mover lost {lost} times")
    refused = {why: number for why, number in facts.get("refused", {}).items() if number}
    if refused:
        reasons = ", ".join(f"{number} {REASONS.get(why, why)}" for why, number in refused.items())
        counts.append(f"{sum(refused.values())} refused ({reasons})")
    if remark := facts.get("remark"):
        counts.append(str(remark))
    return ", ".join(counts)
