"""Torque that turns a pen to a direction, like a compass needle; alone, or together with a dome."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import radians, sqrt

import numpy as np

from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.worlds.maps.dome import Dome
from haptorb.worlds.parameter import parameter
from haptorb.worlds.world import World

__all__ = ["Compass", "CompassDome"]


@dataclass(frozen=True)
class Compass(World):
    """Torque that turns a tool's axis to a direction, increasing smoothly from zero.

    The gradient of U = T (√(c² + s²) − s) with the chord c = |axis − direction|: a torque of
    T (axis × direction)/√(c² + s²), which is a spring of T/s [N·m/rad] near the direction and never exceeds T. It
    is perpendicular to the axis everywhere, as far as a magnet can have torque. It asks no force; a force accompanies
    the torque.

    >>> upright = Compass(direction=(1, 0, 0), strength=0.004).wrench(State.at((0, 0, 0.05)))
    >>> (upright * 1e3).round(2).tolist()
    [0.0, 0.0, 0.0, 0.0, 2.81, 0.0]
    """

    asks = "torque"

    direction: tuple[float, float, float] = parameter(
        (0.5, 0.0, 0.866), "1", -1, 1, "direction to which the world turns the tool's axis"
    )
    strength: float = parameter(0.002, "N·m", 0, 0.02, "T: maximum torque")
    width_deg: float = parameter(10.0, "deg", 2, 90, "s: angle over which the torque increases")

    def __post_init__(self) -> None:
        World.__post_init__(self)
        if not any(self.direction):
            raise InputError(f"{type(self).__name__}.direction must be a direction; got the zero vector")

    @property
    def bound(self) -> float:
        """[N]: no force is asked."""
        return 0.0

    def wrench(self, state: State) -> Array:
        """(6,) torque towards the direction [N·m]."""
        wrench = np.zeros(6)
        ax, ay, az = state.R_SR[:, 2].tolist()
        dx, dy, dz = self.direction
        length = sqrt(dx * dx + dy * dy + dz * dz)
        chord = 2.0 - 2.0 * (ax * dx + ay * dy + az * dz) / length
        k = self.strength / (length * sqrt(max(chord, 0.0) + radians(self.width_deg) ** 2))
        wrench[3], wrench[4], wrench[5] = k * (ay * dz - az * dy), k * (az * dx - ax * dz), k * (ax * dy - ay * dx)
        return wrench


@dataclass(frozen=True)
class CompassDome(World):
    """A dome with a direction: force of the dome and torque of the compass together, as a compromise of the coils.

    Three coils cannot produce six independent components: `--torque-arm` weights torque against force.
    """

    asks = "both"
    passive = False
    continuous = False

    summit: tuple[float, float, float] = parameter(
        (0.0, 0.0, 1.0), "1", -1, 1, "direction of the summit from the centre"
    )
    half_width_deg: float = parameter(18.0, "deg", 5, 90, "θ1: angle of the first zero of the radial force")
    cut_off_deg: float = parameter(54.0, "deg", 5, 180, "θ2: angle from which the force is zero")
    moment: float = parameter(1.2, "A·m²", -4, 4, "moment at the summit; negative pulls")
    direction: tuple[float, float, float] = parameter(
        (0.5, 0.0, 0.866), "1", -1, 1, "direction to which the world turns the tool's axis"
    )
    strength: float = parameter(0.002, "N·m", 0, 0.02, "T: maximum torque")
    width_deg: float = parameter(10.0, "deg", 2, 90, "s: angle over which the torque increases")
    dome: Dome = field(default_factory=Dome)
    compass: Compass = field(default_factory=Compass)

    def __post_init__(self) -> None:
        World.__post_init__(self)
        dome = replace(
            self.dome, summit=self.summit, half_width_deg=self.half_width_deg, cut_off_deg=self.cut_off_deg,
            moment=self.moment,
        )  # fmt: skip
        compass = Compass(direction=self.direction, strength=self.strength, width_deg=self.width_deg)
        object.__setattr__(self, "dome", dome)
        object.__setattr__(self, "compass", compass)

    def for_device(self, device: Device) -> CompassDome:
        """With the dome adapted to `device`."""
        return replace(self, dome=self.dome.for_device(device))

    @property
    def bound(self) -> float:
        """[N] of the dome."""
        return self.dome.bound

    def wrench(self, state: State) -> Array:
        """(6,) force of the dome [N] and torque of the compass [N·m]."""
        wrench = self.dome.wrench(state)
        wrench[3:] = self.compass.wrench(state)[3:]
        return wrench
