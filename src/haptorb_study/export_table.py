"""Trials as CSV or Parquet, with data dictionary, replies and events; all files or none.

Texts that a spreadsheet would interpret as formulas are prefixed with `'` in CSV and TSV, and unchanged in Parquet.
"""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from haptorb.errors import RecordingError
from haptorb.files import escape_formula, open_regular, parse_json, read_text, replace_files
from haptorb_study.columns import COLUMNS, Columns
from haptorb_study.data_dictionary import FLAGS, describe_columns, describe_events, describe_questions
from haptorb_study.export_scripts import make_python_script, make_r_script
from haptorb_study.incidents import COLUMNS as EVENT_COLUMNS
from haptorb_study.incidents import Incident
from haptorb_study.study_file import Study

__all__ = [
    "Replies",
    "explain_foreign",
    "explain_write_error",
    "write_csv",
    "write_json",
    "write_parquet",
    "write_table",
    "write_text",
]


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


_REPLY_COLUMNS = ("participant", "question", "text", "reply")
_SCRIPT_HEAD = "Reads the trials that haptorb "  #: in the first line of each script of an export
_MAX_HEAD_BYTES = 4096  #: bytes of a first line that is looked at


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
        if overwrite and first.with_name(f"{first.stem}-{more}") not in files
    ]
    with explain_write_error(first):
        for path in files:
            if path.is_dir():
                raise RecordingError(f"cannot write {path}: it is a folder")
            if path.exists() and not overwrite:
                text = f"{path} exists; choose another name, or replace it"
                raise RecordingError(f"{text} with overwrite=True", command=f"{text} with --force")
        _check_table(study, first)
        for path in stale:
            if os.path.lexists(path) and not _is_companion(study, path):  # safety: export-own-companion
                raise RecordingError(
                    f"{path} was not written by haptorb, but would belong to this export: rename it, or choose another "
                    "name"
                )
        with replace_files(list(files)) as parts:
            for part, write in zip(parts, files.values(), strict=True):
                write(part)
        for path in stale:  # of an earlier export: it may contain withdrawn participants
            path.unlink(missing_ok=True)
    return tuple(files)


def _questions(study: Study, replies: Replies | None, path: Path) -> Files:
    """Files with the replies beside `path`, one row per participant and question, if there are any."""
    if not replies:
        return {}

    def write(part: Path) -> None:
        with part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(_REPLY_COLUMNS)
            for code, mine in replies.items():
                rows = ((code, q.name, q.text, mine[q.name]) for q in study.questions if q.name in mine)
                writer.writerows(map(escape_formula, row) for row in rows)

    return {
        path.with_name(f"{path.stem}-questions.json"): lambda part: write_json(part, describe_questions(study)),
        path.with_name(f"{path.stem}-questions.csv"): write,
    }


def explain_foreign(study: Study, path: Path) -> str:
    """Why the table at `path` and the files beside it are not all of an export of this study and version; empty if they
    are. A withdrawal replaces them where a database names them, and a stranger may have written that."""
    try:
        _check_table(study, path)
        if _read_columns(path) != list(COLUMNS):  # safety: withdrawn-own-columns
            return "its columns are not those of an export of this haptorb"
        dictionary, *others = _companion_files(study, path)
        others += [path.with_name(f"{path.stem}-{more}") for more in _COMPANION_SUFFIXES]
        if path.is_symlink() or not _is_companion(study, dictionary):  # safety: withdrawn-own-export
            return f"{dictionary.name} does not say that it is an export of this version of the study"
        if other := next((one for one in others if os.path.lexists(one) and not _is_companion(study, one)), None):
            return f"{other.name} beside it was not written by haptorb"
    except (RecordingError, ValueError, OSError, csv.Error) as cause:
        return str(cause)
    return ""


def _is_companion(study: Study, path: Path) -> bool:
    """Whether the file beside a table is of an export by haptorb, and a data dictionary of this study's version."""
    name = path.name
    if path.is_symlink():
        return False
    try:
        if path.suffix == ".json":
            found = parse_json(read_text(path, "data dictionary", RecordingError))
            if name.endswith("-questions.json"):
                return list(found) == list(describe_questions(study))
            if name.endswith("-events.json"):
                return list(found) == list(describe_events())
            own = describe_columns(study)
            return list(found) == list(own) and found["study"]["Levels"] == own["study"]["Levels"]
        first = _read_head(path, "file of an export")
        if path.suffix == ".csv":
            heads = {",".join(EVENT_COLUMNS), ",".join(_REPLY_COLUMNS)}
            return first in heads
        return _SCRIPT_HEAD in first
    except (RecordingError, ValueError, LookupError, TypeError):
        return False


def _read_head(path: Path, what: str) -> str:
    """First line of the file, without its end."""
    with open_regular(path, what, RecordingError) as file:
        return file.readline(_MAX_HEAD_BYTES).decode("utf-8-sig").rstrip("\r\n")


def _read_columns(path: Path) -> list[str]:
    if path.suffix.lower() == ".csv":
        return next(csv.reader([_read_head(path, "table")]), [])
    from pyarrow import parquet

    with open_regular(path, "table", RecordingError) as file, parquet.ParquetFile(file) as table:
        return [str(name) for name in table.schema_arrow.names]


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
