"""The user's own worlds as designs: from the command line, and in a design file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptorb.errors import InputError, UnknownName
from haptorb_study.feel import course, load_designs
from haptorb_study.feel.insertion_forces import force_along
from haptorb_study.feel.limits import DesignChoice

GROOVE = """
from dataclasses import dataclass
import numpy as np
from haptorb.worlds import DynamicWorld, MemoryField, World
from haptorb.worlds.base import parameter

@dataclass(frozen=True)
class Groove(World):
    "A spring along X'."
    stiffness: float = parameter(100.0, "N/m", 0.0, 1000.0, "of the groove")
    width: float = parameter(0.01, "m", 0.001, 0.05, "of the groove")

    def wrench(self, state):
        out = np.zeros(6)
        out[0] = -self.stiffness * min(state.p[0], self.width)
        return out

@dataclass(frozen=True)
class Drag(DynamicWorld):
    "A block on a spring that slips at 2 N, wherever it is left."

    @property
    def memory_fields(self):
        return (MemoryField("place", "m", "of the block"),)

    def advance(self, memory, state, dt):
        memory["place"] = min(max(memory["place"][0], state.p[0] - 2e-3), state.p[0] + 2e-3)
        return np.array([-1000.0 * (state.p[0] - memory["place"][0]), 0, 0, 0, 0, 0])

@dataclass(frozen=True)
class Broken(World):
    def wrench(self, state):
        return np.zeros(6) / len(self.nothing)
"""


@pytest.fixture
def groove(tmp_path: Path) -> Path:
    path = tmp_path / "groove.py"
    path.write_text(GROOVE)
    return path


def test_a_world_of_ones_own_is_a_design_with_its_curve(groove: Path) -> None:
    choice = DesignChoice.of(None, [f"{groove}:Groove"], ["width=4 mm"])
    (design,) = choice.load().designs
    assert choice.folder == groove.with_name("groove-session")
    assert design.name == "groove"
    run = course(design)
    assert run.coming_out.max() == pytest.approx(0.4, rel=1e-6)  # 100 N/m over 4 mm
    assert run.root is None
    before = design.digest
    groove.write_text(GROOVE.replace("-self.stiffness", "-2 * self.stiffness"))
    assert choice.load().designs[0].digest != before  # other code is another design: old scores do not count


def test_a_world_with_memory_remembers_along_the_whole_way(groove: Path) -> None:
    (design,) = DesignChoice.of(None, [f"{groove}:Drag"], []).load().designs
    run = course(design)
    assert run.coming_out[[200, -1]] == pytest.approx([2.0, 2.0])  # dragged along
    assert run.coming_out[20] == pytest.approx(1000.0 * run.place[20], rel=0.02)  # it begins at home
    assert run.going_in[[0, 200]] == pytest.approx([2.0, 2.0])
    assert run.going_in[-1] == pytest.approx(-2.0)  # still pulled from the way out
    assert force_along(design, 0.01, 0.005) == pytest.approx(-2.0)
    assert force_along(design, 0.01, -0.005) == pytest.approx(2.0)


def test_a_design_file_varies_the_parameters_of_an_own_world(groove: Path) -> None:
    path = groove.with_name("designs.toml")
    text = 'title = "Grooves"\nworld = "groove.py:Groove"\n[common]\nwidth = "5 mm"\n'
    path.write_text(
        text + '[design.soft]\nstiffness = 50.0\n[design.hard]\ntitle = "very hard"\nstiffness = "900 N/m"\n'
    )
    designs = load_designs(path)
    assert designs["hard"].title == "very hard"
    assert [course(one).coming_out.max() for one in designs.designs] == pytest.approx([0.25, 4.5])
    assert np.array(course(designs["soft"]).numbers["insertion_force_n"]) <= 0
    for wrong, said in (
        ("stiffness = 2000", "between"),
        ('stiffness = "3 mm"', "stiffness"),
        ("stifness = 1.0", "stifness"),
    ):
        path.write_text(f"{text}[design.x]\n{wrong}\n")
        with pytest.raises((InputError, UnknownName), match=said):
            load_designs(path)


def test_what_cannot_be_is_said(groove: Path, tmp_path: Path) -> None:
    for words in (
        (None, [], []),
        (tmp_path / "d.toml", [f"{groove}:Groove"], []),
        (None, ["dome"], []),
        (groove, [], ["a=1"]),
    ):
        with pytest.raises(InputError):
            DesignChoice.of(*words)
    with pytest.raises(InputError, match="same name"):
        DesignChoice.of(None, [f"{groove}:Groove"] * 2, []).load()
    with pytest.raises(UnknownName):
        DesignChoice.of(None, [f"{groove}:Grove"], []).load()
    (broken,) = DesignChoice.of(None, [f"{groove}:Broken"], []).load().designs
    with pytest.raises(InputError, match=r"groove.py.*line \d+"):
        course(broken)
