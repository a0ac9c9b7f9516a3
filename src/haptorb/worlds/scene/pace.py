"""How fast a scene's own time passes: as fast as the loop's, or slower while its steps take too long.

The pace goes over smoothly. With a step of it, what moves in the scene would change its speed as the hand sees it
within a tick, and the hand would feel a knock. The coupling is softer at a slower pace. Where its spring is stretched,
a rising pace would put energy into it; so the pace rises only as far as the coupling's damper has taken that energy out
before (a tank, as in Ferraguti, Secchi and Fantuzzi 2013).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from haptorb.worlds.memory import MemoryField

__all__ = ["LEVELS", "PACE_FIELDS", "ScenePace", "advance_pace", "fill_tank"]

#: detail → (share of the solver's iterations, pace that the scene's time goes over to). The solver ends when it has
#: converged: a lower limit shortens the longest steps only, and far below a half tight contacts throw a body back and
#: forth
LEVELS = ((1.0, 1.0), (0.5, 1.0), (0.5, 0.5), (0.5, 0.25), (0.5, 0.125))
_GLIDE = 0.1  #: in which the pace changes by a factor of e [s]
_TANK = 2e-4  #: that is remembered of what the damper has taken [J]

#: What the memory of a scene has of it.
PACE_FIELDS = (
    MemoryField("detail", "1", "0 full; above: fewer iterations, then slower time"),
    MemoryField("pace", "1", "how fast the scene's time passes"),
    MemoryField("lighter", "1", "ticks with less than full detail"),
    MemoryField("behind", "s", "by which the scene's time has fallen behind"),
    MemoryField("due", "1", "share of a step that is still due in slow time"),
    MemoryField("stretched", "J", "in the coupling"),
    MemoryField("tank", "J", "that the coupling's damper has taken in slow time, for a spring that grows stiffer"),
    MemoryField("waiting", "N·s", "push of the coupling that the next step takes, and its turn [N·m·s]", (6,)),
)


class ScenePace(NamedTuple):
    """What one tick is for a scene.

    level   of detail, an index of `LEVELS`
    steps   that are due now
    pace    how fast its time passes, 0 to 1
    ahead   part of a step by which its time has gone on since the last one
    """

    level: int
    steps: int
    pace: float
    ahead: float


def advance_pace(one: Any, steps: int, dt: float) -> ScenePace:
    """One tick of `dt` [s], which has `steps` steps [1] at full pace, for a memory with PACE_FIELDS, in their units."""
    level, pace = int(one["detail"]), float(one["pace"])
    aim = LEVELS[level][1]
    if not level and pace == 1.0:
        return ScenePace(0, steps, 1.0, 0.0)
    glide = math.exp(dt / _GLIDE)
    if pace > aim:
        pace = max(aim, pace / glide)
    elif pace < aim:
        pace = _rise(one, pace, min(aim, pace * glide))
    ahead = float(one["due"])
    due = ahead + pace * steps
    count = int(due)
    one["pace"], one["due"] = pace, due - count if pace < 1.0 else 0.0
    one["lighter"] += 1.0
    one["behind"] += (1.0 - pace) * dt
    return ScenePace(level, count, pace, ahead)


def _rise(one: Any, pace: float, faster: float) -> float:
    """The pace that follows: `faster`, if the tank has the energy that the coupling's spring is given by it."""
    needed = float(one["stretched"]) * ((faster / pace) ** 2 - 1.0)  # stiffness grows at most by the square
    if needed > float(one["tank"]):  # safety: stiffer-from-the-tank
        return pace
    one["tank"] -= needed
    return faster


def fill_tank(one: Any, stretched: float, taken: float) -> None:
    """The coupling holds `stretched` [J], and its damper has taken `taken` [J] in this tick of slow time."""
    one["stretched"] = stretched
    one["tank"] = min(float(one["tank"]) + taken, _TANK)
