"""Data out: tidy CSV, Parquet, and a folder after the Brain Imaging Data Structure (BIDS), behavioural data.

Texts that a spreadsheet would take for a formula begin with `'` in tables of text (CSV and TSV); Parquet has them as
they were said.
"""

from __future__ import annotations

import csv
import json
import math
import os
import re
import shutil
from pathlib import Path
from typing import Any

from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.store.columns import COLUMNS, Columns
from haptorb.errors import RecordingError
from haptorb.files.replace_file import replace_file
from haptorb.version import __version__

__all__ = ["Replies", "escape_formula", "write_bids", "write_csv", "write_parquet", "write_replies"]

Replies = dict[str, dict[str, str]]  #: participant's code → question's name → what was answered


_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_NUMBER = re.compile(r"[+-]?[0-9]+(\.[0-9]+)?")


def escape_formula(text: str) -> str:
    """`text` for a cell that no spreadsheet takes for a formula: where it begins like one, `'` stands before it.

    >>> escape_formula("=1+1"), escape_formula("-3"), escape_formula("as it is")
    ("'=1+1", '-3', 'as it is')
    """
    return f"'{text}" if text.startswith(_FORMULA) and not _NUMBER.fullmatch(text) else text


def write_csv(columns: Columns, path: str | Path, *, overwrite: bool = False) -> Path:
    """One row per trial, and beside it PATH.json: what every column is. Nothing is written half."""
    path = _free(path, overwrite)
    try:
        with replace_file(path) as part:
            _table(columns, part, ",", "")
            dictionary = path.with_suffix(".json")
            dictionary.write_text(json.dumps(COLUMNS, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    except OSError as cause:
        raise RecordingError(f"cannot write {path}: {cause.strerror}") from cause
    return path


def write_parquet(columns: Columns, path: str | Path, *, overwrite: bool = False) -> Path:
    """The same table, typed, with the data dictionary in the columns' metadata. Needs pyarrow."""
    path = _free(path, overwrite)
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as cause:
        raise RecordingError("Parquet needs pyarrow: pip install 'haptorb[study]', or export as CSV") from cause
    fields, arrays = [], []
    for name, about in COLUMNS.items():
        array = pyarrow.array([_none_if_nan(value) for value in columns[name].tolist()])
        arrays.append(array)
        fields.append(pyarrow.field(name, array.type, metadata={"description": about}))
    try:
        with replace_file(path) as part:
            parquet.write_table(pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields)), part)
    except OSError as cause:
        raise RecordingError(f"cannot write {path}: {cause.strerror or cause}") from cause
    return path


def write_replies(study: Study, replies: Replies, path: str | Path, *, overwrite: bool = False) -> Path:
    """Answers to the questions in words: one row per participant and question."""
    path = _free(path, overwrite)
    try:
        with replace_file(path) as part, part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(("participant", "question", "text", "reply"))
            for code, mine in replies.items():
                rows = ((code, q.name, q.text, mine[q.name]) for q in study.questions if q.name in mine)
                writer.writerows(map(escape_formula, row) for row in rows)
    except OSError as cause:
        raise RecordingError(f"cannot write {path}: {cause.strerror}") from cause
    return path


def write_bids(
    study: Study, columns: Columns, folder: str | Path, *, overwrite: bool = False, replies: Replies | None = None
) -> Path:
    """A table per participant, sub-CODE/beh/sub-CODE_task-NAME_beh.tsv, and what BIDS wants beside it.

    `replies` to the questions in words become columns of participants.tsv.
    """
    folder = Path(folder)
    if folder.exists() and not overwrite:
        text = f"{folder} exists; choose another name, or replace it"
        raise RecordingError(f"{text} with overwrite=True", command=f"{text} with --force")
    part = folder.with_name(folder.name + ".part")
    task = "".join(filter(str.isalnum, study.name))
    simulated = bool(columns["simulated"].any())
    try:
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        _json(
            part / "dataset_description.json",
            {
                "Name": f"{study.name}{' (SIMULATED participants)' if simulated else ''}",
                "BIDSVersion": "1.10.0",
                "DatasetType": "raw",
                "GeneratedBy": [{"Name": "haptorb", "Version": __version__}],
            },
        )
        (part / "README").write_text(
            f"Perceptual study '{study.name}' on device '{study.device}', run with haptorb {__version__}.\n"
            + ("Participants whose code begins with SIM are SIMULATED.\n" if simulated else "")
            + "The study file is in code/study.toml.\n",
            encoding="utf-8",
        )
        (part / "code").mkdir()
        (part / "code" / "study.toml").write_text(study.text, encoding="utf-8")
        codes = list(dict.fromkeys(columns["participant"].tolist()))
        asked = study.questions if replies else ()
        lines = ["\t".join(["participant_id", "simulated", *(question.name for question in asked)])]
        for code in codes:
            mine = {name: values[columns["participant"] == code] for name, values in columns.items()}
            answers = (replies or {}).get(code, {})
            cells = [escape_formula(" ".join(answers.get(q.name, "n/a").split())) for q in asked]
            lines.append("\t".join([f"sub-{code}", "true" if mine["simulated"][0] else "false", *cells]))
            place = part / f"sub-{code}" / "beh"
            place.mkdir(parents=True)
            _table(mine, place / f"sub-{code}_task-{task}_beh.tsv", "\t", "n/a")
        (part / "participants.tsv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        described = {"simulated": COLUMNS["simulated"], **{question.name: question.text for question in asked}}
        _json(part / "participants.json", {name: {"Description": text} for name, text in described.items()})
        about = {name: {"Description": text} for name, text in COLUMNS.items()}
        _json(part / f"task-{task}_beh.json", {"TaskName": task, "Instructions": study.instructions, **about})
        if folder.exists():
            shutil.rmtree(folder)
        os.replace(part, folder)
    except OSError as cause:
        shutil.rmtree(part, ignore_errors=True)
        raise RecordingError(f"cannot write {folder}: {cause.strerror}") from cause
    return folder


def _table(columns: Columns, path: Path, separator: str, nothing: str) -> None:
    whole = {"answer", "correct", "trial", "session", "set_point", "interval"}
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, delimiter=separator, lineterminator="\n")
        writer.writerow(COLUMNS)
        for row in zip(*(columns[name].tolist() for name in COLUMNS), strict=True):
            writer.writerow([_cell(value, name in whole, nothing) for name, value in zip(COLUMNS, row, strict=True)])


def _cell(value: Any, whole: bool, nothing: str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        if not math.isfinite(value):
            return nothing
        return str(int(value)) if whole else repr(value)
    return escape_formula(str(value)) or nothing


def _none_if_nan(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def _free(path: str | Path, overwrite: bool) -> Path:
    path = Path(path)
    try:
        if path.exists() and not overwrite:
            text = f"{path} exists; choose another name, or replace it"
            raise RecordingError(f"{text} with overwrite=True", command=f"{text} with --force")
    except OSError as cause:
        raise RecordingError(f"cannot write {path}: {cause.strerror}") from cause
    return path
