"""The plan of a servo process: pickled by value, so that it includes worlds defined in a user's script."""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from haptorb.cluster import append_folders
from haptorb.devices.base import Device
from haptorb.own_code import pickle_with_code
from haptorb.runtime.tick import Chain
from haptorb.runtime.trackers.base import Tracker
from haptorb.runtime.warm_up import Compilation
from haptorb.worlds.base import World

__all__ = ["Plan", "load", "pack", "save", "unpack"]


@dataclass(frozen=True)
class Plan:
    """The world at the start, and how to make the chain that renders it."""

    device: Device
    world: World
    rate: float  #: [Hz]
    assemble: Callable[[Tracker], Chain]
    practice: Callable[[Tracker], Chain]  #: the same on the simulated device, run before the start
    prediction: float | None  #: of a tracker's own process [s]; None: the host's pointer is the tracker
    calibration: bytes | None  #: id of the calibration that the controller uses beside the device file
    compilation: Compilation  #: of its code, for a first start's second process
    own_worlds: Mapping[str, World] = field(default_factory=dict)  #: beside the catalogue's, by name
    reloads: bool = False  #: whether one of them may be replaced while the loop runs


def pack(what: Any) -> bytes:
    """`what` pickled with its code and with the folders in which its modules were found."""
    return pickle.dumps(([os.path.abspath(one) for one in sys.path], pickle_with_code(what)))


def unpack(content: bytes) -> Any:
    """What was given to `pack`; only for what a process of this run has just packed."""
    folders, packed = pickle.loads(content)
    append_folders(folders)
    return pickle.loads(packed)


def save(plan: Plan, path: Path) -> None:
    """Write `plan` to the file `path`, with the folders in which its modules were found."""
    path.write_bytes(pack(plan))


def load(path: Path) -> Plan:
    """The plan in the file `path`; only for files that the starting process has just written itself."""
    return cast(Plan, unpack(path.read_bytes()))
