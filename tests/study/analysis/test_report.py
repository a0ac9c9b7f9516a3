"""Reports: no "nan" with one participant, and a simulated device is named on every page and figure."""

from __future__ import annotations

import json
import math
import re
from io import StringIO
from pathlib import Path

import pytest
from matplotlib.text import Text

from haptorb.terminal import make_console
from haptorb_study.analysis.analysis import Analysis, analysis_of
from haptorb_study.analysis.figures import figures
from haptorb_study.analysis.report import page
from haptorb_study.analysis.tables import print_summary
from haptorb_study.database import database
from haptorb_study.prompts import Answer
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of

PLACES = "[set_points]\npoints = [{number = 1, theta_deg = 0}, {number = 2, theta_deg = 36}]\n"
ONCE = "[trials]\nrepetitions = 1\n"
TWO = '[[conditions]]\nname = "a"\n[[conditions]]\nname = "b"\nparameters = {moment = 1.0}\n'
LEVELS = "[levels]\nreference = 1.2\nvalues = [1.0, 1.5]\n"
ADAPTIVE = "[levels]\nreference = 1.2\nleast = 0.01\nmost = 1.0\nstart = 0.8\ntrials = 4\n"
STUDIES = {
    "identification": PLACES + ONCE + TWO, "localisation": PLACES + ONCE, "constant": LEVELS + ONCE,
    "staircase": ADAPTIVE, "bayesian": ADAPTIVE, "forced-choice": ONCE + TWO, "rating": ONCE + TWO,
}  # fmt: skip


NO_IMAGES = dict.fromkeys(("confusion", "answers", "error", "curves"), b"")  #: drawing takes seconds


def sat(study: Study, place: Path, code: str, driver: str | None, most: int = 1000) -> None:
    """One participant, who answers `most` trials."""
    with StoredSession(database(place), study, code, simulated=code.startswith("SIM")) as session:
        while (prompt := session.prompt) is not None and session.number < most:
            value = prompt.numbers[0] if prompt.numbers else prompt.high or None
            session.answer(Answer(value, (0.0, 0.0, 0.05), 1.0), driver=driver)


def text_of(analysis: Analysis) -> str:
    told = StringIO()
    console = make_console()
    console.file, console.width = told, 120
    print_summary(analysis, console)
    return told.getvalue()


@pytest.mark.parametrize("procedure", STUDIES)
@pytest.mark.parametrize("most", [1, 1000])
def test_a_single_participant_gives_no_nan(procedure: str, most: int, tmp_path: Path) -> None:
    study = study_of(f'name = "x"\nprocedure = "{procedure}"\n{STUDIES[procedure]}')
    sat(study, tmp_path / "s.db", "P01", "sim", most)
    found = analysis_of(tmp_path / "s.db")
    drawn = [text.get_text() for figure in figures(found).values() for text in figure.findobj(Text)]
    for told in (page(found, NO_IMAGES), text_of(found), *drawn):
        assert not re.search(r"\b(nan|inf)\b", str(told), re.IGNORECASE)
    json.dumps(found.numbers(), allow_nan=False)


def test_a_simulated_device_is_named_on_every_page_and_figure(identify: Study, tmp_path: Path) -> None:
    sat(identify, tmp_path / "s.db", "P01", "sim")
    found = analysis_of(tmp_path / "s.db")
    assert found.origin == "SIMULATED DEVICE: nobody felt a force; 1 participant"
    text = page(found, NO_IMAGES)
    assert f"<p class='simulated'>{found.origin}</p>" in text
    assert re.search(r"@media print.*?\.simulated\{position:fixed", text)  # what is fixed is on every sheet of paper
    assert "<title>identify (simulated)</title>" in text
    drawn = figures(found)
    assert len(drawn) == 3
    assert all(figure.get_supxlabel() == found.origin for figure in drawn.values())
    assert found.origin in " ".join(text_of(found).split())


@pytest.mark.parametrize(
    ("drivers", "words"),
    [
        (("serial:/dev/ttyUSB0",), "1 participant"),
        (("serial:/dev/ttyUSB0", "sim"), "1 participant"),  # one kind of data in a number: the other is left out
        (("sim", "sim"), "SIMULATED DEVICE: nobody felt a force; 2 participants"),
        ((None,), "1 participant; whether the device was simulated is not stored for 6 trials"),
    ],
)
def test_only_a_simulated_device_is_called_so(
    identify: Study, tmp_path: Path, drivers: tuple[str | None, ...], words: str
) -> None:
    for n, driver in enumerate(drivers):
        sat(identify, tmp_path / "s.db", f"P0{n}", driver)
    found = analysis_of(tmp_path / "s.db")
    assert found.origin == words
    assert found.marked == ("SIMULATED" in words)
    assert ("class='simulated'" in page(found, NO_IMAGES)) == found.marked


def test_simulated_participants_are_called_so_and_not_the_device(identify: Study, tmp_path: Path) -> None:
    sat(identify, tmp_path / "s.db", "SIM01", "i2c:1")
    assert analysis_of(tmp_path / "s.db").origin.startswith("SIMULATED: 1 simulated participant,")


def test_a_threshold_without_reversals_is_still_bounded_by_the_answers(tmp_path: Path) -> None:
    study = study_of(f'name = "x"\nprocedure = "staircase"\n{STUDIES["staircase"]}')
    for code in ("P01", "P02"):
        sat(study, tmp_path / "s.db", code, "sim")
    found = analysis_of(tmp_path / "s.db")
    assert all(math.isnan(value) for people in found.thresholds.values() for value in people.values())
    told = found.numbers()["thresholds"]["base"]["people"]
    assert {one["threshold"] for one in told.values()} == {None}
    for one in told.values():  # wrong as often as right: the answers set a lower limit only
        assert one["fitted"] is None
        assert one["fitted_95"][0] > 0
        assert one["fitted_95"][1] is None
        assert any("only a lower limit" in note for note in one["notes"])
    assert "too few reversals" in " ".join(text_of(found).split())
