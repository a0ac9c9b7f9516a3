"""The device in a session: a prompted set-point is rendered on the real loop, and what happens is reported."""

from __future__ import annotations

from math import atan2, degrees, hypot, isfinite
from typing import TYPE_CHECKING, Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.control.trips import CoilState, GuardState, Trip
from haptorb.devices.electromagnet import electromagnet
from haptorb.errors import InputError
from haptorb.runtime.trackers.pose_filter import describe_trip
from haptorb_study.procedures import Prompt
from haptorb_study.study_file import Study

if TYPE_CHECKING:
    from haptorb.runtime.servo import Servo

__all__ = ["TrialDevice"]


_FELT_FORCE, _FELT_TORQUE = 0.1, 0.002  #: asked of the coils [N], [N·m]
_FELT_MOTION = 0.5e-3  #: of the tool since the stimulus began [m]
_PATIENCE = 1.0  #: that a simulated hand rests where it is while this program waits for a processor [s]


@final
class TrialDevice:
    """A running servo, as a trial needs it. With the pointer as tracker the pen is steered from the keyboard."""

    def __init__(self, study: Study, servo: Servo) -> None:
        device = electromagnet(servo.device, "a study")
        self.study, self.servo = study, servo
        self.contact = device.contact_distance
        self.limit = degrees(device.workspace_half_angle)
        self.steered = servo.tracker == "pointer"
        self.simulated = servo.driver == "sim"
        self._pen = (0.0, 0.0)  #: (x, y): angle from the top towards +x and +y [deg]
        self.trips: list[dict[str, Any]] = []  #: since the loop began, as far as `look` has looked
        self._cursor, self._reason = 0, 0.0
        self._since = 0.0
        self._first: tuple[float, float, float] | None = None  # where the tool was when the stimulus began
        self._before = -1  # changes of the world before the stimulus
        self._recording = True

    def record(self, on: bool) -> None:
        """Have the tool's course recorded, or leave it out of the recording."""
        if on != self._recording:
            self._recording = on
            self.servo.pause_recording(not on)

    def begin(self, prompt: Prompt) -> None:
        """Render the first interval of `prompt`; the course counts from here."""
        self._since = self._time()
        self.interval(prompt, 1)

    def interval(self, prompt: Prompt, which: int) -> None:
        """Render interval `which`, 1 or 2, of a comparison; for other prompts the only one."""
        condition, level = prompt.condition, prompt.level or None
        if prompt.interval and which != prompt.interval:
            condition = prompt.other or condition
            level = self.study.levels.reference if self.study.levels else None
        number = prompt.set_point or self.study.points[0].number
        self._first, self._before = None, self._count_changes()
        self.servo.set_world(self.study.world_name, self.study.values(condition, number, level))

    def rest(self) -> None:
        """Between trials: nothing is felt."""
        self.servo.set_world("nothing")

    @property
    def pen(self) -> tuple[float, float]:
        """Where the hand wants the pen: angle from the top towards +x and +y [deg]."""
        return self._pen

    def steer(self, dx: float, dy: float) -> None:
        """Move the pen by so many degrees; it stays within the workspace."""
        self.aim(self._pen[0] + dx, self._pen[1] + dy)

    def aim(self, x: float, y: float) -> None:
        """The pen at angle (x, y) from the top [deg]; it stays within the workspace."""
        if not (isfinite(x) and isfinite(y)):
            raise InputError("the pen's position must be two finite angles")
        theta = hypot(x, y)
        if theta > self.limit:
            x, y = x * self.limit / theta, y * self.limit / theta
        self._pen = (x, y)

    def refresh(self) -> None:
        """Say again where the hand is, before the pose counts as lost; ServoError if the loop ended."""
        self.servo.check()
        self.hold()

    def hold(self) -> None:
        """Say again where the hand is; of a pen that is steered from here."""
        if self.steered:
            x, y = np.radians(self._pen)
            theta, phi = hypot(x, y), atan2(y, x)
            way = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
            # A little above contact: the hand rests on the dome, it does not dig in.
            self.servo.hand.point(way * self.contact, patience=_PATIENCE)

    @property
    def position(self) -> tuple[float, float, float] | None:
        """Where the tool's magnet is now [m]; None where its pose is not valid."""
        row, layout = self.servo.latest(), self.servo.layout
        if row is None or row[layout["valid"]][0] < 1:
            return None
        x, y, z = row[layout["p"]].tolist()
        return x, y, z

    @property
    def force(self) -> Array | None:
        """(3,) force on the tool now [N]; None where unknown."""
        row, layout = self.servo.latest(), self.servo.layout
        if row is None:
            return None
        force: Array = row[layout["given"]][:3]
        return force if np.isfinite(force).all() else None

    def is_felt(self) -> bool:
        """Whether the stimulus is felt: 0.1 N or 2 mN·m is asked now, or the tool moved by 0.5 mm since it began."""
        place, row = self.position, self.servo.latest()
        if place is None or row is None or self._count_changes() == self._before:
            return False
        self._first = self._first or place
        asked = row[self.servo.layout["asked"]]
        force, torque = float(np.linalg.norm(asked[:3])), float(np.linalg.norm(asked[3:]))
        moved = float(np.linalg.norm(np.subtract(place, self._first)))
        return force >= _FELT_FORCE or torque >= _FELT_TORQUE or moved >= _FELT_MOTION

    @property
    def switched_off(self) -> bool:
        """Whether the guard has the coils off."""
        row = self.servo.latest()
        return row is None or row[self.servo.layout["guard"]][0] in (0, 4)

    @property
    def unconfirmed(self) -> bool:
        """Whether the coils were switched off, and the device has not confirmed it."""
        row = self.servo.latest()
        return row is not None and bool(row[self.servo.layout["coil_state"]][0] == CoilState.UNKNOWN)

    def look(self) -> None:
        """Add new trips to `trips`: read off the loop's rows, which costs less than its report."""
        before = self._cursor
        self._cursor, rows = self.servo.rows(before)
        if not len(rows):
            return
        layout = self.servo.layout
        t, guard, code = (rows[:, layout[name]][:, 0] for name in ("t", "guard", "trip"))
        reason = np.where(guard == GuardState.TRIPPED, code, 0.0)
        fresh = np.flatnonzero((reason != 0) & (reason != np.concatenate([[self._reason], reason[:-1]])))
        self._reason = float(reason[-1])
        trips = [(float(t[n]), Trip(int(reason[n]))) for n in fresh]
        tracker = self.servo.tracker
        found = [{"t": at, "code": trip.name, "reason": describe_trip(trip, tracker)} for at, trip in trips]
        if self._cursor - before > len(rows) and before:
            found.append({"t": float(t[0]), "code": "NOT_WATCHED", "reason": "rows were lost: trips may be missing"})
        self.trips += found

    def course(self, recording: str | None) -> str | None:
        """The part of the recording that is this trial: FILE#t=from,to on the loop's clock [s]."""
        return f"{recording}#t={self._since:.3f},{self._time():.3f}" if recording else None

    def _count_changes(self) -> int:
        row = self.servo.latest()
        return -1 if row is None else int(row[self.servo.layout["world"]][0])

    def _time(self) -> float:
        row = self.servo.latest()
        return 0.0 if row is None else float(row[self.servo.layout["t"]][0])
