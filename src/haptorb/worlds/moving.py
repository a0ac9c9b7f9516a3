"""Worlds that move, change and follow: their parameters are functions of time and tool position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import atan2, cos, hypot, pi, radians, sin
from typing import ClassVar

from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.worlds.maps.dome import Dome
from haptorb.worlds.parameter import parameter
from haptorb.worlds.world import World

__all__ = ["Orbit", "Varying", "Wander"]


@dataclass(frozen=True)
class Varying(World):
    """The world that `at(state)` returns in every tick: changing terrain, domes that follow the tool.

    A moving world can do work, so it is declared active, and not continuous.

    >>> rising = Varying(lambda state: Dome(moment=min(2.4, state.t)))
    >>> bool(rising.wrench(State.at((0, 0, 0.05), t=0.0)).any())
    False
    """

    passive: ClassVar[bool] = False
    continuous: ClassVar[bool] = False

    at: Callable[[State], World] | None = None
    device: Device | None = None

    def __post_init__(self) -> None:
        if not callable(self.at):
            raise InputError("Varying needs a function from State to World")

    def for_device(self, device: Device) -> Varying:
        """With every world of the function adapted to `device`."""
        return replace(self, device=device)

    def wrench(self, state: State) -> Array:
        """(6,) of the current world [N, N·m]. Raises InputError if that world has a memory, which would be lost."""
        assert self.at is not None
        world = self.at(state)
        if world.remembers:
            raise InputError(f"Varying creates a world in every tick, but '{world.name}' has a memory: add it instead")
        return (world if self.device is None else world.for_device(self.device)).wrench(state)


@dataclass(frozen=True)
class Orbit(World):
    """A dome whose summit moves in a circle and pushes the tool sideways as it passes."""

    asks = "force"
    passive: ClassVar[bool] = False
    continuous: ClassVar[bool] = False

    tilt_deg: float = parameter(25.0, "deg", 0, 60, "tilt of the summit's circle")
    turns_per_second: float = parameter(0.25, "Hz", -2, 2, "revolutions of the summit per second")
    half_width_deg: float = parameter(18.0, "deg", 5, 90, "θ1: angle of the first zero of the radial force")
    cut_off_deg: float = parameter(54.0, "deg", 5, 180, "θ2: angle from which the force is zero")
    moment: float = parameter(2.0, "A·m²", -4, 4, "moment at the summit; negative pulls")
    dome: Dome = field(default_factory=Dome)

    def __post_init__(self) -> None:
        World.__post_init__(self)
        dome = replace(self.dome, half_width_deg=self.half_width_deg, cut_off_deg=self.cut_off_deg, moment=self.moment)
        object.__setattr__(self, "dome", dome)

    def for_device(self, device: Device) -> Orbit:
        """With the dome adapted to `device`."""
        return replace(self, dome=self.dome.for_device(device))

    @property
    def bound(self) -> float:
        """[N]"""
        return self.dome.bound

    def wrench(self, state: State) -> Array:
        """(6,) of the dome where its summit is at the state's time [N]."""
        turn = 2 * pi * self.turns_per_second * state.t
        s = sin(radians(self.tilt_deg))
        summit = (s * cos(turn), s * sin(turn), cos(radians(self.tilt_deg)))
        return replace(self.dome, summit=summit).wrench(state)


@dataclass(frozen=True)
class Wander(World):
    """A summit that wanders over the device on a path that never repeats.

    Tilt and azimuth of the summit each follow two oscillations whose periods have no common multiple; it is
    deterministic, so the same time gives the same position.
    """

    asks = "force"
    passive: ClassVar[bool] = False
    continuous: ClassVar[bool] = False

    tilt_deg: float = parameter(40.0, "deg", 0, 60, "maximum tilt of the summit")
    pace: float = parameter(0.1, "Hz", 0, 1, "oscillations of the summit per second")
    half_width_deg: float = parameter(18.0, "deg", 5, 90, "θ1: angle of the first zero of the radial force")
    cut_off_deg: float = parameter(54.0, "deg", 5, 180, "θ2: angle from which the force is zero")
    moment: float = parameter(1.7, "A·m²", -4, 4, "moment at the summit; negative pulls")
    dome: Dome = field(default_factory=Dome)

    def __post_init__(self) -> None:
        World.__post_init__(self)
        dome = replace(self.dome, half_width_deg=self.half_width_deg, cut_off_deg=self.cut_off_deg, moment=self.moment)
        object.__setattr__(self, "dome", dome)

    def for_device(self, device: Device) -> Wander:
        """With the dome adapted to `device`."""
        return replace(self, dome=self.dome.for_device(device))

    @property
    def bound(self) -> float:
        """[N]"""
        return self.dome.bound

    def summit(self, t: float) -> tuple[float, float, float]:
        """The summit's direction (3,) at time `t` [s]: a unit vector."""
        turn = 2 * pi * self.pace * t
        x = 0.6 * sin(turn) + 0.4 * sin(5**0.5 * turn)
        y = 0.6 * cos(2**0.5 * turn) + 0.4 * sin(3**0.5 * turn)
        far = min(1.0, hypot(x, y))
        tilt, azimuth = radians(self.tilt_deg) * far, atan2(y, x)
        return (sin(tilt) * cos(azimuth), sin(tilt) * sin(azimuth), cos(tilt))

    def wrench(self, state: State) -> Array:
        """(6,) of the dome where its summit is at the state's time [N]."""
        return replace(self.dome, summit=self.summit(state.t)).wrench(state)
