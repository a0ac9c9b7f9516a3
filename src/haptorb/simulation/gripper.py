"""Simulation of a gripper and the fingers in it: one mass between stops, with friction, a motor and encoders.

The opening x follows m x'' = motor + stops + k (goal − x) − (b + c) x' − dry friction. The motor's force follows its
command with a first-order lag. Neglected: the motor's heat, and the reaction of the fingers' motion on the arm.
"""

from __future__ import annotations

import math
from collections import deque
from typing import final

import numpy as np

from haptorb.arrays import Record, Records, fields
from haptorb.compiled import kernel
from haptorb.devices.gripper import Gripper

__all__ = ["SimulatedGripper"]

_STEP_S = 1e-4  #: of the simulation [s]
_LAG_S = 3e-4  #: of the motor's force, as of an arm's motors [s]
_STOP_STIFFNESS = 10e3  #: where thumb and finger meet, and where they are widest [N/m]
_STOP_DAMPING = 20.0  #: [N·s/m]
_VELOCITY_WINDOW_S = 5e-3  #: over which the velocity is a difference of openings [s]
_TIME_ERROR_S = 1e-9  #: rounding of a sum of periods [s]

_GRIPPER = fields(
    ("mass", "f8"),  # gripper and fingers [kg]
    ("coulomb", "f8"),  # [N]
    ("damping", "f8"),  # of gripper and fingers [N·s/m]
    ("stiffness", "f8"),  # of the fingers [N/m]
    ("widest", "f8"),  # opening [m]
    ("x", "f8"),  # opening [m]
    ("v", "f8"),  # [m/s]
    ("force", "f8"),  # of the motor [N]
)


@kernel
def _advance(state: Records, command: float, goal: float, dt: float, steps: int) -> None:
    """Advance by `steps` steps of `dt` [s] towards `goal` [m] under `command` [N]: implicit midpoint in springs and
    dampers."""
    g: Record = state[0]
    follow = 1.0 - math.exp(-dt / _LAG_S)
    drag = 0.5 * dt * g.damping + 0.25 * dt * dt * g.stiffness
    for _ in range(steps):
        before = g.force
        g.force += follow * (command - g.force)
        push = 0.5 * (before + g.force) + g.stiffness * (goal - g.x)
        middle = g.x + 0.5 * dt * g.v
        if middle < 0.0:
            push += max(-_STOP_STIFFNESS * middle - _STOP_DAMPING * g.v, 0.0)
        elif middle > g.widest:
            push -= max(_STOP_STIFFNESS * (middle - g.widest) + _STOP_DAMPING * g.v, 0.0)
        v = ((g.mass - drag) * g.v + dt * push) / (g.mass + drag)
        slowed = abs(v) - dt * g.coulomb / (g.mass + drag)  # dry friction stops a motion, but does not reverse it
        v = math.copysign(slowed, v) if slowed > 0.0 else 0.0
        g.x += 0.5 * dt * (g.v + v)
        g.v = v


@final
class SimulatedGripper:
    """Motor, thumb and finger of `gripper`, and the hand's fingers, which are relaxed and half open without a goal.

    >>> simulated = SimulatedGripper(Gripper(0.025, 8.0, 0.1, 0.02, 0.05, 0.2, 1e-5, 0.02, 300.0, 2.0))
    >>> for _ in range(500):
    ...     simulated.advance(1e-3, 3.0, 0.005)
    >>> abs(simulated.opening - (0.005 + 3.0 / 300.0)) < 0.05 / 300.0 + 1e-6  # within dry friction
    True
    """

    def __init__(self, gripper: Gripper) -> None:
        self._gripper = gripper
        self._state: Records = np.zeros(1, dtype=_GRIPPER)
        state = self._state
        state["mass"] = gripper.mass + gripper.finger_mass
        state["coulomb"], state["widest"] = gripper.coulomb, gripper.opening
        state["damping"] = gripper.viscous + gripper.finger_damping
        state["stiffness"] = gripper.finger_stiffness
        self._read: deque[tuple[float, float]] = deque()
        self.reset()

    def reset(self, goal: float = math.nan) -> None:
        """Reset: at rest at the fingers' `goal` [m], without force."""
        self._state["x"], self._state["v"], self._state["force"] = self._find_goal(goal), 0.0, 0.0
        self._read.clear()

    def _find_goal(self, goal: float) -> float:
        """Goal [m] clipped to the gripper's range; half open without one."""
        return min(max(goal, 0.0), self._gripper.opening) if math.isfinite(goal) else 0.5 * self._gripper.opening

    def advance(self, dt: float, command: float, goal: float) -> None:
        """Advance by `dt` [s] under the motor's `command` [N], positive to open, with the fingers' `goal` [m]."""
        steps = max(math.ceil(dt / _STEP_S - _TIME_ERROR_S / _STEP_S), 1)
        if dt > 0.0:
            _advance(self._state, command, self._find_goal(goal), dt / steps, steps)

    @property
    def opening(self) -> float:
        """True opening [m]."""
        return float(self._state["x"][0])

    @property
    def force(self) -> float:
        """Present force of the motor [N], positive to open."""
        return float(self._state["force"][0])

    def read(self, t: float) -> tuple[float, float]:
        """Opening [m] quantised by the encoder, and its rate [m/s] over the last 5 ms, at `t` [s]."""
        step, x = self._gripper.step, self.opening
        seen = round(x / step) * step if step > 0.0 else x
        read = self._read
        if read and read[-1][0] >= t:
            read.pop()
        while len(read) > 1 and t - read[1][0] >= _VELOCITY_WINDOW_S - _TIME_ERROR_S:
            read.popleft()
        before = read[0] if read else (t, seen)
        read.append((t, seen))
        return seen, (seen - before[1]) / (t - before[0]) if before[0] < t else 0.0
