"""A ball in a bowl on the dome, pushed by the tool."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import cos, pi, radians, sin

import numpy as np

from haptorb.arrays import Array, Records, fields
from haptorb.compiled import kernel
from haptorb.devices.base import Device, State
from haptorb.errors import InputError
from haptorb.worlds.base import Shape, World, parameter
from haptorb.worlds.dynamic import DynamicWorld, MemoryField, make_memory

__all__ = ["RollingBall"]

_FIELDS = (
    MemoryField("place", "m", "of the ball's centre, stator frame", (3,)),
    MemoryField("velocity", "m/s", "of the ball's centre, stator frame", (3,)),
    MemoryField("drawn", "m", "position of a ball that rolls on the dome under the tool's tip, stator frame", (3,)),
    MemoryField("energy", "J", "energy: kinetic, in the bowl and in the contact"),
)

_FADE_RADIUS_SHARE = 0.25  #: share of the radius within which the contact force fades out

#: Settings of the kernel.
_BALL = fields(
    ("axis", "f8", (3,)),  # unit vector to the centre of the bowl
    ("distance", "f8"),  # of the ball's centre from the dome's [m]
    ("drawn", "f8"),  # the same for display: under the tool's tip [m]
    ("mass", "f8"),  # inertial [kg]
    ("bowl", "f8"),  # m ω² [N/m]
    ("damping", "f8"),  # [N·s/m]
    ("rim", "f8"),  # angle of the rim from the axis [rad]
    ("rim_stiffness", "f8"),  # [N/m]
    ("reach", "f8"),  # distance of the tool at contact [m]
    ("stiffness", "f8"),  # of the contact [N/m]
    ("greatest", "f8"),  # maximum contact force [N]
)


@kernel
def _push(q: Array, p: Array, ball: Records, force: Array) -> float:
    """force (3,) becomes the sum of all forces on the ball at `q` [N], of which the bowl bears the radial part; returns
    their potential energy [J]. force[3:6] becomes the contact force on the tool at `p`."""
    b = ball[0]
    cosine = (q[0] * b.axis[0] + q[1] * b.axis[1] + q[2] * b.axis[2]) / b.distance
    # Bowl: V = m ω² R² (1 − cos θ), a spherical pendulum's
    energy = b.bowl * b.distance * b.distance * (1.0 - cosine)
    pull = b.bowl * b.distance
    angle = np.arccos(min(1.0, max(-1.0, cosine)))
    if angle > b.rim:
        over = b.distance * (angle - b.rim)
        energy += 0.5 * b.rim_stiffness * over * over
        pull += b.rim_stiffness * over / max(np.sin(angle), 1e-6)
    for i in range(3):
        force[i], force[3 + i] = pull * b.axis[i], 0.0
    # Contact: a spring with saturating force, which fades out towards the ball's centre
    gap = np.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)
    if 1e-12 < gap < b.reach:
        core = _FADE_RADIUS_SHARE * b.reach
        depth, most = b.reach - max(gap, core), b.greatest / b.stiffness
        push = b.stiffness * min(depth, most)
        energy += 0.5 * push * min(depth, most) + b.greatest * max(depth - most, 0.0)
        if gap < core:
            energy += 0.5 * push * (core - gap * gap / core)
            push *= gap / core
        for i in range(3):
            force[3 + i] = push * (p[i] - q[i]) / gap
            force[i] -= force[3 + i]
    return float(energy)


@kernel
def _kick(memory: Records, ball: Records, force: Array, dt: float) -> None:
    """Update the velocity by the tangential part of `force` over `dt` [s]."""
    m, b = memory[0], ball[0]
    q, v = m.place, m.velocity
    radial = (force[0] * q[0] + force[1] * q[1] + force[2] * q[2]) / (b.distance * b.distance)
    for i in range(3):
        v[i] += dt / b.mass * (force[i] - radial * q[i])


@kernel
def _drift(memory: Records, ball: Records, dt: float) -> None:
    """Move the ball by `dt` [s] along its great circle, exactly."""
    m, b = memory[0], ball[0]
    q, v = m.place, m.velocity
    radial = (v[0] * q[0] + v[1] * q[1] + v[2] * q[2]) / (b.distance * b.distance)
    for i in range(3):
        v[i] -= radial * q[i]  # remove the rounding error
    speed = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if speed < 1e-12:
        return
    turn = speed * dt / b.distance
    c, s = np.cos(turn), np.sin(turn)
    square = 0.0
    for i in range(3):
        along = v[i] / speed
        outward = q[i] / b.distance
        q[i] = b.distance * (c * outward + s * along)
        v[i] = speed * (c * along - s * outward)
        square += q[i] * q[i]
    for i in range(3):
        q[i] *= b.distance / np.sqrt(square)


@kernel
def _roll(memory: Records, ball: Records, p: Array, dt: float, wrench: Array) -> None:
    """Kick, drift, kick (Störmer–Verlet): symplectic, so the energy does not drift."""
    m, b = memory[0], ball[0]
    force = np.empty(6)
    _push(m.place, p, ball, force)
    _kick(memory, ball, force, 0.5 * dt)
    fade = np.exp(-b.damping / b.mass * dt)
    for i in range(3):
        m.velocity[i] *= fade
    _drift(memory, ball, dt)
    energy = _push(m.place, p, ball, force)
    _kick(memory, ball, force, 0.5 * dt)
    for i in range(3):
        wrench[i], wrench[3 + i] = force[3 + i], 0.0
        energy += 0.5 * b.mass * m.velocity[i] * m.velocity[i]
        m.drawn[i] = b.drawn / b.distance * m.place[i]
    m.energy = energy


@dataclass(frozen=True)
class RollingBall(DynamicWorld):
    """Ball that rolls in a bowl on the dome, and that the tool can push, catch and release.

    Its centre moves on the sphere on which a touching tool's magnet moves, in the potential of a spherical pendulum,
    V = m ω² R² (1 − cos θ) with ω = 2π `swings` and θ from the bowl's centre; beyond `rim_deg` a steep rim returns
    it. It starts halfway to the rim, towards +x. `mass` is the inertial mass: 7/5 of the mass of a solid rolling
    ball. The contact between tool and ball is a spring without friction; a tool at the centre of the ball is not
    pushed. Integrated by Störmer–Verlet on the sphere, one step per tick: without damping its energy stays within 0.1 %
    (Hairer, Lubich and Wanner 2006, chapter VI).

    Parameters
    ----------
    distance : float
        Distance of the ball's centre from the dome's [m], positive; `for_device` sets it.
    ground : float
        Radius of the dome on which the ball is drawn [m], positive; `for_device` sets it.

    Examples
    --------
    >>> ball = RollingBall(rim_deg=60)
    >>> bool(ball.wrench(State.at((0.02, 0, 0.05)))[0] < 0)
    True
    """

    asks = "force"

    summit: tuple[float, float, float] = parameter((0.0, 0.0, 1.0), "1", -1, 1, "direction of the centre of the bowl")
    mass: float = parameter(0.05, "kg", 0.01, 0.3, "inertial mass of the ball")
    swings: float = parameter(1.0, "Hz", 0.2, 3, "natural frequency in the bowl")
    damping: float = parameter(0.01, "N·s/m", 0, 1, "rolling resistance per speed; 0: no resistance")
    rim_deg: float = parameter(35.0, "deg", 5, 60, "angle from the centre of the bowl to its rim")
    radius: float = parameter(0.010, "m", 0.003, 0.03, "distance from the ball's centre at which the tool touches it")
    stiffness: float = parameter(120.0, "N/m", 10, 500, "stiffness of the contact between tool and ball")
    greatest: float = parameter(0.6, "N", 0.05, 2, "maximum force of the contact")
    distance: float = 0.050
    ground: float = 0.030

    def __post_init__(self) -> None:
        World.__post_init__(self)
        if not np.linalg.norm(self.summit) > 1e-6:
            raise InputError("Ball.summit must be a direction; got the zero vector")

    @property
    def name(self) -> str:
        """Name in the catalogue."""
        return "ball"

    @property
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """Position, velocity, drawn position, and energy."""
        return _FIELDS

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The ball."""
        return (Shape("ball", "sphere", (self.radius,), "drawn"),)

    @property
    def bound(self) -> float:
        """[N]"""
        return self.greatest

    def for_device(self, device: Device) -> RollingBall:
        """Place the ball on the dome of `device`. Raises InputError for a device without a dome, or a summit below
        its rim."""
        shell = device.shell
        if shell is None:
            raise InputError(f"world 'ball' is for a tool over a sphere; device '{device.name}' has none")
        if self.summit[2] < 0.0:
            raise InputError(
                f"Ball.summit {tuple(self.summit)} lies below the rim of the dome of device '{device.name}': "
                "its z must not be negative"
            )
        return replace(self, distance=shell.contact_distance, ground=shell.dome_radius)

    @cached_property
    def _facts(self) -> Records:
        """(1,) _BALL: constant settings."""
        made = np.zeros(1, dtype=_BALL)
        made["axis"] = np.asarray(self.summit) / np.linalg.norm(self.summit)
        made["distance"], made["mass"], made["damping"] = self.distance, self.mass, self.damping
        made["drawn"] = self.ground + self.radius
        made["bowl"] = self.mass * (2 * pi * self.swings) ** 2
        made["rim"], made["rim_stiffness"] = radians(self.rim_deg), 2.0 * self.stiffness
        made["reach"], made["stiffness"], made["greatest"] = self.radius, self.stiffness, self.greatest
        return made

    def begin(self) -> Records:
        """Initial state: at rest, halfway from the bowl's centre to its rim [m]."""
        memory = make_memory(_FIELDS)
        z = self._facts["axis"][0]
        x = np.cross(np.cross(z, (1.0, 0.0, 0.0) if abs(z[0]) < 0.9 else (0.0, 0.0, -1.0)), z)
        half = 0.5 * radians(self.rim_deg)
        memory["place"] = self.distance * (cos(half) * z + sin(half) * x / np.linalg.norm(x))
        memory["drawn"] = (self.ground + self.radius) / self.distance * memory["place"]
        return memory

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) force of the contact on the tool [N], after the ball has moved for `dt` [s]."""
        wrench = np.empty(6)
        _roll(memory, self._facts, np.ascontiguousarray(state.p), dt, wrench)
        return wrench

    def keep(self, memory: Records, previous: DynamicWorld, old: Records) -> None:
        """Continue at the ball's position [m], projected onto the sphere of this world."""
        if isinstance(previous, RollingBall) and old.dtype == memory.dtype:
            memory[:] = old
            memory["place"] *= self.distance / previous.distance
