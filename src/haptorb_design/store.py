"""Results database: candidates by run and number; one program writes a run, any may read."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any, final

from sqlalchemy import Column, Float, ForeignKey, Integer, MetaData, String, Table, Text, UniqueConstraint, select
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.engine import Engine, Row
from sqlalchemy.exc import SQLAlchemyError

from haptorb.database_address import mask_password, path_of
from haptorb.devices.base import DeviceText
from haptorb.devices.loader import DeviceTables
from haptorb.errors import InputError, RecordingError, quote
from haptorb.file_kind import FileKind
from haptorb.sql import ProgramLock, TableSet, explain_error, lock_database
from haptorb.version import __version__
from haptorb_design.problem import (
    Bound,
    Design,
    DesignCandidate,
    DesignGoal,
    DesignParameter,
    DesignQuantity,
    Evaluation,
    ParameterPlace,
    Value,
)
from haptorb_design.workers import CANDIDATE_TIME_LIMIT_S, compute_base_values

__all__ = [
    "FAMILY",
    "SCHEMA",
    "Results",
    "ResultsWriter",
    "Run",
    "check_results",
    "check_values",
    "designs",
    "evaluations",
    "open_database",
    "open_results",
    "read_record",
    "read_results",
    "runs",
    "write_record",
]


# --------------------------------------------------------------------------------------------------
# Stored form of a Design, with its base device, so that results can be read without other files.


def write_record(design: Design, limit: float = CANDIDATE_TIME_LIMIT_S) -> str:
    """JSON of everything but the file's text and its digest, with the base device's own numbers, which are computed,
    each within `limit` of processor time [s]."""
    tables = design.base_tables
    return json.dumps({
        "title": design.title,
        "base": design.base,
        "options": dict(design.options),
        "tables": {"name": tables.name, "values": tables.values, "text": tables.text},
        "device": tables.file.as_note() if tables.file else {},
        "parameters": [
            {"name": one.name, "unit": one.unit, "low": one.low, "high": one.high, "step": one.step,
             "choices": [list(choice) for choice in one.choices],
             "places": [[place.key, place.factor, place.offset] for place in one.places]}
            for one in design.parameters
        ],
        "goals": [{"name": goal.name, "sense": goal.sense, **_write_quantity(goal.quantity)} for goal in design.goals],
        "bounds": [{"name": one.name, "low": one.low, "high": one.high, **_write_quantity(one.quantity)}
                   for one in design.bounds],
        "base_values": compute_base_values(design, limit),
    }, default=str)  # fmt: skip


def read_record(name: str, text: str, digest: str, record: str) -> Design:
    """The Design of a record. A user's own function is not stored: computing it raises InputError."""
    raw: Mapping[str, Any] = json.loads(record)
    file = DeviceText.from_note(raw.get("device", {}))
    return Design(
        name=name,
        title=raw["title"],
        base=raw["base"],
        parameters=tuple(_read_parameter(one) for one in raw["parameters"]),
        goals=tuple(DesignGoal(_read_quantity(one), one["sense"], one["name"]) for one in raw["goals"]),
        bounds=tuple(Bound(one["name"], _read_quantity(one), one["low"], one["high"]) for one in raw["bounds"]),
        options=raw["options"],
        text=text,
        digest=digest,
        tables=DeviceTables(**raw["tables"], file=file),
        base_values=raw.get("base_values"),
    )


def _write_quantity(quantity: DesignQuantity) -> dict[str, Any]:
    return {"quantity": quantity.name, "unit": quantity.unit, "wanted": quantity.sense, "text": quantity.text,
            "kinds": list(quantity.kinds)}  # fmt: skip


def _read_quantity(raw: Mapping[str, Any]) -> DesignQuantity:
    name = raw["quantity"]
    return DesignQuantity(name, raw["unit"], raw["wanted"], raw["text"], tuple(raw["kinds"]), partial(_compute, name))


def _compute(name: str, candidate: DesignCandidate) -> float:
    """Compute haptorb's own quantity of that name; results of a user's function cannot be recomputed."""
    from haptorb_design.objectives import quantity

    try:
        return quantity(name).compute(candidate)
    except InputError as cause:
        raise InputError(f"'{name}' cannot be computed from a results file: {cause}") from cause


def _read_parameter(raw: Mapping[str, Any]) -> DesignParameter:
    places = tuple(ParameterPlace(*place) for place in raw["places"])
    choices = tuple((label, value) for label, value in raw["choices"])
    return DesignParameter(raw["name"], places, raw["unit"], raw["low"], raw["high"], raw["step"], choices)


# --------------------------------------------------------------------------------------------------
# Schema of a results database, created at its first opening; foreign and newer databases are refused.


SCHEMA = 1  #: of this version; databases of newer ones are refused
FAMILY = 0x68617064  #: key of our PostgreSQL advisory locks

_tables = MetaData()
versions = Table("haptorb_design_schema", _tables, Column("version", Integer, primary_key=True))
designs = Table(
    "designs", _tables,
    Column("digest", String(64), primary_key=True),
    Column("name", String(64), nullable=False),
    Column("text", Text, nullable=False),  # the design file, verbatim
    Column("record", Text, nullable=False),  # JSON: base device, units, senses and bounds, as computed
)  # fmt: skip
runs = Table(
    "runs", _tables,
    Column("id", Integer, primary_key=True),
    Column("design", ForeignKey("designs.digest"), nullable=False),
    Column("method", String(32), nullable=False),
    Column("seed", Integer, nullable=False),
    Column("settings", String(400), nullable=False),  # JSON: other settings that determine the values of a number
    Column("version", String(32), nullable=False),
    Column("started", String(32), nullable=False),
    UniqueConstraint("design", "method", "seed", "settings"),
)  # fmt: skip
evaluations = Table(
    "evaluations", _tables,
    Column("run", ForeignKey("runs.id"), primary_key=True),
    Column("number", Integer, primary_key=True, autoincrement=False),  # from 0; unique with the run
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
    """Open the database at `place`; RecordingError if it cannot be reached, is newer, or is not a results database.

    With `make` false a missing database is refused instead of created.
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


# --------------------------------------------------------------------------------------------------
# Validation of a results file, which may be damaged or foreign.


_NAME = re.compile(r"[a-z][a-z0-9-]{0,63}")  #: name of a design, also of its device files
_WORD = re.compile(r"[\w.-]{1,64}")
_MAX_NUMBER = 1e300  #: maximum of any number
_MAX_TEXT_CHARACTERS = 4000  #: maximum length of a text [characters]


def check_results(design: Design, runs: Iterable[Run]) -> None:
    """Raise InputError for the first invalid value in a results file."""
    _require(isinstance(design.name, str) and bool(_NAME.fullmatch(design.name)), "name of the design", design.name)
    for what, text in (("title", design.title), ("base", design.base), ("text", design.text)):
        _require(isinstance(text, str) and len(text) <= 64 * _MAX_TEXT_CHARACTERS, f"{what} of the design", text)
    _require(0 < len(design.parameters) <= 1000 and 0 < len(design.goals) <= 100, "parameters and objectives", design)
    for parameter in design.parameters:
        _check_parameter(parameter)
    for goal in design.goals:
        _check_word("name of an objective", goal.name)
        _require(goal.sense in ("minimise", "maximise"), "sense of an objective", goal.sense)
    parts = [(one.name, one.quantity) for one in design.goals] + [(one.name, one.quantity) for one in design.bounds]
    for name, quantity in parts:
        _check_word("name of an objective or constraint", name)
        for text in (quantity.name, quantity.unit, quantity.text):
            _check_text("text of an objective or constraint", text)
    for bound in design.bounds:
        _require(all(end is None or _is_number(end) for end in (bound.low, bound.high)), "bounds", bound.name)
    for run in runs:
        _require(isinstance(run.seed, int) and isinstance(run.settings, Mapping), "seed or settings of a run", run.seed)
        for text in (run.method, run.version, run.started):
            _check_text("text of a run", text)
        for one in run.evaluations:
            _check_evaluation(design, one)


def _check_parameter(one: DesignParameter) -> None:
    _check_word("name of a parameter", one.name)
    _check_text("unit of a parameter", one.unit)
    if one.choices:
        _require(all(isinstance(label, str) and len(label) <= 400 for label, _ in one.choices), "choices", one.name)
        return
    _require(_is_number(one.low) and _is_number(one.high) and one.low < one.high, "range of a parameter", one.name)


def _check_evaluation(design: Design, one: Evaluation) -> None:
    where = f"design {quote(one.number)}"
    _require(isinstance(one.number, int) and 0 <= one.number < 10**12, f"number of {where}", one.number)
    values = one.values
    _require(isinstance(values, Mapping) and set(values) == {p.name for p in design.parameters}, where, values)
    for parameter in design.parameters:
        value = values[parameter.name]
        fits = value in parameter.labels if parameter.labels else _is_number(value)
        _require(fits, f"{parameter.name} of {where}", value)
    for numbers in (one.objectives, one.constraints):
        _require(
            isinstance(numbers, Mapping) and all(map(_is_number, numbers.values())), f"numbers of {where}", numbers
        )
    _require(_is_number(one.seconds), f"time of {where}", one.seconds)
    for text in (one.refused_by, one.reason):
        _require(isinstance(text, str) and len(text) <= _MAX_TEXT_CHARACTERS, f"reason of {where}", text)
    if one.valid:
        _require({goal.name for goal in design.goals} <= set(one.objectives), f"objectives of {where}", one.objectives)


def _check_word(what: str, text: Any) -> None:
    _require(isinstance(text, str) and bool(_WORD.fullmatch(text)), what, text)


def _check_text(what: str, text: Any) -> None:
    _require(
        isinstance(text, str) and len(text) <= _MAX_TEXT_CHARACTERS and (text.isprintable() or not text), what, text
    )


def _is_number(value: Any) -> bool:
    return (
        isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value) and abs(value) < _MAX_NUMBER
    )


def _require(fits: bool, what: str, found: Any) -> None:
    if not fits:
        raise InputError(f"{what} is not one that haptorb wrote; got {quote(found)}")


@dataclass(frozen=True)
class Run:
    """One sweep or optimisation, with the settings that determine the values of a number.

    settings  other than method and seed, such as the count of a Latin hypercube
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
    """Content of a results file. Numbers of candidates are unique within a run only.

    Parameters
    ----------
    design : Design
        The design.
    runs : tuple of Run
        Sweeps and optimisations with their evaluations.
    """

    design: Design
    runs: tuple[Run, ...]

    @property
    def evaluations(self) -> tuple[Evaluation, ...]:
        """Of all runs, in sequence."""
        return tuple(one for run in self.runs for one in run.evaluations)


@final
class ResultsWriter:
    """Run in a results file to which evaluations are added; `open_results` makes one.

    Parameters
    ----------
    engine : Engine
        Database (SQLAlchemy).
    place : str
        File or address of the database, for messages.
    run : Run
        The run.
    """

    def __init__(self, engine: Engine, place: str, run: Run) -> None:
        self._engine, self._place = engine, place
        self.run = run
        self._known = {one.number: one for one in _read_evaluations(engine, run.id)}

    def list_known(self) -> dict[int, Evaluation]:
        """Number → stored evaluation of this run, also from earlier programs."""
        return dict(self._known)

    def add(self, found: Iterable[Evaluation]) -> None:
        """Store evaluations, all or none.

        Parameters
        ----------
        found : iterable of Evaluation
            The evaluations; one whose number is stored already changes nothing.

        Raises
        ------
        RecordingError
            If they cannot be stored; earlier ones are kept.
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
    resume: bool = True, limit: float = CANDIDATE_TIME_LIMIT_S,
) -> Iterator[ResultsWriter]:  # fmt: skip
    """Open a run of a design in a results file, until the `with` block ends; an existing run continues.

    Parameters
    ----------
    where : str or Path
        SQLite file, or address of a PostgreSQL database.
    design : Design
        The design.
    method : str
        Method of the run, such as "sobol".
    seed : int
        Seed of the run.
    settings : Mapping, optional
        Further settings that determine the candidates.
    resume : bool
        False: refuse a run that exists.
    limit : float
        Processor time after which a number of the base device is left out [s].

    Yields
    ------
    ResultsWriter
        The run, to which evaluations are added.

    Raises
    ------
    RecordingError
        If the file holds another design, was started by another version of haptorb, or another program writes to the
        run.
    """
    place = mask_password(where)
    engine = open_database(where, make=True)
    try:
        run, resumed = _find_run(
            engine, place, design, (method, seed, json.dumps(dict(settings or {}), sort_keys=True)), limit
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
    """Read a results file, also while another program writes to it.

    Parameters
    ----------
    where : str or Path
        SQLite file, or address of a PostgreSQL database.

    Returns
    -------
    Results
        The design and all runs.

    Raises
    ------
    RecordingError
        If there is no such file, or it is not a results file of haptorb.
    """
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


def _find_run(engine: Engine, place: str, design: Design, key: tuple[str, int, str], limit: float) -> tuple[Run, bool]:
    """The run, and whether it existed before."""
    method, seed, settings = key
    with engine.connect() as connection:
        is_there = connection.execute(select(designs.c.digest)).first() is not None
    record = (
        "" if is_there else write_record(design, limit)
    )  # computes the base device: not while others wait for the lock
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
    """Evaluations of one run, by number."""
    columns = [column for column in evaluations.c if column.name not in ("run", "time")]
    query = select(*columns).where(evaluations.c.run == run).order_by(evaluations.c.number)
    with engine.connect() as connection:
        return [
            Evaluation(number, json.loads(values), json.loads(objectives), json.loads(constraints), *rest)
            for number, values, objectives, constraints, *rest in connection.execute(query)
        ]


def _insert(engine: Engine) -> Any:
    """Insert rows, ignoring existing ones: after ^C a transaction may be complete without this program knowing."""
    make = postgresql.insert if engine.dialect.name == "postgresql" else sqlite.insert
    return make(evaluations).on_conflict_do_nothing()


def _write_row(one: Evaluation) -> dict[str, Any]:
    return {
        "number": one.number, "values": json.dumps(dict(one.values)), "objectives": json.dumps(dict(one.objectives)),
        "constraints": json.dumps(dict(one.constraints)), "refused_by": one.refused_by, "reason": one.reason,
        "seconds": one.seconds,
    }  # fmt: skip


# --------------------------------------------------------------------------------------------------
# Consistency of a resumed run.


def check_values(wanted: Mapping[int, Mapping[str, Value]], stored: Iterable[Evaluation]) -> None:
    """Raise RecordingError unless each stored candidate has the values that its number determines now."""
    for one in stored:
        for name, value in wanted[one.number].items():
            if one.values.get(name) != value:
                raise RecordingError(
                    f"candidate {one.number} of the results has {name} = {one.values.get(name)}, this program "
                    f"computes {value}: another version of haptorb, NumPy, SciPy or pymoo wrote them; use another "
                    "--seed, or another results file"
                )
