"""Candidates as they are computed, kept by number: written by one program per run, read by any."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, final

from sqlalchemy import select
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.engine import Engine, Row
from sqlalchemy.exc import SQLAlchemyError

from haptorb.design.design import Design
from haptorb.design.evaluation import Evaluation
from haptorb.design.store.record import read_record, write_record
from haptorb.design.store.stored_results import check_results
from haptorb.design.store.tables import FAMILY, designs, evaluations, open_database, runs
from haptorb.errors import InputError, RecordingError
from haptorb.files.program_lock import ProgramLock
from haptorb.files.sql_engine import lock_database, mask_password
from haptorb.files.table_set import explain_error
from haptorb.version import __version__

__all__ = ["Results", "ResultsWriter", "Run", "open_results", "read_results"]


@dataclass(frozen=True)
class Run:
    """One sweep or optimisation: what decides which values a number has.

    settings  what does beside method and seed, such as the count of a Latin hypercube
    started   UTC, ISO 8601
    """

    id: int
    method: str
    seed: int
    settings: Mapping[str, Any]
    version: str
    started: str
    evaluations: tuple[Evaluation, ...] = field(default=(), repr=False)


@dataclass(frozen=True)
class Results:
    """What a results file holds. Numbers are unique within a run only."""

    design: Design
    runs: tuple[Run, ...]

    @property
    def evaluations(self) -> tuple[Evaluation, ...]:
        """Of all runs, one after the other."""
        return tuple(one for run in self.runs for one in run.evaluations)


@final
class ResultsWriter:
    """A run that candidates are added to; made by `open_results`."""

    def __init__(self, engine: Engine, place: str, run: Run) -> None:
        self._engine, self._place = engine, place
        self.run = run
        self._known = {one.number: one for one in _read_evaluations(engine, run.id)}

    def list_known(self) -> dict[int, Evaluation]:
        """Number → what is stored of this run, also from earlier programs."""
        return dict(self._known)

    def add(self, found: Iterable[Evaluation]) -> None:
        """Store `found`, all or none; numbers that are stored already stay as they are.

        Raises RecordingError if the database cannot take them: what was stored before is kept.
        """
        new = {one.number: one for one in found if one.number not in self._known}
        if not new:
            return
        now = datetime.now(UTC).isoformat(timespec="seconds")
        rows = [{"run": self.run.id, "time": now, **_write_row(one)} for one in new.values()]
        try:
            with self._engine.begin() as connection:
                connection.execute(_insert(self._engine), rows)
        except SQLAlchemyError as cause:
            raise RecordingError(
                f"results {self._place} cannot be written ({explain_error(cause)}): {len(self._known)} designs of this "
                "run are stored; free some space, then repeat the command to continue"
            ) from cause
        self._known.update(new)


@contextmanager
def open_results(
    where: str | Path, design: Design, method: str, seed: int, *, settings: Mapping[str, Any] | None = None,
    resume: bool = True,
) -> Iterator[ResultsWriter]:  # fmt: skip
    """The run of `design` by `method` with `seed` and `settings`, in the file, or PostgreSQL database, `where`.

    An existing run continues; with `resume` false it is refused. Raises RecordingError if `where` holds
    another design, was started by another version of haptorb, or if another program writes the same run.
    """
    place = mask_password(where)
    engine = open_database(where, make=True)
    try:
        run, resumed = _find_run(
            engine, place, design, (method, seed, json.dumps(dict(settings or {}), sort_keys=True))
        )
        conflict = RecordingError(
            f"results {place}: another program is writing run {run.id} ({method}, seed {seed}): end that one first, or "
            "choose another file or seed"
        )
        with ProgramLock(engine, FAMILY, run.id, f".run-{run.id}.lock", conflict):
            if resumed and not resume:
                raise RecordingError(
                    f"results {place} already contain {method} with seed {seed}: continue that run, or choose "
                    "another seed"
                )
            if run.version != __version__:
                raise RecordingError(
                    f"results {place}: run {run.id} was begun with haptorb {run.version}, this is {__version__}: "
                    "install that version, or write to another file"
                )
            yield ResultsWriter(engine, place, run)
    except SQLAlchemyError as cause:
        raise RecordingError(f"results {place} cannot be used: {explain_error(cause)}") from cause
    finally:
        engine.dispose()


def read_results(where: str | Path) -> Results:
    """All that the results file, or PostgreSQL database, `where` holds, also while another program writes to it."""
    place = mask_password(where)
    engine = open_database(where, make=False)
    try:
        with engine.connect() as connection:
            row = connection.execute(select(designs)).first()
            if row is None:
                raise RecordingError(f"{place} has no results yet: run `haptorb design sweep` or `optimise` first")
            design = read_record(row.name, row.text, row.digest, row.record)
            found = connection.execute(select(runs).order_by(runs.c.id)).all()
        results = Results(design, tuple(_make_run(one, tuple(_read_evaluations(engine, one.id))) for one in found))
        check_results(design, results.runs)  # safety: results-checked
        return results
    except (SQLAlchemyError, InputError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError,
            RecursionError) as cause:  # fmt: skip
        what = explain_error(cause) if isinstance(cause, SQLAlchemyError) else str(cause)
        raise RecordingError(f"results {place} cannot be read: {what}") from cause
    finally:
        engine.dispose()


def _find_run(engine: Engine, place: str, design: Design, key: tuple[str, int, str]) -> tuple[Run, bool]:
    """The run, and whether it was there already."""
    method, seed, settings = key
    with engine.connect() as connection:
        is_there = connection.execute(select(designs.c.digest)).first() is not None
    record = "" if is_there else write_record(design)  # computes the base device: not while others wait for the lock
    with engine.begin() as connection:
        lock_database(connection, FAMILY)
        row = connection.execute(select(designs.c.digest, designs.c.name)).first()
        if row is None:
            connection.execute(
                designs.insert().values(digest=design.digest, name=design.name, text=design.text, record=record)
            )
        elif row.digest != design.digest:
            same = row.name == design.name
            why = ", as it was before a change of its file or base device" if same else ""
            raise RecordingError(f"results {place} belong to design '{row.name}'{why}: choose another file")
        wanted = (runs.c.method == method) & (runs.c.seed == seed) & (runs.c.settings == settings)
        known = connection.execute(select(runs).where(wanted)).first()
        if known is None:
            started = datetime.now(UTC).isoformat(timespec="seconds")
            connection.execute(runs.insert().values(
                design=design.digest, method=method, seed=seed, settings=settings, version=__version__, started=started,
            ))  # fmt: skip
        return _make_run(known or connection.execute(select(runs).where(wanted)).one()), known is not None


def _make_run(row: Row[Any], found: tuple[Evaluation, ...] = ()) -> Run:
    return Run(row.id, row.method, row.seed, json.loads(row.settings), row.version, row.started, found)


def _read_evaluations(engine: Engine, run: int) -> list[Evaluation]:
    """Of one run, by number."""
    columns = [column for column in evaluations.c if column.name not in ("run", "time")]
    query = select(*columns).where(evaluations.c.run == run).order_by(evaluations.c.number)
    with engine.connect() as connection:
        return [
            Evaluation(number, json.loads(values), json.loads(objectives), json.loads(constraints), *rest)
            for number, values, objectives, constraints, *rest in connection.execute(query)
        ]


def _insert(engine: Engine) -> Any:
    """Rows that are there already stay: ^C between the transaction's end and what this program knows of it."""
    make = postgresql.insert if engine.dialect.name == "postgresql" else sqlite.insert
    return make(evaluations).on_conflict_do_nothing()


def _write_row(one: Evaluation) -> dict[str, Any]:
    return {
        "number": one.number, "values": json.dumps(dict(one.values)), "objectives": json.dumps(dict(one.objectives)),
        "constraints": json.dumps(dict(one.constraints)), "refused_by": one.refused_by, "reason": one.reason,
        "seconds": one.seconds,
    }  # fmt: skip
