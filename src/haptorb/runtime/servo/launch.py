"""What the processes beside the loop are told when they start, as plain JSON types."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from time import monotonic_ns, time_ns
from typing import Any

import numpy as np

from haptorb.devices.device import Device
from haptorb.runtime.exchange.shared_memory import SharedMemory
from haptorb.runtime.trackers.tracker_registry import Preparation
from haptorb.sensing.frame.tracker_frame import TrackerFrame
from haptorb.version import __version__

__all__ = ["notes", "recorder_spec", "tracker_spec"]


def recorder_spec(
    shared: SharedMemory, servo: int, descriptor: int, rate: float, *, temporary: Path | None, notes: Mapping[str, Any]
) -> dict[str, Any]:
    """For `recorder_process`: `servo` is the loop's process id, `rate` in Hz; a `temporary` file it may delete."""
    return {
        "shared": str(shared.path),
        "descriptor": descriptor,
        "servo": servo,
        "parent": os.getpid(),
        "rate": rate,
        "unix_minus_monotonic": time_ns() - monotonic_ns(),
        "temporary": None if temporary is None else str(temporary),
        "notes": notes,
    }


def notes(device: Device, text: str, run: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """What a recording says of its `device` (with the `text` of its file), of the `run`, and of who made it."""
    return {
        "device": {
            "name": device.name,
            "digest": device.digest,
            "title": device.title,
            "source": device.source,
            "file": text,
            "coils": json.dumps(device.coils.names),
        },
        "run": dict(run),
        "versions": {"haptorb": __version__, "numpy": np.__version__},
    }


def tracker_spec(shared: SharedMemory, tracker: Preparation, frame: TrackerFrame | None) -> dict[str, Any]:
    """For `tracker_process`: what was prepared, and the `frame` between tracker and stator if there is one."""
    return {
        "shared": str(shared.path),
        "descriptor": tracker.descriptor,
        "parent": os.getpid(),
        "feed": tracker.spec,
        "frame": "" if frame is None else frame.text(),
    }
