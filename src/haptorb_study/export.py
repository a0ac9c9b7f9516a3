"""Export of trials as CSV, Parquet or BIDS, with data dictionary, replies and events; all files or none.

Texts that a spreadsheet would interpret as formulas are prefixed with `'` in CSV and TSV, and unchanged in Parquet.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy.engine import Engine

from haptorb.errors import HaptorbError, InputError, RecordingError
from haptorb.files import escape_formula, foreign_text, parse_json, read_text, replace_files, replace_folder
from haptorb.version import __version__
from haptorb_study.codes import make_labels
from haptorb_study.columns import (
    COLUMNS,
    FLAGS,
    WORDS,
    Columns,
    describe_columns,
    describe_events,
    describe_questions,
    read_replies,
    read_study,
    select_kind,
    tidy,
)
from haptorb_study.copies import Kind
from haptorb_study.incidents import COLUMNS as EVENT_COLUMNS
from haptorb_study.incidents import Incident, list_incidents
from haptorb_study.study_file import Study, study_of

__all__ = [
    "Replies",
    "StudyExport",
    "check_output",
    "explain_write_error",
    "export_study",
    "make_python_script",
    "make_r_script",
    "write_bids",
    "write_csv",
    "write_json",
    "write_parquet",
    "write_table",
    "write_text",
]


# --------------------------------------------------------------------------------------------------
# Scripts beside the data that read an export, in Python with pandas and in R without packages.


def make_python_script(study: Study, table: str) -> str:
    """Python script that reads `table` beside it: NAME.csv, NAME.parquet, or a pattern of TSV files below it."""
    return (
        (_SCRIPT_FOLDER / "read_export.py.txt").read_text(encoding="utf-8").replace("@VERSION@", __version__)
        .replace("@TABLE@", _quote(table)).replace("@FLAGS@", repr(FLAGS)).replace("@WORDS@", repr(WORDS))
        .replace("@CONDITIONS@", _quote_all(study, "[", "]")).replace("@MEASURES@", repr(_list_measures(study)))
    )  # fmt: skip


def make_r_script(study: Study, table: str) -> str:
    """R script that reads `table`; a Parquet file needs the package arrow or nanoparquet."""
    return (
        (_SCRIPT_FOLDER / "read_export.R.txt").read_text(encoding="utf-8").replace("@VERSION@", __version__)
        .replace("@TABLE@", _quote(table)).replace("@FLAGS@", ", ".join(map(_quote, FLAGS)))
        .replace("@WORDS@", ", ".join(map(_quote, WORDS))).replace("@CONDITIONS@", _quote_all(study, "c(", ")"))
        .replace("@MEASURES@", ", ".join(map(_quote, _list_measures(study))))
    )  # fmt: skip


_SCRIPT_FOLDER = Path(__file__).parent


def _list_measures(study: Study) -> tuple[str, ...]:
    """Columns whose means are meaningful."""
    return (
        ("answer", "seconds") if study.procedure in ("rating", "magnitude") else ("correct", "distance_mm", "seconds")
    )


def _quote(text: str) -> str:
    """String literal of both Python and R."""
    return json.dumps(text, ensure_ascii=False)


def _quote_all(study: Study, begin: str, end: str) -> str:
    return begin + ", ".join(_quote(one.name) for one in study.conditions) + end


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
                    found = first.get("study") or ""  # older exports have no such column
    except (OSError, ValueError, csv.Error):
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
    form = "" if path.suffix == ".csv" else path.suffix.removeprefix(".")  # one folder may hold the data in both forms
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


# --------------------------------------------------------------------------------------------------
# Export as a BIDS folder (Brain Imaging Data Structure, behavioural data); the whole folder or nothing.


#: procedure → task of the participant
_TASKS = {
    "identification": "Feel a force and name the set-point that it leads to",
    "constant": "Feel two forces, one of several fixed levels beside the reference, and answer which pushed harder",
    "staircase": "Feel two forces, whose difference follows the answers, and answer which pushed harder",
    "bayesian": "Feel two forces, whose difference is chosen from all answers so far, and answer which pushed harder",
    "magnitude": "Feel a force and estimate its magnitude as a number",
    "forced-choice": "Feel the same place under two conditions and choose the one that is preferred",
    "rating": "Feel a force under one condition and rate it on a scale",
}


def write_bids(
    study: Study, columns: Columns, folder: str | Path, *, overwrite: bool = False, replies: Replies | None = None,
    incidents: Sequence[Incident] | None = None,
) -> Path:  # fmt: skip
    """Write sub-LABEL/beh/sub-LABEL_task-NAME_beh.tsv per participant, and the files that BIDS requires.

    A label is the participant's code reduced to ASCII letters and digits, as BIDS requires; participants.tsv has both,
    and the `replies` to questions as columns. `incidents`: a table sub-LABEL_task-NAME_events.tsv per
    participant. Raises RecordingError, with nothing changed, if `folder` exists and `overwrite` is not set, or if it is
    not an export of this study.
    """
    folder = Path(folder)
    with explain_write_error(folder):
        _check_place(study, folder, overwrite)
        with replace_folder(folder) as part:
            _fill_folder(study, columns, part, replies or {})
            if incidents is not None:
                _write_events(study, columns, part, incidents)
    return folder


def _check_place(study: Study, folder: Path, overwrite: bool) -> None:
    if not folder.exists():
        return
    if not folder.is_dir():
        raise RecordingError(f"{folder} is a file: name a folder, or a file that ends in .csv or .parquet")
    if not overwrite:
        text = f"{folder} exists; choose another name, or replace it"
        raise RecordingError(f"{text} with overwrite=True", command=f"{text} with --force")
    # Replacing removes the whole folder, so it must be an earlier export.
    if any(folder.iterdir()) and not _is_export(folder):  # safety: export-own-folder
        raise RecordingError(
            f"{folder} is not an export of haptorb, so it is not replaced: choose another name, or remove it yourself"
        )
    if any(folder.iterdir()) and (other := _find_other_study(study, folder)):  # safety: export-own-study
        raise RecordingError(
            f"{folder} is the export of {other}, so it is not replaced: choose another name, or remove it yourself"
        )


def _find_other_study(study: Study, folder: Path) -> str:
    """Description of the study that the export in `folder` is of; empty if it is of `study`."""
    try:
        found = study_of((folder / "code" / "study.toml").read_text(encoding="utf-8"), str(folder), stored=True)
    except (OSError, ValueError, HaptorbError):
        return "a study that cannot be read any more"
    if found.digest == study.digest:
        return ""
    return f"another study, '{found.name}'" if found.name != study.name else f"another version of study '{study.name}'"


def _is_export(folder: Path) -> bool:
    try:
        description = parse_json(read_text(folder / "dataset_description.json", "description", RecordingError))
        return any(made["Name"] == "haptorb" for made in description["GeneratedBy"])
    except (RecordingError, ValueError, LookupError, TypeError):
        return False


def _fill_folder(study: Study, columns: Columns, part: Path, replies: Replies) -> None:
    task = "".join(filter(str.isalnum, study.name))
    people, device = (
        bool(columns["simulated"].any()),
        any(simulated is True for simulated in columns["simulated_device"]),
    )
    felt = [simulated is not True for simulated in columns["simulated_device"]]
    pilot = bool((columns["pilot"] & felt).any())  # data from the simulated device are always pilot data
    marks = [
        word
        for word, marked in (("SIMULATED participants", people), ("SIMULATED DEVICE", device), ("PILOT", pilot))
        if marked
    ]
    description = {
        "Name": f"{study.name}{' (' + ', '.join(marks) + ')' if marks else ''}",
        "BIDSVersion": "1.10.0",
        "DatasetType": "raw",
        "GeneratedBy": [{"Name": "haptorb", "Version": __version__}],
    }
    write_json(part / "dataset_description.json", description)
    (part / "README").write_text(
        f"Perceptual study '{study.name}' on device '{study.device}', run with haptorb {__version__}.\n"
        + ("Participants whose code is SIM and a number are SIMULATED.\n" if people else "")
        + ("Where simulated_device is true, the SIMULATED DEVICE was used: nobody felt a force.\n" if device else "")
        + ("These are PILOT data, not those of the study.\n" if pilot else "")
        + "The study file is in code/study.toml; code/read_trials.py and code/read_trials.R read all trials.\n",
        encoding="utf-8",
    )
    (part / "code").mkdir()
    (part / "code" / "study.toml").write_text(study.text, encoding="utf-8")
    asked = study.questions if replies else ()
    lines = [["participant_id", "code", "simulated", "simulated_device", *(question.name for question in asked)]]
    for code, label in make_labels(dict.fromkeys(columns["participant"].tolist())).items():
        mine = {name: values[columns["participant"] == code] for name, values in columns.items()}
        answers = [escape_formula(" ".join(replies.get(code, {}).get(q.name, "n/a").split())) for q in asked]
        lines.append(
            [
                f"sub-{label}",
                escape_formula(foreign_text(code)),
                _word(mine["simulated"]),
                _word(mine["simulated_device"]),
                *answers,
            ]
        )
        place = part / f"sub-{label}" / "beh"
        place.mkdir(parents=True)
        write_table(mine, place / f"sub-{label}_task-{task}_beh.tsv", "\t", "n/a", ("true", "false"))
    text = "".join("\t".join(line) + "\n" for line in lines)
    (part / "participants.tsv").write_text(text, encoding="utf-8")
    columns_of_trials = describe_columns(study)
    described = {"code": columns_of_trials["participant"], "simulated": columns_of_trials["simulated"],
                 "simulated_device": columns_of_trials["simulated_device"]}  # fmt: skip
    described["simulated_device"]["Levels"] |= {"mixed": "simulated in some of the trials"}
    for question in asked:
        described[question.name] = {"Description": question.text}
        if question.choices:
            described[question.name]["Levels"] = {choice: choice for choice in question.choices}
    write_json(part / "participants.json", described)
    about = {
        "TaskName": task,
        "TaskDescription": f"{_TASKS[study.procedure]} ({study.procedure}), on the haptic device '{study.device}'.",
        **({"Instructions": study.instructions} if study.instructions else {}),
        **columns_of_trials,
    }
    write_json(part / f"task-{task}_beh.json", about)
    pattern = f"sub-*/beh/sub-*_task-{task}_beh.tsv"
    write_text(part / "code" / "read_trials.py", make_python_script(study, pattern))
    write_text(part / "code" / "read_trials.R", make_r_script(study, pattern))


def _write_events(study: Study, columns: Columns, part: Path, incidents: Sequence[Incident]) -> None:
    """Write a table of events per participant, with the column names of BIDS."""
    task = "".join(filter(str.isalnum, study.name))
    heads = ("onset", "duration", "trial_type", "session", "trial", "reason", "time")
    for code, label in make_labels(dict.fromkeys(columns["participant"].tolist())).items():
        mine = [one for one in incidents if one.participant == code]
        lines = [heads]
        for number, one in enumerate(mine):
            later = (two for two in mine[number + 1 :] if two.session == one.session and two.event != "safety")
            until = next((two.onset for two in later), None) if one.event == "stop" else one.onset
            took = "n/a" if until is None else f"{max(0.0, until - one.onset):.3f}"
            reason = escape_formula(" ".join(one.reason.split())) or "n/a"
            lines.append((f"{one.onset:.3f}", took, one.event, str(one.session), str(one.trial), reason, one.time))
        text = "".join("\t".join(line) + "\n" for line in lines)
        (part / f"sub-{label}" / "beh" / f"sub-{label}_task-{task}_events.tsv").write_text(text, encoding="utf-8")
    known = describe_events()
    about = {name: known[{"trial_type": "event"}.get(name, name)] for name in heads if name != "duration"}
    about["duration"] = {"Description": "of a stop: time until it was resumed or ended", "Units": "s"}
    write_json(part / f"task-{task}_events.json", about)


def _word(flags: Any) -> str:
    """ "true", "false" or "n/a" for all trials of a participant, or "mixed"."""
    words = {None: "n/a", True: "true", False: "false"}
    found = {words[value] for value in flags.tolist()}
    return found.pop() if len(found) == 1 else "mixed"


# --------------------------------------------------------------------------------------------------
# Export of a study from its database, in any form, of one kind of data.


@dataclass(frozen=True)
class StudyExport:
    """Files and trials of an export."""

    study: str
    files: tuple[Path, ...]
    trials: int
    practice: int
    on_simulated_device: bool  #: at least one trial
    left_out: str  #: description of data of another kind


def check_output(path: Path) -> None:
    """Raise InputError if the name of the output belongs to no form of export."""
    if path.suffix not in ("", ".csv", ".parquet"):
        raise InputError(f"the output must be NAME.csv, NAME.parquet or a folder; got '{path}'")


def export_study(
    engine: Engine, path: Path, name: str | None = None, kind: Kind | None = None, *, overwrite: bool = False
) -> StudyExport:
    """Export the trials of one `kind` (see `select_kind`), replies and incidents to `path`; all or nothing."""
    check_output(path)
    known = read_study(engine, name)
    columns, left_out = select_kind(tidy(engine, known), kind)
    people = set(columns["participant"].tolist())
    replies = {code: given for code, given in read_replies(engine, known).items() if code in people}
    incidents = list_incidents(engine, known, people)
    if path.suffix:
        write = write_csv if path.suffix == ".csv" else write_parquet
        files = write(known, columns, path, overwrite=overwrite, replies=replies, incidents=incidents)
    else:
        files = (write_bids(known, columns, path, overwrite=overwrite, replies=replies, incidents=incidents),)
    return StudyExport(
        known.name, files, len(columns["trial"]), int((columns["phase"] == "practice").sum()),
        any(simulated is True for simulated in columns["simulated_device"]), left_out,
    )  # fmt: skip
