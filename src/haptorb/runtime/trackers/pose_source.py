"""What people read about where poses come from: what is waited for, and what an old or lost pose means there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from haptorb.control.protection.trip import Trip
from haptorb.runtime.trackers.pose_filter import REASONS
from haptorb.runtime.trackers.tracker_registry import has_feed

__all__ = ["describe_missing_pose", "describe_source", "describe_trip"]

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
    """Where the poses of `tracker`, as in `--tracker`, come from.

    >>> describe_source("osc:9109"), describe_source("pointer")
    ('OSC port 9109', 'the pointer')
    """
    kind, _, where = tracker.partition(":")
    match kind:
        case "osc":
            return f"OSC port {where.rpartition(':')[2]}"
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


def describe_trip(trip: Trip, tracker: str) -> str:
    """What happened and what to do, for those whose poses come from `tracker`.

    >>> describe_trip(Trip.POSE_EXPIRED, "osc:9109")[:58]
    'No new pose arrived in time from OSC port 9109. Check the '
    >>> describe_trip(Trip.STOPPED, "osc:9109") == Trip.STOPPED.text
    True
    """
    if trip not in _POSE:
        return trip.text
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
    """What is waited for while no pose is valid; empty where poses do not come from outside.

    facts   `PoseFilter.facts`, empty before the tracker's process said anything

    >>> describe_missing_pose("osc:9109", {})
    'waiting for a pose on OSC port 9109: none yet'
    >>> describe_missing_pose("osc:9109", {"accepted": 0, "lost": 0, "refused": {"too_far": 7}})
    'waiting for a pose on OSC port 9109: 7 refused (7 farther than 5 m away: millimetres instead of metres?)'
    >>> describe_missing_pose("natnet:lab", {"accepted": 90, "lost": 2, "refused": {}})
    'waiting for a pose from the OptiTrack server lab: 90 accepted, mover lost 2 times'
    """
    if not has_feed(tracker):
        return ""
    counts = []
    if accepted := facts.get("accepted", 0):
        counts.append(f"{accepted} accepted")
    if lost := facts.get("lost", 0):
        counts.append("mover lost once" if lost == 1 else f"mover lost {lost} times")
    refused = {why: number for why, number in facts.get("refused", {}).items() if number}
    if refused:
        reasons = ", ".join(f"{number} {REASONS.get(why, why)}" for why, number in refused.items())
        counts.append(f"{sum(refused.values())} refused ({reasons})")
    place = "on" if tracker.startswith("osc:") else "from"
    return f"waiting for a pose {place} {describe_source(tracker)}: {', '.join(counts) or 'none yet'}"
