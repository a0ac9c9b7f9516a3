"""Device in a trial: renders the prompted stimulus on a servo, and reports pose, force and trips."""

from __future__ import annotations

from math import atan2, degrees, hypot, isfinite
from typing import TYPE_CHECKING, Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.control.trip_reasons import CoilState, GuardState, Trip
from haptorb.devices.api import electromagnet
from haptorb.errors import InputError
from haptorb.runtime.trackers.pose_filter import describe_trip
from haptorb_study.prompts import Prompt
from haptorb_study.study_file import Study

if TYPE_CHECKING:
    from haptorb.runtime.servo import Servo

__all__ = ["TrialDevice"]


_FELT_FORCE_N, _FELT_TORQUE_NM = 0.1, 0.002  #: perception limits of the commanded wrench [N], [N·m]
_FELT_MOTION_M = 0.5e-3  #: perception limit of motion since the onset of the stimulus [m]
_HAND_KEEP_ALIVE_S = 1.0  #: keep-alive of a simulated hand while this process is not scheduled [s]


@final
class TrialDevice:
    """Adapter of a running servo to trials. With the pointer as tracker, keyboard or page steers the pen."""

    def __init__(self, study: Study, servo: Servo) -> None:
        device = electromagnet(servo.device, "a study")
        self.study, self.servo = study, servo
        self.contact = device.contact_distance
        self.limit = degrees(device.workspace_half_angle)
        self.steered = servo.tracker == "pointer"
        self.simulated = servo.driver == "sim"
        self._pen = (0.0, 0.0)  #: (x, y): angle from the top towards +x and +y [deg]
        self.trips: list[dict[str, Any]] = []  #: since the start of the servo, up to the last poll
        self._cursor, self._last_trip = 0, 0.0
        self._trial_start = 0.0
        self._onset_position: tuple[float, float, float] | None = None  # position of the tool at stimulus onset
        self._onset_changes = -1  # world changes before the stimulus
        self._recording = True

    def record(self, on: bool) -> None:
        """Pause or resume the recording."""
        if on != self._recording:
            self._recording = on
            self.servo.pause_recording(not on)

    def begin(self, prompt: Prompt) -> None:
        """Render the first interval of `prompt`; the trial's part of the recording starts here."""
        self._trial_start = self._time()
        self.interval(prompt, 1)

    def interval(self, prompt: Prompt, which: int) -> None:
        """Render interval `which`, 1 or 2, of a comparison; for other prompts the only one."""
        condition, level = prompt.condition, prompt.level or None
        if prompt.interval and which != prompt.interval:
            condition = prompt.other or condition
            level = self.study.levels.reference if self.study.levels else None
        number = prompt.set_point or self.study.points[0].number
        self._onset_position, self._onset_changes = None, self._count_changes()
        self.servo.set_world(self.study.world_name, self.study.values(condition, number, level))

    def rest(self) -> None:
        """Render no force, between trials."""
        self.servo.set_world("nothing")

    @property
    def pen(self) -> tuple[float, float]:
        """Goal of the pen: angle from the top towards +x and +y [deg]."""
        return self._pen

    def steer(self, dx: float, dy: float) -> None:
        """Move the pen's goal by (dx, dy) [deg], within the workspace."""
        self.aim(self._pen[0] + dx, self._pen[1] + dy)

    def aim(self, x: float, y: float) -> None:
        """Set the pen's goal to angle (x, y) from the top [deg], within the workspace."""
        if not (isfinite(x) and isfinite(y)):
            raise InputError("the pen's position must be two finite angles")
        theta = hypot(x, y)
        if theta > self.limit:
            x, y = x * self.limit / theta, y * self.limit / theta
        self._pen = (x, y)

    def refresh(self) -> None:
        """Repeat the hand goal, before it expires; ServoError if the loop ended."""
        self.servo.check()
        self.repeat_goal()

    def repeat_goal(self) -> None:
        """Repeat the hand goal, if the pen is steered from here."""
        if self.steered:
            x, y = np.radians(self._pen)
            theta, phi = hypot(x, y), atan2(y, x)
            way = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
            # At contact: the hand rests on the dome without pressing.
            self.servo.hand.point(way * self.contact, keep_alive=_HAND_KEEP_ALIVE_S)

    @property
    def position(self) -> tuple[float, float, float] | None:
        """Position of the tool's magnet [m]; None where its pose is invalid."""
        row, layout = self.servo.latest(), self.servo.layout
        if row is None or row[layout["valid"]][0] < 1:
            return None
        x, y, z = row[layout["p"]].tolist()
        return x, y, z

    @property
    def force(self) -> Array | None:
        """(3,) actual force on the tool [N]; None where unknown."""
        row, layout = self.servo.latest(), self.servo.layout
        if row is None:
            return None
        force: Array = row[layout["wrench_actual"]][:3]
        return force if np.isfinite(force).all() else None

    def is_felt(self) -> bool:
        """Whether the stimulus exceeds 0.1 N or 2 mN·m now, or the tool has moved by 0.5 mm since onset."""
        place, row = self.position, self.servo.latest()
        if place is None or row is None or self._count_changes() == self._onset_changes:
            return False
        self._onset_position = self._onset_position or place
        asked = row[self.servo.layout["wrench_commanded"]]
        force, torque = float(np.linalg.norm(asked[:3])), float(np.linalg.norm(asked[3:]))
        moved = float(np.linalg.norm(np.subtract(place, self._onset_position)))
        return force >= _FELT_FORCE_N or torque >= _FELT_TORQUE_NM or moved >= _FELT_MOTION_M

    @property
    def switched_off(self) -> bool:
        """Whether the guard has switched the coils off."""
        row = self.servo.latest()
        return row is None or row[self.servo.layout["guard"]][0] in (0, 4)

    @property
    def unconfirmed(self) -> bool:
        """Whether the coils were switched off without confirmation by the device."""
        row = self.servo.latest()
        return row is not None and bool(row[self.servo.layout["coil_state"]][0] == CoilState.UNKNOWN)

    def poll_trips(self) -> None:
        """Append new trips to `trips`; from the loop's rows, which is cheaper than its report."""
        before = self._cursor
        self._cursor, rows = self.servo.rows(before)
        if not len(rows):
            return
        layout = self.servo.layout
        t, guard, code = (rows[:, layout[name]][:, 0] for name in ("t", "guard", "trip"))
        reason = np.where(guard == GuardState.TRIPPED, code, 0.0)
        fresh = np.flatnonzero((reason != 0) & (reason != np.concatenate([[self._last_trip], reason[:-1]])))
        self._last_trip = float(reason[-1])
        trips = [(float(t[n]), Trip(int(reason[n]))) for n in fresh]
        tracker = self.servo.tracker
        found = [{"t": at, "code": trip.name, "reason": describe_trip(trip, tracker)} for at, trip in trips]
        if self._cursor - before > len(rows) and before:
            found.append({"t": float(t[0]), "code": "NOT_WATCHED", "reason": "rows were lost: trips may be missing"})
        self.trips += found

    def course(self, recording: str | None) -> str | None:
        """This trial's part of the recording: FILE#t=from,to on the loop's clock [s]."""
        return f"{recording}#t={self._trial_start:.3f},{self._time():.3f}" if recording else None

    def _count_changes(self) -> int:
        row = self.servo.latest()
        return -1 if row is None else int(row[self.servo.layout["world"]][0])

    def _time(self) -> float:
        row = self.servo.latest()
        return 0.0 if row is None else float(row[self.servo.layout["t"]][0])
