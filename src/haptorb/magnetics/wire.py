"""Enamelled round wire in layers of a winding: number of turns that fit, and the resulting resistance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import InputError
from haptorb.magnetics.coil import COPPER_DENSITY, COPPER_RESISTIVITY, COPPER_SPECIFIC_HEAT, Coil

__all__ = ["WireLayers", "overall_diameter", "wind", "wire_diameter"]

#: Nominal diameter of the copper, and maximum diameter over an enamel of grade 1 [mm]: IEC 60317-0-1, table 4
_SIZES: Array = np.array([
    (0.100, 0.117), (0.125, 0.144), (0.160, 0.182), (0.200, 0.226), (0.250, 0.281), (0.315, 0.349), (0.355, 0.392),
    (0.400, 0.439), (0.450, 0.491), (0.500, 0.544), (0.560, 0.606), (0.630, 0.679), (0.710, 0.762), (0.800, 0.855),
    (0.900, 0.959), (1.000, 1.062), (1.120, 1.184), (1.250, 1.316), (1.400, 1.468), (1.600, 1.670), (1.800, 1.872),
    (2.000, 2.074), (2.240, 2.316), (2.500, 2.578), (2.800, 2.880), (3.150, 3.233), (3.550, 3.635), (4.000, 4.088),
    (4.500, 4.591), (5.000, 5.093),
])  # fmt: skip
_ROUNDING = 1e-9  #: rounding tolerance of sizes that were computed from a wire [m]


def overall_diameter(copper: float) -> float:
    """Maximum diameter [m] over the enamel (grade 1, the thinnest) of a wire whose copper is `copper` [m] thick.

    Between the standard's sizes the enamel grows linearly; beyond them it is in proportion to the wire.

    Raises InputError unless `copper` is a positive length.

    >>> round(overall_diameter(0.63e-3) * 1e3, 3), round(overall_diameter(0.67e-3) * 1e3, 4)
    (0.679, 0.7205)
    """
    if not (np.isfinite(copper) and copper > 0):
        raise InputError(f"a wire's diameter must be a positive length; got {copper!r} m")
    size = 1e3 * copper
    nominal, overall = _SIZES.T
    if size < nominal[0] or size > nominal[-1]:
        end = 0 if size < nominal[0] else -1
        return float(copper * overall[end] / nominal[end])
    return float(copper + 1e-3 * np.interp(size, nominal, overall - nominal))


def wire_diameter(coil: Coil, resistance: float, resistivity: float = COPPER_RESISTIVITY) -> float:
    """Diameter [m] of the copper of a wire with which `coil` has `resistance` [Ω]; its mean turn is in the middle of
    its wall."""
    length = np.pi * (coil.inner_radius + coil.outer_radius) * coil.turns
    return float(np.sqrt(4 * resistivity * length / (np.pi * resistance)))


@dataclass(frozen=True)
class WireLayers:
    """Winding of round wire in layers, spaced at the wire's full diameter.

    That is where the wire of one layer crosses that of the layer below. Wires that lay in the grooves below them all
    the way round would take 13 % less depth; no winding of several layers reaches that.
    """

    per_layer: int  #: turns side by side in a full layer
    layers: int
    depth: float  #: of all layers [m]
    wire_length: float  #: [m]

    def resistance(self, copper: float, resistivity: float = COPPER_RESISTIVITY) -> float:
        """[Ω] with wire whose copper is `copper` [m] thick."""
        return float(4 * resistivity * self.wire_length / (np.pi * copper**2))

    def count_turns(self, turns: float) -> Array:
        """(layers,) of `turns` in each layer, from inside; the last one has what is left."""
        return _count_turns(turns, self.per_layer, self.layers)

    def heat_capacity(self, copper: float) -> float:
        """[J/K] of the copper only."""
        return float(np.pi / 4 * copper**2 * self.wire_length * COPPER_DENSITY * COPPER_SPECIFIC_HEAT)


def _count_turns(turns: float, per_layer: int, layers: int) -> Array:
    """(layers,) of `turns` in each of `layers`, all but the last full with `per_layer`."""
    counts = np.full(layers, float(per_layer))
    counts[-1] = turns - per_layer * (layers - 1)
    return counts


def wind(turns: float, inner_radius: float, length: float, overall: float) -> WireLayers | None:
    """`turns` of a wire of diameter `overall` [m] on a former of `inner_radius` [m] between flanges `length` [m] apart.

    None where not even one turn fits between the flanges.

    >>> layers = wind(74, 24.5e-3, 14.3e-3, 0.7205e-3)
    >>> layers.per_layer, layers.layers, round(layers.wire_length, 2)
    (19, 4, 12.05)
    """
    per_layer = int((length + _ROUNDING) // overall)
    if per_layer < 1:
        return None
    layers = int(np.ceil(turns / per_layer))
    counts = _count_turns(turns, per_layer, layers)
    radii = inner_radius + overall * (np.arange(layers) + 0.5)
    return WireLayers(per_layer, layers, layers * overall, float(2 * np.pi * counts @ radii))
