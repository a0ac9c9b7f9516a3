"""Simulated person who follows a path by heading and pace, with a hand model unknown to the controller.

The hand is a spring and a damper towards where the person means to be (the simulated device has them). That point goes
on with the person's own pace, slower in bends (speed falls with the cube root of curvature: Lacquaniti, Terzuolo and
Viviani 1983), in the path's direction as the person knew it a reaction time ago, wrong by an angle that wanders. It
trembles at 8 to 12 Hz, and it yields to what the hand felt a while ago. So there is no force that a fixed place would
need permanently: a person who draws without seeing the path has no such position. `insistence` gives one: the person
means a line of his own beside the path, and goes back to it.

Assumed, and not fitted to a person: 4° of error, 0.25 s to yield, 0.1 mm of tremor.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from haptorb.analysis.stability import HandGrip
from haptorb.arrays import Array
from haptorb.estimation.types import HandGoal
from haptorb.worlds.path import GuidancePath
from haptorb.worlds.path_guidance import fill_frame, find_arc, follow_arc

__all__ = ["Habits", "Person"]

_PRESS = 0.1  #: with which the tip is put on the dome [N]
_BEND = 0.02  #: radius of a bend that needs no slowing down [m]
_SPAN = 3e-3  #: length over which a bend is felt as one [m]
_REACH = 5e-3  #: in which the person looks for the own place on the path [m]


@dataclass(frozen=True)
class Habits:
    """Motion parameters of a person, as the simulation assumes."""

    pace: float = 0.03  #: [m/s]
    heading_error: float = np.radians(4.0)  #: standard deviation [rad]
    heading_time: float = 2.0  #: in which that error wanders [s]
    pace_error: float = 0.2  #: standard deviation, as a share of the pace
    reaction: float = 0.15  #: by which direction and feeling are late [s]
    yielding: float = 0.25  #: time constant with which the person goes along with the hand [s]
    tremor: float = 1e-4  #: rms in each direction [m]
    insistence: float = 0.0  #: standard deviation of a line of the person's own beside the path [m]; 0: none
    rest_after: float = np.inf  #: then the hand rests [s]


@final
class Person:
    """Intended position of the tool, advanced by `dt` [s] per tick for `duration` [s]; the driver calls `goal`.

    `feel` takes the tool's true place after each tick.
    """

    def __init__(
        self, path: GuidancePath, grip: HandGrip, radius: float, habits: Habits, duration: float, dt: float, seed: int
    ) -> None:
        self._path, self._habits, self._dt = path, habits, dt
        self._radius = radius - _PRESS / grip.stiffness
        count = int(np.ceil(duration / dt)) + 2
        noise = np.random.default_rng(seed)
        self._heading = habits.heading_error * _wander(noise, count, habits.heading_time, dt)
        self._pace = 1.0 + habits.pace_error * _wander(noise, count, habits.heading_time, dt)
        self._tremor = habits.tremor * np.column_stack([_make_tremor(noise, count, dt) for _ in range(2)])
        self._own = habits.insistence * _wander(noise, count, 2.0, dt)
        self._slow = _slowness(path)
        self._frame = np.empty((4, 3))
        late = max(round(habits.reaction / dt), 1)
        fill_frame(path.places, path.tangents, path.spacing, 0.0, self._frame)
        self._intended = path.places[0].copy()
        self._arc, self._direction, self._tick = 0.0, 1.0, 0
        self._felt: deque[Array] = deque([np.zeros(3)] * late, maxlen=late)
        self._goal = HandGoal(self._intended.copy(), np.array([0.0, 0.0, 0.0, 1.0]), 0.0, False)

    def goal(self, now: float) -> HandGoal:
        """Goal of the person for the tool at `now` [s]."""
        return replace(self._goal, stamp=now)

    def feel(self, place: Array) -> None:
        """One tick more, in which the tool was at `place` (3,) [m]."""
        path, habits, frame, dt = self._path, self._habits, self._frame, self._dt
        n = min(self._tick, len(self._heading) - 1)
        self._arc = follow_arc(self._intended, path.places, path.spacing, path.closed, self._arc, _REACH)
        if not path.closed and (
            (self._direction > 0 and self._arc >= path.length - path.spacing)
            or (self._direction < 0 and self._arc <= path.spacing)
        ):
            self._direction = -self._direction  # to and fro
        fill_frame(path.places, path.tangents, path.spacing, self._arc, frame)
        sideways, outward = frame[2], self._intended / np.linalg.norm(self._intended)
        resting = n * dt >= habits.rest_after
        away = place - self._intended
        self._felt.append(away - outward * float(away @ outward))
        step = dt / habits.yielding * self._felt[0]
        if not resting:
            ahead = self._direction * frame[1]
            way = ahead + np.tan(self._heading[n]) * np.cross(outward, ahead)
            pace = (
                habits.pace
                * max(self._pace[n], 0.2)
                * self._slow[min(round(self._arc / path.spacing), len(self._slow) - 1)]
            )
            step = step + pace * dt * way / float(np.linalg.norm(way))
        if habits.insistence > 0.0:
            beside = float((self._intended - frame[0]) @ sideways)
            step = step + dt / habits.yielding * (self._own[n] - beside) * sideways
        self._intended = self._intended + step
        self._intended *= self._radius / np.linalg.norm(self._intended)
        wanted = self._intended + self._tremor[n, 0] * frame[1] + self._tremor[n, 1] * sideways
        x, y, z = (wanted / np.linalg.norm(wanted)).tolist()
        q = np.array([-y, x, 0.0, 1.0 + z])
        self._goal = HandGoal(wanted, q / np.linalg.norm(q), self._tick * dt, False)
        self._tick += 1


def place_across(path: GuidancePath, places: Array) -> Array:
    """(n,) [m] how far to the side of the path each of `places` (n, 3) [m] is, which follow each other on it."""
    frame, arc = np.empty((4, 3)), 0.0
    found = np.empty(len(places))
    for n, p in enumerate(places):
        if n == 0:
            arc = find_arc(p, path.places, path.spacing)
        arc = follow_arc(p, path.places, path.spacing, path.closed, arc, _REACH)
        fill_frame(path.places, path.tangents, path.spacing, arc, frame)
        found[n] = float(frame[2] @ (p - frame[0]))
    return found


def _wander(noise: np.random.Generator, count: int, time: float, dt: float) -> Array:
    """(count,) an Ornstein-Uhlenbeck process of variance 1 and correlation time `time` [s]."""
    from scipy.signal import lfilter

    keep = np.exp(-dt / time)
    kicks = np.sqrt(1.0 - keep * keep) * noise.standard_normal(count)
    kicks[0] = noise.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -keep], kicks))


def _make_tremor(noise: np.random.Generator, count: int, dt: float) -> Array:
    """(count,) noise between 8 and 12 Hz, rms 1."""
    spectrum = np.fft.rfft(noise.standard_normal(count))
    frequency = np.fft.rfftfreq(count, dt)
    spectrum[(frequency < 8.0) | (frequency > 12.0)] = 0.0
    course = np.fft.irfft(spectrum, count)
    return course / max(float(np.sqrt((course**2).mean())), 1e-12)


def _slowness(path: GuidancePath) -> Array:
    """(k,) share of the pace at each place of the path: the cube root of the bend's radius, 1 in straight parts."""
    reach = max(round(_SPAN / path.spacing), 1)
    numbers = np.arange(len(path.places))
    before, after = numbers - reach, numbers + reach
    if path.closed:
        before, after = before % (len(numbers) - 1), after % (len(numbers) - 1)
    turned = path.tangents[np.clip(after, 0, numbers[-1])] - path.tangents[np.clip(before, 0, numbers[-1])]
    bend = np.linalg.norm(turned, axis=1) / (2 * reach * path.spacing)
    share: Array = np.minimum(1.0, (1.0 / (_BEND * np.maximum(bend, 1e-9))) ** (1 / 3))
    return share
