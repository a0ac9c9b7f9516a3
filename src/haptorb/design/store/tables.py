"""The tables of a results database, made at its first opening; what is none of ours, or newer, is refused."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import (
    Column,
    Float,
    ForeignKey,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
)
from sqlalchemy.engine import Engine

from haptorb.errors import RecordingError
from haptorb.files.file_kind import FileKind
from haptorb.files.sql_engine import path_of
from haptorb.files.table_set import TableSet

__all__ = ["FAMILY", "SCHEMA", "designs", "evaluations", "open_database", "runs"]

SCHEMA = 1  #: of this version; a database of a newer one is refused
FAMILY = 0x68617064  #: of PostgreSQL's advisory locks that are ours

_tables = MetaData()
versions = Table("haptorb_design_schema", _tables, Column("version", Integer, primary_key=True))
designs = Table(
    "designs", _tables,
    Column("digest", String(64), primary_key=True),
    Column("name", String(64), nullable=False),
    Column("text", Text, nullable=False),  # the design file, word for word
    Column("record", Text, nullable=False),  # JSON: base device, units, senses and bounds, as they were computed
)  # fmt: skip
runs = Table(
    "runs", _tables,
    Column("id", Integer, primary_key=True),
    Column("design", ForeignKey("designs.digest"), nullable=False),
    Column("method", String(32), nullable=False),
    Column("seed", Integer, nullable=False),
    Column("settings", String(400), nullable=False),  # JSON: what else decides the values of a number
    Column("version", String(32), nullable=False),
    Column("started", String(32), nullable=False),
    UniqueConstraint("design", "method", "seed", "settings"),
)  # fmt: skip
evaluations = Table(
    "evaluations", _tables,
    Column("run", ForeignKey("runs.id"), primary_key=True),
    Column("number", Integer, primary_key=True, autoincrement=False),  # from 0; with the run unique: nothing doubled
    Column("values", Text, nullable=False),  # JSON
    Column("objectives", Text, nullable=False),  # JSON
    Column("constraints", Text, nullable=False),  # JSON
    Column("refused_by", String(64), nullable=False),
    Column("reason", Text, nullable=False),
    Column("seconds", Float, nullable=False),
    Column("time", String(32), nullable=False),
)  # fmt: skip


_RESULTS = TableSet("results of a design", FileKind.RESULTS, _tables, versions, SCHEMA, FAMILY)


def open_database(place: str | Path, *, make: bool) -> Engine:
    """The database at `place`, with its tables; RecordingError if it cannot be reached, is newer, or is none of ours.

    With `make` false one that is not there is refused rather than made.
    """
    path = path_of(place)
    if path is not None:
        _check_place(path, place, make)
    return _RESULTS.open(place, make=make)


def _check_place(path: Path, place: str | Path, make: bool) -> None:
    if path.is_dir():
        raise RecordingError(f"{place} is a folder: name a file, such as results.sqlite")
    if path.exists():
        return
    if not make:
        raise RecordingError(f"results file {place} does not exist: `haptorb design sweep` creates one")
    if not path.absolute().parent.is_dir():
        raise RecordingError(f"{place}: there is no folder {path.parent}; make it first")
