"""Fluids: one that continues to move after stirring and drags the tool along, and one that rotates steadily."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, sqrt
from typing import ClassVar

import numpy as np

from haptorb.arrays import Array, Records, fields
from haptorb.compiled import kernel
from haptorb.devices.base import Device, State
from haptorb.errors import InputError
from haptorb.worlds.base import Shape, World, parameter
from haptorb.worlds.dynamic import DynamicWorld, MemoryField, make_memory

__all__ = ["Fluid", "StirredFluid"]


_RINGS = 8
_CORK_RADIUS_M = 0.003  #: radius [m]
_FIELDS = (
    MemoryField("swirl", "m/s", "speed of each ring of fluid about +z, from the axis outward", (_RINGS,)),
    MemoryField("angle", "rad", "angle about +z of a cork that floats on the fluid"),
    MemoryField("cork", "m", "position of the cork, stator frame", (3,)),
    MemoryField("energy", "J", "kinetic energy of all rings"),
)

#: Settings of the kernel.
_FLUID = fields(
    ("width", "f8"),  # of a ring [m]
    ("drag", "f8"),  # b [N·s/m]
    ("greatest", "f8"),  # maximum force [N]
    ("decay", "f8"),  # rate of the friction at the bottom [1/s]
    ("mixing", "f8"),  # kinematic viscosity between rings [m²/s]
    ("mass", "f8", (_RINGS,)),  # of each ring [kg]
    ("cork", "f8"),  # distance of the cork from the axis [m]
    ("distance", "f8"),  # distance of the cork from the dome's centre [m]
)


@kernel
def _mix(u: Array, f: Records, dt: float) -> None:
    """Friction between rings and at the bottom for `dt` [s]: backward Euler, so it is strictly dissipative.

    Rings exchange angular momentum by the shear of their angular velocities, T = 2π ν σ ρ³ dω/dρ with σ the mass per
    area; written for the momenta J ω with J = m ρ². A tridiagonal system, solved by Thomas's algorithm."""
    b = f[0]
    upper, right = np.empty(_RINGS), np.empty(_RINGS)
    below = 0.0
    for k in range(_RINGS):
        radius = (k + 0.5) * b.width
        inertia = b.mass[k] * radius * radius
        above = 0.0
        if k + 1 < _RINGS:
            face = (k + 1.0) * b.width
            per_area = b.mass[k] / (2.0 * np.pi * radius * b.width)
            above = dt * 2.0 * np.pi * b.mixing * per_area * face * face * face / b.width
        diagonal = inertia * (1.0 + b.decay * dt) + below + above
        value = inertia * u[k] / radius
        if k > 0:
            diagonal += below * upper[k - 1]
            value += below * right[k - 1]
        upper[k] = -above / diagonal
        right[k] = value / diagonal
        below = above
    omega = 0.0
    for back in range(_RINGS):
        k = _RINGS - 1 - back
        omega = right[k] - upper[k] * omega
        u[k] = omega * (k + 0.5) * b.width


@kernel
def _stir(memory: Records, fluid: Records, p: Array, v: Array, dt: float, wrench: Array) -> None:
    """Advance the fluid by `dt` [s], with the tool at `p` (3,) [m] and `v` (3,) [m/s]; `wrench` (6,) is its drag
    [N]."""
    m, b = memory[0], fluid[0]
    u = m.swirl
    _mix(u, fluid, dt)
    rho = np.sqrt(p[0] * p[0] + p[1] * p[1])
    at = rho / b.width - 0.5
    # The drag is distributed over two rings, by weights; within the innermost the fluid rotates like a solid body.
    inner = min(max(int(np.floor(at)), 0), _RINGS - 2)
    share = min(max(at - inner, 0.0), 1.0)
    near, far = 1.0 - share, share
    if at < 0.0:
        near, far = rho / (0.5 * b.width), 0.0
    flow = near * u[inner] + far * u[inner + 1]
    ex, ey = (-p[1] / rho, p[0] / rho) if rho > 1e-9 else (0.0, 0.0)
    relative = v[0] * ex + v[1] * ey - flow
    # Implicit drag at the end of the step: it cannot overshoot.
    light = near * near / b.mass[inner] + far * far / b.mass[inner + 1]
    later = relative / (1.0 + b.drag * dt * light)
    rx, ry, rz = v[0] + (later - v[0] * ex - v[1] * ey) * ex, v[1] + (later - v[0] * ex - v[1] * ey) * ey, v[2]
    size = b.drag * np.sqrt(rx * rx + ry * ry + rz * rz)
    scale = b.drag if size <= b.greatest else b.drag * b.greatest / size
    wrench[:] = 0.0
    wrench[0], wrench[1], wrench[2] = -scale * rx, -scale * ry, -scale * rz
    push = scale * later * dt
    u[inner] += near * push / b.mass[inner]
    u[inner + 1] += far * push / b.mass[inner + 1]
    energy = 0.0
    for k in range(_RINGS):
        energy += 0.5 * b.mass[k] * u[k] * u[k]
    m.energy = energy
    ring = b.cork / b.width - 0.5
    k = min(max(int(np.floor(ring)), 0), _RINGS - 2)
    carried = u[k] + (ring - k) * (u[k + 1] - u[k])
    m.angle = (m.angle + carried / b.cork * dt) % (2.0 * np.pi)
    m.cork[0], m.cork[1] = b.cork * np.cos(m.angle), b.cork * np.sin(m.angle)
    m.cork[2] = np.sqrt(b.distance * b.distance - b.cork * b.cork)


@dataclass(frozen=True)
class StirredFluid(DynamicWorld):
    """Fluid on the dome that the tool stirs; it continues to move and drags the tool along.

    Eight rings about +z, each with a mass and a speed: F = −b (v − u), and the rings where the tool is get the opposite
    impulse. Viscosity transfers angular momentum between rings, ν = (width of a ring)²/`mixing`; the ground absorbs
    it with the time constant `runs_on`.
    The film is thin and only rotates: a radial motion of the tool is damped and moves nothing. All steps are backward
    Euler, so the fluid never returns more energy than it received.

    Parameters
    ----------
    distance : float
        Distance of the tool's magnet from the dome's centre at contact, which is the radius of the largest ring [m],
        positive; `for_device` sets it.
    ground : float
        Radius of the dome on which the cork is drawn [m], positive; `for_device` sets it.

    Examples
    --------
    >>> import numpy as np
    >>> fluid = StirredFluid()
    >>> fluid.advance(fluid.begin(), State.at((0.02, 0, 0.05), v=(0, 0.1, 0)), 1e-3)[1] < 0
    np.True_
    """

    asks = "force"

    drag: float = parameter(2.0, "N·s/m", 0, 10, "b: drag coefficient, for the speed relative to the fluid")
    mass: float = parameter(
        0.4, "kg", 0.02, 3, "mass of the fluid: a larger mass is harder to stir and keeps moving longer"
    )
    runs_on: float = parameter(4.0, "s", 0.1, 100, "time in which friction at the ground reduces its speed to 37 %")
    mixing: float = parameter(
        2.0, "s", 0.05, 100, "time in which neighbouring rings equalise their speed; shorter is more viscous"
    )
    greatest: float = parameter(0.5, "N", 0.05, 1, "limit of the drag")
    distance: float = 0.050
    ground: float = 0.030

    @property
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """Rings, cork and energy."""
        return _FIELDS

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Cork that floats on the fluid."""
        return (Shape("cork", "sphere", (_CORK_RADIUS_M,), "cork"),)

    @property
    def bound(self) -> float:
        """[N]"""
        return self.greatest

    def for_device(self, device: Device) -> StirredFluid:
        """With rings up to the edge of the dome of `device`. Raises InputError for a device without a dome."""
        shell = device.shell
        if shell is None:
            raise InputError(f"world 'stirred_fluid' is for a tool over a sphere; device '{device.name}' has none")
        return replace(self, distance=shell.contact_distance, ground=shell.dome_radius)

    @cached_property
    def _facts(self) -> Records:
        """(1,) _FLUID: constant settings."""
        made = np.zeros(1, dtype=_FLUID)
        made["width"] = self.distance / _RINGS
        made["drag"], made["greatest"] = self.drag, self.greatest
        made["decay"], made["mixing"] = 1.0 / self.runs_on, (self.distance / _RINGS) ** 2 / self.mixing
        made["mass"] = self.mass * (2 * np.arange(_RINGS) + 1) / _RINGS**2  # equal mass per area
        made["cork"], made["distance"] = 0.5 * self.ground, self.ground + _CORK_RADIUS_M
        return made

    def begin(self) -> Records:
        """Initial state: at rest, with the cork at +x [m]."""
        memory = make_memory(_FIELDS)
        aside, high = 0.5 * self.ground, self.ground + _CORK_RADIUS_M
        memory["cork"] = aside, 0.0, (high * high - aside * aside) ** 0.5
        return memory

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) drag of the fluid [N], `dt` [s] after the previous tick."""
        wrench = np.empty(6)
        _stir(memory, self._facts, np.ascontiguousarray(state.p), np.ascontiguousarray(state.v), dt, wrench)
        return wrench


# --------------------------------------------------------------------------------------------------
# Stirred viscous fluid: Zárate 2020's second example, drag of the liquid on the tool.


@dataclass(frozen=True)
class Fluid(World):
    """Drag in a fluid that rotates about +z: F = −b (v − u(p)), limited to `greatest`.

    The current u is a Lamb–Oseen vortex: solid rotation near the axis, 1/ρ outside `core`. With `stir` zero the
    fluid is at rest and only damps; a current can move the tool, so the world is declared active.
    """

    asks = "force"
    passive: ClassVar[bool] = False

    viscosity: float = parameter(2.0, "N·s/m", 0, 10, "b: drag coefficient, for the speed relative to the fluid")
    stir: float = parameter(0.1, "m/s", -0.5, 0.5, "maximum speed of the fluid, counter-clockwise from above")
    core: float = parameter(0.02, "m", 0.005, 0.1, "radius at which the fluid is fastest")
    greatest: float = parameter(0.5, "N", 0.05, 1, "limit of the drag")

    @property
    def bound(self) -> float:
        """[N]"""
        return self.greatest

    def wrench(self, state: State) -> Array:
        """(6,) drag [N]."""
        px, py, _ = state.p.tolist()
        vx, vy, vz = state.v.tolist()
        rho = sqrt(px * px + py * py)
        if rho > 1e-9:
            # Lamb–Oseen: (1 − e^(−1.2564 ρ²/a²)) a/ρ has its maximum 0.7153 at ρ = a
            s = rho / self.core
            u = self.stir / 0.71533 * (1 - exp(-1.25643 * s * s)) / s
            vx, vy = vx + u * py / rho, vy - u * px / rho
        speed = sqrt(vx * vx + vy * vy + vz * vz)
        drag = -self.viscosity
        if self.viscosity * speed > self.greatest:
            drag = -self.greatest / speed
        wrench = np.zeros(6)
        wrench[0], wrench[1], wrench[2] = drag * vx, drag * vy, drag * vz
        return wrench
