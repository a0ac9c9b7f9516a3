"""Device files of coil arrays: the built device, and messages of rejected files."""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

import haptorb
from haptorb.devices.base import State
from haptorb.devices.loader import parse
from haptorb.errors import DeviceError, GeometryError

CATALOGUE = files("haptorb.devices") / "catalogue"
PLANAR, TETRAHEDRON = ((CATALOGUE / f"{name}.toml").read_text(encoding="utf-8") for name in ("planar", "tetrahedron"))

DOWN, UP = "[0.00000, 0.00000, -20.00000]", "axis = [[0, 0, 1]]\nturns"


def test_the_catalogue_has_both_arrangements() -> None:
    planar, tetrahedron = haptorb.load("planar"), haptorb.load("tetrahedron")
    assert planar.channels == 16
    assert planar.shell is None
    assert np.ptp(planar.windings.position, axis=0) == pytest.approx([0.1225, 0.0909, 0.0], abs=1e-4)
    axes = tetrahedron.windings.axis
    assert axes @ axes.T == pytest.approx(np.eye(4) * 4 / 3 - 1 / 3, abs=1e-6)
    assert tetrahedron.shell.contact_distance == pytest.approx(0.05)


def test_the_pull_of_the_core_is_the_omnis() -> None:
    """The same core and the same tool, computed in another way."""
    state = State.at((0.01, 0.02, 0.05))
    known = haptorb.load("omni").wrench_map(state, "exact").passive
    found = haptorb.load("tetrahedron").wrench_map(state, "exact").passive
    assert found == pytest.approx(known, abs=1e-4 * np.linalg.norm(known))


@pytest.mark.parametrize(
    ("text", "before", "after", "words"),
    [
        (TETRAHEDRON, DOWN, "[0, 0, -18]", ("coil down", "windings outside the core", "15 mm")),
        (TETRAHEDRON, DOWN, "[0, 0, -26]", ("coil down", "windings inside the dome", "30 mm")),
        (PLANAR, "[8.75, -45.466, -15]", "[-20, -45.466, -15]", ("A2 and A3", "windings beside each")),
        (PLANAR, "[8.75, -45.466, -15]", "[8.75, -45.466, -10]", ("coil A3", "windings below the plate")),
        (PLANAR, "[8.75, -45.466, -15]", "[nan, -45.466, -15]", ("windings.position.3.1", "finite")),
        (PLANAR, UP, "axis = [[0, 0, 0]]\nturns", ("windings.axis", "direction")),
        (PLANAR, UP, "axis = [[0, 0, 1], [0, 0, 1]]\nturns", ("windings.axis", "2 values", "16")),
        (PLANAR, 'value = "16.25 mm"', 'value = "5 mm"', ("tip_distance", "6.25 mm")),
        (PLANAR, "outer_radius = { value = [16]", "outer_radius = { value = [4]", ("inner_radius", "smaller")),
        (PLANAR, "position = { value = [0, 0, 0]", "position = { value = [9, 15, -33]", ("magnets.1 and coil C3",)),
    ],
    ids=["core", "dome", "overlap", "plate", "nan", "no axis", "axes", "tip", "wall", "magnet in coil"],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_one_line(text: str, before: str, after: str, words: tuple[str, ...]) -> None:
    assert before in text
    with pytest.raises(DeviceError) as refused:
        parse(text.replace(before, after, 1), "mine.toml")
    assert all(word in str(refused.value) for word in words), refused.value


def test_more_than_a_hundred_coils_are_refused() -> None:
    names = ", ".join(f'"{n}"' for n in range(101))
    start = PLANAR.index("names = [")
    text = PLANAR[:start] + f"names = [{names}]" + PLANAR[PLANAR.index("]", start) + 1 :]
    with pytest.raises(DeviceError, match=r"coils\.names"):
        parse(text, "mine.toml")


def test_exactly_one_surface() -> None:
    with pytest.raises(DeviceError, match=r"\[dome\] or \[plate\]"):
        parse(PLANAR[: PLANAR.index("[plate]")] + PLANAR[PLANAR.index("[tool]") :], "mine.toml")


def test_overlaps_may_be_studied() -> None:
    text = PLANAR.replace("[8.75, -45.466, -15]", "[-20, -45.466, -15]")
    assert parse(text, "mine.toml", override=True).channels == 16


def test_a_magnet_in_a_coil_or_in_the_core_has_no_wrench() -> None:
    planar, tetrahedron = haptorb.load("planar"), haptorb.load("tetrahedron")
    with pytest.raises(GeometryError, match="inside a coil"):
        planar.wrench_map(State.at((8.75e-3, 15e-3, -10e-3), axis=(0, 0, 1)), "exact")
    with pytest.raises(GeometryError, match="inside the core"):
        tetrahedron.wrench_map(State.at((0.0, 0.0, 20e-3), axis=(0, 0, 1)), "exact")


def test_with_a_fill_the_windings_give_resistances_inductances_and_heat_capacity() -> None:
    given = haptorb.load("tetrahedron")
    found = parse('based_on = "tetrahedron"\nname = "mine"\n[windings]\nfill = 0.6', "mine.toml").coils
    assert found.resistance == pytest.approx(given.coils.resistance, rel=0.004)
    assert found.heat.winding_capacity == pytest.approx(given.coils.heat.winding_capacity, rel=1e-3)
    with pytest.raises(DeviceError, match=r"windings\.fill"):
        parse(TETRAHEDRON.replace("[windings]\n", "[windings]\nfill = 1.2\n", 1), "mine.toml")
    # a winding about the middle of a core: what a spherical electromagnet's has
    omni, core = haptorb.load("omni"), given.core
    middle = replace(
        given.windings, position=np.zeros((3, 3)), axis=np.eye(3), turns=omni.windings.turns,
        inner_radius=omni.windings.inner_radius, outer_radius=omni.windings.outer_radius, length=omni.windings.length,
    )  # fmt: skip
    assert middle.complete(omni.coils, core, 0.6).inductance == pytest.approx(omni.windings.inductance(core), rel=1e-6)
