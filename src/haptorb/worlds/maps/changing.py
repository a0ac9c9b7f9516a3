"""Maps with several summits, and maps that change in time: Zárate 2020's combined and adapted force maps."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import cos, pi, radians, sin

import numpy as np

from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.worlds.maps.dome import Dome
from haptorb.worlds.maps.domes import overlaps
from haptorb.worlds.maps.terrain import Terrain
from haptorb.worlds.parameter import parameter
from haptorb.worlds.world import Sum, World

__all__ = ["ChangingTerrain", "Summits"]


@dataclass(frozen=True)
class Summits(World):
    """Several summits in one map, on a circle about the centre: each a dome with its own cut-off, pushing or pulling.

    Where their cut-offs overlap, the maps add. Every other summit can have the opposite sign, a valley
    between two mountains.
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
        """[N]: that of one summit if their cut-offs do not overlap, else of all together."""
        bounds = [dome.bound for dome in self.domes]
        return sum(bounds) if overlaps(self.domes) else max(bounds)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Whether maps overlap, and by how much."""
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
