"""Several streams of one name: none is used until one is chosen, independent of the order of replies."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest

from haptorb.errors import DriverError
from haptorb.runtime.trackers.base import RawPose
from haptorb.runtime.trackers.lsl_feed import THIS_COMPUTER, LslFeed, lsl_stream

SENDER = f"""
import sys, time
import pylsl
pylsl.set_config_content({THIS_COMPUTER!r})
name, source, speaks = sys.argv[1:4]
outlet = pylsl.StreamOutlet(pylsl.StreamInfo(name, "Pose", 7, 0, "double64", source))
while True:
    if speaks == "speaks":
        outlet.push_sample([0.0, 0.0, 0.055, 0.0, 0.0, 0.0, 1.0])
    time.sleep(0.01)
"""


@pytest.fixture
def publish() -> Iterator[Callable[[str, str, str], subprocess.Popen[bytes]]]:
    """A function that starts a program with a stream: name, source id, "speaks" or "silent"."""
    programs = []

    def start(name: str, source: str, speaks: str) -> subprocess.Popen[bytes]:
        programs.append(subprocess.Popen([sys.executable, "-c", SENDER, name, source, speaks]))
        return programs[-1]

    yield start
    for program in programs:
        program.kill()
        program.wait()


def wait_for(feed: LslFeed, condition: Callable[[list[object]], bool], limit: float = 20.0) -> bool:
    found: list[object] = []
    end = time.monotonic() + limit
    while not condition(found) and time.monotonic() < end:
        found += feed.receive(0.05)
    return condition(found)


def has_pose(found: list[object]) -> bool:
    return any(isinstance(one, RawPose) for one in found)


def test_of_two_streams_of_a_name_none_is_used_until_one_is_chosen(
    publish: Callable[[str, str, str], subprocess.Popen[bytes]],
) -> None:
    name = f"stylus-{time.monotonic_ns()}"
    publish(name, "silent-one", "silent")
    publish(name, "speaking-one", "speaks")
    lsl_stream(f"{name}/silent-one", 20.0)
    lsl_stream(f"{name}/speaking-one", 20.0)
    for _ in range(3):
        with pytest.raises(
            DriverError, match=f"2 streams.*silent-one.*lsl:{name}/|2 streams.*speaking-one.*lsl:{name}/"
        ) as said:
            lsl_stream(name, 20.0)
        assert "silent-one" in str(said.value)
        assert "speaking-one" in str(said.value)
    feed = LslFeed(f"{name}/speaking-one")
    assert wait_for(feed, has_pose)
    assert feed.remark == ""
    feed.close()


def test_a_second_stream_is_said_and_takes_the_place_of_the_first_only_alone(
    publish: Callable[[str, str, str], subprocess.Popen[bytes]],
) -> None:
    name = f"stylus-{time.monotonic_ns()}"
    first = publish(name, "first", "speaks")
    feed = LslFeed(name) if lsl_stream(name, 20.0) else None
    assert feed is not None
    assert wait_for(feed, has_pose)
    second = publish(name, "second", "speaks")
    assert wait_for(feed, lambda found: "2 streams" in feed.remark)
    assert "first" in feed.remark
    assert "second" in feed.remark
    third = publish(name, "third", "speaks")
    assert wait_for(feed, lambda found: "3 streams" in feed.remark)
    first.kill()
    first.wait()
    assert wait_for(feed, lambda found: "none of them is used" in feed.remark)
    assert not wait_for(feed, has_pose, 2.5)
    for program in (second,):
        program.kill()
        program.wait()
    assert wait_for(feed, has_pose)
    assert third.poll() is None
    feed.close()


def test_a_name_may_have_a_slash(publish: Callable[[str, str, str], subprocess.Popen[bytes]]) -> None:
    name = f"lab/stylus-{time.monotonic_ns()}"
    publish(name, "one", "speaks")
    assert lsl_stream(name, 20.0).source_id() == "one"
    assert lsl_stream(f"{name}/one", 20.0).source_id() == "one"
    with pytest.raises(DriverError, match="no stream"):
        lsl_stream(f"{name}/two", 0.5)
