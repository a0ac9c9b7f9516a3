"""The parameters of the processes beside the loop, as plain JSON types."""

from __future__ import annotations

import json
import os
from base64 import b64encode
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from time import monotonic_ns, time_ns
from typing import Any

from haptorb.control.clutch.gains import Gains
from haptorb.devices.device import Device
from haptorb.errors import InputError
from haptorb.runtime.exchange.shared_memory import SharedMemory
from haptorb.runtime.exchange.world_change import name_of
from haptorb.runtime.recording.software import describe_machine, list_versions
from haptorb.runtime.tick.assembly import read_learned
from haptorb.runtime.trackers.tracker_registry import Preparation
from haptorb.sensing.frame.tracker_frame import TrackerFrame
from haptorb.worlds.own.world_note import note_world
from haptorb.worlds.world import World

__all__ = ["check_seed", "describe_choices", "notes", "recorder_spec", "tracker_spec"]


_LONGEST = 1_000_000  #: characters of how a world is made


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


def notes(device: Device, run: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """Metadata of a recording: its `device` (with its file, if it has one), the `run` (with what its estimator learned,
    in base64), and the software."""
    learned = b64encode(read_learned(device, run["estimator"])).decode()
    return {
        "device": {
            "name": device.name,
            "digest": device.digest,
            "title": device.title,
            "source": device.source,
            **(device.text.as_note() if device.text else {"file": ""}),
            "coils": json.dumps(device.coils.names),
        },
        "run": {**run, "learned": learned} if learned else dict(run),
        "versions": list_versions(),
        "machine": describe_machine(),
    }


def tracker_spec(shared: SharedMemory, tracker: Preparation, frame: TrackerFrame | None) -> dict[str, Any]:
    """For `tracker_process`: the prepared tracker, and the `frame` between tracker and stator if there is one."""
    return {
        "shared": str(shared.path),
        "descriptor": tracker.descriptor,
        "parent": os.getpid(),
        "feed": tracker.spec,
        "frame": "" if frame is None else frame.text(),
    }


def describe_choices(gains: Gains | None, torque_arm: float | None, worlds: Iterable[World]) -> dict[str, str]:
    """Further data for a replay: `gains`, `torque_arm` [m], and the source of each world."""
    made = {name_of(world): note_world(world) for world in worlds}
    return {
        "gains": "" if gains is None else json.dumps(asdict(gains)),
        "torque_arm_m": "" if torque_arm is None else repr(torque_arm),
        "worlds": json.dumps({name: text for name, text in made.items() if len(text) <= _LONGEST}),
    }


def check_seed(seed: int) -> int:
    """`seed` itself; InputError unless it is a whole number, 0 or more."""
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed must be a whole number, 0 or more; got {seed!r}")
    return seed
