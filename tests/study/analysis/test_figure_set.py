"""Figures for a paper: size, embedded fonts, colours for any colour vision, SIMULATED where it applies."""

from __future__ import annotations

import re
import struct
import zlib
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.text import Text

from haptorb.cli import main
from haptorb.errors import InputError, RecordingError
from haptorb_study.analysis.analysis import Analysis, analysis_of
from haptorb_study.analysis.paper_figures import draw_figures, write_figures
from haptorb_study.analysis.paper_style import COLOURS, DASHES, MARKERS, PaperSize
from haptorb_study.database import database
from haptorb_study.set_points import PUBLISHED_ERRORS
from haptorb_study.simulated.rehearsal import rehearse
from haptorb_study.study_file import study_of

POINTS = "[set_points]\npoints = [{ number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36 }]\n"
TWO = '[[conditions]]\nname = "a"\n[[conditions]]\nname = "b"\nparameters = { moment = 0.5 }\n'
LEVELS = "[levels]\nreference = 1.0\nvalues = [0.5, 1.0, 1.5]\nleast = 0.05\nmost = 1.0\nstart = 0.5\ntrials = 12\n"
STUDIES = {
    "identification": ('[set_points]\nlayout = "published"\n', {"identification", "error-over-theta"}),
    "localisation": (POINTS, {"error-over-theta"}),
    "constant": (LEVELS + TWO, {"psychometric-curves"}),
    "staircase": (f"{LEVELS}reversals = 4\n{TWO}", {"thresholds"}),
    "rating": (TWO, {"ratings"}),
    "forced-choice": (TWO, {"choices"}),
    "magnitude": (LEVELS + TWO, {"magnitudes"}),
}


@pytest.fixture(scope="module")
def analyses(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Analysis]:
    found = {}
    for procedure, (text, _) in STUDIES.items():
        place = tmp_path_factory.mktemp(procedure) / "s.db"
        more = "[trials]\nrepetitions = 1\n"
        rehearse(database(place), study_of(f'name = "x"\nprocedure = "{procedure}"\n{text}{more}'), 2)
        found[procedure] = analysis_of(place)
    return found


def spell_out(analysis: Analysis) -> dict[str, list[str]]:
    """Every text of every figure."""
    return {
        name: [text.get_text() for text in figure.findobj(Text)] for name, (figure, _) in draw_figures(analysis).items()
    }


@pytest.mark.parametrize("procedure", STUDIES)
def test_every_procedure_has_its_figures_and_every_figure_is_called_simulated(
    procedure: str, analyses: dict[str, Analysis]
) -> None:
    texts = spell_out(analyses[procedure])
    assert set(texts) == STUDIES[procedure][1] | {"response-times"}
    for words in texts.values():
        assert "SIMULATED" in words
        assert any("no person took part" in " ".join(word.split()) for word in words)
        assert not any("nan" in word for word in words)


def test_the_printed_errors_stand_beside_the_published_set_points(analyses: dict[str, Analysis]) -> None:
    figure, caption = draw_figures(analyses["identification"])["error-over-theta"]
    left, right = figure.axes
    printed = left.containers[0].lines[0].get_xydata()
    assert printed.tolist() == [[theta, mean] for theta, (mean, _) in PUBLISHED_ERRORS.items()]
    assert left.get_ylim() == right.get_ylim()
    assert "Zárate" in caption
    other, caption = draw_figures(analyses["localisation"])["error-over-theta"]
    assert len(other.axes) == 1
    assert "Zárate" not in caption


def test_figures_have_the_widths_of_columns(analyses: dict[str, Analysis]) -> None:
    for size in (PaperSize(), PaperSize(80.0, 160.0)):
        found = draw_figures(analyses["identification"], size)
        for name, width in (("identification", size.double), ("response-times", size.single)):
            assert found[name][0].get_figwidth() * 25.4 == pytest.approx(width)
    with pytest.raises(InputError, match="50 to 400 mm"):
        PaperSize(20.0, 100.0)


def test_a_pdf_has_its_fonts_inside_as_truetype(analyses: dict[str, Analysis], tmp_path: Path) -> None:
    *files, captions = write_figures(analyses["identification"], tmp_path)
    for path in files:
        data = path.read_bytes()
        streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", data, re.DOTALL)
        assert b"/FontFile2" in data  # TrueType, embedded
        assert b"/Type3" not in data
        assert not any(b"/Subtype /Image" in part for part in data.split(b"endobj")), "vector throughout"
        assert streams
        assert b"SIMULATED" in data  # in its title
    assert "error-over-theta" in captions.read_text(encoding="utf-8")


def test_svg_and_png_need_nothing_else(analyses: dict[str, Analysis], tmp_path: Path) -> None:
    *drawn, _ = write_figures(analyses["rating"], tmp_path, "svg")
    before = [path.read_bytes() for path in drawn]
    write_figures(analyses["rating"], tmp_path, "svg", overwrite=True)
    assert [path.read_bytes() for path in drawn] == before, "the same answers give the same file"
    for path in drawn:
        text = path.read_text(encoding="utf-8")
        assert "<text" not in text, "letters are outlines"
        assert "<image" not in text
        assert float(re.search(r'width="([0-9.]+)pt"', text)[1]) / 72 * 25.4 == pytest.approx(85.0, abs=0.1)
    *drawn, _ = write_figures(analyses["rating"], tmp_path, "png")
    for path in drawn:
        data = path.read_bytes()
        width, _ = struct.unpack(">II", data[16:24])
        assert width / 600 * 25.4 == pytest.approx(85.0, abs=0.1)
        assert zlib.crc32(data[12:29]) == struct.unpack(">I", data[29:33])[0]


#: Viénot, Brettel and Mollon 1999: linear RGB as people without long-wave, or medium-wave, cones see it
BLIND = {
    "protanopia": ((0.11238, 0.88762, 0.0), (0.11238, 0.88762, 0.0), (0.00401, -0.00401, 1.0)),
    "deuteranopia": ((0.29275, 0.70725, 0.0), (0.29275, 0.70725, 0.0), (-0.02234, 0.02234, 1.0)),
}


@pytest.mark.parametrize("eye", BLIND)
def test_colours_differ_for_colour_blind_people_and_are_never_alone(eye: str) -> None:
    linear = np.array([to_rgb(colour) for colour in COLOURS]) ** 2.2
    seen = np.clip(linear @ np.array(BLIND[eye]).T, 0, 1) ** (1 / 2.2)
    distances = [float(np.linalg.norm(a - b)) for a, b in combinations(seen, 2)]
    assert min(distances) > 0.08
    assert len(set(MARKERS)) == len(set(map(str, DASHES))) == len(COLOURS)


def test_the_command_overwrites_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rehearse(database("s.db"), study_of(f'name = "x"\nprocedure = "rating"\n{TWO}'), 2)

    def run(*words: str) -> int:
        try:
            return main(["study", "figures", "s.db", *words])
        except SystemExit as end:
            return int(end.code or 0)

    assert run("--format", "gif") == 2
    assert run("--single", "300") == 2
    assert not Path("x-figures").exists()
    assert run("--format", "svg") == 0
    assert "x-figures/ratings.svg" in capsys.readouterr().out
    before = {path.name: path.read_bytes() for path in Path("x-figures").iterdir()}
    assert run("--format", "svg") == 2
    assert "--force" in capsys.readouterr().err
    Path("x-figures/captions.md").write_text("mine")
    assert run("--format", "png") == 2
    Path("x-figures/captions.md").write_bytes(before["captions.md"])
    assert {path.name: path.read_bytes() for path in Path("x-figures").iterdir()} == before
    assert run("--format", "png") == 0, "the same captions belong to both"
    assert run("--format", "svg", "--force") == 0
    Path("file").write_text("mine")
    assert run("--out", "file") == 2
    with pytest.raises(RecordingError, match="cannot be written"):
        write_figures(analysis_of("s.db"), Path("file"), "svg")
