"""Coils around a soft core, from their sizes: what an ampere makes before anybody has calibrated it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from haptorb.devices.device import Coils
from haptorb.numerics.arrays import Array
from haptorb.physics.sources.coil import COPPER_RESISTIVITY, Coil
from haptorb.physics.sources.dipole import MU0
from haptorb.physics.sources.soft_sphere import SoftSphere

__all__ = ["Windings"]

_COPPER_AT = 293.15  #: temperature of COPPER_RESISTIVITY [K]

_DEGREES = np.arange(1, 16, 2)  #: of the harmonics of the core's answer that `field_error` counts


@final
@dataclass(frozen=True)
class Windings:
    """Round coils about the core's centre, the first about x, the second about y, the third about z."""

    turns: Array  #: (3,)
    inner_radius: Array  #: (3,) [m]
    outer_radius: Array  #: (3,) [m]
    length: Array  #: (3,) along each coil's own axis [m]

    @cached_property
    def coils(self) -> tuple[Coil, ...]:
        """Each coil, its axis along its own +z."""
        sizes = zip(self.turns, self.inner_radius, self.outer_radius, self.length, strict=True)
        return tuple(Coil(*map(float, size)) for size in sizes)

    def parts(self, core: SoftSphere) -> Array:
        """(3, 2) [m²] moment per ampere along its own axis: of the winding itself, and of the core that it magnetises.

        N π (rₒ² + rₒrᵢ + rᵢ²)/3, and 4π/μ0 a³ (µ−1)/(µ+2) B(0), where a and µ are the core's and B(0) the winding's own
        field at the centre: the answer of a sphere to any field has the moment that its value at the centre gives
        (`SoftSphere.moment_in`; Jackson, Classical Electrodynamics, §5.11). With half the length h,

            B(0) = μ0 N/(2 (rₒ − rᵢ)) ln[(rₒ + √(rₒ² + h²))/(rᵢ + √(rᵢ² + h²))]

        (Montgomery, Solenoid Magnet Design, §1). Exact for windings that fill their section evenly and a core that does
        not saturate.
        """
        ri, ro, h = self.inner_radius, self.outer_radius, self.length / 2
        middle = MU0 * self.turns / (2 * (ro - ri)) * np.log((ro + np.hypot(ro, h)) / (ri + np.hypot(ri, h)))
        fields = np.stack([np.zeros(3), np.zeros(3), middle], axis=1)
        own = [coil.moment[2] for coil in self.coils]
        return np.stack([own, core.moment_in(fields)[:, 2]], axis=1)

    def moment_per_current(self, core: SoftSphere) -> Array:
        """(3, 3) [m²] m_e per ampere; diagonal, as the coils are taken to stand square on each other.

        Valid for what a device takes an electromagnet for: a point dipole. `field_error` returns how far the field near
        the coils is from that. Left out: saturation, leads, and the core's answer to the tool (`PassivePull`).
        """
        return np.diag(self.parts(core).sum(axis=1))

    def field_error(self, core: SoftSphere, distance: float) -> Array:
        """(3,) how far the field of each coil and core is from its dipole's, at `distance` [m] from the centre.

        The greater of the relative differences on the coil's axis and on its equator. The winding's own field is exact;
        the core's answer to its harmonic of degree l on the axis, b_l z^(l−1), is b_l β_l (l+1)/l a^(2l+1)/z^(l+2)
        (`soft_sphere`), with b_l of one loop of Smythe, Static and Dynamic Electricity, §7.13. It falls as 1/distance².

        `distance` must lie outside the windings.
        """
        found = []
        for coil, moment in zip(self.coils, self.parts(core).sum(axis=1), strict=True):
            own = coil.field(np.array([[0.0, 0.0, distance], [distance, 0.0, 0.0]]))[:, 2]
            scale = MU0 * moment / (4 * np.pi * distance**3)
            axis, equator = (own + _answer(coil, core, distance)) / (2 * scale, -scale)
            found.append(max(abs(axis - 1), abs(equator - 1)))
        return np.array(found)

    def inductance(self, core: SoftSphere) -> Array:
        """(3,) [H] of each winding with the core.

        The winding's own, and what the core's moment m adds to its flux: m·B(0) per ampere squared, by reciprocity.
        Left out: the core's higher harmonics, some per cent of the second part.
        """
        own = np.array([coil.inductance for coil in self.coils])
        moments = self.parts(core)[:, 1]
        per_field = core.moment_in(np.array([0.0, 0.0, 1.0]))[2]  # A·m² per tesla
        whole: Array = own + moments**2 / per_field
        return whole

    def complete(self, coils: Coils, core: SoftSphere, fill: float) -> Coils:
        """`coils` with resistance, inductance and heat capacity of these windings, of which copper fills `fill`.

        The heat capacity is the mean of the three, as a device has one for all its channels.
        """
        warm = 1 + coils.temperature_coefficient * (coils.reference_temperature - _COPPER_AT)
        capacity = float(np.mean([coil.heat_capacity(fill) for coil in self.coils]))
        return replace(
            coils,
            resistance=np.array([coil.resistance(fill, COPPER_RESISTIVITY * warm) for coil in self.coils]),
            inductance=self.inductance(core),
            heat=replace(coils.heat, winding_capacity=capacity),
        )

    def fill(self, resistance: Array, resistivity: float) -> Array:
        """(3,) share of each winding's section that conductor of `resistivity` [Ω·m] must fill for `resistance` [Ω].

        Round wire fills at most π/√12 = 0.907; more than that cannot be wound.
        """
        least = np.array([coil.resistance(1.0, resistivity) for coil in self.coils])
        share: Array = least / resistance
        return share


def _answer(coil: Coil, core: SoftSphere, distance: float) -> Array:
    """(2,) [T/A] axial field of the core alone, on the coil's axis and on its equator at `distance` [m]."""
    radii, heights, turns = coil.filaments(12, 12)
    far = np.hypot(radii, heights)
    c = heights / far
    axis, equator = 0.0, 0.0
    for degree, response in zip(_DEGREES, core.response(int(_DEGREES[-1]))[_DEGREES - 1], strict=True):
        slope = np.polynomial.legendre.Legendre.basis(int(degree)).deriv()
        own = MU0 / 2 * float(np.sum(turns * (1 - c * c) / far**degree * slope(c)))  # b_l
        answer = own * response * core.radius ** (2 * degree + 1) / distance ** (degree + 2) / degree
        axis += answer * (degree + 1)
        equator -= answer * float(slope(0.0))
    return np.array([axis, equator])
