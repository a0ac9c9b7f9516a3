"""Measured and computed peak: they agree, or all contributions to the difference are listed in the report."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import haptorb_study.feel
from haptorb.devices.base import State
from haptorb.errors import RecordingError
from haptorb.worlds import SnapFit
from haptorb_study.feel import Candidate, FeelSession, Trace, course, load_designs
from haptorb_study.feel.comparison import comparison
from haptorb_study.feel.insertion_forces import explain_peaks
from haptorb_study.feel.peak_comparison import PeakComparison, compare_peaks
from haptorb_study.feel.report import make_report, write_report

EXAMPLE = Path(haptorb_study.feel.__file__).with_name("example.toml")
FIRM = load_designs(EXAMPLE)["firm"]


def move(design: Candidate, reach: float, speed: float, aside: float = 0.0, *, asked: float = 1.0) -> Trace:
    """Pulled out along X' as far as `reach`, then put back, with what the world gave there."""
    trace, x, t = Trace(design), 0.0, 0.0
    for way in (speed, -speed):
        while (way > 0 and x < reach) or (way < 0 and x > 0):
            state = State(t, np.eye(3), np.array([x, aside, 0.0]), np.zeros(3), np.array([way, 0.0, 0.0]))
            wrench = design.world.wrench(state)
            row = [t, *state.p, 0, 0, 0, 1, *wrench, asked * abs(wrench[0]), abs(wrench[0]), 1.0, float(asked > 1)]
            trace.extend(np.array([row]))
            x, t = x + way * 1e-3, t + 1e-3
    return trace


def peaks(trace: Trace) -> tuple[PeakComparison, PeakComparison]:
    insertion, pull_out = compare_peaks(trace.design, course(trace.design), [trace.all_rows])
    return insertion, pull_out


def test_a_part_that_is_pulled_out_and_put_back_quickly_agrees() -> None:
    for one in peaks(move(FIRM, 0.009, 0.05)):
        assert one.agrees
        assert not one.hand
        assert one.sentences[0].endswith("they agree")


@pytest.mark.parametrize(
    ("reach", "speed", "aside", "cause"),
    [
        (0.0005, 0.05, 0.0, "the part reached X' = 0.5 mm"),
        (0.006, 0.001, 0.0, "slow motion (1.0 mm/s)"),
        (0.006, 0.05, 0.8e-3, "off centre (0.8 mm sideways"),
    ],
    ids=["not far enough", "too slow", "aside"],
)
def test_a_difference_has_its_cause_and_the_causes_add_up(reach: float, speed: float, aside: float, cause: str) -> None:
    _, pull_out = peaks(move(FIRM, reach, speed, aside))
    assert not pull_out.agrees
    assert pull_out.felt is not None
    largest = max(pull_out.causes, key=lambda pair: abs(pair[1]))
    assert cause in largest[0]
    assert sum(amount for _, amount in pull_out.causes) == pytest.approx(
        pull_out.felt - pull_out.computed, abs=0.03 * pull_out.computed
    )


def test_the_peaks_follow_from_the_handbooks_formula_share_by_share() -> None:
    world = load_designs(EXAMPLE)["plain"].world
    numbers = course(load_designs(EXAMPLE)["plain"]).numbers
    assert isinstance(world, SnapFit)
    for one, angle, place, sharp, felt in zip(
        explain_peaks(world), (30.0, 45.0), (18.5, 16.5), (9.61, 8.22),
        (numbers["insertion_force_n"], numbers["pull_out_force_n"]), strict=True,
    ):  # fmt: skip
        # P of a stepped cantilever by sums: bending and shear up to the contact, 1.5 mm of deflection, two hooks
        s = (np.arange(20000) + 0.5) * place / 20000  # mm
        h = 1.5 + np.clip(s - 15.0, 0.0, 1.5)
        soft = (12 * (place - s) ** 2 / h**3 + 1.2 * 2.7 / h).sum() * place / 20000
        push, tan = 2 * 2300.0 * 6.0 * 1.5 / soft, np.tan(np.radians(angle))
        assert one.handbook == pytest.approx(push * (0.3 + tan) / (1 - 0.3 * tan), rel=1e-4)
        assert one.sharp == pytest.approx(sharp, abs=0.006)
        assert one.total == pytest.approx(felt, rel=0.01)  # the course is slower: almost all friction
        assert one.total == pytest.approx(one.handbook + one.pull_bends + one.face_turns + one.edges_rounded)
        assert -0.2 < one.off_middle < 0.0


def test_what_the_device_could_not_give_is_said() -> None:
    _, pull_out = peaks(move(FIRM, 0.009, 0.05, asked=2.0))
    assert "at its limit" in pull_out.sentences[1]


def test_nothing_was_felt(tmp_path: Path) -> None:
    assert compare_peaks(FIRM, course(FIRM), []) == ()
    still = Trace(FIRM)
    still.extend(move(FIRM, 0.001, 0.05).all_rows[:1])
    assert {one.felt for one in compare_peaks(FIRM, course(FIRM), [still.all_rows])} == {None}
    assert "not moved" in compare_peaks(FIRM, course(FIRM), [still.all_rows])[0].sentences[0]


class Page(HTMLParser):
    """Texts, pictures, and whatever would be loaded from elsewhere."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.pictures: list[str] = []
        self.foreign: list[str] = []
        self.text = ""
        self.tags: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        for name, value in attrs:
            if name in ("src", "href") and not (value or "").startswith("data:"):
                self.foreign.append(f"{tag} {value}")
        if tag == "img":
            self.pictures.append(dict(attrs)["alt"] or "")

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_report_has_geometry_forces_stress_and_everybodys_ratings(tmp_path: Path) -> None:
    path = tmp_path / "designs.toml"
    path.write_text(
        EXAMPLE.read_text()
        .replace('title = "plain"', 'title = "plain <b>&"\nyield_strength = "10 MPa"')
        .replace(
            'title = "longer and thinner"',
            'title = "own mix"\nmaterial = "mix"\nyoungs_modulus = "2 GPa"\npoisson_ratio = 0.3',
        )
    )
    session = FeelSession(tmp_path / "s", load_designs(path))
    felt = move(session.candidates["firm"], 0.009, 0.05)
    session.rate("firm", 6, person="anna", trace=session.store_trace(felt, person="anna"), blind=True)
    session.rate("plain", 2, person="ben")
    session.choose("firm")
    page = Page(make_report(session, ("Simulated device 'pmsm'.", "True scale.")))
    assert not page.foreign
    assert "b" not in page.tags  # a title is text
    assert len(page.pictures) == 8
    for words in ("plain <b>&", "anna", "ben", "6 (blind)", "steeper rear face (chosen)", "they agree",
                  "BEYOND YIELD", "not known (yield_strength", "Simulated device 'pmsm'.",
                  "yield strength of ABS (44 MPa)"):  # fmt: skip
        assert words in page.text
    written = write_report(session, tmp_path / "s" / "report.html")
    assert written.read_text().startswith("<!doctype html>")
    with pytest.raises(RecordingError, match="cannot be written"):
        write_report(session, tmp_path / "none" / "report.html")


def test_every_design_felt_is_in_the_comparison_rated_or_not(tmp_path: Path) -> None:
    session = FeelSession(tmp_path, load_designs(EXAMPLE))
    session.store_trace(move(session.candidates["firm"], 0.009, 0.05))
    table = comparison(session.candidates, session)
    assert table["firm"]["felt"] == 1
    assert table["firm"]["felt_pull_out_force_n"] == pytest.approx(table["firm"]["pull_out_force_n"], rel=0.05)
    assert table["plain"]["felt"] == 0
    assert table["firm"]["root_stress_pa"] == pytest.approx(2.3e9 * table["firm"]["root_strain"])
    assert table["firm"]["yield_margin"] == pytest.approx(44e6 / table["firm"]["root_stress_pa"])
