"""Attributes of a world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from haptorb import worlds
from haptorb.worlds import Dome, Nothing, Wall, World
from haptorb.worlds.base import parameter, parameters


@pytest.mark.parametrize("name", worlds.CATALOGUE)
def test_every_world_shows_its_parameters_with_units(name: str) -> None:
    world = worlds.find_world(name)()
    assert len(repr(world)) <= 160
    assert repr(world).startswith(type(world).__name__)
    html = world._repr_html_()
    ElementTree.fromstring(html)
    for one in parameters(type(world)).values():
        assert one.name in html
        assert one.unit in html


def test_a_short_world_is_a_call_that_makes_it_again() -> None:
    world = Wall(normal=(0, 0, 1), offset=0.055, stiffness=100)
    assert repr(world) == "Wall(normal=(0, 0, 1), offset=0.055, stiffness=100, damping=0.5, greatest=1)"
    assert eval(repr(world), {"Wall": Wall}) == world
    assert "100 N/m" in world._repr_html_()


def test_of_a_long_one_what_is_not_at_its_default() -> None:
    @dataclass(frozen=True)
    class Many(Nothing):
        first_of_a_dozen_parameters: float = parameter(0.0, "m", 0, 1, "a")
        second_of_a_dozen_parameters: float = parameter(0.0, "m", 0, 1, "b")
        third_of_a_dozen_parameters: float = parameter(0.0, "m", 0, 1, "c")
        fourth_of_a_dozen_parameters: float = parameter(0.0, "m", 0, 1, "d")
        fifth_of_a_dozen_parameters: float = parameter(0.0, "m", 0, 1, "e")

    assert repr(Many(third_of_a_dozen_parameters=0.5)) == "Many(third_of_a_dozen_parameters=0.5)"


def test_a_sum_shows_its_parts() -> None:
    both: World = Dome() + Wall()
    assert repr(both) == f"{Dome()!r} + {Wall()!r}"
    assert repr(both + Wall()) == f"{both!r} + {Wall()!r}"[:159] + "…"
    html = both._repr_html_()
    ElementTree.fromstring(html)
    assert "half_width_deg" in html
    assert "stiffness" in html
    assert repr(worlds.Sum()) == "Sum()"


@pytest.mark.parametrize("make", [np.array, list], ids=["array", "list"])
def test_a_path_can_be_an_array_or_a_list(make: Callable[[object], Any]) -> None:
    points = [(0.0, 0.0, 0.05), (0.0, 0.01, 0.05)]
    given, listed = worlds.Guidance(path=make(points)), worlds.Guidance(path=tuple(points))
    assert given == listed
    assert hash(given) == hash(listed)
    assert worlds.Guidance(path=np.empty((0, 3))) == worlds.Guidance()
