"""A study from its database into an export of any form, of one kind of data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sqlalchemy.engine import Engine

from haptorb.apps.study.store.bids import write_bids
from haptorb.apps.study.store.columns import read_replies, read_study, select_kind, tidy
from haptorb.apps.study.store.contents import Kind
from haptorb.apps.study.store.export import write_csv, write_parquet
from haptorb.apps.study.store.incidents import list_incidents
from haptorb.errors import InputError

__all__ = ["StudyExport", "check_output", "export_study"]


@dataclass(frozen=True)
class StudyExport:
    """What was written."""

    study: str
    files: tuple[Path, ...]
    trials: int
    practice: int
    on_simulated_device: bool  #: some of them
    left_out: str  #: data of another kind, in words


def check_output(path: Path) -> None:
    """InputError if no form of export has such a name."""
    if path.suffix not in ("", ".csv", ".parquet"):
        raise InputError(f"the output must be NAME.csv, NAME.parquet or a folder; got '{path}'")


def export_study(
    engine: Engine, path: Path, name: str | None = None, kind: Kind | None = None, *, overwrite: bool = False
) -> StudyExport:
    """Write the trials of one `kind` (see `select_kind`), replies and incidents to `path`, whole or not at all."""
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
