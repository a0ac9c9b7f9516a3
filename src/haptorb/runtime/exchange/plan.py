"""What a servo process is to build: pickled by value, so that worlds written in a user's script come along."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from haptorb.runtime.tick.chain import Chain
from haptorb.runtime.trackers.tracker import Tracker
from haptorb.worlds.world import World

__all__ = ["Plan", "load", "save"]


@dataclass(frozen=True)
class Plan:
    """The world at the start, and how to make the chain that renders it."""

    world: World
    rate: float  #: [Hz]
    assemble: Callable[[Tracker], Chain]
    practice: Callable[[Tracker], Chain]  #: the same on the simulated device, run before the start
    prediction: float | None  #: of a tracker's own process [s]; None: the host's pointer is the tracker
    calibration: bytes | None  #: id of what the controller believes of the device beside its file
    compiling: Callable[[], Iterator[None]]  #: its code part by part, for a first start's second process


def save(plan: Plan, path: Path) -> None:
    """Write `plan` to the file `path`, with the folders in which its modules were found."""
    import cloudpickle

    path.write_bytes(pickle.dumps((sys.path, cloudpickle.dumps(plan))))


def load(path: Path) -> Plan:
    """The plan in the file `path`; only for files that the starting process has just written itself."""
    folders, content = pickle.loads(path.read_bytes())
    sys.path[:] = folders
    return cast(Plan, pickle.loads(content))
