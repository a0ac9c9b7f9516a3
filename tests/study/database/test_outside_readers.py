"""Exports in other programs: the official BIDS validator, pandas, DuckDB, R and LibreOffice (nightly)."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from haptorb_study.bids import write_bids
from haptorb_study.columns import COLUMNS, Columns, read_replies, tidy
from haptorb_study.database import database
from haptorb_study.export_table import write_csv, write_parquet
from haptorb_study.prompts import Answer, Prompt
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of

POINTS = "[set_points]\npoints = [{ number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36, phi_deg = 90 }]\n"
TRIALS = "[trials]\nrepetitions = 2\npractice = 1\nseed = 7\n"
TWO = '[[conditions]]\nname = "strong"\n[[conditions]]\nname = "weak"\nparameters = { moment = 0.3 }\n'
QUESTIONS = ('[[questions]]\nname = "hand"\ntext = "Which \\"hand\\"?"\nchoices = ["left", "right"]\n'
             '[[questions]]\nname = "what_else"\ntext = "Anything else?"\n')  # fmt: skip
LEVELS = "[levels]\nreference = 1.2\nleast = 0.01\nmost = 1.0\n"
STUDIES = {
    "identification": POINTS + TRIALS + QUESTIONS,
    "constant": "[levels]\nreference = 1.2\nvalues = [0.8, 1.4]\n" + TRIALS + QUESTIONS,
    "staircase": LEVELS + "start = 0.5\ntrials = 6\nreversals = 4\n",
    "bayesian": LEVELS + "trials = 4\n",
    "magnitude": "[levels]\nreference = 1.2\nvalues = [0.6, 1.2]\n" + TRIALS,
    "forced-choice": TWO + TRIALS,
    "rating": '[rating]\nlow = 1\nhigh = 7\nquestion = "How stiff?"\n' + TWO + TRIALS,
}
CODES = ("P01", "vp-7", "Ä3", "Q-04")
#: what the validator recommends, and no program can know
UNKNOWN = {
    "TOO_FEW_AUTHORS", "Authors", "License", "SourceDatasets", "HEDVersion", "CogAtlasID", "CogPOID", "InstitutionName",
    "InstitutionAddress", "InstitutionalDepartmentName",
}  # fmt: skip
REPLIES = ("left", '=1+1, "very" good\nTwo lines\tand a tab, ünï')


def choose_answer(prompt: Prompt, draw: np.random.Generator) -> Answer:
    """One that may be given: the kinds of prompts have numbers, a range, or the position alone."""
    value: Any = None
    if prompt.numbers:
        value = int(draw.choice(prompt.numbers))
    elif prompt.decimal:
        value = prompt.high / 2 + 0.25
    elif prompt.high > prompt.low:
        value = int(draw.integers(prompt.low, prompt.high + 1))
    return Answer(value, (0.01, 0.0, 0.05), 1.25)


def take_part(study: Study, folder: Path) -> tuple[Columns, dict[str, dict[str, str]]]:
    """People and a simulated participant: real and simulated devices, trips, pauses, repeats, a session that ends
    early, recordings, answers in words."""
    engine, draw = database(folder / "s.db"), np.random.default_rng(5)
    for number, code in enumerate(CODES):
        with StoredSession(engine, study, code, simulated=False) as session:
            while session.prompt is not None:
                if session.number == 1:
                    session.record_event("pause", "a break")
                    session.record_event("repeat", "the device was off")
                session.answer(
                    choose_answer(session.prompt, draw), driver="sim" if number % 2 else "serial:/dev/ttyUSB0",
                    safety=[{"code": "OVERSPEED"}, {"code": "STOPPED"}] if session.number == 2 else [],
                    recording=f"recordings/{code}.mcap#t=1.5,3" if number else None,
                )  # fmt: skip
                if number == 2 and session.number == 3:
                    session.abort("stopped")
                    break
            if session.prompt is None:
                for question, text in zip(study.questions, REPLIES, strict=False):
                    session.reply(question, text)
    return tidy(engine, study), read_replies(engine, study)


#: those with questions and numbers, with levels, and with conditions; the files of the others have the same columns
IN_EVERY_RUN = ("identification", "staircase", "rating")


@pytest.fixture(
    scope="module",
    params=[name if name in IN_EVERY_RUN else pytest.param(name, marks=pytest.mark.slow) for name in STUDIES],
)
def data(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, ...]:
    procedure = request.param
    text = f'name = "my-{procedure}_1"\nprocedure = "{procedure}"\ninstructions = "Hold the pen."\n{STUDIES[procedure]}'
    study = study_of(text)
    return study, *take_part(study, tmp_path_factory.mktemp(procedure))


def validate(folder: Path) -> list[dict[str, str]]:
    """What the official BIDS validator finds, with its own schema."""
    program = [str(Path(sys.executable).with_name("bids-validator-deno")), str(folder), "--format", "json"]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert done.stdout.lstrip().startswith("{"), done.stderr[-2000:]
    found: list[dict[str, str]] = json.loads(done.stdout)["issues"]["issues"]
    return found


def test_the_official_validator_finds_no_error_and_warns_of_what_only_the_laboratory_knows(
    data: tuple[Any, ...], tmp_path: Path
) -> None:
    study, columns, replies = data
    found = validate(write_bids(study, columns, tmp_path / "bids", replies=replies))
    assert [
        one for one in found if one["severity"] != "warning" or one.get("subCode", one["code"]) not in UNKNOWN
    ] == []


def test_pandas_and_duckdb_read_the_same_table_from_csv_and_parquet(data: tuple[Any, ...], tmp_path: Path) -> None:
    import duckdb
    import pandas

    study, columns, replies = data
    text, typed = tmp_path / "t.csv", tmp_path / "t.parquet"
    write_csv(study, columns, text, replies=replies)
    write_parquet(study, columns, typed)
    frame, flat = pandas.read_parquet(typed), pandas.read_csv(text, keep_default_na=False, na_values=[""])
    assert list(frame.columns) == list(flat.columns) == list(COLUMNS)
    for name in COLUMNS:
        kind = duckdb.sql(f"SELECT {name} FROM '{typed}'")
        values = [row[0] for row in kind.fetchall()]
        sniffed = [row[0] for row in duckdb.sql(f"SELECT {name} FROM read_csv('{text}')").fetchall()]
        for one, two, three, four in zip(columns[name].tolist(), values, frame[name], flat[name], strict=True):
            if one is None or one == "" or one != one:
                assert two in (None, "")
                assert pandas.isna(three) or three == ""
                assert pandas.isna(four)
            elif name != "answered":  # a time: DuckDB has it as one
                assert one == two == three == four, name
        assert len(sniffed) == len(values)


def test_a_spreadsheets_rules_find_the_columns_and_no_formula(data: tuple[Any, ...], tmp_path: Path) -> None:
    """The dialect that Python's sniffer finds is the one that was written; no cell begins as a formula does."""
    study, columns, replies = data
    for path in write_csv(study, columns, tmp_path / "t.csv", replies=replies):
        if path.suffix != ".csv":
            continue
        text = path.read_text(encoding="utf-8")
        dialect = csv.Sniffer().sniff(text.partition("\n")[0])
        assert dialect.delimiter == ","
        rows = list(csv.reader(text.splitlines(keepends=True), dialect="excel", strict=True))
        assert len({len(row) for row in rows}) == 1
        cells = [cell for row in rows for cell in row]
        assert not [cell for cell in cells if cell.startswith(("=", "+", "@", "\t", "\r"))]
        assert not [cell for cell in cells if cell.startswith("-") and not cell[1:].replace(".", "").isdigit()]


def test_the_rules_of_rs_read_csv_find_the_same_numbers(data: tuple[Any, ...], tmp_path: Path) -> None:
    """Where R is not installed: its rules for fields, names and types, from the manual of read.csv."""
    import pandas

    study, columns, replies = data
    path = tmp_path / "t.csv"
    write_csv(study, columns, path, replies=replies)
    names, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines(keepends=True), strict=True)
    assert all(re.fullmatch(r"[A-Za-z.][A-Za-z0-9._]*", name) for name in names)  # make.names changes none
    assert len(set(names)) == len(names)
    number = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|NA|")  # type.convert; empty is NA too
    frame = pandas.read_csv(path, engine="python", keep_default_na=False, na_values=["", "NA"])
    for at, name in enumerate(names):
        known = columns[name].tolist()
        if any(isinstance(one, bool) for one in known):
            assert {row[at] for row in rows} <= {"TRUE", "FALSE", "T", "F", "", "NA"}
        elif any(isinstance(one, int | float) for one in known):
            assert all(number.fullmatch(row[at]) for row in rows), name
            read = [float(row[at]) if row[at] not in ("", "NA") else None for row in rows]
            assert read == [None if one is None or one != one else float(one) for one in known], name
        assert [None if pandas.isna(one) or one == "" else one for one in frame[name]] == [
            None if one is None or one == "" or one != one else one for one in known
        ], name


#: R's own reader, and what it found: a line of types, then the table as R writes it
IN_R = """
arguments <- commandArgs(trailingOnly = TRUE)
found <- read.csv(arguments[1], encoding = "UTF-8")
cat(vapply(found, function(one) class(one)[1], ""), sep = "\\n")
write.csv(found, arguments[2], row.names = FALSE, na = "", fileEncoding = "UTF-8")
"""


@pytest.mark.slow
def test_r_itself_finds_the_same_numbers_and_words(data: tuple[Any, ...], tmp_path: Path) -> None:
    if (r := shutil.which("Rscript")) is None:
        pytest.skip("Rscript is not installed; `make nightly` installs it where it may")
    study, columns, replies = data
    path, script, again = tmp_path / "t.csv", tmp_path / "read.R", tmp_path / "again.csv"
    write_csv(study, columns, path, replies=replies)
    script.write_text(IN_R, encoding="utf-8")
    done = subprocess.run([r, str(script), str(path), str(again)], capture_output=True, text=True, check=True)
    types = done.stdout.split()
    names, *rows = csv.reader(again.read_text(encoding="utf-8").splitlines(keepends=True), strict=True)
    assert names == list(COLUMNS)
    for at, name in enumerate(names):
        for known, row in zip(columns[name].tolist(), rows, strict=True):
            if known is None or known == "" or known != known:
                assert row[at] == "", name
            elif isinstance(known, bool):
                assert (types[at], row[at]) == ("logical", str(known).upper())
            elif isinstance(known, int | float):
                assert types[at] in ("integer", "numeric"), name
                assert float(row[at]) == pytest.approx(known, rel=1e-14)  # R writes 15 digits
            else:
                assert row[at] == str(known)


NAMES = "{urn:oasis:names:tc:opendocument:xmlns:%s:1.0}"
TABLE, OFFICE, TEXT = (NAMES % name for name in ("table", "office", "text"))


def read_words(part: ElementTree.Element) -> str:
    """The text of a paragraph; tabs and rows of spaces are elements."""
    between = {f"{TEXT}tab": "\t", f"{TEXT}s": " " * int(part.get(f"{TEXT}c", "1"))}.get(part.tag, "")
    return between + (part.text or "") + "".join(read_words(one) + (one.tail or "") for one in part)


def read_cells(path: Path) -> list[list[str | float | bool]]:
    """The rows of a flat OpenDocument: numbers, truth values, and words; no empty cell at a row's end."""
    rows = []
    for row in ElementTree.parse(path).iter(f"{TABLE}table-row"):
        cells: list[str | float | bool] = []
        for cell in row.iter(f"{TABLE}table-cell"):
            assert cell.get(f"{TABLE}formula") is None
            kind, value = cell.get(f"{OFFICE}value-type"), cell.get(f"{OFFICE}value", "nan")
            words = "\n".join(read_words(part) for part in cell.iter(f"{TEXT}p"))
            found = float(value) if kind == "float" else words
            cells += [found] * int(cell.get(f"{TABLE}number-columns-repeated", "1"))
        while cells and cells[-1] == "":
            cells.pop()
        rows.append(cells)
    return rows


@pytest.mark.slow
def test_libreoffice_shows_the_same_table_without_a_formula(data: tuple[Any, ...], tmp_path: Path) -> None:
    """Read with commas and UTF-8, as its dialog proposes, and saved with the type of each cell."""
    if (office := shutil.which("soffice")) is None:
        pytest.skip("LibreOffice is not installed; `make nightly` installs it where it may")
    study, columns, replies = data
    for path in write_csv(study, columns, tmp_path / "t.csv", replies=replies):
        if path.suffix != ".csv":
            continue
        words = ["--headless", "--infilter=CSV:44,34,76,1,,1033,false,true", "--convert-to", "fods"]
        home = f"-env:UserInstallation={(tmp_path / 'office').as_uri()}"
        subprocess.run([office, home, *words, "--outdir", str(tmp_path), str(path)], capture_output=True, check=True)
        shown = read_cells(path.with_suffix(".fods"))
        written = list(csv.reader(path.read_text(encoding="utf-8").splitlines(keepends=True), strict=True))
        for cells, row in zip(shown, written, strict=False):
            while row and row[-1] == "":
                row.pop()
            row = [cell.replace("\t", "") if "\n" in cell else cell for cell in row]  # LibreOffice drops these tabs
            assert [one if isinstance(one, str) else pytest.approx(one, rel=1e-15) for one in cells] == [
                float(one) if isinstance(cell, float) else one for cell, one in zip(cells, row, strict=True)
            ]
        assert not any(shown[len(written) :])
