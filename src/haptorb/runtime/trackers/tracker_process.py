"""Tracker process, which receives a tracker's poses: `python -m haptorb.runtime.trackers.tracker_process`.

Its specification comes as JSON on its standard input, because every account can read the arguments of a process, and
the specification contains a token.

It may wait for the network and parse messages, which a tick must not. It writes poses to the memory that it shares
with the servo, and ends when the servo or its parent has ended.
"""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from time import monotonic, process_time, sleep
from typing import Any

from haptorb.compiled import load_compiler
from haptorb.errors import HaptorbError
from haptorb.runtime.linux import END_SIGNALS, die_with_parent, is_parent_gone, lower_priority, raise_priority
from haptorb.runtime.shared_memory import Phase, SharedMemory, Word
from haptorb.runtime.trackers.pose_filter import PoseFilter
from haptorb.runtime.trackers.registry import feed_of

__all__ = ["main"]

load_compiler()  # at import, so that no pose waits for it

_POLL_TIMEOUT_S = 0.05  #: longest wait for a pose before the check whether to end
_REPORT_INTERVAL_S = 0.25  #: between two reports
_FLOOD_LOAD = 0.3  #: processor load above which the process counts as flooded


class _ServoEnded(Exception):
    """The servo has ended, or no process reads the poses."""


def main(spec: Mapping[str, Any]) -> int:
    """Receive poses until the servo has ended; return the exit code.

    `spec`: shared (path), descriptor (of an open socket, or −1), parent (process id), feed (of a `Preparation`),
    frame (text of a `TrackerFrame`; empty: poses are in the stator's frame).
    """
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # it ends after the servo
    die_with_parent()
    shared = SharedMemory(Path(spec["shared"]))
    words, parent = shared.words, int(spec["parent"])

    def poll() -> None:
        if words[Word.QUIT] or words[Word.PHASE] >= Phase.ENDED or is_parent_gone(parent):
            raise _ServoEnded

    def origin() -> float:
        words[Word.TRACKER] = Phase.RUNNING  # before the first pose: its sender may wait for the loop
        while words[Word.PHASE] < Phase.RUNNING:
            poll()
            sleep(0.002)
        return float(words[Word.ORIGIN]) * 1e-9

    try:
        feed = feed_of(spec["feed"], spec["descriptor"], origin, spec["frame"])
    except _ServoEnded:
        return 0
    except HaptorbError as cause:
        return _report_failure(shared, str(cause))
    pose_filter = PoseFilter(feed, shared.tracked)
    words[Word.TRACKER] = Phase.RUNNING
    raise_priority()  # it sleeps nearly always, and scheduling delays on a busy computer would age the poses
    report_time, cpu_time = monotonic(), process_time()
    try:
        while True:
            poll()
            pose_filter.listen(_POLL_TIMEOUT_S)
            if (passed := monotonic() - report_time) > _REPORT_INTERVAL_S:
                if process_time() - cpu_time > _FLOOD_LOAD * passed:
                    lower_priority()
                report_time, cpu_time = monotonic(), process_time()
                shared.tracker_facts.write(json.dumps(pose_filter.facts()))
    except _ServoEnded:
        shared.tracker_facts.write(json.dumps(pose_filter.facts()))
        words[Word.TRACKER] = Phase.ENDED
        return 0
    except Exception as cause:
        return _report_failure(shared, str(cause))
    finally:
        feed.close()


def _report_failure(shared: SharedMemory, why: str) -> int:
    shared.tracker_reason.write(why[:4000])
    shared.words[Word.TRACKER] = Phase.FAILED
    return 1


if __name__ == "__main__":
    sys.exit(main(json.loads(sys.stdin.buffer.read())))
