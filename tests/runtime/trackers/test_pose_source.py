"""Messages on missing poses: the source's own terms, remedies, and counts."""

from __future__ import annotations

import pytest

from haptorb.control.trip_reasons import Trip
from haptorb.runtime.trackers.pose_filter import describe_missing_pose, describe_source, describe_trip

SOURCES = {
    "pointer": "page",
    "hall": "field sensors",
    "osc:9109": "OSC port 9109",
    "osc:0.0.0.0:9109": "OSC port 9109",
    "lsl:Motive": "LSL stream 'Motive'",
    "natnet:lab/3": "camera",
    "replay:a.mcap": "recording",
}


@pytest.mark.parametrize("tracker", SOURCES)
@pytest.mark.parametrize("trip", [Trip.POSE_EXPIRED, Trip.POSE_LOST])
def test_the_text_of_a_lost_pose_fits_its_source_and_says_what_to_do(tracker: str, trip: Trip) -> None:
    text = describe_trip(trip, tracker)
    if (tracker, trip) != ("natnet:lab/3", Trip.POSE_EXPIRED):
        assert SOURCES[tracker] in text
    assert "re-engage" in text
    assert text.endswith(".")
    if tracker == "pointer":  # nobody's camera or cable is at fault
        assert "racker" not in text


def test_every_other_trip_reads_the_same_whoever_knows_the_pose() -> None:
    for trip in set(Trip) - {Trip.POSE_EXPIRED, Trip.POSE_LOST}:
        assert {describe_trip(trip, tracker) for tracker in SOURCES} == {trip.text}


def test_what_is_waited_for_has_the_place_and_the_counts() -> None:
    assert describe_missing_pose("pointer", {}) == describe_missing_pose("hall", {}) == ""
    none = describe_missing_pose("osc:127.0.0.1:9109", {"accepted": 0, "lost": 0, "refused": {}})
    assert none == "waiting for a pose on OSC port 9109: none yet"
    facts = {"accepted": 12, "lost": 1, "refused": {"too_far": 3, "jump": 2, "garbage": 0}}
    some = describe_missing_pose("lsl:Motive", facts)
    assert "LSL stream 'Motive'" in some
    for part in ("12 accepted", "lost once", "5 refused", "3 farther than 5 m", "2 farther from the last pose"):
        assert part in some
    assert describe_source("natnet:lab/3") == "the OptiTrack server lab, rigid body 3"
