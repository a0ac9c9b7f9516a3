"""Exports: the same in every form, all files or none, codes as safe names, only exports are replaced."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path
from typing import Any

import pytest

from haptorb.cli import main
from haptorb.errors import RecordingError
from haptorb_study.analysis.analysis import analysis_of
from haptorb_study.analysis.report import page
from haptorb_study.bids import write_bids
from haptorb_study.columns import COLUMNS, Columns, tidy
from haptorb_study.database import database
from haptorb_study.export import export_study
from haptorb_study.export_table import write_csv, write_parquet
from haptorb_study.participant_codes import make_labels
from haptorb_study.prompts import Answer
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of

CODES = ("P01", "vp-7", "Ä3")
REPLIES = {"P01": {"hand": "left"}}


@pytest.fixture
def columns(identify: Study, tmp_path: Path) -> Columns:
    engine = database(tmp_path / "s.db")
    for code, driver in zip(CODES, ("serial:/dev/ttyUSB0", "sim", "sim"), strict=True):
        with StoredSession(engine, identify, code) as session:
            while session.prompt is not None:
                session.answer(Answer(1, (0.0, 0.0, 0.05), 1.0), driver=driver)
    return tidy(engine, identify)


def read(path: Path, separator: str) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file, delimiter=separator))


def list_files(folder: Path) -> dict[str, bytes]:
    """Every file under `folder` with its content."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def command(*words: str) -> int:
    """Exit code of `haptorb study WORDS`."""
    try:
        return main(["study", *words])
    except SystemExit as end:
        return int(end.code or 0)


def test_csv_parquet_and_bids_say_the_same(identify: Study, columns: Columns, tmp_path: Path) -> None:
    from pyarrow import parquet

    rows = read(write_csv(identify, columns, tmp_path / "t.csv")[0], ",")
    assert list(rows[0]) == list(COLUMNS)
    assert [int(row["trial"]) for row in rows] == 3 * list(range(1, 8))  # as the pages count
    assert [row["simulated_device"] for row in rows] == 7 * ["FALSE"] + 14 * ["TRUE"]
    assert list(json.loads((tmp_path / "t.json").read_text(encoding="utf-8"))) == list(COLUMNS)
    table = parquet.read_table(write_parquet(identify, columns, tmp_path / "t.parquet")[0])
    assert table.column("answer").to_pylist() == [int(row["answer"]) for row in rows]
    assert table.column("simulated_device").to_pylist() == 7 * [False] + 14 * [True]
    assert table.schema.field("x_m").metadata[b"description"].decode() == COLUMNS["x_m"]
    folder = write_bids(identify, columns, tmp_path / "bids")
    people = read(folder / "participants.tsv", "\t")
    assert [row["code"] for row in people] == list(CODES)
    tables = [
        folder / row["participant_id"] / "beh" / f"{row['participant_id']}_task-identify_beh.tsv" for row in people
    ]
    assert [row["answer"] for path in tables for row in read(path, "\t")] == [row["answer"] for row in rows]
    described = json.loads((folder / "dataset_description.json").read_text(encoding="utf-8"))
    assert described["Name"] == "identify (SIMULATED DEVICE)"
    assert "SIMULATED DEVICE" in (folder / "README").read_text(encoding="utf-8")


def test_an_older_database_does_not_know_its_device(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01") as session:
        session.answer(Answer(1, (0.0, 0.0, 0.05), 1.0))
    rows = read(write_csv(identify, tidy(engine, identify), tmp_path / "t.csv")[0], ",")
    assert rows[0]["simulated_device"] == ""


def test_labels_of_files_are_plain_and_all_different() -> None:
    codes = ["P01", "S-07", "S07", "被験者12", "Ä3", "3", "../../etc1"]
    labels = make_labels(codes)
    assert list(labels) == codes
    assert all(label.isascii() and label.isalnum() for label in labels.values())
    assert len({label.casefold() for label in labels.values()}) == len(codes)
    assert (labels["P01"], labels["S07"], labels["3"]) == ("P01", "S07", "3")


@pytest.mark.parametrize("there", ["t.csv", "t.json", "t-questions.csv", "read_t.py"])
def test_a_csv_export_is_written_whole_or_not_at_all(
    identify: Study, columns: Columns, tmp_path: Path, there: str
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / there).write_text("trial\n")
    with pytest.raises(RecordingError, match=rf"{there} exists.*overwrite=True"):
        write_csv(identify, columns, folder / "t.csv", replies=REPLIES)
    assert list_files(folder) == {there: b"trial\n"}
    write_csv(identify, columns, folder / "t.csv", overwrite=True, replies=REPLIES)
    assert set(list_files(folder)) == {
        "t.csv", "t.json", "t-questions.csv", "t-questions.json", "read_t.py", "read_t.R",
    }  # fmt: skip


def test_a_disk_that_fills_while_the_last_file_is_moved_leaves_all_as_it_was(
    identify: Study, columns: Columns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "t.csv").write_text("trial\n1\n")
    (folder / "t-questions.csv").write_text("mine too")
    move = os.replace

    def fail(source: Any, target: Any) -> None:
        if str(source).endswith(".part") and str(target).endswith("questions.csv"):
            raise OSError(28, "No space left on device")
        move(source, target)

    with monkeypatch.context() as changed:
        changed.setattr(os, "replace", fail)
        with pytest.raises(RecordingError, match="No space left"):
            write_csv(identify, columns, folder / "t.csv", overwrite=True, replies=REPLIES)
    assert list_files(folder) == {"t.csv": b"trial\n1\n", "t-questions.csv": b"mine too"}


def test_a_folder_that_is_no_export_is_never_replaced(identify: Study, columns: Columns, tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    write_bids(identify, columns, home, overwrite=True)  # an empty folder may be
    (home / "README").write_text("changed")
    with pytest.raises(RecordingError, match="overwrite=True"):
        write_bids(identify, columns, home)
    write_bids(identify, columns, home, overwrite=True)
    assert (home / "README").read_text(encoding="utf-8") != "changed"
    (home / "dataset_description.json").write_text('{"GeneratedBy": [{"Name": "fMRIPrep"}]}')
    before = list_files(home)
    with pytest.raises(RecordingError, match="not an export of haptorb"):
        write_bids(identify, columns, home, overwrite=True)
    assert list_files(home) == before
    (tmp_path / "file").write_text("mine")
    with pytest.raises(RecordingError, match="is a file"):
        write_bids(identify, columns, tmp_path / "file", overwrite=True)


def test_an_export_of_another_study_is_never_replaced(
    identify: Study, stairs: Study, columns: Columns, tmp_path: Path
) -> None:
    other = study_of(f"{identify.text}[parameters]\nmoment = 2.0\n")
    write_bids(identify, columns, tmp_path / "bids")
    write_csv(identify, columns, tmp_path / "t.csv")
    write_parquet(identify, columns, tmp_path / "t.parquet")
    before = list_files(tmp_path)
    with pytest.raises(RecordingError, match="another study, 'identify'"):
        write_bids(stairs, columns, tmp_path / "bids", overwrite=True)
    with pytest.raises(RecordingError, match="another version of study 'identify'"):
        write_bids(other, columns, tmp_path / "bids", overwrite=True)
    for name, write in (("t.csv", write_csv), ("t.parquet", write_parquet)):
        with pytest.raises(RecordingError, match="another study, 'identify'"):
            write(stairs, columns, tmp_path / name, overwrite=True)
    (tmp_path / "mine.csv").write_text("a,b\n1,2\n")
    with pytest.raises(RecordingError, match="no table of trials"):
        write_csv(identify, columns, tmp_path / "mine.csv", overwrite=True)
    (tmp_path / "mine.csv").unlink()
    assert list_files(tmp_path) == before


def test_stops_and_repeats_are_in_every_export(identify: Study, tmp_path: Path) -> None:
    engine = database(tmp_path / "s.db")
    with StoredSession(engine, identify, "P01") as session:
        session.answer(Answer(1, (0.0, 0.0, 0.05), 1.0))
        session.record_event("pause", "by the participant")
        session.record_event("resume")
        session.record_event("repeat", "stopped by the participant")
        while session.prompt is not None:
            session.answer(Answer(1, (0.0, 0.0, 0.05), 1.0))
    export_study(engine, tmp_path / "t.csv")
    export_study(engine, tmp_path / "bids")
    rows = read(tmp_path / "t-events.csv", ",")
    assert [(row["event"], row["trial"], row["reason"]) for row in rows] == [
        ("stop", "2", "by the participant"), ("resume", "2", ""), ("repeat", "2", "stopped by the participant"),
    ]  # fmt: skip
    events = read(tmp_path / "bids" / "sub-P01" / "beh" / "sub-P01_task-identify_events.tsv", "\t")
    assert [row["trial_type"] for row in events] == ["stop", "resume", "repeat"]
    assert list(events[0])[:2] == ["onset", "duration"]
    assert float(events[0]["duration"]) >= 0
    found = analysis_of(tmp_path / "s.db")
    assert len(found.incidents) == 3
    assert "by the participant" in page(found)


def test_a_bids_folder_that_cannot_be_finished_leaves_the_old_one(
    identify: Study, columns: Columns, tmp_path: Path
) -> None:
    folder = write_bids(identify, columns, tmp_path / "bids")
    before = list_files(tmp_path)
    broken = {name: values for name, values in columns.items() if name != "answer"}
    with pytest.raises(KeyError):
        write_bids(identify, broken, folder, overwrite=True)
    assert list_files(tmp_path) == before


def test_the_command_counts_trials_lists_codes_and_names_force(
    columns: Columns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command("export", "s.db", "t.csv") == 0
    told = capsys.readouterr()
    assert "7 trials, 1 of them practice: t.csv, t.json" in told.out
    assert "14 pilot trials (2 participants; --data pilot)" in told.err
    assert command("export", "s.db", "pilot.csv", "--data", "pilot") == 0
    assert "SIMULATED DEVICE" in capsys.readouterr().err
    assert {row["participant"] for row in read(tmp_path / "pilot.csv", ",")} == {"vp-7", "Ä3"}
    assert {row["pilot"] for row in read(tmp_path / "pilot.csv", ",")} == {"TRUE"}
    assert command("export", "s.db", "t.csv") == 2
    assert "--force" in capsys.readouterr().err
    assert command("export", "s.db", "t.csv", "--force") == 0
    capsys.readouterr()
    assert command("participants", "s.db", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert [one["code"] for one in found["participants"]] == list(CODES)
    assert found["next_free_code"] == "Ä4"
    assert command("participants", "s.db") == 0
    assert "next free code: Ä4" in capsys.readouterr().out
