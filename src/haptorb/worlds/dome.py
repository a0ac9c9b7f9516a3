"""Zárate 2020's force map: a dome that repels (or a valley that attracts), sharper than any permanent magnet's.

The printed argument and inverse have errors (errata E12 to E14); this is the corrected map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from math import pi, radians, sqrt
from typing import ClassVar

import numpy as np
from numpy import ascontiguousarray

from haptorb.arrays import Array, Records, fields
from haptorb.compiled import tick_kernel
from haptorb.devices.base import Device, State
from haptorb.errors import InputError
from haptorb.magnetics.dipole import MU0
from haptorb.worlds.base import Sum, World, parameter

__all__ = ["Compass", "CompassDome", "Dome", "domes_apart", "overlaps"]


#: Settings of the kernel.
_DOME = fields(
    ("summit", "f8", (3,)),  # unit vector
    ("cut_off", "f8"),  # θ₂ [rad]
    ("turns", "f8"),  # k = π/(2θ₁)
    ("strength", "f8"),  # F₀ [N]
    ("contact", "f8"),  # d_min [m]
    ("reach", "f8"),  # d_max [m]
)


@tick_kernel
def _push(p: Array, domes: Records, wrench: Array) -> None:
    """Fill `wrench` (6,) [N] with the force at `p` (3,) [m]; domes is (1,) _DOME."""
    dome = domes[0]
    summit = dome.summit
    for i in range(6):
        wrench[i] = 0.0
    d = np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    if not 0.0 < d < dome.reach:
        return
    c = (p[0] * summit[0] + p[1] * summit[1] + p[2] * summit[2]) / d
    alpha = np.arccos(min(1.0, max(-1.0, c)))
    if alpha >= dome.cut_off:
        return
    # Outside contact the force falls with the fourth power; it does not increase when a tip penetrates the shell.
    fallen = dome.contact / max(d, dome.contact)
    strength = dome.strength * fallen * fallen * fallen * fallen
    radial = 2.0 * strength * np.cos(dome.turns * alpha)
    # e_t: away from the summit along the sphere (E12); undefined at the summit itself, where F_t is zero
    sine = np.sqrt(max(1.0 - c * c, 0.0))
    tangential = strength * np.sin(dome.turns * alpha) / sine if sine > 1e-9 else 0.0
    for i in range(3):
        outward = p[i] / d
        wrench[i] = radial * outward + tangential * (c * outward - summit[i])


@dataclass(frozen=True)
class Dome(World):
    """A hill that pushes the tool away, or a valley that draws it in: the map of Zárate 2020, Fig. 3.

    The printed argument and inverse are corrected: errata E12 to E14. With α the angle from the summit and k = π/(2θ₁):
    F_r = 2F₀ cos(kα) (d_min/d)⁴ outward, F_t = F₀ sin(kα) (d_min/d)⁴ away from the summit, for α < θ₂ and d < d_max;
    zero elsewhere. F₀ = 3μ₀ m_e m_p/(4π d_min⁴). At θ₁ = 90° it is the map of two permanent magnets.
    A positive moment repels, a negative one attracts. Torque is not controlled.

    Not passive: the force of a sharpened map (θ₁ < 90°) is not a gradient, so a closed path can extract energy (E19).
    Not continuous: it is cut off at θ₂ and d_max as in the paper; the guard's slew limit softens the jump.

    Parameters
    ----------
    tool_moment : float
        Dipole moment m_p of the tool's magnet [A·m²]; `for_device` sets it.
    contact_distance : float
        Distance d_min of the magnet from the centre at contact [m], positive; `for_device` sets it.
    reach : float
        Distance d_max from which the force is zero [m], above `contact_distance`; `for_device` sets it.

    Examples
    --------
    >>> dome = Dome(half_width_deg=18)
    >>> edge = (0.05 * np.sin(radians(18)), 0, 0.05 * np.cos(radians(18)))
    >>> bool(abs(dome.wrench(State.at(edge))[2]) < 0.1)
    True
    """

    asks = "force"
    passive: ClassVar[bool] = False
    continuous: ClassVar[bool] = False

    summit: tuple[float, float, float] = parameter(
        (0.0, 0.0, 1.0), "1", -1, 1, "direction of the summit from the centre"
    )
    half_width_deg: float = parameter(18.0, "deg", 5, 90, "θ1: angle of the first zero of the radial force")
    cut_off_deg: float = parameter(54.0, "deg", 5, 180, "θ2: angle from which the force is zero")
    moment: float = parameter(2.4, "A·m²", -4, 4, "strength: moment of the electromagnet at the summit; negative pulls")
    tool_moment: float = 2.406
    contact_distance: float = 0.050
    reach: float = 0.070

    def __post_init__(self) -> None:
        World.__post_init__(self)
        x, y, z = self.summit
        if sqrt(x * x + y * y + z * z) < 1e-6:
            raise InputError("Dome.summit must be a direction; got the zero vector")
        if self.cut_off_deg < self.half_width_deg:
            raise InputError(
                f"Dome.cut_off_deg (θ2) must not be smaller than half_width_deg (θ1 = {self.half_width_deg:g} deg); "
                f"got {self.cut_off_deg:g} deg"
            )

    def for_device(self, device: Device) -> Dome:
        """With the tool's moment, the contact distance and the shell of `device`.

        Raises InputError for a device without a dome, or a summit below its rim.
        """
        shell = device.shell
        if shell is None:
            raise InputError(f"world 'dome' is for a tool over a sphere; device '{device.name}' has none")
        if self.summit[2] < 0.0:
            raise InputError(
                f"Dome.summit {tuple(self.summit)} lies below the rim of the dome of device '{device.name}': its z "
                "must not be negative"
            )
        return replace(
            self,
            tool_moment=shell.moment,
            contact_distance=shell.contact_distance,
            reach=shell.contact_distance + shell.thickness,
        )

    @property
    def strength(self) -> float:
        """F₀ [N]: half the radial force at the summit in contact; negative if the map pulls."""
        return 3 * MU0 * self.moment * self.tool_moment / (4 * pi * self.contact_distance**4)

    @property
    def bound(self) -> float:
        """[N] 2|F₀|: cosine and sine under one root never exceed the summit's."""
        return 2 * abs(self.strength)

    @cached_property
    def _map(self) -> Records:
        """(1,) _DOME: constant settings."""
        made = np.zeros(1, dtype=_DOME)
        x, y, z = self.summit
        length = sqrt(x * x + y * y + z * z)
        made["summit"] = x / length, y / length, z / length
        made["cut_off"], made["turns"] = radians(self.cut_off_deg), 90.0 / self.half_width_deg
        made["strength"], made["contact"], made["reach"] = self.strength, self.contact_distance, self.reach
        return made

    def wrench(self, state: State) -> Array:
        """(6,) force of the map at the tool's magnet [N]; zero torque."""
        wrench = np.empty(6)
        _push(ascontiguousarray(state.p), self._map, wrench)
        return wrench


# --------------------------------------------------------------------------------------------------
# Sum of several domes, separated by their cut-offs: Zárate 2020's combined force maps.


def overlaps(domes: Sequence[Dome]) -> list[tuple[int, int, float]]:
    """Pairs (i, j) of domes whose cut-offs overlap, and the overlap [deg].

    >>> overlaps([Dome(), Dome(summit=(1, 0, 0))])
    [(0, 1, 18.0)]
    """
    found = []
    for (i, a), (j, b) in combinations(enumerate(domes), 2):
        p, q = np.asarray(a.summit), np.asarray(b.summit)
        cosine = float(p @ q / np.linalg.norm(p) / np.linalg.norm(q))
        apart = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        excess = a.cut_off_deg + b.cut_off_deg - apart
        if excess > 1e-9:
            found.append((i, j, round(float(excess), 9)))
    return found


def domes_apart(domes: Sequence[Dome]) -> Sum:
    """Combine several domes of which no two may overlap.

    To let domes overlap, add them: `Dome(...) + Dome(...)`.

    Parameters
    ----------
    domes : sequence of Dome
        The domes.

    Returns
    -------
    Sum
        All domes at once.

    Raises
    ------
    InputError
        If the cut-offs of two domes overlap; the message names the first two.
    """
    if not domes:
        raise InputError("domes_apart needs at least one dome")
    for i, j, excess in overlaps(domes):
        raise InputError(
            f"domes {i} and {j} overlap by {excess:.1f} deg: make their cut_off_deg smaller or move their summits "
            "apart; to let them overlap, add them with +"
        )
    return Sum(tuple(domes))


# --------------------------------------------------------------------------------------------------
# Torque that aligns a pen with a direction, like a compass needle; alone, or together with a dome.


@dataclass(frozen=True)
class Compass(World):
    """Torque that aligns a tool's axis with a direction, increasing smoothly from zero.

    The gradient of U = T (√(c² + s²) − s) with the chord c = |axis − direction|: a torque of
    T (axis × direction)/√(c² + s²), which is a spring of T/s [N·m/rad] near the direction and never exceeds T. It
    is perpendicular to the axis everywhere, like any torque on a magnet. It commands no force, but a force accompanies
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
        """[N]: no force is commanded."""
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
    """Dome with a direction: force of the dome and torque of the compass, as a compromise of the coils.

    Three coils cannot produce six independent components: `--torque-arm` weights torque against force.

    Parameters
    ----------
    dome : Dome
        The device's numbers: moment of the tool, contact distance, reach. `summit`, `half_width_deg`, `cut_off_deg` and
        `moment` replace its own.
    compass : Compass
        Computed from `direction`, `strength` and `width_deg`; a given one has no effect.
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
