"""A wall in a hand, in a separate loop: true force and true motion, unknown to the controller.

Nothing here comes from `haptorb.analysis` or from the simulation: a hand m ẍ + b ẋ + k (x − goal) = f, stepped exactly
(matrix exponential), the coils' current on its way to the next value in every tick, a tracker with a clock of its own
whose poses are late, and a wall f = −K x for x < 0. Only `Protection.protect_wrench` is the product's. The energy that
the hand was given is the integral of the true force over the true motion.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm

from haptorb.control.protection import Protection
from haptorb.control.trip_reasons import GuardState
from haptorb.devices.base import State, WrenchMap
from haptorb.devices.loader import load
from haptorb.estimation.types import Estimate

_FINE = 4  #: steps of the motion per tick
_UPRIGHT, _STILL = np.eye(3), np.zeros(3)
_NOTHING = WrenchMap(np.zeros((6, 3)), np.zeros(6))


@dataclass(frozen=True)
class WallRun:
    """What really happened.

    t         (n,) [s] of the ticks
    x         (n,) place, negative in the wall [m]
    given     (n,) energy that the hand was given until then [J]
    softened  (n,) share of the wrench that the controller has taken away
    damping   (n,) that it has added [N·s/m]
    """

    t: Any
    x: Any
    given: Any
    softened: Any
    damping: Any

    def motion(self, since: float) -> float:
        """From the innermost to the outermost place from `since` [s] on [m]."""
        return float(np.ptp(self.x[self.t >= since]))

    def most_given(self, since: float) -> float:
        """The greatest energy that the hand was given within any second from `since` [s] on [J]."""
        energy, second = self.given[self.t >= since], round(1.0 / (self.t[1] - self.t[0]))
        return float((energy[second:] - energy[:-second]).max())


def run_wall(
    hand: tuple[float, float, float], stiffness: float, tracker_rate: float, latency: float, seconds: float,
    *, goal: float | Callable[[float], float] = -1e-3, start: float = -1e-3, rate: float = 1000.0,
    phase: float = 0.37, controlled: bool = True, noise: float = 0.0,
) -> WallRun:  # fmt: skip
    """A hand (mass [kg], damping [N·s/m], stiffness [N/m]) that is let go at rest at `start` [m] and wants to `goal`
    [m], which may be a function of the time [s].

    phase: where between two poses the run begins, 0 to 1. noise: standard deviation of a pose [m].
    """
    m, b, k = hand
    device, dt = load("omni"), 1.0 / rate
    lag = float((device.coils.inductance / device.coils.resistance).max())
    protection = Protection(device, dt)
    guard = protection.state["guard"]
    for name in ("force", "torque", "expiry", "force_rate", "torque_rate"):
        guard[name] = 1e9
    protection.change_world(passive=True)
    guard["state"], guard["gain"] = GuardState.RUNNING, 1.0
    passivity = protection.state["passivity"]
    A = np.zeros((5, 5))  # x, v, force; the force's goal and the hand's
    A[0, 1], A[2, 2], A[2, 3] = 1.0, -1 / lag, 1 / lag
    A[1] = -k / m, -b / m, 1 / m, 0.0, k / m
    step = expm(A * dt / _FINE)[:3].tolist()
    overshoot = -1 / math.expm1(-dt / lag)  # the drive brings the current to its value at the end of the tick
    rng, poses = np.random.default_rng(0), deque[tuple[float, float]]()
    x, v, force, given, seen, next_pose = start, 0.0, 0.0, 0.0, (-latency, start), phase / tracker_rate
    ticks = round(seconds * rate)
    out = np.zeros((5, ticks))
    wrench, place = np.zeros(6), np.array([0.0, 0.0, 0.06])
    for n in range(ticks):
        now = n * dt
        while poses and poses[0][0] + latency <= now + 1e-9:
            seen = poses.popleft()
        wrench[0], place[0] = max(-stiffness * seen[1], 0.0), seen[1]
        estimate = Estimate(State(now, _UPRIGHT, place, _STILL, _STILL), _NOTHING, True, now - seen[0])
        asked = protection.protect_wrench(wrench, estimate, now)[0]
        wanted = goal(now) if callable(goal) else goal
        goal_force = force + ((asked if controlled else wrench[0]) - force) * overshoot
        for i in range(1, _FINE + 1):
            before = x, force
            x, v, force = (
                a * x + c * v + d * force + e * goal_force + g * wanted for (a, c, d, e, g) in step
            )  # fmt: skip
            given += 0.5 * (before[1] + force) * (x - before[0])
            at = now + i * dt / _FINE
            if next_pose <= at:
                share = 1.0 - (at - next_pose) / (dt / _FINE)
                poses.append((next_pose, before[0] + share * (x - before[0]) + noise * rng.standard_normal()))
                next_pose += 1.0 / tracker_rate
        out[:, n] = now, x, given, passivity["softened"][0], passivity["damping"][0]
    return WallRun(*out)


def find_limit(hand: tuple[float, float, float], tracker_rate: float, latency: float, rate: float = 1000.0) -> float:
    """The stiffness [N/m] of a spring at which the loop with an ideal drive begins to grow: by the eigenvalues of one
    common period of tracker and servo, stepped through in 1/48 000 s; the mean over the phases of the two clocks."""
    found = []
    for phase in (0.0, 0.25, 0.5, 0.75):
        low, high = 1.0, 1e5
        while high > 1.005 * low:
            middle = math.sqrt(low * high)
            grows = _grow(hand, middle, tracker_rate, latency, rate, phase)
            low, high = (low, middle) if grows else (middle, high)
        found.append(low)
    return float(np.mean(found))


def _grow(
    hand: tuple[float, float, float], stiffness: float, tracker_rate: float, latency: float, rate: float, phase: float
) -> bool:
    m, b, k = hand
    fine = 48_000
    tick, period, late = round(fine / rate), round(fine / tracker_rate), round(latency * fine)
    first, steps = round(phase * tick), math.lcm(tick, period)
    A = np.zeros((3, 3))
    A[0, 1], A[1] = 1.0, (-k / m, -b / m, 1 / m)
    depth = 2 + math.ceil((late + tick) / period)
    state = np.eye(3 + depth)  # x, v, force, and the last poses
    x, v, force = state[0], state[1], state[2]
    events = sorted({*range(0, steps, tick), *range(first % period, steps, period), steps})
    newest = first % period - period
    poses = [(newest - i * period, state[3 + i]) for i in range(depth)]
    at = 0
    for event in events:
        if event > at:
            turn = expm(A * (event - at) / fine)
            x, v = (turn[:2] @ np.stack([x, v, force])).copy()
            at = event
        if event == steps:
            break
        if (event - first) % period == 0:
            poses.insert(0, (event, x))
        if event % tick == 0:
            force = -stiffness * next(pose for taken, pose in poses if taken + late <= event)
    after = np.stack([x, v, force, *(pose for _, pose in poses[:depth])])
    return bool(np.abs(np.linalg.eigvals(after)).max() > 1.0)
