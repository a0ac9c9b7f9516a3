"""Enamelled wire and its layers, against wire catalogues, counting, and the copper's volume."""

import numpy as np
import pytest

from haptorb.errors import InputError
from haptorb.magnetics.coil import COPPER_RESISTIVITY, Coil
from haptorb.magnetics.wire import overall_diameter, wind, wire_diameter

#: Nominal and greatest overall diameter [mm], grade 1: Elektrisola's list of wires by IEC 60317, as the OpenMagnetics
#: database of wires has it
CATALOGUE = {
    0.375: 0.414, 0.425: 0.466, 0.45: 0.491, 0.475: 0.519, 0.5: 0.544, 0.56: 0.606, 0.63: 0.679, 0.71: 0.762,
    0.8: 0.855, 0.9: 0.959, 1.0: 1.062, 1.12: 1.184, 1.25: 1.316, 1.4: 1.468, 1.6: 1.670, 1.8: 1.872, 2.0: 2.074,
}  # fmt: skip


@pytest.mark.parametrize("size", CATALOGUE)
def test_the_enamel_is_that_of_a_catalogue(size):
    """Sizes between those of the table, too: 0.375, 0.425 and 0.475 mm."""
    assert 1e3 * overall_diameter(1e-3 * size) == pytest.approx(CATALOGUE[size], abs=0.0015)


def test_the_enamel_grows_with_the_wire_and_is_never_nothing():
    sizes = np.geomspace(0.02e-3, 8e-3, 300)
    overall = np.array([overall_diameter(size) for size in sizes])
    assert (np.diff(overall) > 0).all()
    assert (overall > 1.015 * sizes).all()


@pytest.mark.parametrize("size", [0.0, -1e-3, float("nan"), float("inf")])
def test_a_wire_without_a_size_is_refused(size):
    with pytest.raises(InputError, match="diameter"):
        overall_diameter(size)


@pytest.mark.parametrize(
    ("turns", "length"), [(94, 15.6e-3), (1, 0.7e-3), (75.5, 13.7e-3), (23, 15.6e-3), (24, 15.6e-3)]
)
def test_the_layers_are_those_that_one_counts_turn_by_turn(turns, length):
    """One turn after the other is put down: on from the left flange, up where the next would not fit."""
    overall, inner, left, wire = 0.648e-3, 15.6e-3, turns, 0.0
    layer, at, side_by_side = 1, 0.0, []
    while left > 0:
        if at + overall > length + 1e-9:
            layer, at = layer + 1, 0.0
        wire += 2 * np.pi * (inner + (layer - 0.5) * overall) * min(left, 1)
        at, left = at + overall, left - 1
        side_by_side.append(layer)
    layers = wind(turns, inner, length, overall)
    assert (layers.layers, layers.depth) == (layer, pytest.approx(layer * overall))
    assert layers.per_layer == int((length + 1e-9) // overall) >= max(map(side_by_side.count, side_by_side))
    assert layers.wire_length == pytest.approx(wire, rel=1e-12)


def test_a_wire_wider_than_the_winding_does_not_fit():
    assert wind(10, 10e-3, 0.6e-3, 0.648e-3) is None


def test_resistance_and_heat_are_those_of_the_copper():
    """By its volume: ρ V/A² and c ρ_m V; V counted as circles."""
    copper, overall = 0.6e-3, 0.648e-3
    layers = wind(96, 15.6e-3, 15.6e-3, overall)
    radii = np.repeat(15.6e-3 + overall * (np.arange(4) + 0.5), 24)
    area = np.pi * (copper / 2) ** 2
    volume = area * 2 * np.pi * radii.sum()
    assert layers.resistance(copper) == pytest.approx(COPPER_RESISTIVITY * volume / area**2, rel=1e-12)
    assert layers.heat_capacity(copper) == pytest.approx(385.0 * 8890.0 * volume, rel=1e-12)


def test_the_wire_of_a_resistance_has_it_again():
    """In a section that its layers fill, whose mean turn is that in the middle."""
    overall = overall_diameter(0.5e-3)
    coil = Coil(200, 20e-3, 20e-3 + 5 * overall, 40 * overall)
    layers = wind(coil.turns, coil.inner_radius, coil.length, overall)
    assert layers.layers == 5
    found = wire_diameter(coil, layers.resistance(0.5e-3))
    assert found == pytest.approx(0.5e-3, rel=1e-9)
