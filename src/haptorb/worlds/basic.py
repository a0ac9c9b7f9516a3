"""Basic worlds: wall, point attraction, empty world, texture, vibration and detents."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, cos, exp, pi, radians, sin, sqrt
from typing import ClassVar

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import State
from haptorb.errors import InputError
from haptorb.worlds.base import World, parameter

__all__ = ["Detents", "Magnet", "Nothing", "Texture", "Vibration", "Wall"]


@dataclass(frozen=True)
class Wall(World):
    """A stiff half-space: stiffness and damping along the normal, beyond `offset`.

    Damping acts only while the mover is in the wall and moves inward, so the wall never pulls.

    >>> Wall(normal=(0, 0, 1), offset=0.055, stiffness=100).wrench(State.at((0, 0, 0.052)))[2].round(3).item()
    0.3
    """

    asks = "force"

    normal: tuple[float, float, float] = parameter(
        (1.0, 0.0, 0.0), "", -1, 1, "direction of the outward normal of the wall"
    )
    offset: float = parameter(0.0, "m", -0.1, 0.1, "distance of the wall's face from the centre, along the normal")
    stiffness: float = parameter(150.0, "N/m", 0, 5000, "stiffness: force per depth")
    damping: float = parameter(0.5, "N·s/m", 0, 50, "damping: force per speed into the wall")
    greatest: float = parameter(1.0, "N", 0.05, 20, "limit of the force")

    def __post_init__(self) -> None:
        World.__post_init__(self)
        if not any(self.normal):
            raise InputError("Wall.normal must be a direction; got the zero vector")

    @property
    def bound(self) -> float:
        """[N]"""
        return self.greatest

    def wrench(self, state: State) -> Array:
        """(6,) push along the normal [N]."""
        x, y, z = self.normal
        length = sqrt(x * x + y * y + z * z)
        x, y, z = x / length, y / length, z / length
        px, py, pz = state.p.tolist()
        vx, vy, vz = state.v.tolist()
        wrench = np.zeros(6)
        depth = self.offset - (x * px + y * py + z * pz)
        if depth > 0.0:
            inward = -(x * vx + y * vy + z * vz)
            push = min(self.stiffness * depth + self.damping * max(inward, 0.0), self.greatest)
            wrench[0], wrench[1], wrench[2] = push * x, push * y, push * z
        return wrench


# --------------------------------------------------------------------------------------------------
# Attraction to a point, of finite range.


_PEAK = exp(-0.5)  #: of r/s e^(−r²/2s²), at r = s


@dataclass(frozen=True)
class Magnet(World):
    """Attraction to a point: the gradient of U = −E e^(−r²/2s²), maximum force `strength` at distance `width`.

    >>> bool(Magnet(place=(0, 0, 0.05)).wrench(State.at((0.01, 0, 0.05)))[0] < 0)
    True
    """

    asks = "force"

    place: tuple[float, float, float] = parameter((0.0, 0.0, 0.05), "m", -0.1, 0.1, "position of the point")
    width: float = parameter(0.01, "m", 0.001, 0.05, "distance of the maximum pull")
    strength: float = parameter(0.25, "N", -1, 1, "maximum force; negative pushes away")

    @property
    def bound(self) -> float:
        """[N]"""
        return abs(self.strength)

    def wrench(self, state: State) -> Array:
        """(6,) pull towards the point [N]."""
        px, py, pz = state.p.tolist()
        x, y, z = px - self.place[0], py - self.place[1], pz - self.place[2]
        r = sqrt(x * x + y * y + z * z) / self.width
        pull = -self.strength / (self.width * _PEAK) * exp(-0.5 * r * r)
        wrench = np.zeros(6)
        wrench[0], wrench[1], wrench[2] = pull * x, pull * y, pull * z
        return wrench


# --------------------------------------------------------------------------------------------------
# Empty world: zero wrench.


@dataclass(frozen=True)
class Nothing(World):
    """Zero wrench everywhere: only the device's own friction and passive wrench remain."""

    asks = "force"

    @property
    def bound(self) -> float:
        """[N]"""
        return 0.0

    def wrench(self, state: State) -> Array:
        """(6,) zeros [N, N·m]."""
        return np.zeros(6)


# --------------------------------------------------------------------------------------------------
# Rough surface: spatially periodic bumps.


@dataclass(frozen=True)
class Texture(World):
    """Periodic bumps, fixed in space: the gradient of U = (a λ/2π) Σ sin(2π x_i/λ), F_i = −a cos(2π x_i/λ)."""

    asks = "force"

    wavelength: float = parameter(0.006, "m", 0.001, 0.05, "distance between two bumps")
    amplitude: float = parameter(0.12, "N", 0, 0.5, "maximum force along each axis")

    @property
    def bound(self) -> float:
        """[N]"""
        return 3**0.5 * self.amplitude

    def wrench(self, state: State) -> Array:
        """(6,) force of the bumps [N]."""
        k, a = 2 * pi / self.wavelength, self.amplitude
        x, y, z = state.p.tolist()
        wrench = np.zeros(6)
        wrench[0], wrench[1], wrench[2] = -a * cos(k * x), -a * cos(k * y), -a * cos(k * z)
        return wrench


# --------------------------------------------------------------------------------------------------
# Vibration: a force that oscillates in time, at any position.


@dataclass(frozen=True)
class Vibration(World):
    """Sinusoidal radial force F = a sin(2π f t) along the direction from the centre. Active: it can produce energy."""

    asks = "force"
    passive: ClassVar[bool] = False

    frequency: float = parameter(40.0, "Hz", 1, 250, "frequency of the force; the loop must run several times faster")
    amplitude: float = parameter(0.15, "N", 0, 0.5, "amplitude of the force")

    @property
    def bound(self) -> float:
        """[N]"""
        return self.amplitude

    def wrench(self, state: State) -> Array:
        """(6,) radial force at the state's time [N]."""
        wrench = np.zeros(6)
        d = state.distance
        if d > 0.0:
            wrench[:3] = self.amplitude * sin(2 * pi * self.frequency * state.t) / d * state.p
        return wrench


# --------------------------------------------------------------------------------------------------
# Detents: clicks as the tool tilts away from an axis.


@dataclass(frozen=True)
class Detents(World):
    """Clicks every `spacing_deg` of tilt from the axis.

    The gradient of U = −E cos(nθ) with n clicks a turn: F = −(E n/d) sin(nθ) e_θ, `strength` where d = 50 mm.

    >>> bool(abs(Detents().wrench(State.at((0, 0, 0.05)))).max() == 0)
    True
    """

    asks = "force"

    axis: tuple[float, float, float] = parameter((0.0, 0.0, 1.0), "", -1, 1, "direction of zero tilt")
    spacing_deg: float = parameter(10.0, "deg", 2, 60, "tilt between two clicks")
    strength: float = parameter(0.2, "N", 0, 1, "maximum force, halfway up each side of a click")

    def __post_init__(self) -> None:
        World.__post_init__(self)
        if not any(self.axis):
            raise InputError("Detents.axis must be a direction; got the zero vector")

    @property
    def bound(self) -> float:
        """[N] for a tool that stays at least 10 mm from the centre."""
        return 5 * self.strength

    def wrench(self, state: State) -> Array:
        """(6,) tangential force towards the nearest ring [N]."""
        wrench = np.zeros(6)
        px, py, pz = state.p.tolist()
        d = sqrt(px * px + py * py + pz * pz)
        ax, ay, az = self.axis
        length = sqrt(ax * ax + ay * ay + az * az)
        if d == 0.0:
            return wrench
        c = (px * ax + py * ay + pz * az) / (d * length)
        theta = acos(min(1.0, max(-1.0, c)))
        tx, ty, tz = c * px / d - ax / length, c * py / d - ay / length, c * pz / d - az / length
        t = sqrt(tx * tx + ty * ty + tz * tz)  # sin θ: no direction at the poles
        if t < 1e-9:
            return wrench
        n = 2 * pi / radians(self.spacing_deg)
        push = -self.strength * (0.05 / d) * sin(n * theta) / t
        wrench[0], wrench[1], wrench[2] = push * tx, push * ty, push * tz
        return wrench
