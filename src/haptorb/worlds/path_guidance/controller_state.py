"""The state of the controller between two ticks, and its settings."""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array, Records, fields
from haptorb.worlds.memory import MemoryField

__all__ = ["MEMORY", "SETTINGS", "STEPS", "weigh_plan"]

STEPS = 12  #: of the plan
SETTLE = 0.03  #: an approach to the path that takes so long costs as much as the deviation itself [s]

#: What the controller remembers. "Across" are two directions: sideways along the sphere, and outward from the centre.
MEMORY = (
    MemoryField("started", "1", "1 once a position on the path was found"),
    MemoryField("arc", "m", "progress: distance along the path"),
    MemoryField("lag", "m", "lag of the progress behind the hand, along the path"),
    MemoryField("across", "m", "estimated deviation from the path, sideways and radial", (2,)),
    MemoryField("rate", "m/s", "of the deviation", (2,)),
    MemoryField("push", "N", "estimated force of the hand across the path", (2,)),
    MemoryField("pace", "m/s", "speed of the hand along the path, smoothed"),
    MemoryField("share", "1", "share of the guidance that is given: 0 for a hand at rest"),
    MemoryField("force", "N", "given in this tick", (3,)),
    MemoryField("heat", "W", "power of the coils in the plan, now"),
    MemoryField("steps", "1", "Newton steps of the last solution; -1: not converged"),
    MemoryField("place", "m", "point of the path nearest to the hand, on the dome, under the tool's tip", (3,)),
    MemoryField("plan", "N", "sideways force in every step of the plan", (STEPS,)),
)

#: The weights and the hand, as the kernel takes them.
SETTINGS = fields(
    ("strength", "f8"),  # most force [N]
    ("height", "f8"),  # share of the guidance outward from the centre
    ("step", "f8"),  # of the plan [s]
    ("tolerance", "f8"),  # deviation that costs 1 [m]
    ("heat", "f8"),  # cost of 1 W [1/W]
    ("power", "f8"),  # of the supply: more heat there is not [W]
    ("change", "f8"),  # change of the force from step to step that costs 1 [N]
    ("slowest", "f8"),  # pace at which half of the guidance is given [m/s]
    ("mass", "f8"),  # of hand and tool [kg]
    ("damping", "f8"),  # of the hand [N·s/m]
    ("observer", "f8"),  # its poles [rad/s]
    ("lower", "f8"),  # by how much the tip is nearer to the centre than the tool's magnet [m]
    ("closed", "?"),
    ("spacing", "f8"),  # of the path's places [m]
    ("cost", "f8", (STEPS, STEPS)),  # Hessian of one direction, without heat [1/N²]
    ("from_place", "f8", (STEPS, 2)),  # gradient per deviation and rate [1/(N·m), s/(N·m)]
    ("from_push", "f8", (STEPS,)),  # gradient per push of the hand [1/N²]
)


def weigh_plan(settings: Records) -> None:
    """Fill in the terms of the cost of a plan, from the weights of `settings`, (1,) SETTINGS.

    The hand is a mass with a damper, e'' = (f + d − b e')/m, with the force f constant in each step and the push d in
    all. After k steps, e and e' are linear in e₀, e₀', d and the forces before; the cost is Σ (e_k² + (SETTLE
    e'_k)²)/tolerance² + Σ ((f_k − f_(k−1))/change)², and the heat, which depends on the place.

    The heat depends on the position and is added in the tick.
    """
    one = settings[0]
    step, mass, damping = float(one["step"]), float(one["mass"]), float(one["damping"])
    decay = np.exp(-damping * step / mass)
    reach = mass / damping * (1.0 - decay)  # by a rate of 1, in a step
    advance = np.array([[1.0, reach], [0.0, decay]])
    gain = np.array([(step - reach) / damping, (1.0 - decay) / damping])
    free, response = np.zeros((STEPS, 2, 2)), np.zeros((STEPS, 2, STEPS))
    now, then = np.eye(2), np.zeros((2, STEPS))
    for k in range(STEPS):
        then = advance @ then
        then[:, k] += gain
        now = advance @ now
        free[k], response[k] = now, then
    weights = np.array([1.0, SETTLE**2]) / float(one["tolerance"]) ** 2
    change = np.eye(STEPS) - np.eye(STEPS, k=-1)
    change[0, 0] = 0.0  # the first step may differ from what was
    cost: Array = np.einsum("kaj,a,kal->jl", response, weights, response)
    settings["cost"] = 2.0 * (cost + change.T @ change / float(one["change"]) ** 2 + 1e-6 * np.eye(STEPS))
    settings["from_place"] = 2.0 * np.einsum("kaj,a,kab->jb", response, weights, free)
    settings["from_push"] = 2.0 * np.einsum("kaj,a,ka->j", response, weights, response.sum(axis=2))
