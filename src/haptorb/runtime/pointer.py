"""Pointer as a tracker: the hand's goal follows the console's pointer (mouse, pen, finger), else a script."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np

from haptorb.arrays import Array
from haptorb.estimation.types import HandGoal, Pose
from haptorb.rotations import rotation_of
from haptorb.runtime.shared_memory import HandGoalSource, HandSignals
from haptorb.runtime.trackers.base import Tracker
from haptorb.simulation.hand_motion import DomeMotion, GuidedMotion, ScriptedMotion

__all__ = ["PointerPose", "PointerTracker"]


# --------------------------------------------------------------------------------------------------
# Pointer as the tracker of a real tool: valid only while it is held.


_MAX_SPEED_M_PER_S = 3.0  #: speed limit of the tool: faster motion is a jump of the pointer


@final
class PointerPose:
    """Converts the host's pointer to the pose of a tracker.

    A simulated hand may play a guided motion while the pointer is not held; a real tool does not follow a script,
    so then the pose is not valid. The velocity is that between the pointer's last two messages.
    """

    def __init__(self) -> None:
        self._p = np.zeros(3)
        self._v = np.zeros(3)
        self._stamp = -np.inf

    def __call__(self, goal: HandGoal, now: float) -> Pose:
        """Return the pose at `now` [s] for the pointer's last message `goal`."""
        if not goal.held:
            self._stamp = -np.inf
            return Pose(now, rotation_of(goal.q), goal.p, np.zeros(3), np.zeros(3), valid=False)
        if goal.stamp > self._stamp:
            passed = goal.stamp - self._stamp
            v = (goal.p - self._p) / passed if np.isfinite(passed) else np.zeros(3)
            speed = float(np.linalg.norm(v))
            self._v = v if speed <= _MAX_SPEED_M_PER_S else np.zeros(3)
            self._p, self._stamp = goal.p, goal.stamp
        valid = bool(np.isfinite(goal.stamp))
        return Pose(min(goal.stamp, now) if valid else now, rotation_of(goal.q), goal.p, np.zeros(3), self._v, valid)


_RELEASE_TIME_S = 1.5  #: time in which a released hand returns to rest [s]


def _since(now: float, start: float) -> float:
    """Time [s] from `start` to `now`, with bits independent of the start time on the loop's clock."""
    return round(now - start, 9) if start else now


@final
class PointerTracker(Tracker):
    """Follows the host's pointer while it is held; plays the guided motion until it is held for the first time.

    After a release the hand returns to the rest pose of the guided motion on a minimum-jerk path.
    `origin` is the computer's monotonic time [s] at zero of the loop's clock; `guide` is the guided motion;
    `signals` receives the buttons, the gripper and the time of a scripted one. With `waits`, a scripted one stays at
    its first pose until `signals` reports a program; it begins with the tick that reads this, and from then on every
    run has the same goals, bit for bit.
    """

    def __init__(
        self,
        source: HandGoalSource | None = None,
        origin: float = 0.0,
        *,
        guide: GuidedMotion | None = None,
        signals: HandSignals | None = None,
    ) -> None:
        self._source, self._signals = source, signals
        self.origin = origin
        self._guide = guide or DomeMotion()
        self._last: tuple[Array, Array] | None = None  # last pose of a held pointer
        self._released = 0.0  # when the guided motion begins, or the pointer was released [s]
        self.waits = False
        self._rest = self._guide.at(self._guide.duration)
        self._pose = PointerPose()

    @property
    def guide(self) -> GuidedMotion:
        """The hand's motion while the pointer is not held."""
        return self._guide

    @guide.setter
    def guide(self, guide: GuidedMotion) -> None:
        self._guide = guide
        self._rest = guide.at(guide.duration)

    def goal(self, now: float) -> HandGoal:
        """Goal of a simulated hand at `now` [s] on the loop's clock; it does not age within its keep-alive."""
        if self.waits and self._last is None:
            self.waits = self._signals is not None and not self._signals.begun
            self._released = now
        goal, keep_alive = self._find(now)
        if isinstance(self._guide, ScriptedMotion):
            bits, grip, t = 0, np.nan, np.nan
            if self._last is None:
                t = _since(now, self._released)
                bits, grip = self._guide.signals_at(t)
                if self.waits:
                    bits, t = 0, np.nan
            if self._signals is not None:
                self._signals.write(bits, grip, t)
            goal = replace(goal, grip=grip)
        if not keep_alive:
            return goal
        return replace(goal, stamp=max(goal.stamp, min(now, goal.stamp + keep_alive)))

    def pose(self, now: float) -> Pose:
        """Return the pointer as the pose of a real tool: valid only while held, as old as its last message."""
        return self._pose(self._find(now)[0], now)

    def _find(self, now: float) -> tuple[HandGoal, float]:
        """Return the goal, as old as its message, and the message's keep-alive [s]."""
        if self._source is not None:
            pointed = self._source.read_hand_goal()
            if pointed.held:
                self._last, self._released = (pointed.p, pointed.q), now
                return HandGoal(pointed.p, pointed.q, pointed.stamp - self.origin, True), pointed.keep_alive
        guide, since, still = self._guide, _since(now, self._released), False
        if since >= (guide.duration if self._last is None else _RELEASE_TIME_S):
            (p, q), still = self._rest, guide.relaxes
        elif self._last is None:
            p, q = guide.at(since)
        else:
            s = min(since / _RELEASE_TIME_S, 1.0)
            p, q = guide.pose_on_return(*self._last, s * s * s * (10.0 + s * (6.0 * s - 15.0)))
        return HandGoal(p, q, now, False, still), 0.0
