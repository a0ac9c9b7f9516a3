"""Study files: parsing, and mistakes reported before a session."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from haptorb.devices.loader import load
from haptorb.errors import InputError
from haptorb_study.columns import find_begun_version
from haptorb_study.columns import read_study as read_stored
from haptorb_study.database import database
from haptorb_study.order import balance_conditions, plan, procedure_of
from haptorb_study.prompts import Answer
from haptorb_study.set_points import list_equal_rings, list_published
from haptorb_study.simulated.forecast import forecast, load_squared, overlap
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, read_study, study_of

LEVELS = 'name = "x"\nprocedure = "{}"\n[levels]\nreference = 1.0\n'


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('name = "x"\n[parameters]\nmomnt = 2', "did you mean 'moment'"),
        ('name = "x"\n[parameters]\nmoment = 40', "between -4 and 4"),
        ('name = "x"\n[set_points]\npoints = [{number = 1, theta_deg = 61}]', "outside the workspace"),
        ('name = "x"\n[set_points]\npoints = [{number = 1, theta_deg = 1}, {number = 1, theta_deg = 2}]', "number 1"),
        ('name = "x"\n[set_points]\npoints = []', "layout"),
        ('name = "x"\nworld = "dume"', "did you mean 'dome'"),
        ('name = "x"\nworld = "wall"', "no summit"),
        ('name = "x"\ndevice = "pmsm"', "works for spherical electromagnets"),
        ('name = "x"\ndevise = "omni"', "devise"),
        ('name = "x"\nrender = "twist"', "render"),
        ('name = "a name with blanks"', "name"),
        ('name = "x"\n[parameters]\nsummit = [0, 0, 1]', "summit"),
        ('name = "x"\nprocedure = "guessing"', "procedure"),
        ('name = "x"\n[trials]\nrepetitions = 0', "repetitions"),
        ('name = "x"\n[trials]\norder = "any"', "counter-balanced"),
        ('name = "x"\n[[conditions]]\nname = "a"\n[[conditions]]\nname = "a"', "differ"),
        ('name = "x"\nprocedure = "forced-choice"', "two conditions"),
        ('name = "x"\nprocedure = "constant"', "needs [levels]"),
        (LEVELS.format("constant") + "values = [1.0]", "two different"),
        (LEVELS.format("staircase") + "least = 0.5\nmost = 0.1\nstart = 0.2", "least < levels.most"),
        (LEVELS.format("bayesian") + "least = 0.1\nmost = 3.5", "between -4 and 4"),
        (LEVELS.format("identification"), "[levels] needs"),
        ("name = ", "not TOML"),
    ],
)
def test_a_wrong_file_is_refused_with_the_reason(text: str, says: str) -> None:
    with pytest.raises(InputError, match="study file") as told:
        study_of(text)
    assert says in str(told.value)


def test_a_file_that_is_not_there_is_told(tmp_path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_study(tmp_path / "none.toml")


def test_every_set_point_is_prompted_exactly_as_often_as_asked(identify: Study) -> None:
    prompts = procedure_of(identify, plan(identify, 3)).parts[0].prompts
    assert [p.phase for p in prompts].count("practice") == 1
    main = [p.set_point for p in prompts if p.phase == "main"]
    assert sorted(main) == [1, 1, 2, 2, 3, 3]


def test_the_order_is_the_seeds_and_every_persons_own() -> None:
    study = study_of('name = "x"\n[trials]\nseed = 1')
    assert plan(study, 0) == plan(study, 0)
    assert plan(study, 0) != plan(study, 1)


@pytest.mark.parametrize("n", [2, 3, 4, 5, 6])
def test_counter_balancing_puts_every_condition_after_every_other_equally_often(n: int) -> None:
    rows = [balance_conditions(n, k) for k in range(2 * n)]
    assert all(sorted(row) == list(range(n)) for row in rows)
    follows = [(a, b) for row in rows for a, b in pairwise(row)]
    counts = {follows.count((a, b)) for a in range(n) for b in range(n) if a != b}
    assert counts == {2}


def test_breaks_come_where_the_file_says() -> None:
    study = study_of('name = "x"\n[trials]\nbreak_every = 20\nbreak_seconds = 30')
    pauses = [n for n, p in enumerate(plan(study, 0)["parts"][0]["prompts"]) if p["pause"]]
    assert pauses == [20, 40]


def test_maps_that_reach_into_each_other_are_told_by_how_much() -> None:
    told = overlap(study_of('name = "x"'))
    assert told is not None
    # The nearest neighbours are 18° apart; two cut-offs of 54° want 108°.
    assert told.worst == pytest.approx(108 - 18.0, abs=0.01)
    equal = overlap(study_of('name = "x"\n[set_points]\nlayout = "1-8-8-8"'))
    assert equal is not None
    assert equal.worst == pytest.approx(108 - 13.58, abs=0.01)  # on its ring at 18°
    narrow = 'name = "x"\n[parameters]\nhalf_width_deg = 6\ncut_off_deg = 6'
    points = "[set_points]\npoints = [{number = 1, theta_deg = 0}, {number = 2, theta_deg = 18}]"
    assert overlap(study_of(f"{narrow}\n{points}")) is None


def test_a_hot_study_is_foretold_and_more_pause_holds_it() -> None:
    calm = forecast(study_of('name = "x"\n[trials]\nexpected_seconds = 5\npause_seconds = 5'))
    assert calm.holds
    top = "[set_points]\npoints = [{number = 1, theta_deg = 0}]"
    hot = forecast(study_of(f'name = "x"\n[parameters]\nmoment = 3.0\n{top}\n[trials]\nrepetitions = 40'))
    assert not hot.holds
    assert hot.pause is not None
    assert "will be reduced" in hot.sentence


def test_the_rendered_part_is_chosen_in_the_file_and_counts_for_the_heat(tmp_path) -> None:
    """A study without the key keeps its digest; torque alone takes no current for a dome, which asks none."""
    text = 'name = "x"\nworld = "compass_dome"\n'
    plain, force = (study_of(text + more, "x.toml") for more in ("", 'render = "force"\n'))
    assert plain.render == ""
    assert force.digest != plain.digest
    dome = study_of('name = "x"\nrender = "torque"\n', "x.toml")
    prompt = procedure_of(dome, plan(dome, 0)).parts[0].prompts[0]
    assert load_squared(load("omni"), dome, prompt).max() < 1e-6
    assert load_squared(load("omni"), plain, prompt).max() > 1.0


def test_the_built_in_set_points_are_distinct_and_counted() -> None:
    for points in (list_published(), list_equal_rings()):
        assert [p.number for p in points] == list(range(1, 26))
        assert len({p.direction for p in points}) == 25


def test_published_means_1_4_8_12_and_the_file_that_is_kept_says_so() -> None:
    study = study_of('name = "p"')
    assert study.points == list_published()
    assert study.text.startswith('published_layout = "1-4-8-12"\n')
    assert study_of(study.text, stored=True).digest == study.digest
    equal = study_of('name = "p"\n[set_points]\nlayout = "1-8-8-8"')
    assert equal.points == list_equal_rings()
    assert equal.text == 'model_version = "2"\norder_version = "2"\nname = "p"\n[set_points]\nlayout = "1-8-8-8"'


def test_a_stored_study_keeps_the_set_points_that_it_ran_with(tmp_path: Path) -> None:
    text = 'name = "p"'
    older = study_of(text, stored=True)  # as a database of an older haptorb has it
    assert older.points == list_equal_rings()
    engine = database(tmp_path / "s.db")
    assert find_begun_version(engine, study_of(text)).points == list_published()
    with StoredSession(engine, older, "P01") as session:
        prompt = session.prompt
        session.answer(Answer(prompt.set_point if prompt else 0, (0.0, 0.0, 0.05)))
    kept = find_begun_version(engine, study_of(text))
    assert (kept.digest, kept.text, kept.points) == (older.digest, text, list_equal_rings())
    with StoredSession(engine, kept, "P01") as session:
        assert session.number == 1
    assert read_stored(engine).points == list_equal_rings()


HILL = """
from dataclasses import dataclass
import numpy as np
from haptorb.worlds import World
from haptorb.worlds.base import parameter
with open("ran", "a") as file:
    file.write("x")

@dataclass(frozen=True)
class Hill(World):
    summit: tuple = parameter((0.0, 0.0, 1.0), "1", -1, 1, "direction of the summit")
    force: float = parameter(0.2, "N", 0, 1, "everywhere, outward")

    def wrench(self, state):
        return np.append(self.force * state.p / np.linalg.norm(state.p), np.zeros(3))
"""


def test_a_world_beside_the_study_file_is_used_and_never_loaded_out_of_a_database(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "hill.py").write_text(HILL)
    file = folder / "hill.toml"
    levels = LEVELS.format("constant").replace("1.0", "0.2") + 'parameter = "force"\nvalues = [0.1, 0.3]\n'
    file.write_text('world = "hill.py:Hill"\n' + levels)
    study = read_study(file)
    assert study.world_name == "hill"
    assert study.level_unit == "N"
    assert study.make_world("base", 1, 0.3).force == 0.3
    ran = len((tmp_path / "ran").read_text())
    stored = study_of(study.text)
    assert stored.digest == study.digest
    assert stored.level_unit == ""
    with pytest.raises(InputError, match="not from a database"):
        stored.make_world("base", 1)
    assert len((tmp_path / "ran").read_text()) == ran
    (folder / "hill.py").write_text(HILL + "\n# other code\n")
    assert read_study(file).digest != study.digest, "sessions with other code are another study's"
    file.write_text('world = "hill.py:Hill"\n' + levels.replace('"force"', '"forse"'))
    with pytest.raises(InputError, match="did you mean 'force'"):
        read_study(file)
