"""Card, scene and drawing of coil arrays."""

from __future__ import annotations

import json
from io import StringIO
from itertools import pairwise

import pytest
from rich.console import Console

from haptorb.cli.cards import card
from haptorb.devices.loader import load
from haptorb.web.session import describe_scene


@pytest.mark.parametrize("name", ["planar", "tetrahedron"])
def test_the_card_tells_forces_by_height(name):
    made = card(load(name))
    numbers = json.loads(json.dumps(made.numbers()))
    peaks = [min(layer["peak_n"]) for layer in numbers["layers"]]
    assert all(low > high > 0 for low, high in pairwise(peaks))
    for layer in numbers["layers"]:
        assert 0 < layer["weakest_peak_n"] <= min(layer["peak_n"]) * (1 + 1e-9)
        assert max(layer["continuous_n"]) < max(layer["peak_n"])
    contact = numbers["contact"]
    told = [force for row in contact["weakest_peak_n"] for force in row if force is not None]
    assert 0.0 < min(told) <= numbers["layers"][0]["weakest_peak_n"] * 1.01
    assert min(told) < contact["median_weakest_peak_n"] < max(told)
    assert numbers["heat_between_coils"] is False
    console = Console(width=160, record=True, file=StringIO())
    made.show(console)
    assert "weakest" in console.export_text()
    assert {one.name for one in made.quantities()} >= {"channels", "weakest peak force at contact"}


def test_coils_are_drawn_where_they_are():
    for name, kind in (("planar", "plate"), ("tetrahedron", "dome")):
        device = load(name)
        scene = describe_scene(device)
        assert scene["kind"] == kind
        coils = [part for part in scene["parts"] if part["role"] == "coil"]
        assert [coil["position"] for coil in coils] == device.windings.position.tolist()
    assert load("tetrahedron").draw() is not None
