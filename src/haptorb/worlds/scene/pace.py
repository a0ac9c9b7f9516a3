"""The pace of a scene: its own time passes as fast as the loop's, or slower while its steps take too long.

The pace changes smoothly. With a sudden change, moving bodies would change their velocity relative to the hand within
a tick, and the hand would feel an impact. The coupling is softer at a slower pace. If its spring is stretched, a rising
pace would add energy to it; so the pace rises only if the coupling's damper has dissipated that energy before (an
energy tank, as in Ferraguti, Secchi and Fantuzzi 2013).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from haptorb.worlds.memory import MemoryField

__all__ = ["BACKGROUND", "LEVELS", "PACE_FIELDS", "ScenePace", "advance_pace", "fill_tank", "take_over_step"]

#: detail → (share of the solver's iterations, pace that the scene approaches). The solver ends when it has
#: converged: a lower limit shortens the longest steps only, and far below a half tight contacts throw a body back and
#: forth
LEVELS = ((1.0, 1.0), (0.5, 1.0), (0.5, 0.5), (0.5, 0.25), (0.5, 0.125), (0.5, 0.125))
BACKGROUND = len(LEVELS) - 1  #: the level of background steps: a single step is longer than a tick
_GLIDE = 0.1  #: in which the pace changes by a factor of e [s]
_TANK = 2e-4  #: capacity of the tank [J]

#: Fields of the memory of a scene.
PACE_FIELDS = (
    MemoryField("detail", "1", "0: full detail; above: fewer iterations, slower time, then background steps"),
    MemoryField("pace", "1", "speed of the scene's time"),
    MemoryField("lighter", "1", "ticks with less than full detail"),
    MemoryField("behind", "s", "delay of the scene's time"),
    MemoryField("due", "1", "fraction of a step due in slow time"),
    MemoryField("stretched", "J", "energy stored in the coupling"),
    MemoryField("tank", "J", "energy that the coupling's damper took in slow time and its spring may use"),
    MemoryField("pending", "1", "1 while a step is computed in the background"),
    MemoryField("share", "N", "wrench on the body during that step: force, and torque [N·m]", (6,)),
    MemoryField("waiting", "N·s", "impulse of the coupling for the next step, linear and angular [N·m·s]", (6,)),
)


class ScenePace(NamedTuple):
    """One tick of a scene.

    level   of detail, an index of `LEVELS`
    steps   that are due now
    pace    how fast its time passes, 0 to 1
    ahead   fraction of a step by which its time has advanced since the last step
    passed  by how many steps its time advances now
    """

    level: int
    steps: int
    pace: float
    ahead: float
    passed: float


def advance_pace(one: Any, steps: int, dt: float) -> ScenePace:
    """One tick of `dt` [s], which has `steps` steps [1] at full pace, for a memory with PACE_FIELDS, in their units."""
    level, pace = int(one["detail"]), float(one["pace"])
    aim = LEVELS[level][1]
    if not level and pace == 1.0:
        return ScenePace(0, steps, 1.0, 0.0, float(steps))
    glide = math.exp(dt / _GLIDE)
    if pace > aim:
        pace = max(aim, pace / glide)
    elif pace < aim:
        pace = _rise(one, pace, min(aim, pace * glide))
    ahead = float(one["due"])
    due = ahead + pace * steps
    count = int(due)
    if level == BACKGROUND:  # its time stops at the end of a step until that has been computed
        due, count = min(due, 1.0), 0
    passed = due - ahead
    one["pace"], one["due"] = pace, due - count if pace < 1.0 or level == BACKGROUND else 0.0
    one["lighter"] += 1.0
    one["behind"] += (1.0 - passed / steps) * dt
    return ScenePace(level, count, pace, ahead, passed)


def take_over_step(one: Any, state: Any) -> None:
    """The background step of a memory with PACE_FIELDS has led to `state` (n,), in SI units."""
    one["state"][:] = state
    one["pending"], one["due"] = 0.0, max(float(one["due"]) - 1.0, 0.0)


def _rise(one: Any, pace: float, faster: float) -> float:
    """The next pace: `faster`, if the tank has the energy that this adds to the coupling's spring."""
    needed = float(one["stretched"]) * ((faster / pace) ** 2 - 1.0)  # stiffness grows at most by the square
    if needed > float(one["tank"]):  # safety: stiffer-from-the-tank
        return pace
    one["tank"] -= needed
    return faster


def fill_tank(one: Any, stretched: float, taken: float) -> None:
    """Note that the coupling stores `stretched` [J] and its damper took `taken` [J] in this tick of slow time."""
    one["stretched"] = stretched
    one["tank"] = min(float(one["tank"]) + taken, _TANK)
