"""Untrusted text in files: escaped by every command that prints or writes it, for every kind of file.

COMMANDS is the list of these places: whoever adds a command that reads a file adds it here.
"""

from __future__ import annotations

import csv
import json
import re
import shutil
import sqlite3
import unicodedata
import zipfile
from contextlib import closing
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import haptorb
from haptorb.cli import main
from haptorb.devices.loader import load
from haptorb.figure_file import show_text_as_is
from haptorb.files import visible
from haptorb.recording.export import Export
from haptorb.recording.mcap import Recorder
from haptorb.recording.recording import Recording
from haptorb.recording.row import RowLayout
from haptorb.terminal import print_json
from haptorb_design.problem import Evaluation
from haptorb_design.store import open_results
from haptorb_study.database import database
from haptorb_study.simulated.rehearsal import rehearse
from haptorb_study.study_file import study_of
from oracles.designs.small_design import make_design

#: clear the screen, set the clipboard, set the title, 8-bit CSI, right-to-left override, a hidden tag, an own line, a
#: spreadsheet's formula, a page's tag, a wrong formula of a figure
POISON = (
    "\x1b[2J\x1b]52;c;cm0gLXJm\x07\x1b]0;x\x07\x9b31m\u202e\u2028\U000e0041\nhaptorb: all is well\n=cmd|' /C calc'!A0"
    r"<script>x()</script>$\frac$"
)
FORMULA = "=cmd|' /C calc'!A0"
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029]")
BAD = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u200b\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\U000e0000-\U000e01ef]"
)

#: command, with the file; what is poisoned in it is below
COMMANDS = (
    "info run.mcap", "info run.mcap --json", "info run.mcap --fields", "info run.mcap --all",
    "export run.mcap -o run.csv", "export run.mcap --to npz -o run.npz", "export run.mcap --to parquet -o run.parquet",
    "export run.mcap --fields nothing", "replay run.mcap", "view run.mcap --duration 0.01",
    "run omni --headless --duration 0.1 --tracker replay:run.mcap", "calibrate omni --out n.json --thermal run.mcap",
    "inspect poison.toml", "inspect poison.toml --json", "show poison.toml",
    "inspect formula.toml --plot card.png", "show formula.toml --view section -o drawing.svg",
    "run poison.toml --headless --duration 0.1",
    "run omni --headless --duration 0.1 --calibration poison.json",
    "run omni --headless --duration 0.1 --tracker osc:9000 --frame poison.json",
    "run omni --headless --duration 0.1 --scene poison.xml", "run omni --headless --duration 0.1 --scene body.xml",
    "calibrate omni --out n.json --thermal poison.csv", "feel poison.toml --headless",
    "feel felt.toml --headless --only x",
    "study check poison.toml", "study power poison.toml", "study check study.toml",
    "study participants study.db", "study participants study.db --json", "study analyse study.db --out report",
    "study analyse study.db --json", "study export study.db trials.csv", "study export study.db bids",
    "study export study.db trials.parquet", "study analyse study.db --registration poison.toml",
    "design sweep poison.toml", "design report results.sqlite -o results.html",
    "design report results.sqlite --json -o r.html",
)  # fmt: skip


def poison_recording(path: Path) -> None:
    layout = RowLayout(3, 2, memory=4)
    with path.open("wb") as file:
        recorder = Recorder(file, layout, 1000.0, 10**18)
        recorder.add_metadata("device", {"name": POISON, "title": POISON, "digest": POISON})
        recorder.add_metadata("run", {"driver": POISON, "model": POISON, "rate_hz": POISON})
        recorder.add_metadata("versions", {POISON: POISON})
        memory = [{"name": f"../../{FORMULA}{POISON}", "unit": FORMULA + POISON, "shape": [3]},
                  {"name": FORMULA, "unit": "m", "shape": []}]  # fmt: skip
        recorder.add_metadata(
            "world", {"tick": "0", "change": "1", "world": json.dumps({"name": FORMULA + POISON, "memory": memory})}
        )
        recorder.add_metadata("error", {"tick": POISON, "text": POISON})
        rows = np.zeros((60, layout.width))
        rows[:, layout["t"]] = rows[:, layout["wall"]] = np.arange(60)[:, None] / 1000.0
        rows[:, layout["world"]] = 1.0
        recorder.append(rows)
        recorder.finish()


def poison_database(path: Path) -> None:
    """Whatever a simulated study has as text is poisoned where the schema lets it be."""
    text = "name = 'one'\n[set_points]\npoints = [{ number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36 }]\n"
    text += f"[trials]\nrepetitions = 1\n[[questions]]\nname = 'n'\ntext = {json.dumps(FORMULA)}\n"
    engine = database(path)
    rehearse(engine, study_of(text), 2, seed=1)
    engine.dispose()
    with closing(sqlite3.connect(path)) as found, found:
        found.execute("UPDATE participants SET code = ? WHERE ordinal = 0", (FORMULA,))
        found.execute("UPDATE participants SET code = ? WHERE ordinal = 1", ("../../x",))
        found.execute("UPDATE trials SET driver = ?, recording = ?, answered = ?", (FORMULA, "/etc/passwd", FORMULA))
        found.execute("UPDATE trials SET safety = ?", (json.dumps([{"code": POISON}]),))
        found.execute("UPDATE sessions SET started = ?", (FORMULA,))
        session = found.execute("SELECT min(id) FROM sessions").fetchone()[0]
        found.execute("INSERT INTO replies (session, question, reply, at) VALUES (?, 'n', ?, 't')", (session, POISON))
        found.execute(
            "INSERT INTO events (session, kind, trial, at, text) VALUES (?, 'pause', 0, 't', ?)", (session, POISON)
        )


@pytest.fixture(scope="module")
def poisoned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("poisoned")
    poison_recording(folder / "run.mcap")
    quoted = json.dumps(POISON).replace("\u2028", "\\u2028").replace("\x9b", "\\u009b")
    (folder / "poison.toml").write_text(f"name = {quoted}\ntitle = {quoted}\n{quoted} = {quoted}\n", encoding="utf-8")
    arm = (files("haptorb.devices") / "catalogue" / "arm.toml").read_text(encoding="utf-8")
    formula = re.sub("(?m)^title = .*", r"title = 'one $\\frac$ of two'", arm)
    assert formula != arm
    (folder / "formula.toml").write_text(formula, encoding="utf-8")
    (folder / "poison.json").write_text(json.dumps({"format": POISON, POISON: POISON, "device": POISON}))
    (folder / "poison.csv").write_text(f'"{POISON}",t_s\n{POISON}\n', encoding="utf-8")
    (folder / "poison.xml").write_text(
        f"<mujoco><{'x' * 10} a='{POISON}'/></mujoco>".replace("\x1b", ""), encoding="utf-8"
    )
    (folder / "body.xml").write_text(
        "<mujoco model='=cmd'><worldbody><body name='a&#x202e;&#x9b;3'><freejoint/><geom size='1'/></body></worldbody>"
        "</mujoco>", encoding="utf-8",
    )  # fmt: skip
    (folder / "felt.toml").write_text(
        f"title = {quoted}\nworld = 'snap_fit'\n[design.a]\nmaterial = {quoted}\n", encoding="utf-8"
    )
    (folder / "study.toml").write_text(f"name = 'one'\ninstructions = {quoted}\nconsent = {quoted}\n", encoding="utf-8")
    poison_database(folder / "study.db")
    design = make_design(folder)
    with open_results(folder / "results.sqlite", design, "sobol", 1) as writer:
        values = {"radius": 30.0, "angle": 55.0, "shell": "thin"}
        writer.add([Evaluation(0, values, {"cost": 1.0, "reach": 2.0}, {"room": 0.02}, "", "", 0.1),
                    Evaluation(1, values, {}, {}, "room<script>x()</script>", FORMULA + POISON, 0.1)])  # fmt: skip
    (folder / "own.py").unlink()
    with closing(sqlite3.connect(folder / "results.sqlite")) as found, found:
        found.execute("UPDATE designs SET text = text || ?", (POISON,))
    assert load("omni")
    return folder


class Scripts(HTMLParser):
    """What a page would run that is not haptorb's own."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_data(self, data: str) -> None:
        if self.cdata_elem == "script" and data.strip() == "x()":
            self.found.append(data)


def look_at(path: Path) -> list[str]:
    """What is wrong with a file that a command wrote."""
    wrong = []
    if path.suffix == ".npz":
        with zipfile.ZipFile(path) as archive:
            wrong += [
                f"member {name!r}"
                for name in archive.namelist()
                if not re.fullmatch(r"[\w.-]+\.npy", name) or ".." in name
            ]
        np.load(path)
    elif path.suffix in (".csv", ".tsv"):
        with path.open(newline="", encoding="utf-8") as file:
            for row in csv.reader(file, delimiter="\t" if path.suffix == ".tsv" else ","):
                wrong += [f"cell {cell!r}" for cell in row if cell.startswith(("=", "@", "\t")) or CONTROL.search(cell)]
    elif path.suffix == ".html":
        page = Scripts()
        page.feed(path.read_text(encoding="utf-8"))
        wrong += page.found
    elif path.suffix in (".py", ".R"):
        text = path.read_text(encoding="utf-8")
        wrong += ["control characters"] if BAD.search(text) else []
    return wrong


@pytest.mark.parametrize("command", COMMANDS)
def test_text_of_a_strangers_file_is_shown_and_does_nothing(
    poisoned: Path, tmp_path: Path, command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / "a" / "b" / "c"
    shutil.copytree(poisoned, place)
    monkeypatch.chdir(place)
    before = set(tmp_path.rglob("*"))
    try:
        code = main(command.split())
    except SystemExit as end:
        code = int(end.code or 0)
    said = capsys.readouterr()
    assert code in (0, 1, 2)
    for text in (said.out, said.err):
        assert not BAD.search(text), ascii(BAD.search(text)[0])  # type: ignore[index]
        assert "Traceback" not in text
        assert not re.search("^haptorb: all is well", text, re.MULTILINE) or "error at tick" in text
    new = set(tmp_path.rglob("*")) - before
    assert all(path.is_relative_to(place) for path in new)
    wrong = {str(path): found for path in new if path.is_file() and (found := look_at(path))}
    assert wrong == {}


@pytest.mark.filterwarnings("ignore:Attempting to set identical")  # all values of the recording are 0
def test_a_formula_in_a_name_is_shown_as_it_is_in_every_figure(poisoned: Path, tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure()
    axes = figure.subplots()
    axes.plot([1, 10], [1, 100], label=r"$\frac$")
    axes.plot([1, 10], [2, 20], label="$F_x$")
    axes.set(xscale="log", title=POISON.replace("\x1b", ""), ylabel="costs $5 or $6")
    axes.legend()
    show_text_as_is(figure).savefig(tmp_path / "a.svg")
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_parse_math() for text in legend.get_texts()] == [False, True]
    ticks = [text for text in axes.get_xticklabels() if text.get_text()]
    assert all(text.get_parse_math() for text in ticks)
    assert Recording(poisoned / "run.mcap").plot(tmp_path / "b.png")
    sources = [
        path for path in Path(haptorb.__file__).parents[1].glob("haptorb*/**/*.py") if "papers" not in path.parts
    ]
    calls = [line for path in sources for line in path.read_text(encoding="utf-8").splitlines() if ".savefig(" in line]
    assert [line for line in calls if "show_text_as_is(figure).savefig(" not in line and "`" not in line] == []


def test_json_and_lines_hide_the_same_characters(capsys: pytest.CaptureFixture[str]) -> None:
    """All that Unicode calls control or format, but what writing needs: the joiners, and signs of some scripts."""
    kept = {"\n", "\t", "\u200c", "\u200d"}
    letters = [
        chr(number) for number in range(0x110000) if unicodedata.category(chr(number)) in ("Cc", "Cf", "Zl", "Zp")
    ]
    shown = [letter for letter in letters if letter not in kept]
    print_json({"text": "".join(letters)})
    printed = capsys.readouterr().out.replace("\n", "")
    lines = visible("".join(letters))
    assert {letter for letter in shown if letter in printed} == {letter for letter in shown if letter in lines}
    left = {unicodedata.name(letter, "") for letter in shown if letter in lines}
    assert all(name.startswith(("ARABIC", "SYRIAC", "KAITHI", "EGYPTIAN")) for name in left), left


def test_heads_of_a_table_and_members_of_an_archive_are_plain(poisoned: Path, tmp_path: Path) -> None:
    """Memory of a world is named by the recording: `../../=cmd…` must be neither a member nor a formula."""
    for form in ("csv", "npz"):
        Export.of(Recording(poisoned / "run.mcap"), form).write(tmp_path / f"x.{form}")
        assert look_at(tmp_path / f"x.{form}") == []
    heads = (tmp_path / "x.csv").read_text(encoding="utf-8").splitlines()[0]
    assert "cmd_C_calc_A0" in heads
    with zipfile.ZipFile(tmp_path / "x.npz") as archive:
        assert any("cmd_C_calc_A0" in name for name in archive.namelist())
