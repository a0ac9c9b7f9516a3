"""Path guidance by predictive contouring control: the user sets the pace, the coils' heat is part of the cost."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from haptorb.arrays import Array, Record, Records, fields
from haptorb.box_qp import solve_box
from haptorb.compiled import kernel
from haptorb.devices.base import Device, State
from haptorb.errors import GeometryError
from haptorb.worlds.base import Shape, parameter
from haptorb.worlds.dynamic import DynamicWorld, MemoryField, make_memory
from haptorb.worlds.path import SHAPES, GuidancePath, draw_path, make_path, make_shape

__all__ = [
    "MEMORY",
    "SETTINGS",
    "STEPS",
    "WORK",
    "PathGuidance",
    "advance_plan",
    "fill_frame",
    "find_arc",
    "follow_arc",
    "weigh_plan",
]


# --------------------------------------------------------------------------------------------------
# Nearest point of a path, searched near that of the previous tick.


@kernel
def _square(p: Array, places: Array, k: int) -> float:
    x, y, z = p[0] - places[k, 0], p[1] - places[k, 1], p[2] - places[k, 2]
    square: float = x * x + y * y + z * z
    return square


@kernel
def _refine(p: Array, places: Array, spacing: float, k: int) -> float:
    """Arc length [m] of the point nearest to p, near the sample k, on the polyline through its neighbours."""
    first, last = max(k - 1, 0), min(k + 1, places.shape[0] - 1)
    along, square = 0.0, 0.0
    for i in range(3):
        step = places[last, i] - places[first, i]
        along += (p[i] - places[k, i]) * step
        square += step * step
    share = along / square * (last - first) if square > 0.0 else 0.0
    arc: float = spacing * min(max(k + min(max(share, -0.5), 0.5), 0.0), places.shape[0] - 1.0)
    return arc


@kernel
def find_arc(p: Array, places: Array, spacing: float) -> float:
    """Arc length [m] of the point of the path nearest to p (3,) [m], over the whole path."""
    best, nearest = 0, np.inf
    for k in range(places.shape[0]):
        square = _square(p, places, k)
        if square < nearest:
            best, nearest = k, square
    return _refine(p, places, spacing, best)


@kernel
def follow_arc(p: Array, places: Array, spacing: float, closed: bool, arc: float, reach: float) -> float:
    """Arc length [m] of the nearest point within `reach` [m] of `arc` [m] along the path, so that progress does not
    jump to another section nearby."""
    count = places.shape[0] - 1
    if not 0.0 <= arc <= count * spacing:  # of a recorded memory: any number
        arc = 0.0
    middle, window = round(arc / spacing), max(round(reach / spacing), 1)
    best, nearest = 0, np.inf
    for n in range(middle - window, middle + window + 1):
        k = n
        if closed:
            k = n % count
        elif n < 0 or n > count:
            continue
        square = _square(p, places, k)
        if square < nearest:
            best, nearest = k, square
    found = _refine(p, places, spacing, best)
    return found % (count * spacing) if closed else found


@kernel
def fill_frame(places: Array, tangents: Array, spacing: float, arc: float, frame: Array) -> None:
    """frame (4, 3): the point at `arc` [m], with the tangential, sideways and outward directions there."""
    last = places.shape[0] - 1
    at = min(max(arc / spacing, 0.0), float(last))
    if not at >= 0.0:  # NaN, of a pose or a memory that is not finite: no index
        at = 0.0
    k = min(int(at), last - 1)
    share = at - k
    length, radius, along = 0.0, 0.0, 0.0
    for i in range(3):
        frame[0, i] = places[k, i] + share * (places[k + 1, i] - places[k, i])
        frame[1, i] = tangents[k, i] + share * (tangents[k + 1, i] - tangents[k, i])
        length += frame[1, i] * frame[1, i]
        radius += frame[0, i] * frame[0, i]
    length, radius = np.sqrt(length), np.sqrt(radius)
    for i in range(3):
        frame[1, i] /= length
        along += frame[1, i] * frame[0, i] / radius
    length = 0.0
    for i in range(3):
        frame[3, i] = frame[0, i] / radius - along * frame[1, i]
        length += frame[3, i] * frame[3, i]
    length = np.sqrt(length)
    if not length > 1e-6:  # straight away from the centre: any normal direction is valid
        x = 1.0 if abs(frame[1, 0]) < 0.7 else 0.0
        for i in range(3):
            frame[3, i] = (x if i == 0 else (1.0 - x if i == 1 else 0.0)) - (
                frame[1, 0] * x + frame[1, 1] * (1.0 - x)
            ) * frame[1, i]
        length = np.sqrt(frame[3, 0] ** 2 + frame[3, 1] ** 2 + frame[3, 2] ** 2)
    for i in range(3):
        frame[3, i] /= length
    frame[2, 0] = frame[3, 1] * frame[1, 2] - frame[3, 2] * frame[1, 1]
    frame[2, 1] = frame[3, 2] * frame[1, 0] - frame[3, 0] * frame[1, 2]
    frame[2, 2] = frame[3, 0] * frame[1, 1] - frame[3, 1] * frame[1, 0]


# --------------------------------------------------------------------------------------------------
# One tick of predictive contouring control: progress, estimate of the hand's force, and the planned force.
#
# After Langerak, Zárate, Vechev, Lindlbauer, Panozzo and Hilliges, "Optimal Control for Electromagnetic Haptic Guidance
# Systems", UIST 2020: the hand's own progress, not a clock, determines the reference; a plan over a short horizon
# weighs the deviation across the path against the heat of the coils, and only its first step is used.


WORK = 64  #: rows of the scratch memory: Hessian, three vectors, workspace of the solver, frames
_SEARCH_RANGE_M = 3e-3  #: search range of the progress per tick [m]: 3 m/s at 1 kHz
_MAX_PATH_DISTANCE_M = 15e-3  #: distance from the path's point above which the tool was set down elsewhere [m]
_PACE_TIME_CONSTANT_S = 0.15  #: time constant of the pace's low-pass filter [s]
_GUIDANCE_TIME_CONSTANT_S = 0.25  #: time constant with which guidance follows the pace [s]
_MAX_NEWTON_STEPS = 30  #: per tick
_PLAN_TOLERANCE_N = 1e-5  #: tolerance of the plan [N]


@kernel
def _observe(m: Record, s: Record, frame: Array, p: Array, v: Array, dt: float) -> None:
    """Update deviation, its rate, the hand's force and the pace: an observer of e'' = (f + d − be')/m.

    The force that acted meanwhile is the last one. All poles are at s.observer; the push is held within what guidance
    can resist."""
    w = s.observer * dt
    along = 0.0
    for i in range(3):
        along += frame[1, i] * v[i]
    m.pace += -np.expm1(-dt / _PACE_TIME_CONSTANT_S) * (along - m.pace)
    square = m.pace * m.pace
    wanted = 1.0 if s.slowest == 0.0 else square / (square + s.slowest * s.slowest)
    m.share += -np.expm1(-dt / _GUIDANCE_TIME_CONSTANT_S) * (wanted - m.share)
    most = 2.0 * s.strength
    for a in range(2):
        y, force = 0.0, 0.0
        for i in range(3):
            y += frame[2 + a, i] * (p[i] - frame[0, i])
            force += frame[2 + a, i] * m.force[i]
        rate = m.rate[a]
        before = m.across[a] + dt * rate
        error = y - before
        m.rate[a] = rate + dt / s.mass * (force + m.push[a] - s.damping * rate) + 3.0 * w * w / dt * error
        m.across[a] = before + min(3.0 * w, 1.0) * error
        m.push[a] = min(max(m.push[a] + s.mass * w * w * w / (dt * dt) * error, -most), most)


@kernel
def _weigh_heat(s: Record, frame: Array, matrix: Array, passive: Array, ohms: Array, out: Array, per: Array) -> bool:
    """out (2, 2) [1/N²] and out[2] (2,) [1/N]: contribution of heat to the cost of the force across the path.

    The currents of a force F are i = A⁻¹(F − F₀), with F₀ the core's own attraction: power iᵀRi. per (3, 3) becomes
    A⁻¹. False, and zeros, for a device without three coils.
    """
    for a in range(3):
        for b in range(2):
            out[a, b] = 0.0
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 0], matrix[1, 1], matrix[1, 2]
    g, h, k = matrix[2, 0], matrix[2, 1], matrix[2, 2]
    size = a * (e * k - f * h) - b * (d * k - f * g) + c * (d * h - e * g)
    if not abs(size) > 1e-12:
        return False
    per[0, 0], per[0, 1], per[0, 2] = (e * k - f * h) / size, (c * h - b * k) / size, (b * f - c * e) / size
    per[1, 0], per[1, 1], per[1, 2] = (f * g - d * k) / size, (a * k - c * g) / size, (c * d - a * f) / size
    per[2, 0], per[2, 1], per[2, 2] = (d * h - e * g) / size, (b * g - a * h) / size, (a * e - b * d) / size
    for coil in range(3):
        still = 0.0
        for i in range(3):
            still -= per[coil, i] * passive[i]
        for x in range(2):
            along = 0.0
            for i in range(3):
                along += per[coil, i] * frame[2 + x, i]
            out[2, x] += 2.0 * s.heat * ohms[coil] * along * still
            for y in range(2):
                other = 0.0
                for i in range(3):
                    other += per[coil, i] * frame[2 + y, i]
                out[x, y] += 2.0 * s.heat * ohms[coil] * along * other
    return True


@kernel
def _plan(m: Record, s: Record, heat: Array, work: Array) -> None:
    """Solve for the forces of the horizon, sideways then outward, each at most s.strength: row 2n + 3 of `work`.

    The sideways forces start at the last plan, m.plan (n,), the others at zero."""
    n = s.from_push.size
    size = 2 * n
    hessian, linear, low, high = work[:size], work[size], work[size + 1], work[size + 2]
    for x in range(2):
        most = s.strength * (1.0 if x == 0 else s.height)
        for i in range(n):
            at = x * n + i
            linear[at] = s.from_place[i, 0] * m.across[x] + s.from_place[i, 1] * m.rate[x]
            linear[at] += s.from_push[i] * m.push[x] + heat[2, x]
            low[at], high[at] = -most, most
            for y in range(2):
                for j in range(n):
                    cost = heat[x, y] if i == j else 0.0
                    if x == y:
                        cost += s.cost[i, j]
                    hessian[at, y * n + j] = cost
    x = work[size + 3]
    for i in range(n):
        x[i], x[n + i] = m.plan[i], 0.0
    m.steps = solve_box(hessian, linear, low, high, x, work[size + 4 :], _MAX_NEWTON_STEPS, _PLAN_TOLERANCE_N)
    for i in range(n):
        m.plan[i] = x[i]


@kernel
def advance_plan(
    memory: Records, settings: Records, places: Array, tangents: Array, actuation: Array, motion: Array, dt: float,
    work: Array, wrench: Array,
) -> None:  # fmt: skip
    """Advance `memory`, (1,) MEMORY, by `dt` [s] and fill `wrench` (6,) [N].

    places, tangents: (k, 3) of the path [m]. actuation (3, 5): force per ampere of three coils [N/A], force without
    current [N], resistances [Ω]; zeros if heat has no weight. motion (2, 3): position [m] and velocity [m/s] of the
    hand. work (WORK, 2n) is overwritten.
    """
    m, s = memory[0], settings[0]
    n = s.from_push.size
    below = work[4 * n + 8 :]
    frame, heat, per = below[0:4, 0:3], below[4:7, 0:2], below[4:7, 3:6]
    p, v = motion[0], motion[1]
    for i in range(6):
        wrench[i] = 0.0
    if m.started == 0.0:
        m.arc = find_arc(p, places, s.spacing)
    else:
        m.arc = follow_arc(p, places, s.spacing, s.closed, m.arc, _SEARCH_RANGE_M)
    fill_frame(places, tangents, s.spacing, m.arc, frame)
    gap, lag = 0.0, 0.0
    for i in range(3):
        gap += (p[i] - frame[0, i]) ** 2
        lag += (p[i] - frame[0, i]) * frame[1, i]
    if m.started == 1.0 and gap > _MAX_PATH_DISTANCE_M * _MAX_PATH_DISTANCE_M:
        m.started = 0.0
        m.arc = find_arc(p, places, s.spacing)
        fill_frame(places, tangents, s.spacing, m.arc, frame)
    if m.started == 0.0:
        m.started, m.lag, m.pace, m.share = 1.0, 0.0, 0.0, 1.0 if s.slowest == 0.0 else 0.0
        m.push[:], m.rate[:], m.plan[:], m.force[:] = 0.0, 0.0, 0.0, 0.0
        for a in range(2):
            m.across[a] = 0.0
            for i in range(3):
                m.across[a] += frame[2 + a, i] * (p[i] - frame[0, i])
    m.lag = lag
    distance = np.sqrt(frame[0, 0] * frame[0, 0] + frame[0, 1] * frame[0, 1] + frame[0, 2] * frame[0, 2])
    for i in range(3):
        m.place[i] = frame[0, i] * (1.0 - s.lower / distance)
    _observe(m, s, frame, p, v, dt)
    known = _weigh_heat(s, frame, actuation[:, :3], actuation[:, 3], actuation[:, 4], heat, per)
    _plan(m, s, heat, work)
    x, y = m.share * work[2 * n + 3, 0], m.share * work[2 * n + 3, n]
    size = np.sqrt(x * x + y * y)
    cut = 1.0 if size <= s.strength else s.strength / size
    for i in range(3):
        m.force[i] = cut * (x * frame[2, i] + y * frame[3, i])
        wrench[i] = m.force[i]
    m.heat = 0.0
    if known:
        for coil in range(3):
            current = 0.0
            for i in range(3):
                current += per[coil, i] * (m.force[i] - actuation[i, 3])
            m.heat = min(m.heat + actuation[coil, 4] * current * current, s.power)


# --------------------------------------------------------------------------------------------------
# State of the controller between two ticks, with its settings.


STEPS = 12  #: number of steps of the plan
SETTLE = 0.03  #: approach time to the path whose cost equals that of the deviation itself [s]

#: State of the controller. "Across" are two directions: sideways along the sphere, and outward from the centre.
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

#: Weights and hand model in the form that the kernel needs.
SETTINGS = fields(
    ("strength", "f8"),  # maximum force [N]
    ("height", "f8"),  # weight of the guidance outward from the centre
    ("step", "f8"),  # of the plan [s]
    ("tolerance", "f8"),  # deviation that costs 1 [m]
    ("heat", "f8"),  # cost of 1 W [1/W]
    ("power", "f8"),  # of the supply: upper limit of the heat [W]
    ("change", "f8"),  # change of the force from step to step that costs 1 [N]
    ("slowest", "f8"),  # pace at which guidance is reduced to half [m/s]
    ("mass", "f8"),  # of hand and tool [kg]
    ("damping", "f8"),  # of the hand [N·s/m]
    ("observer", "f8"),  # poles of the observer [rad/s]
    ("lower", "f8"),  # distance of the tip below the tool's magnet, towards the centre [m]
    ("closed", "?"),
    ("spacing", "f8"),  # spacing of the path's points [m]
    ("cost", "f8", (STEPS, STEPS)),  # Hessian of one direction, without heat [1/N²]
    ("from_place", "f8", (STEPS, 2)),  # gradient per deviation and rate [1/(N·m), s/(N·m)]
    ("from_push", "f8", (STEPS,)),  # gradient per force of the hand [1/N²]
)


def weigh_plan(settings: Records) -> None:
    """Compute the terms of the cost of a plan, from the weights of `settings`, (1,) SETTINGS.

    The hand is a mass with a damper, e'' = (f + d − b e')/m, with the force f constant in each step and the push d in
    all. After k steps, e and e' are linear in e₀, e₀', d and the forces before; the cost is Σ (e_k² + (SETTLE
    e'_k)²)/tolerance² + Σ ((f_k − f_(k−1))/change)², and the heat, which depends on the place.

    The heat depends on the position and is added in the tick.
    """
    one = settings[0]
    step, mass, damping = float(one["step"]), float(one["mass"]), float(one["damping"])
    decay = np.exp(-damping * step / mass)
    reach = mass / damping * (1.0 - decay)  # displacement by a rate of 1, in a step
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
    change[0, 0] = 0.0  # no cost for the difference between the first step and the previous force
    cost: Array = np.einsum("kaj,a,kal->jl", response, weights, response)
    settings["cost"] = 2.0 * (cost + change.T @ change / float(one["change"]) ** 2 + 1e-6 * np.eye(STEPS))
    settings["from_place"] = 2.0 * np.einsum("kaj,a,kab->jb", response, weights, free)
    settings["from_push"] = 2.0 * np.einsum("kaj,a,ka->j", response, weights, response.sum(axis=2))


@dataclass(frozen=True)
class PathGuidance(DynamicWorld):
    """Predictive guidance that keeps the tool on a path: contouring control after Langerak et al., UIST 2020.

    In every tick it estimates deviation, its rate and the hand's force across the path, predicts them over
    `horizon`, and chooses the forces with the lowest cost: Σ (deviation² + (30 ms · rate)²)/tolerance² + heat_weight ·
    power + Σ (change of force/`change`)², each force at most `strength`. The first of them is rendered. There is no
    force along the path: the user determines progress and speed. No force acts on a hand at rest.

    Active: it works against the hand, so it can put energy into a hand that leaves the path.

    Parameters
    ----------
    path : GuidancePath or array_like, shape (n, 3), optional
        Path in the stator frame, or points [m] that `make_path` connects. None: `shape` of the size `size_deg`.
    device : Device, optional
        Device whose coils heat up in the cost; `for_device` sets it. None: heat has no cost.
    """

    passive: ClassVar[bool] = False
    continuous: ClassVar[bool] = False
    asks = "force"

    mode: float = parameter(1.0, "1", 0, 1, "1: guide; 0: no force, only observe and record the deviation")
    strength: float = parameter(0.5, "N", 0, 1, "maximum force across the path")
    horizon: float = parameter(0.1, "s", 0.05, 0.4, "prediction horizon")
    tolerance: float = parameter(0.0005, "m", 0.0002, 0.01, "deviation with a cost of 1 in every step of the plan")
    heat_weight: float = parameter(0.005, "1/W", 0, 1, "cost of 1 W in the coils")
    change: float = parameter(0.5, "N", 0.01, 1, "change of force from step to step with a cost of 1")
    rest_pace: float = parameter(
        0.005, "m/s", 0, 0.05, "pace at which half of the guidance is given; 0: always full guidance"
    )
    height: float = parameter(0.0, "1", 0, 1, "share of radial guidance, for paths above the dome")
    hand_mass: float = parameter(0.1, "kg", 0.05, 2, "mass of hand and tool in the prediction")
    hand_damping: float = parameter(2.0, "N·s/m", 0.2, 20, "damping of the hand in the prediction")
    observer: float = parameter(20.0, "Hz", 1, 30, "bandwidth of the estimate of the hand's force")
    shape: float = parameter(1.0, "1", 0, 3, "default path: 0 line, 1 circle, 2 square, 3 spiral")
    size_deg: float = parameter(25.0, "deg", 10, 55, "tilt from the summit to the edge of that path")
    path: GuidancePath | tuple[tuple[float, ...], ...] | None = None
    device: Device | None = None

    def __post_init__(self) -> None:
        DynamicWorld.__post_init__(self)
        if self.path is not None and not isinstance(self.path, GuidancePath):
            object.__setattr__(self, "path", make_path(self.path))

    def for_device(self, device: Device) -> PathGuidance:
        """With the path checked against the workspace of `device`, and the heat of its coils in the cost.

        Raises InputError for a device without a dome, and for a path that leaves the workspace.
        """
        path = self.path if isinstance(self.path, GuidancePath) else self._find_shape(device)
        path.check(device)
        return replace(self, path=path, device=device)

    def _find_shape(self, device: Device | None) -> GuidancePath:
        shell = None if device is None else device.shell
        name = SHAPES[round(self.shape)]
        return (
            make_shape(name, self.size_deg)
            if shell is None
            else make_shape(name, self.size_deg, shell.contact_distance)
        )

    @cached_property
    def curve(self) -> GuidancePath:
        """Path [m]."""
        return self.path if isinstance(self.path, GuidancePath) else self._find_shape(self.device)

    @property
    def bound(self) -> float:
        """[N]"""
        return self.strength if self.mode >= 0.5 else 0.0

    @cached_property
    def _settings(self) -> Records:
        """(1,) SETTINGS."""
        made = np.zeros(1, dtype=SETTINGS)
        made["strength"], made["height"], made["step"] = self.bound, self.height, self.horizon / STEPS
        made["tolerance"], made["heat"], made["change"] = self.tolerance, self.heat_weight, self.change
        made["slowest"], made["mass"], made["damping"] = self.rest_pace, self.hand_mass, self.hand_damping
        made["power"] = np.inf if self.device is None else self.device.supply.power
        made["observer"] = 2 * np.pi * self.observer
        made["lower"] = self._lower
        made["closed"], made["spacing"] = self.curve.closed, self.curve.spacing
        weigh_plan(made)
        return made

    @cached_property
    def _scratch(self) -> tuple[Array, Array, Array]:
        return np.zeros((WORK, 2 * STEPS)), np.zeros((3, 5)), np.zeros((2, 3))

    @property
    def name(self) -> str:
        """Name in the catalogue."""
        return "path_guidance"

    @property
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """Progress, estimates of the hand, and the plan."""
        return MEMORY

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Path, and its point at the present progress."""
        return draw_path(self.curve, self._lower), Shape("progress", "sphere", (0.0015,), "place")

    @property
    def _lower(self) -> float:
        """Distance of a tool's tip below its magnet, for which the path is defined [m]."""
        shell = None if self.device is None else self.device.shell
        return 0.0 if shell is None else shell.contact_distance - shell.dome_radius

    def begin(self) -> Records:
        """(1,) initial state: no observation; progress at the beginning of the path."""
        memory = make_memory(MEMORY)
        first = self.curve.places[0]
        memory["place"] = first * (1.0 - self._lower / np.linalg.norm(first))
        return memory

    def keep(self, memory: Records, previous: DynamicWorld, old: Records) -> None:
        """Keep the state unless the path changed: then search the hand's position on it again. In the fields' units."""
        if isinstance(previous, PathGuidance) and np.array_equal(previous.curve.places, self.curve.places):
            memory[:] = old

    def wrench(self, state: State) -> Array:
        """(6,) first planned force for a hand that moves along the path at `state` [N], for force maps."""
        return replace(self, rest_pace=0.0).advance(self.begin(), state, 1e-3)

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) force across the path at `state`, `dt` [s] after the previous tick [N]."""
        work, actuation, motion = self._scratch
        device = self.device
        if device is not None and device.channels == 3:
            try:
                known = device.wrench_map(state, device.models[0])
            except GeometryError:  # a pose that no tool can have: its heat is not in the cost
                actuation[:] = 0.0
            else:
                actuation[:, :3], actuation[:, 3] = known.force, known.passive[:3]
                actuation[:, 4] = device.greatest_resistance
        motion[0], motion[1] = state.p, state.v
        wrench = np.empty(6)
        curve = self.curve
        advance_plan(memory, self._settings, curve.places, curve.tangents, actuation, motion, dt, work, wrench)
        return wrench
