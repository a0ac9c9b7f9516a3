"""One recording, ready to be played: its device, columns, worlds, and where a time is."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, final

from haptorb.apps.console.session import session
from haptorb.apps.view.device_of import find_device
from haptorb.apps.view.overview import Overview
from haptorb.apps.view.recorded_servo import RecordedServo
from haptorb.apps.view.recorded_world import describe_world, list_worlds, read_worlds
from haptorb.apps.view.row_columns import RowColumns
from haptorb.apps.view.row_search import find_row
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.runtime.recording.recording import Recording
from haptorb.version import __version__

__all__ = ["PlayedRecording"]

_NEAR = 2e-6  #: the page's times come as float32: a tick's own time must find it [s]
_NEWEST = 64  #: characters of a version that are shown


@final
class PlayedRecording:
    """The recording at `path`, of the device that it describes, or of `device` (name or path of a device file).

    recording  what is played; damaged rows are left out
    device   what is drawn
    start    time of the first tick on the loop's clock [s]
    seconds  from the first tick to the last [s]
    notices  what a person should know: cut short, another version, no device, missing fields

    Raises RecordingError for a file that is none, InputError for one without rows or times.
    """

    def __init__(self, path: Path, device: str | None = None) -> None:
        self.recording = recording = Recording(path)
        recording.check()
        if not len(recording):
            cut = "it was cut short before its first ticks" if recording.truncated else "nothing was recorded"
            raise InputError(f"{path} has no ticks to play: {cut}")
        recording.require("t")
        self._t = recording["t"]
        self.start, end = self._ends = float(self._t[0]), float(self._t[-1])
        self.seconds = end - self.start
        if not math.isfinite(self.seconds) or self.seconds < 0:
            raise InputError(
                f"{path} cannot be played: its times must increase; the first is {self.start:g} s, the last {end:g} s"
            )
        self.device, trouble = find_device(path, recording.metadata.get("device", {}), device)
        self._servo = RecordedServo(self.device, recording.metadata.get("run", {}))
        self._columns = RowColumns(recording, self._servo.layout, moded=bool(self._servo.modes))
        self._worlds = read_worlds(recording.worlds)
        self.overview = Overview(recording, self.start, end)
        self.notices = [*self._list_notices(), *([trouble] if trouble else [])]

    @property
    def name(self) -> str:
        """Of its file."""
        return self.recording.path.name

    def __len__(self) -> int:
        """Rows."""
        return len(self.recording)

    @property
    def render(self) -> str | None:
        """Part of the wrench that was rendered, overriding the world; None: the world's."""
        return self._servo.render

    def _list_notices(self) -> list[str]:
        notices = list(self.recording.damage)
        if self.recording.truncated:
            notices.append(f"the file is truncated: recorded up to {self.seconds:.2f} s, the rest was cut off")
        made = self.recording.metadata.get("versions", {}).get("haptorb", "")[:_NEWEST]
        if _order(made) > _order(__version__):
            notices.append(f"made by haptorb {made}, newer than this one ({__version__}): new fields are not shown")
        if self._columns.missing:
            notices.append(f"not in the recording, so not shown: {', '.join(self._columns.missing)}")
        notices += [f"at tick {one.get('tick', '?')}: {one.get('text', '')[:300]}" for one in self.recording.errors[:3]]
        return notices

    def find_row(self, seconds: float) -> int:
        """The row at `seconds` after the first tick: the last that is not later. Raises RecordingError for damage."""
        return find_row(self._read_times, len(self), self.start + seconds + _NEAR, self._ends)

    def _read_times(self, first: int, last: int) -> Array:
        times: Array = self._t[first:last]
        return times

    def frame(self, first: int, last: int, question: float) -> bytes:
        """Rows `first` up to `last`, as far as there are such, as a frame; see `RowColumns.frame`."""
        first = min(max(first, 0), len(self) - 1)
        return self._columns.frame(first, min(max(last, first + 1), len(self)), question)

    def find_world(self, change: int) -> tuple[str, dict[str, Any]] | None:
        """Name and values of the world after that `change`, the latest known one before it; None: not noted."""
        known = [number for number in self._worlds if number <= change]
        return self._worlds[max(known)] if known else None

    def describe_world(self, change: int, model: str) -> dict[str, Any]:
        """What the page shows of the world after `change`, for a controller that inverts `model`."""
        found = self.find_world(change)
        if found is None:
            return {"name": "unknown", "values": {}, "model": model, "scene": None, "shapes": [],
                    "remarks": ["The recording does not state which world this was."]}  # fmt: skip
        return describe_world(*found, model, self.device)

    def describe(self, started: str) -> dict[str, Any]:
        """The console's session of this recording, and `played`: what there is to play."""
        names = list(dict.fromkeys(name for name, _ in self._worlds.values()))
        known = session(self._servo, started)
        return known | {
            "columns": self._columns.describe(),
            "worlds": list_worlds(self.device, names),
            "world": self.describe_world(min(self._worlds, default=0), self._servo.model),
            "feel": None,
            "played": {
                "name": self.name,
                "rows": len(self),
                "start": self.start,
                "seconds": self.seconds,
                "notices": self.notices,
                "changes": {str(number): name for number, (name, _) in self._worlds.items()},
            },
        }

    def close(self) -> None:
        """End what reads the file."""
        self.overview.close()


def _order(version: str) -> tuple[int, ...]:
    """Numbers of a version such as 0.2.1; of anything else, none.

    >>> _order("0.10.0") > _order("0.9.3"), _order("unknown")
    (True, ())
    """
    parts = version.split(".")[:3]
    return tuple(int(part) for part in parts) if all(part.isascii() and part.isdecimal() for part in parts) else ()
