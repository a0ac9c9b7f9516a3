"""Ratings, traces and choice: durable, and compared."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from haptorb.devices.base import State
from haptorb.errors import InputError, RecordingError
from haptorb_study.feel import FeelSession, Trace, designs, load_designs
from haptorb_study.feel.comparison import comparison, plot_comparison
from haptorb_study.feel.trace import COLUMNS

EXAMPLE = Path(designs.__file__).with_name("example.toml")


def feel(session: FeelSession, name: str) -> Trace:
    trace = Trace(session.candidates[name])
    for k in range(50):
        target = State(k * 1e-3, np.eye(3), np.array([k * 1e-4, 0, 0]), np.zeros(3), np.array([0.1, 0, 0]))
        trace.append(target, session.candidates[name].world.wrench(target))
    return trace


def test_feel_rate_choose_and_come_back(tmp_path: Path) -> None:
    session = FeelSession(tmp_path / "s", load_designs(EXAMPLE))
    kept = session.store_trace(feel(session, "firm"))
    assert kept == "traces/firm-0001.csv"
    session.rate("firm", 6, person="anna", comment="holds well, größer", trace=kept)
    session.rate("firm", 5)
    session.rate("plain", 3)
    session.choose("plain")
    session.choose("firm", comment="best")
    again = FeelSession(tmp_path / "s", load_designs(EXAMPLE))
    assert [rating.score for rating in again.ratings()] == [6, 5, 3]
    assert again.ratings()[0].comment == "holds well, größer"
    assert again.scores()["firm"] == (2, 5.5)
    assert again.scores()["gentle"][0] == 0
    assert math.isnan(again.scores()["gentle"][1])
    choice = again.choice()
    assert choice is not None
    assert choice.design == "firm"
    assert again.store_trace(feel(again, "firm")) == "traces/firm-0002.csv"
    rows = again.trace(kept)
    assert rows.shape == (50, len(COLUMNS))
    assert rows == pytest.approx(feel(again, "firm").rows, rel=1e-8, abs=1e-12)


@pytest.mark.parametrize("name", ["", "ratings.jsonl", "traces"])
@pytest.mark.parametrize("when", ["before", "meanwhile"])
def test_a_link_in_the_folder_of_ratings_is_not_followed(tmp_path: Path, name: str, when: str) -> None:
    """The folder lies beside the file of designs, and may have come with it: a rating must not go into another file."""
    outside, folder = tmp_path / "outside", tmp_path / "s"
    outside.mkdir()
    (outside / "notes").write_text("my own\n")
    session = None
    if when == "meanwhile":
        session = FeelSession(folder, load_designs(EXAMPLE))
        folder.rename(tmp_path / "old")
    if name:
        folder.mkdir()
    (folder / name).symlink_to(outside / "notes" if name == "ratings.jsonl" else outside)
    with pytest.raises(RecordingError, match="is a link"):
        (session or FeelSession(folder, load_designs(EXAMPLE))).rate("firm", 7)
    assert [path.name for path in outside.iterdir()] == ["notes"]
    assert (outside / "notes").read_text() == "my own\n"


def test_ratings_go_into_no_pipe(tmp_path: Path) -> None:
    session = FeelSession(tmp_path, load_designs(EXAMPLE))
    os.mkfifo(tmp_path / "ratings.jsonl")
    with pytest.raises(RecordingError, match="not a regular file"):
        session.rate("firm", 7)


@pytest.mark.parametrize("way", ["absolute", "above", "linked"])
def test_a_trace_lies_in_the_folder_of_ratings(tmp_path: Path, way: str) -> None:
    """The records name it, and a stranger may have written them."""
    session = FeelSession(tmp_path / "s", load_designs(EXAMPLE))
    kept = tmp_path / "s" / session.store_trace(feel(session, "firm"))
    outside = kept.rename(tmp_path / "outside.csv")
    name = {"absolute": str(outside), "above": "../outside.csv", "linked": "traces/firm-0001.csv"}[way]
    if way == "linked":
        kept.symlink_to(outside)
    lines = (tmp_path / "s" / "ratings.jsonl").read_text().replace("traces/firm-0001.csv", name)
    (tmp_path / "s" / "ratings.jsonl").write_text(lines)
    assert session.feelings()[0].trace == name
    assert not session.was_felt("firm")
    with pytest.raises(RecordingError, match="lies outside"):
        session.trace(name)


def test_a_rating_belongs_to_the_design_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "designs.toml"
    path.write_text(EXAMPLE.read_text())
    FeelSession(tmp_path, load_designs(path)).rate("firm", 7)
    path.write_text(EXAMPLE.read_text().replace("60 deg", "50 deg"))
    session = FeelSession(tmp_path, load_designs(path))
    assert session.scores()["firm"][0] == 0
    assert [rating.design for rating in session.find_outdated()] == ["firm"]


def test_a_line_cut_short_costs_only_itself(tmp_path: Path) -> None:
    session = FeelSession(tmp_path, load_designs(EXAMPLE))
    session.rate("plain", 2)
    with (tmp_path / "ratings.jsonl").open("a") as file:
        file.write('{"kind": "rating", "design": "pla')
    session.rate("plain", 4)
    assert [rating.score for rating in session.ratings()] == [2, 4]
    assert session.skipped == 1


def test_what_was_rated_survives_a_killed_process(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom haptorb_study.feel import FeelSession, load_designs\n"
        "session = FeelSession(sys.argv[2], load_designs(sys.argv[1]))\n"
        "for score in range(1, 8):\n    session.rate('plain', score)\n    print(score, flush=True)\nsys.stdin.read()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(EXAMPLE), str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert process.stdout is not None
    told = [process.stdout.readline() for _ in range(7)]
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    assert len(told) == 7
    assert [rating.score for rating in FeelSession(tmp_path, load_designs(EXAMPLE)).ratings()] == list(range(1, 8))


def test_the_comparison_is_a_table_and_a_picture(tmp_path: Path) -> None:
    session = FeelSession(tmp_path, load_designs(EXAMPLE))
    session.rate("firm", 6, trace=session.store_trace(feel(session, "firm")))
    session.choose("firm")
    table = comparison(session.candidates, session)
    assert table["firm"]["chosen"]
    assert not table["plain"]["chosen"]
    assert table["firm"]["score"] == 6.0
    json.dumps(table)
    for name in ("out.png", "out.svg"):
        path = plot_comparison(session.candidates, tmp_path / name, session)
        assert path.stat().st_size > 10_000
    assert plot_comparison(session.candidates, tmp_path / "alone.png").is_file()
    with pytest.raises(RecordingError, match="cannot be drawn"):
        plot_comparison(session.candidates, tmp_path / "none" / "out.png")
    with pytest.raises(RecordingError, match="cannot be drawn"):
        plot_comparison(session.candidates, tmp_path / "out.xyz")


def test_bad_input(tmp_path: Path) -> None:
    session = FeelSession(tmp_path, load_designs(EXAMPLE))
    for score in (0, 8, 3.5, True):
        with pytest.raises(InputError, match="a whole number from 1 to 7"):
            session.rate("plain", score)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="unknown design 'plane'"):
        session.rate("plane", 3)
    with pytest.raises(InputError, match="there is no trace"):
        session.rate("plain", 3, trace="traces/plain-0009.csv")
    with pytest.raises(InputError, match="is empty"):
        session.store_trace(Trace(session.candidates["plain"]))
    (tmp_path / "traces" / "odd.csv").write_text("a,b\n1,2\n")
    with pytest.raises(RecordingError, match="is not a trace"):
        session.trace("traces/odd.csv")
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be created"):
        FeelSession(tmp_path / "file", session.candidates)
    assert session.ratings() == ()
    assert session.choice() is None
