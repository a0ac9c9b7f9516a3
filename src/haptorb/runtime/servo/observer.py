"""Observing a running servo: rows, report, trips, recording, and whether it is alive."""

from __future__ import annotations

import json
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from haptorb.control.allocation.wrench_choice import WrenchChoice
from haptorb.control.protection.trip import GuardState, Trip
from haptorb.devices.device import Device
from haptorb.display.quantity_text import format_vector
from haptorb.errors import RecordingError, ServoError, WorldError
from haptorb.numerics.arrays import Array
from haptorb.runtime.exchange.black_box import BlackBox, TripRecord
from haptorb.runtime.exchange.commands import Commands
from haptorb.runtime.exchange.report import loop_report, tracker_facts
from haptorb.runtime.exchange.run_report import RunReport
from haptorb.runtime.exchange.scene_detail import describe_detail, read_detail
from haptorb.runtime.exchange.shared_memory import SharedMemory
from haptorb.runtime.exchange.world_trouble import describe_slow_world, is_tripped, world_failure
from haptorb.runtime.recording.run_recording import RunRecording
from haptorb.runtime.row import RowLayout
from haptorb.runtime.servo.latest_row import LatestRow
from haptorb.runtime.servo.process_group import ProcessGroup
from haptorb.runtime.servo.world_watcher import WorldWatcher
from haptorb.runtime.trackers.pose_source import describe_missing_pose
from haptorb.worlds.dynamic_world import DynamicWorld
from haptorb.worlds.memory import count_numbers
from haptorb.worlds.wrench_part import PARTS, WrenchPart

if TYPE_CHECKING:
    from haptorb.runtime.recording.recording import Recording

__all__ = ["ServoObserver"]

_PREPARING = "preparing world '{}': its code is being compiled, once on this computer; the previous world continues"


class ServoObserver(Commands):
    """Base of `Servo`: everything that comes back from the loop."""

    device: Device
    driver: str
    tracker: str
    estimator: str
    rate: float
    seed: int
    _recording: RunRecording
    _black_box: BlackBox | None
    _shared: SharedMemory | None
    _children: ProcessGroup | None
    _choice: WrenchChoice | None
    _watcher: WorldWatcher | None

    @property
    def layout(self) -> RowLayout:
        """Which numbers of a row are what, with room for the memory of every world that this servo was given."""
        if self._shared is not None:
            return self._shared.layout
        given = (self._first, *self.own_worlds.values())
        sizes = [count_numbers(one.memory_fields) for one in given if isinstance(one, DynamicWorld)]
        return RowLayout.of(self.device, max(sizes, default=0))

    def __repr__(self) -> str:
        return (
            f"<Servo of {self.device.name}, world '{self.world[0]}', driver {self.driver}, tracker {self.tracker}, "
            f"{self.rate:g} Hz: {self._describe_phase()}>"
        )

    def _describe_phase(self) -> str:
        """Whether it runs, and with which force; or why not."""
        if self._children is None:
            return "not started"
        try:
            self._children.check()
            row = self.latest()
        except (ServoError, RecordingError) as cause:
            return str(cause)
        if row.guard == GuardState.TRIPPED:
            return f"running, coils off. {Trip(int(row.trip)).text}"
        return f"running, given {format_vector(row.given[:3], 'N')}"

    @property
    def alive(self) -> bool:
        """Whether the loop runs."""
        return self._children is not None and self._children.alive

    @property
    def servo_pid(self) -> int:
        """Process id of the loop; 0 before the start."""
        return self._children.servo_pid if self._children is not None else 0

    @property
    def memory_path(self) -> Path:
        """The file that loop, recorder and servers share. Raises ServoError before the start."""
        return self._memory.path

    @property
    def connections(self) -> list[dict[str, Any]]:
        """The programs connected to each server, in the order of the `--serve` options: `server`,
        `address`, and `clients`, each with its name, `session`, `rate_hz` and whether it `holds` the device."""
        shared = self._memory_or_none
        texts = () if shared is None else [slot.read()[1] for slot in shared.server_facts]
        return [json.loads(text) for text in texts if text]

    @property
    def recording_trouble(self) -> str:
        """Why the recording ended early, or is stalled; empty if there is no problem."""
        return self._children.recorder_trouble if self._children is not None else ""

    def _compile_world(self, name: str) -> None:
        assert self._children is not None
        self._children.compiler.compile_world(name)

    def _check_compiler(self) -> None:
        assert self._children is not None
        self._children.compiler.check()

    @property
    def warning(self) -> str:
        """Warnings for the user: about the connected device, the servo's memory, the code of world and path, and a
        world that is being prepared; empty if there are none."""
        if self._shared is None or self._children is None:
            return ""
        found = (
            self._shared.warning.read()[1], self._children.memory.warning, self.world_trouble, self.hand_trouble,
            _PREPARING.format(self.world_ahead) if self.world_ahead else "",
        )  # fmt: skip
        return "; ".join(filter(None, found))

    @property
    def world_trouble(self) -> str:
        """Problem of the world's code: it failed (with file and line), takes too long, or a saved file is not used,
        and why. Empty if there is no problem."""
        if self._shared is None:
            return ""
        failed = world_failure(self._shared) or describe_slow_world(self._shared, self.rate)
        failed = failed or describe_detail(read_detail(self._shared), now=True)
        return failed or ("" if self._watcher is None else self._watcher.trouble)

    def check_world(self) -> None:
        """Raise WorldError if the coils are off because the world's code failed, or takes too long."""
        shared = self._memory
        if failed := world_failure(shared):
            raise WorldError(f"{failed}\nThe coils are off.")
        if is_tripped(shared, Trip.OVERRUN) and (slow := describe_slow_world(shared, self.rate)):
            raise WorldError(f"{slow} The coils are off.")

    def check(self) -> None:
        """Raise ServoError with the servo's reason if the loop no longer runs, RecordingError if the recorder no
        longer runs."""
        if self._children is None:
            raise ServoError("the servo was not started: use `with haptorb.Servo(...) as servo:`")
        self._children.check()

    def check_end(self) -> None:
        """Raise what `check` raises, unless the loop ended because `end_loop` asked it to."""
        if self._children is None or not self._children.ended_on_request:
            self.check()

    def rows(self, cursor: int = 0) -> tuple[int, Array]:
        """(new cursor, rows (n, width)): the rows that the loop published after the first `cursor` rows, oldest first.

        In the units [..] of `layout`.

        The last 8191 rows are kept; (new cursor − cursor − n) rows were lost to a slower reader.
        """
        return self._memory.ring.read_since(cursor)

    def latest(self) -> LatestRow:
        """The newest tick, by field name: `latest().given`, `latest()["given"]`, see `LatestRow`.

        Raises ServoError before the first.
        """
        numbers = self._memory.ring.latest()
        if numbers is None:
            raise ServoError("the servo has not ticked yet: `open` returns, and `with` begins, when it has")
        return LatestRow(self.layout, numbers)

    def report(self) -> RunReport:
        """Report of the run so far, as plain JSON types: see `loop_report`."""
        world, values = self.world
        loop, children = loop_report(self._memory, self.tracker), self._children
        assert children is not None
        troubles = {"recording_trouble": children.recorder_trouble, "tracker_trouble": children.tracker_trouble}
        found = {
            "device": self.device.name,
            "world": world,
            "world_values": values,
            "rendered_part": self.rendered_part,
            "driver": self.driver,
            "tracker": self.tracker,
            "estimator": self.estimator,
            "model": self.model,
            "rate_hz": self.rate,
            "seed": self.seed,
            "recording": self._recording.user_path,
            **loop,
            **({"scene": scene} if (scene := read_detail(self._memory)) else {}),
            "recorded": children.recorder_counts,
            **({"servers": served} if (served := self.connections) else {}),
            "memory_mb": children.memory.facts(),
            "warning": self.warning,
            **{name: trouble for name, trouble in troubles.items() if trouble},
        }
        return RunReport(found)

    @property
    def tracker_refusals(self) -> dict[str, int]:
        """Number of messages that the tracker's process has rejected so far, by the reasons of `pose_filter`."""
        shared = self._memory_or_none
        return dict(tracker_facts(shared).get("refused", {})) if shared is not None else {}

    @property
    def missing_pose(self) -> str:
        """The pose that the servo waits for, with the counts so far, while the newest row has no valid pose from a
        tracker with its own process; else empty."""
        shared = self._memory_or_none
        row = None if shared is None else shared.ring.latest()
        if shared is None or row is None or row[shared.layout["valid"].start] == 1.0:
            return ""
        return describe_missing_pose(self.tracker, tracker_facts(shared))

    @cached_property
    def part_remarks(self) -> tuple[str, ...]:
        """Remarks about each part of the wrench that can be rendered, by its number in the row; empty for a device
        without a choice, and for a part without remarks."""
        remarks = self.device.kind.part("part_remarks")
        return () if self._choice is None or remarks is None else tuple(remarks(self.device, self._choice))

    @property
    def rendered_part(self) -> WrenchPart | None:
        """The part of the world's wrench that is rendered now; None for a device without a choice, and before the first
        tick."""
        shared = self._memory_or_none
        row = None if shared is None else shared.ring.latest()
        number = -1.0 if row is None else float(row[self.layout["part"].start])
        return PARTS[int(number)] if number >= 0.0 else None  # NaN too: nothing is known

    @property
    def trips(self) -> tuple[TripRecord, ...]:
        """The first 64 trips, each with the last 100 ticks up to it."""
        if self._black_box is None:
            return ()
        self._black_box.look()
        return tuple(self._black_box.trips)

    @property
    def trip_files(self) -> tuple[Path, ...]:
        """Recordings in the `black_box` folder so far."""
        return () if self._black_box is None else tuple(file for file in self._black_box.files if file is not None)

    @property
    def recording(self) -> Recording:
        """The recording so far. While the loop runs, and after a crash, it is marked as truncated.

        Raises RecordingError if nothing was recorded, or if the file cannot be read.
        """
        return self._recording.read()
