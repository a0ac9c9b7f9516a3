"""Trials as CSV or Parquet, with data dictionary, replies and events; all files or none.

Texts that a spreadsheet would interpret as formulas are prefixed with `'` in CSV and TSV, and unchanged in Parquet.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from haptorb.errors import RecordingError
from haptorb.files import escape_formula, open_regular, replace_files
from haptorb_study.columns import COLUMNS, Columns
from haptorb_study.data_dictionary import FLAGS, describe_columns, describe_events, describe_questions
from haptorb_study.export_scripts import make_python_script, make_r_script
from haptorb_study.incidents import COLUMNS as EVENT_COLUMNS
from haptorb_study.incidents import Incident
from haptorb_study.study_file import Study

__all__ = ["Replies", "explain_write_error", "write_csv", "write_json", "write_parquet", "write_table", "write_text"]


Replies = dict[str, dict[str, str]]  #: participant's code → question's name → reply


Files = dict[Path, Callable[[Path], None]]  #: path → function that writes it


#: true and false as R and spreadsheets read them; BIDS uses those of JSON
TRUTH = ("TRUE", "FALSE")


_COMPANION_SUFFIXES = (
    "questions.csv",
    "questions.json",
    "events.csv",
    "events.json",
)  #: suffixes of the files beside a table


#: columns whose floats are whole numbers, except estimated magnitudes
_WHOLE_NUMBER_COLUMNS = {"answer", "correct", "trial", "session", "set_point", "interval", "repeats"}


def write_csv(
    study: Study, columns: Columns, path: str | Path, *, overwrite: bool = False, replies: Replies | None = None,
    incidents: Sequence[Incident] | None = None,
) -> tuple[Path, ...]:  # fmt: skip
    """Write one row per trial as CSV, with data dictionary, reading scripts, and tables of replies and events.

    The latter two only with `replies` and `incidents`. Returns the files. Raises RecordingError, with nothing
    written, if one of them exists and `overwrite` is not set, or if the table at `path` is another study's.
    """
    path = Path(path)
    files: Files = {
        path: lambda part: write_table(columns, part, ",", "", TRUTH),
        **_companion_files(study, path),
        **_questions(study, replies, path),
        **_events(incidents, path),
    }
    return _write_all(study, files, overwrite)


def write_parquet(
    study: Study, columns: Columns, path: str | Path, *, overwrite: bool = False, replies: Replies | None = None,
    incidents: Sequence[Incident] | None = None,
) -> tuple[Path, ...]:  # fmt: skip
    """Write the same table, typed, with the data dictionary also in the columns' metadata. Needs pyarrow."""
    path = Path(path)
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as cause:
        raise RecordingError("Parquet needs pyarrow: pip install 'haptorb[study]', or export as CSV") from cause
    fields, arrays = [], []
    for name, about in describe_columns(study).items():
        array = pyarrow.array([_none_if_nan(value) for value in columns[name].tolist()])
        arrays.append(array)
        more = {"unit": about["Units"]} if "Units" in about else {}
        if "Levels" in about:
            more["levels"] = json.dumps(about["Levels"], ensure_ascii=False)
        fields.append(pyarrow.field(name, array.type, metadata={"description": COLUMNS[name], **more}))
    table = pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields))
    files: Files = {
        path: lambda part: parquet.write_table(table, part),
        **_companion_files(study, path),
        **_questions(study, replies, path),
        **_events(incidents, path),
    }
    return _write_all(study, files, overwrite)


def write_table(columns: Columns, path: Path, separator: str, nothing: str, truth: tuple[str, str]) -> None:
    """Write the columns as text, one row per trial; `nothing` for missing values, `truth` for true and false."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, delimiter=separator, lineterminator="\n")
        writer.writerow(COLUMNS)
        for row in zip(*(columns[name].tolist() for name in COLUMNS), strict=True):
            cells = zip(COLUMNS, row, strict=True)
            writer.writerow([_cell(value, name in _WHOLE_NUMBER_COLUMNS, nothing, truth) for name, value in cells])


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write indented JSON, without ASCII escapes."""
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def write_text(path: Path, content: str) -> None:
    """Write UTF-8 with the same line ends on every system."""
    path.write_text(content, encoding="utf-8", newline="\n")


@contextmanager
def explain_write_error(path: Path) -> Iterator[None]:
    """Convert OSError into RecordingError that names the path."""
    try:
        yield
    except OSError as cause:
        raise RecordingError(f"cannot write {cause.filename or path}: {cause.strerror or cause}") from cause
    except ValueError as cause:  # a zero byte in the path
        raise RecordingError(f"cannot write {str(path)!r}: not the name of a file") from cause


def _write_all(study: Study, files: Files, overwrite: bool) -> tuple[Path, ...]:
    first = next(iter(files))
    stale = [
        first.with_name(f"{first.stem}-{more}")
        for more in _COMPANION_SUFFIXES
        if first.with_name(f"{first.stem}-{more}") not in files
    ]
    with explain_write_error(first):
        for path in files:
            if path.is_dir():
                raise RecordingError(f"cannot write {path}: it is a folder")
            if path.exists() and not overwrite:
                text = f"{path} exists; choose another name, or replace it"
                raise RecordingError(f"{text} with overwrite=True", command=f"{text} with --force")
        _check_table(study, first)
        with replace_files(list(files)) as parts:
            for part, write in zip(parts, files.values(), strict=True):
                write(part)
        for path in stale if overwrite else ():  # of an earlier export: it may contain withdrawn participants
            path.unlink(missing_ok=True)
    return tuple(files)


def _questions(study: Study, replies: Replies | None, path: Path) -> Files:
    """Files with the replies beside `path`, one row per participant and question, if there are any."""
    if not replies:
        return {}

    def write(part: Path) -> None:
        with part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(("participant", "question", "text", "reply"))
            for code, mine in replies.items():
                rows = ((code, q.name, q.text, mine[q.name]) for q in study.questions if q.name in mine)
                writer.writerows(map(escape_formula, row) for row in rows)

    return {
        path.with_name(f"{path.stem}-questions.json"): lambda part: write_json(part, describe_questions(study)),
        path.with_name(f"{path.stem}-questions.csv"): write,
    }


def _check_table(study: Study, path: Path) -> None:
    """Raise RecordingError if the table at `path` is not an export of this study."""
    if not path.exists():
        return
    found = ""
    try:
        if path.suffix.lower() == ".parquet":
            from pyarrow import parquet

            with open_regular(path, "table", RecordingError) as file, parquet.ParquetFile(file) as table:
                if "trial" not in table.schema_arrow.names:
                    found = "no table of trials"
                elif "study" in table.schema_arrow.names and table.metadata.num_rows:
                    found = str(next(table.iter_batches(1, columns=["study"])).column(0)[0].as_py())
        else:
            with open_regular(path, "table", RecordingError) as file:
                rows = csv.DictReader(TextIOWrapper(file, newline="", encoding="utf-8-sig"))
                if "trial" not in (rows.fieldnames or ()):
                    found = "no table of trials"
                elif (first := next(rows, None)) is not None:
                    found = first.get("study") or ""  # older exports have no such column
    except (OSError, ValueError, RecordingError, csv.Error):
        found = "no table of trials"
    if found not in ("", study.name):  # safety: export-own-table
        what = found if found == "no table of trials" else f"the export of another study, '{found}'"
        raise RecordingError(f"{path} is {what}, so it is not replaced: choose another name, or remove it yourself")


def _events(incidents: Sequence[Incident] | None, path: Path) -> Files:
    """Files with the events beside `path`: one row per stop, repeat, safety event or early end."""
    if incidents is None:
        return {}

    def write(part: Path) -> None:
        with part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(EVENT_COLUMNS)
            for one in incidents:
                writer.writerow([escape_formula(str(value)) for value in one.row().values()])

    return {
        path.with_name(f"{path.stem}-events.json"): lambda part: write_json(part, describe_events()),
        path.with_name(f"{path.stem}-events.csv"): write,
    }


def _companion_files(study: Study, path: Path) -> Files:
    """Files beside a table: its data dictionary, and scripts that read both."""
    ending = path.suffix.lower()
    form = "" if ending == ".csv" else ending.removeprefix(".")  # one folder may hold the data in both forms
    script = f"read_{path.stem}{form and '_'}{form}"
    described = describe_columns(study)
    if not form:
        for name in FLAGS:
            described[name]["Levels"] = {word.upper(): about for word, about in described[name]["Levels"].items()}
    return {
        path.with_name(f"{path.stem}{form and '-'}{form}.json"): lambda part: write_json(part, described),
        path.with_name(f"{script}.py"): lambda part: write_text(part, make_python_script(study, path.name)),
        path.with_name(f"{script}.R"): lambda part: write_text(part, make_r_script(study, path.name)),
    }


def _cell(value: Any, whole: bool, nothing: str, truth: tuple[str, str]) -> str:
    if value is None:
        return nothing
    if isinstance(value, bool):
        return truth[0] if value else truth[1]
    if isinstance(value, float):
        if not math.isfinite(value):
            return nothing
        return str(int(value)) if whole and value == int(value) else repr(value)
    return escape_formula(str(value)) or nothing


def _none_if_nan(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
