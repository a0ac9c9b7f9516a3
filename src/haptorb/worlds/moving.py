"""Time-varying worlds: their parameters are functions of time and tool position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import atan2, cos, hypot, pi, radians, sin
from typing import ClassVar

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import Device, State
from haptorb.errors import InputError
from haptorb.worlds.base import Sum, World, parameter
from haptorb.worlds.dome import Dome, overlaps
from haptorb.worlds.terrain import Terrain

__all__ = ["ChangingTerrain", "Orbit", "Summits", "Varying", "Wander"]


@dataclass(frozen=True)
class Varying(World):
    """World given by a function of time and tool position: changing terrain, domes that follow the tool.

    It can do work, so it is declared active, and not continuous.

    Parameters
    ----------
    at : callable
        (State) → World that is rendered at that state; `state.t` is the time [s].
    device : Device, optional
        Device for which the worlds are adapted; a servo sets it.

    Examples
    --------
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
        """(6,) wrench of the current world [N, N·m]. Raises InputError if that world has a memory, which would be
        lost."""
        assert self.at is not None
        world = self.at(state)
        if world.remembers:
            raise InputError(f"Varying creates a world in every tick, but '{world.name}' has a memory: add it instead")
        return (world if self.device is None else world.for_device(self.device)).wrench(state)


@dataclass(frozen=True)
class Orbit(World):
    """Dome with a summit that moves in a circle and pushes the tool sideways as it passes.

    Parameters
    ----------
    dome : Dome
        The device's numbers: moment of the tool, contact distance, reach. Summit, angles and moment of the orbit
        replace its own.
    """

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
        """(6,) wrench of the dome with its summit at the state's time [N]."""
        turn = 2 * pi * self.turns_per_second * state.t
        s = sin(radians(self.tilt_deg))
        summit = (s * cos(turn), s * sin(turn), cos(radians(self.tilt_deg)))
        return replace(self.dome, summit=summit).wrench(state)


@dataclass(frozen=True)
class Wander(World):
    """Dome with a summit that moves over the device on a path that never repeats.

    Tilt and azimuth of the summit each follow two oscillations whose periods have no common multiple; it is
    deterministic, so the same time gives the same position.

    Parameters
    ----------
    dome : Dome
        The device's numbers: moment of the tool, contact distance, reach. Summit, angles and moment of the wandering
        dome replace its own.
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
        """Direction of the summit (3,) at time `t` [s]: a unit vector."""
        turn = 2 * pi * self.pace * t
        x = 0.6 * sin(turn) + 0.4 * sin(5**0.5 * turn)
        y = 0.6 * cos(2**0.5 * turn) + 0.4 * sin(3**0.5 * turn)
        far = min(1.0, hypot(x, y))
        tilt, azimuth = radians(self.tilt_deg) * far, atan2(y, x)
        return (sin(tilt) * cos(azimuth), sin(tilt) * sin(azimuth), cos(tilt))

    def wrench(self, state: State) -> Array:
        """(6,) wrench of the dome with its summit at the state's time [N]."""
        return replace(self.dome, summit=self.summit(state.t)).wrench(state)


# --------------------------------------------------------------------------------------------------
# Maps with several summits, and maps that change in time: Zárate 2020's combined and adapted force maps.


@dataclass(frozen=True)
class Summits(World):
    """Several repelling or attracting summits in one map, on a circle about the centre.

    Each is a dome with its own cut-off; where these overlap, the maps add. Every other summit can have the opposite
    sign, a valley between two mountains.

    Parameters
    ----------
    dome : Dome
        The device's numbers: moment of the tool, contact distance, reach. Places, angles and moments of the summits
        replace its own.
    """

    asks = "force"
    passive = False
    continuous = False

    count: float = parameter(4.0, "1", 1, 8, "number of summits; a whole number")
    tilt_deg: float = parameter(35.0, "deg", 0, 60, "tilt of the circle of summits")
    half_width_deg: float = parameter(10.0, "deg", 5, 90, "θ1: angle of the first zero of the radial force of each")
    cut_off_deg: float = parameter(22.0, "deg", 5, 180, "θ2: angle from a summit from which its force is zero")
    moment: float = parameter(2.0, "A·m²", -4, 4, "moment at the first summit; negative pulls")
    opposite: float = parameter(1.0, "1", -1, 1, "moment of every other summit, relative to the first; −1: a valley")
    dome: Dome = field(default_factory=Dome)

    def __post_init__(self) -> None:
        World.__post_init__(self)
        if self.count != int(self.count):
            raise InputError(f"Summits.count must be a whole number from 1 to 8; got {self.count:g}")
        s, c = sin(radians(self.tilt_deg)), cos(radians(self.tilt_deg))
        domes = []
        for n in range(int(self.count)):
            turn = 2 * pi * n / self.count
            moment = self.moment * (self.opposite if n % 2 else 1.0)
            domes.append(
                replace(
                    self.dome, summit=(s * cos(turn), s * sin(turn), c), half_width_deg=self.half_width_deg,
                    cut_off_deg=self.cut_off_deg, moment=moment,
                )
            )  # fmt: skip
        object.__setattr__(self, "_domes", tuple(domes))
        object.__setattr__(self, "_map", Sum(tuple(domes)))

    @property
    def domes(self) -> tuple[Dome, ...]:
        """One for each summit, the first towards +x."""
        domes: tuple[Dome, ...] = self._domes  # type: ignore[attr-defined]
        return domes

    def for_device(self, device: Device) -> Summits:
        """With the domes adapted to `device`."""
        return replace(self, dome=self.dome.for_device(device))

    @property
    def bound(self) -> float:
        """[N]: that of one summit if their cut-offs do not overlap, otherwise of all together."""
        bounds = [dome.bound for dome in self.domes]
        return sum(bounds) if overlaps(self.domes) else max(bounds)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Overlap of the maps, if any."""
        most = max((excess for _, _, excess in overlaps(self.domes)), default=0.0)
        return (f"neighbouring maps overlap by {most:.0f} deg and add there",) if most else ()

    def wrench(self, state: State) -> Array:
        """(6,) force of all summits [N]."""
        wrench: Array = self._map.wrench(state)  # type: ignore[attr-defined]
        return wrench


@dataclass(frozen=True)
class ChangingTerrain(World):
    """Terrain that changes in time: it rises and sinks, so that mountains become valleys, and drifts about the centre.

    Heights are those of `Terrain`, times cos(2π t/period), rotated by `drift` revolutions per second. It moves by
    itself and can do work, so it is declared active.

    Parameters
    ----------
    terrain : Terrain
        Heights of the terrain, and the device's numbers; `strength` and `half_angle_deg` of the changing terrain
        replace its own. The default is that of `Terrain`.
    """

    asks = "force"
    passive = False
    continuous = False

    strength: float = parameter(
        0.5, "N", -1, 1, "F0: radial force for a height of 1, at contact, at the maximum of the cycle"
    )
    half_angle_deg: float = parameter(60.0, "deg", 10, 90, "tilt at the edge of the map")
    period: float = parameter(8.0, "s", 1, 120, "period of the change")
    drift: float = parameter(0.02, "Hz", -1, 1, "revolutions of the terrain per second, counter-clockwise")
    terrain: Terrain = field(default_factory=Terrain)

    def __post_init__(self) -> None:
        World.__post_init__(self)
        terrain = self.terrain.replace(strength=self.strength, half_angle_deg=self.half_angle_deg)
        object.__setattr__(self, "terrain", terrain)

    def for_device(self, device: Device) -> ChangingTerrain:
        """With the terrain adapted to `device`."""
        return replace(self, terrain=self.terrain.for_device(device))

    @property
    def bound(self) -> float:
        """[N] of the terrain."""
        return self.terrain.bound

    def wrench(self, state: State) -> Array:
        """(6,) force of the terrain at the state's time [N]."""
        turn = 2 * pi * self.drift * state.t
        height, c, s = cos(2 * pi * state.t / self.period), cos(turn), sin(turn)
        x, y, z = state.p.tolist()
        at = np.array((c * x + s * y, c * y - s * x, z))
        wrench = self.terrain.wrench(State(state.t, state.R_SR, at, state.w, state.v))
        fx, fy, fz = wrench[:3].tolist()
        wrench[0], wrench[1], wrench[2] = height * (c * fx - s * fy), height * (s * fx + c * fy), height * fz
        return wrench
