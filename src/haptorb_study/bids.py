"""Export as a BIDS folder (Brain Imaging Data Structure, behavioural data); the whole folder or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from haptorb.errors import HaptorbError, RecordingError
from haptorb.files import escape_formula, foreign_text, parse_json, read_text, replace_folder
from haptorb.version import __version__
from haptorb_study.columns import Columns
from haptorb_study.data_dictionary import describe_columns, describe_events
from haptorb_study.export_scripts import make_python_script, make_r_script
from haptorb_study.export_table import Replies, explain_write_error, write_json, write_table, write_text
from haptorb_study.incidents import Incident
from haptorb_study.participant_codes import make_labels
from haptorb_study.study_file import Study, study_of

__all__ = ["write_bids"]


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
        text = read_text(folder / "code" / "study.toml", "study file", RecordingError)
        if text == study.text:
            return ""
        found = study_of(text, str(folder), stored=True, devices=study.devices)
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
