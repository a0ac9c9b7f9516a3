"""Lab streaming layer (LSL) streams of a session for other equipment: events, and pose of the tool.

    haptorb-markers  irregular text, JSON: {"kind": "trial", "trial": 1, "set_point": 12, ...}; kinds are trial, answer,
                     safety, interval, time is up, device off, break, pause, resume, repeat, reply, session, leave,
                     abort, done, end; trials count from 1, as on the pages
    haptorb-pose     every tick: x y z [m], quaternion x y z w, valid; stamped with the time the tick began

The layer's clock is this computer's monotonic one, and so is the loop's: stamps of rows need an offset only.
"""

from __future__ import annotations

import json
import os
from time import monotonic
from typing import TYPE_CHECKING, Any, final

import numpy as np

from haptorb.errors import InputError
from haptorb.runtime.trackers.lsl_feed import THIS_COMPUTER

if TYPE_CHECKING:
    import pylsl

    from haptorb.runtime.servo import Servo

__all__ = ["MARKERS", "POSE", "REACHES", "Streams", "open_streams"]

MARKERS, POSE = "haptorb-markers", "haptorb-pose"
REACHES = ("computer", "network")  #: visibility of the streams
_CHANNELS = ("x", "y", "z", "qx", "qy", "qz", "qw", "valid")
_UNITS = ("m", "m", "m", "1", "1", "1", "1", "1")


@final
class Streams:
    """Both streams. `offset` from this computer's monotonic clock to the LSL clock [s]."""

    def __init__(self, markers: pylsl.StreamOutlet, pose: pylsl.StreamOutlet, offset: float = 0.0) -> None:
        self._markers, self._pose, self._offset = markers, pose, offset
        self._servo: Servo | None = None
        self._cursor = 0
        self.lost = 0  #: rows overwritten before they were sent

    def mark(self, kind: str, facts: dict[str, Any]) -> None:
        """Send an event marker, now."""
        marker = json.dumps({"kind": kind, **facts}, ensure_ascii=False, default=str)
        self._markers.push_sample([marker], monotonic() + self._offset)

    def poses(self, servo: Servo) -> None:
        """Send every row that `servo` published since the last call."""
        if servo is not self._servo:
            self._servo, self._cursor = servo, servo.rows(0)[0]
        before = self._cursor
        self._cursor, rows = servo.rows(before)
        if not len(rows):
            return
        self.lost += self._cursor - before - len(rows)
        layout = servo.layout
        samples = np.concatenate([rows[:, layout[name]] for name in ("p", "q", "valid")], axis=1)
        self._pose.push_chunk(samples, (rows[:, layout["wall"]][:, 0] + self._offset).tolist())


def _ignore_local_settings() -> None:
    """Keep the library from reading an `lsl_api.cfg` of the current folder, which could name whom streams are shown to.

    It reads the file that LSLAPICFG names before all others.
    """
    if "LSLAPICFG" not in os.environ:  # safety: no-local-lsl-settings
        own = (os.path.expanduser("~/lsl_api/lsl_api.cfg"), "/etc/lsl_api/lsl_api.cfg")  # as the library looks for them
        os.environ["LSLAPICFG"] = next((file for file in own if os.path.isfile(file)), os.devnull)


def open_streams(reach: str, rate: float = 1000.0) -> Streams:
    """Open both streams, visible on this "computer" only or on its "network".

    Raises InputError if that is neither, or if the layer's library is not installed.
    """
    if reach not in REACHES:
        raise InputError(f"streams reach '{REACHES[0]}' or '{REACHES[1]}'; got '{reach}'")
    try:
        import pylsl
    except (ImportError, RuntimeError, OSError) as cause:  # without its package, or without liblsl
        raise InputError(
            f"streams need the lab streaming layer, which is not installed ({cause}): pip install pylsl, or run "
            "without --lsl"
        ) from cause
    if reach == "computer":
        pylsl.set_config_content(THIS_COMPUTER)
    else:
        _ignore_local_settings()
    markers = pylsl.StreamInfo(MARKERS, "Markers", 1, pylsl.IRREGULAR_RATE, pylsl.cf_string, f"{MARKERS}-study")
    pose = pylsl.StreamInfo(POSE, "MoCap", len(_CHANNELS), rate, pylsl.cf_double64, f"{POSE}-study")
    channels = pose.desc().append_child("channels")
    for label, unit in zip(_CHANNELS, _UNITS, strict=True):
        channel = channels.append_child("channel")
        channel.append_child_value("label", label)
        channel.append_child_value("unit", unit)
    return Streams(pylsl.StreamOutlet(markers), pylsl.StreamOutlet(pose), pylsl.local_clock() - monotonic())
