"""Tables of trials: CSV or Parquet, with a data dictionary and the answers to questions; all files or none.

Texts that a spreadsheet would take for a formula begin with `'` in tables of text (CSV and TSV); Parquet has them as
they were said.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.store.columns import COLUMNS, Columns
from haptorb.apps.study.store.dictionary import describe_columns, describe_events, describe_questions
from haptorb.apps.study.store.incidents import COLUMNS as EVENT_COLUMNS
from haptorb.apps.study.store.incidents import Incident
from haptorb.apps.study.store.scripts import make_python_script, make_r_script
from haptorb.errors import RecordingError
from haptorb.files.foreign_text import escape_formula
from haptorb.files.replace_together import replace_files

__all__ = [
    "Replies",
    "explain_write_error",
    "write_csv",
    "write_json",
    "write_parquet",
    "write_table",
    "write_text",
]

Replies = dict[str, dict[str, str]]  #: participant's code → question's name → the answer
Files = dict[Path, Callable[[Path], None]]  #: place → what writes it

_MORE = ("questions.csv", "questions.json", "events.csv", "events.json")  #: ends of what may stand beside a table
#: columns whose floats are whole numbers, but for estimated magnitudes
_WHOLE = {"answer", "correct", "trial", "session", "set_point", "interval", "repeats"}


def write_csv(
    study: Study, columns: Columns, path: str | Path, *, overwrite: bool = False, replies: Replies | None = None,
    incidents: Sequence[Incident] | None = None,
) -> tuple[Path, ...]:  # fmt: skip
    """One row per trial; beside it the data dictionary, scripts that read it, and NAME-questions.csv, NAME-events.csv.

    These are there if `replies` and `incidents` are given. Returns the files. Raises RecordingError, with nothing
    written, if one of them exists and `overwrite` is not set, or if the table at `path` is another study's.
    """
    path = Path(path)
    files: Files = {
        path: lambda part: write_table(columns, part, ",", ""),
        **_companion_files(study, path),
        **_questions(study, replies, path),
        **_events(incidents, path),
    }
    return _write_all(study, files, overwrite)


def write_parquet(
    study: Study, columns: Columns, path: str | Path, *, overwrite: bool = False, replies: Replies | None = None,
    incidents: Sequence[Incident] | None = None,
) -> tuple[Path, ...]:  # fmt: skip
    """The same table, typed, with the data dictionary in the columns' metadata too. Needs pyarrow."""
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


def write_table(columns: Columns, path: Path, separator: str, nothing: str) -> None:
    """The columns as text, one row per trial; `nothing` stands where there is no value."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, delimiter=separator, lineterminator="\n")
        writer.writerow(COLUMNS)
        for row in zip(*(columns[name].tolist() for name in COLUMNS), strict=True):
            writer.writerow([_cell(value, name in _WHOLE, nothing) for name, value in zip(COLUMNS, row, strict=True)])


def write_json(path: Path, content: dict[str, Any]) -> None:
    """For people too: indented, with letters as they are."""
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def write_text(path: Path, content: str) -> None:
    """As UTF-8 with the same ends of lines everywhere."""
    path.write_text(content, encoding="utf-8", newline="\n")


@contextmanager
def explain_write_error(path: Path) -> Iterator[None]:
    """What the system refuses as RecordingError that names the place."""
    try:
        yield
    except OSError as cause:
        raise RecordingError(f"cannot write {cause.filename or path}: {cause.strerror or cause}") from cause
    except ValueError as cause:  # a zero byte in its name
        raise RecordingError(f"cannot write {str(path)!r}: not the name of a file") from cause


def _write_all(study: Study, files: Files, overwrite: bool) -> tuple[Path, ...]:
    first = next(iter(files))
    stale = [
        first.with_name(f"{first.stem}-{more}")
        for more in _MORE
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
        for path in stale if overwrite else ():  # of an earlier export: nobody who has withdrawn since may stay in it
            path.unlink(missing_ok=True)
    return tuple(files)


def _questions(study: Study, replies: Replies | None, path: Path) -> Files:
    """The file with the answers to questions beside `path`, one row per participant and question, if there are any."""
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
    """RecordingError if there is a table at `path` that is none of this study."""
    if not path.exists():
        return
    found = ""
    try:
        if path.suffix == ".parquet":
            from pyarrow import parquet

            with parquet.ParquetFile(path) as table:
                if "trial" not in table.schema_arrow.names:
                    found = "no table of trials"
                elif "study" in table.schema_arrow.names and table.metadata.num_rows:
                    found = str(next(table.iter_batches(1, columns=["study"])).column(0)[0].as_py())
        else:
            with path.open(newline="", encoding="utf-8") as file:
                rows = csv.DictReader(file)
                if "trial" not in (rows.fieldnames or ()):
                    found = "no table of trials"
                elif (first := next(rows, None)) is not None:
                    found = first.get("study") or ""  # tables of an older haptorb do not say it
    except (OSError, ValueError, csv.Error):
        found = "no table of trials"
    if found not in ("", study.name):  # safety: export-own-table
        what = found if found == "no table of trials" else f"the export of another study, '{found}'"
        raise RecordingError(f"{path} is {what}, so it is not replaced: choose another name, or remove it yourself")


def _events(incidents: Sequence[Incident] | None, path: Path) -> Files:
    """The file with what interrupted sessions beside `path`, one row per stop, repeat, safety event or early end."""
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
    """What stands beside a table: the data dictionary, and scripts that read both."""
    form = "" if path.suffix == ".csv" else path.suffix.removeprefix(".")  # a folder may hold the data in both forms
    script = f"read_{path.stem}{form and '_'}{form}"
    return {
        path.with_name(f"{path.stem}{form and '-'}{form}.json"): lambda part: write_json(part, describe_columns(study)),
        path.with_name(f"{script}.py"): lambda part: write_text(part, make_python_script(study, path.name)),
        path.with_name(f"{script}.R"): lambda part: write_text(part, make_r_script(study, path.name)),
    }


def _cell(value: Any, whole: bool, nothing: str) -> str:
    if value is None:
        return nothing
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        if not math.isfinite(value):
            return nothing
        return str(int(value)) if whole and value == int(value) else repr(value)
    return escape_formula(str(value)) or nothing


def _none_if_nan(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
