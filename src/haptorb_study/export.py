"""Export of a study from its database, in any form, of one kind of data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sqlalchemy.engine import Engine

from haptorb.errors import InputError
from haptorb_study.bids import write_bids
from haptorb_study.columns import read_replies, read_study, select_kind, tidy
from haptorb_study.data_kind import Kind
from haptorb_study.export_table import write_csv, write_parquet
from haptorb_study.incidents import list_incidents

__all__ = ["StudyExport", "check_output", "export_study"]


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
    if path.suffix.lower() not in ("", ".csv", ".parquet"):
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
        write = write_csv if path.suffix.lower() == ".csv" else write_parquet
        files = write(known, columns, path, overwrite=overwrite, replies=replies, incidents=incidents)
    else:
        files = (write_bids(known, columns, path, overwrite=overwrite, replies=replies, incidents=incidents),)
    return StudyExport(
        known.name, files, len(columns["trial"]), int((columns["phase"] == "practice").sum()),
        any(simulated is True for simulated in columns["simulated_device"]), left_out,
    )  # fmt: skip
