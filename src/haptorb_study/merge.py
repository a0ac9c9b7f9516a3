"""Merge databases of several laboratories into a new one; complete or not at all.

Each source is read from a snapshot and not changed, except for a record that a copy of it exists. Trials, orders and
events are unchanged; sessions and participants are renumbered, and an event of each session names its source.
Recordings are copied beside the new database, or linked on the same file system.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Row, Table, select
from sqlalchemy.engine import Engine

from haptorb.database_address import mask_password, path_of
from haptorb.errors import InputError, RecordingError
from haptorb.sql import connect_file, lock_file_of, make_engine
from haptorb_study.data_kind import describe_kind, read_contents
from haptorb_study.database import (
    check_database_file,
    contents,
    copies,
    database,
    events,
    identity_of,
    lock_session,
    participants,
    replies,
    session_lock_end,
    sessions,
    studies,
    trials,
    withdrawn,
)
from haptorb_study.database_copies import record_copy
from haptorb_study.json_values import utc_now
from haptorb_study.participant_codes import check_code, fold_spelling, is_reserved
from haptorb_study.recordings import folder_of, locate_recording, name_parts, name_recording
from haptorb_study.study_file import Study, study_of

__all__ = ["Merged", "Renaming", "merge_databases", "read_renaming"]

_RENAMING = re.compile(r"([1-9][0-9]?):([^=]+)=(.+)")
_MAX_LISTED_CLASHES = 12  #: clashes listed in a message
_SESSION_TABLES = (trials, events, replies)  #: tables with rows of a session


@dataclass(frozen=True)
class Renaming:
    """Renaming of the codes of one source: a single code, or all by a pattern in which * is the code."""

    source: int  #: number of the database, from 1, in the order given
    old: str  #: code, or * for every code without a renaming of its own
    new: str


@dataclass(frozen=True)
class Merged:
    """Result of a merge."""

    place: str
    holds: str
    people: dict[str, int]  #: path of a source → participants from it
    trials: int
    recordings: int  #: files copied or linked
    missing: tuple[str, ...]  #: recordings that are not beside their database
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class _Source:
    number: int
    place: str
    engine: Engine
    studies: dict[str, Row[Any]]  # digest → row
    holds: str


def read_renaming(text: str) -> Renaming:
    """Parse NUMBER:OLD=NEW, or NUMBER:*=PATTERN such as 2:*=B-*; InputError otherwise.

    >>> read_renaming("2:P01=Q01")
    Renaming(source=2, old='P01', new='Q01')
    """
    found = _RENAMING.fullmatch(text)
    if found is None or (found[2] == "*") != ("*" in found[3]):
        raise InputError(
            "--rename must be NUMBER:OLD=NEW, such as 2:P01=Q01 for code P01 of the second database, or 2:*=B-* for "
            f"all of its codes; got '{text}'"
        )
    return Renaming(int(found[1]), found[2], found[3])


def merge_databases(
    places: Sequence[str | Path], into: str | Path, *, study: str | None = None, renamings: Sequence[Renaming] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Merged:  # fmt: skip
    """Merge the databases at `places` into a new one, `into`.

    study      name of the study; None: all, which every source must contain
    renamings  of codes that occur in two sources
    progress   receives (participants done, participants in all)

    Raises InputError or RecordingError, with nothing written, if a source cannot be read, if they hold different
    studies, versions or kinds of data, if codes clash, or if `into` exists.
    """
    if len(places) < 2:
        raise InputError("a merge needs two databases or more")
    if "://" in str(into):
        raise InputError("--into must be the file of a new database")
    target = Path(into).expanduser().absolute()
    if target.exists():
        raise RecordingError(f"{target} exists: a merge only makes a new database; choose another name")
    if not target.parent.is_dir():
        raise RecordingError(f"{target} cannot be written: there is no folder {target.parent}")
    if len({identity_of(place) for place in places}) < len(places):
        raise InputError("the same database was given twice")
    with tempfile.TemporaryDirectory(prefix=".merge-", dir=target.parent) as folder:
        sources = [_open_source(n, place, Path(folder), study) for n, place in enumerate(places, 1)]
        try:
            holds, notes = _compare(sources)
            codes = _assign_codes(sources, renamings)
            part = Path(folder) / "merged.db"
            engine = database(part)
            made: list[Path] = []
            try:
                with engine.begin() as connection:
                    if holds:
                        connection.execute(contents.insert().values(id=1, holds=holds))
                    writer = _Writer(connection, target, Path(folder), made)
                    writer.copy(sources, codes, progress)
                engine.dispose()
                with closing(sqlite3.connect(part)) as raw:  # leave no write-ahead log beside the file
                    raw.execute("PRAGMA wal_checkpoint(TRUNCATE)")
                    raw.execute("PRAGMA journal_mode = DELETE")
                _publish(part, target)
            except BaseException:
                for path in made:
                    path.unlink(missing_ok=True)
                raise
        finally:
            for source in sources:
                source.engine.dispose()
    for place in places:  # a later withdrawal is then applied to these too
        with suppress(RecordingError):
            engine = database(place, make=False)
            record_copy(engine, "merged", target, settings={"codes": writer.codes[str(place)]})
            engine.dispose()
    return Merged(
        str(target), holds, writer.people, writer.trials, writer.files, tuple(sorted(writer.missing)), tuple(notes)
    )  # fmt: skip


def _publish(part: Path, target: Path) -> None:
    """Rename the finished file to `target`, unless that exists by now."""
    try:
        os.link(part, target)
    except FileExistsError as cause:
        raise RecordingError(
            f"{target} was created in the meantime: nothing was merged; choose another name"
        ) from cause
    except OSError:  # a file system without links
        os.replace(part, target)


def _open_source(number: int, place: str | Path, folder: Path, study: str | None) -> _Source:
    """Open the database at `place`; of a file, a snapshot in `folder`, migrated to the newest schema."""
    shown = mask_password(place)
    path = path_of(place)
    if path is not None:
        path = path.expanduser()
        if not path.exists():
            raise RecordingError(f"database {shown} does not exist")
        check_database_file(path)
        copy = folder / f"source-{number}.db"
        try:
            with closing(connect_file(path, read_only=True)) as raw, closing(sqlite3.connect(copy)) as kept:
                raw.backup(kept)
        except sqlite3.Error as cause:
            raise RecordingError(f"database {shown} cannot be read: {cause}") from cause
        engine = database(copy, make=False)
        _check_idle(path, engine)
    else:
        engine = database(place, make=False)
    with engine.connect() as connection:
        rows = connection.execute(select(studies)).all()
    known = {str(row.digest): row for row in rows if study in (None, row.name)}
    if not known:
        what = f"no study '{study}'" if study else "no study yet"
        engine.dispose()
        raise InputError(f"database {shown} holds {what}: nothing was merged")
    return _Source(number, str(place), engine, known, read_contents(engine))


def _check_idle(path: Path, engine: Engine) -> None:
    """Raise RecordingError if a session of the database at `path` is running: the snapshot would be incomplete."""
    with engine.connect() as connection:
        running = connection.execute(select(sessions.c.id).where(sessions.c.ended.is_(None))).scalars().all()
    for session in running:
        if lock_file_of(path, session_lock_end(session)).exists():
            lock_session(make_engine(path), session).release()


def _compare(sources: Sequence[_Source]) -> tuple[str, list[str]]:
    """Kind of data of the sources, and notes; InputError if they cannot be merged."""
    first = sources[0]
    notes = []
    for other in sources[1:]:
        if first.holds and other.holds and first.holds != other.holds:  # safety: study-merge-kind
            raise InputError(
                f"database {mask_password(first.place)} holds {describe_kind(first.holds)}, and "
                f"{mask_password(other.place)} holds {describe_kind(other.holds)}: they are never merged"
            )
        if set(first.studies) != set(other.studies):  # safety: study-merge-digest
            raise InputError(_explain_difference(first, other))
        for digest, row in first.studies.items():
            if row.text != other.studies[digest].text:
                notes.append(
                    f"study '{row.name}': the files differ, but not in how the study runs (comments or the plan); "
                    f"that of {mask_password(first.place)} is kept"
                )
    return next((one.holds for one in sources if one.holds), ""), notes


def _explain_difference(first: _Source, other: _Source) -> str:
    one, two = mask_password(first.place), mask_password(other.place)
    names = {row.name for row in first.studies.values()}, {row.name for row in other.studies.values()}
    both = names[0] & names[1]
    if names[0] != names[1]:
        only = [f"{place}: {', '.join(sorted(mine))}" for place, mine in ((one, names[0]), (two, names[1]))]
        choose = f"; --study {sorted(both)[0]} merges that one" if both else ""
        return f"the databases hold different studies ({'; '.join(only)}): nothing was merged{choose}"
    lines = []
    for name in sorted(both):
        versions = [next(row for row in of.studies.values() if row.name == name) for of in (first, other)]
        folders = [folder_of(source.place) for source in (first, other)]
        if versions[0].digest != versions[1].digest:
            keys = _differing_keys(
                *(
                    study_of(row.text, f"'{row.name}'", stored=True, devices=folder)
                    for row, folder in zip(versions, folders, strict=True)
                )
            )
            digests = " and ".join(row.digest for row in versions)
            lines.append(f"study '{name}' differs in {', '.join(keys) or 'its text'} (digests {digests})")
    return f"{one} and {two} hold different versions: {'; '.join(lines)}. Nothing was merged: they are two studies"


def _differing_keys(one: Study, two: Study) -> list[str]:
    return [name for name in type(one).model_fields if name != "plan" and getattr(one, name) != getattr(two, name)]


def _assign_codes(sources: Sequence[_Source], renamings: Sequence[Renaming]) -> dict[tuple[int, int], str]:
    """(source, participant's id) → code in the merged database; InputError with all clashes, if any."""
    for one in renamings:
        if one.source > len(sources):
            raise InputError(f"--rename {one.source}:...: there are only {len(sources)} databases")
    rules = {(one.source, one.old): one.new for one in renamings}
    used: set[tuple[int, str]] = set()
    found: dict[tuple[int, int], str] = {}
    taken: dict[tuple[str, str], tuple[int, str, bool]] = {}  # (study, folded code) → source, code, participant?
    clashes: list[str] = []
    for source in sources:
        with source.engine.connect() as connection:
            people = [(True, row) for row in connection.execute(select(participants).order_by(participants.c.ordinal))]
            gone = [(False, row) for row in connection.execute(select(withdrawn))]
        for person, row in people + gone:
            if row.study not in source.studies:
                continue
            code = str(row.code)
            rule = (source.number, code) if (source.number, code) in rules else (source.number, "*")
            if person and rule in rules:
                used.add(rule)
                code = check_code(rules[rule].replace("*", code))
                if is_reserved(code) != is_reserved(row.code):
                    raise InputError(f"--rename {source.number}:{row.code}={code}: SIM is for simulated participants")
            if person:
                found[source.number, row.id] = code
            key = (row.study, fold_spelling(code))
            number, other, theirs = taken.setdefault(key, (source.number, str(row.code), person))
            if (number, other, theirs) != (source.number, row.code, person) and (person or theirs):
                clashes.append(f"{other} ({number}), {row.code} ({source.number})")
    if clashes:
        more = f" and {len(clashes) - _MAX_LISTED_CLASHES} more" if len(clashes) > _MAX_LISTED_CLASHES else ""
        listed = "; ".join(clashes[:_MAX_LISTED_CLASHES])
        places = ", ".join(f"{one.number}: {mask_password(one.place)}" for one in sources)
        raise InputError(
            f"{len(clashes)} codes clash, or are those of people who withdrew: {listed}{more} ({places}). Nothing was "
            "merged. If they are different people, rename: --rename 2:P01=Q01, or all of the second: --rename '2:*=B-*'"
        )
    unused = [f"{number}:{old}" for number, old in rules if (number, old) not in used]
    if unused:
        raise InputError(f"--rename {unused[0]}: there is no such code; nothing was merged")
    return found


class _Writer:
    """Copies rows and recordings in one transaction of the new database; `made`: files created so far."""

    def __init__(self, connection: Connection, target: Path, folder: Path, made: list[Path]) -> None:
        self._connection, self._target, self._folder, self._made = connection, target, folder, made
        self.people: dict[str, int] = {}
        self.codes: dict[str, dict[str, str]] = {}  #: path of a source → original code → code in the new database
        self.trials = self.files = 0
        self.missing: set[str] = set()

    def copy(
        self, sources: Sequence[_Source], codes: Mapping[tuple[int, int], str],
        progress: Callable[[int, int], None] | None,
    ) -> None:  # fmt: skip
        """Copy all sources."""
        ordinals: dict[str, int] = {}
        left: set[tuple[str, str]] = set()
        done = 0
        for source in sources:
            self.people[source.place], self.codes[source.place] = 0, {}
            for digest, row in source.studies.items():
                if digest not in ordinals:
                    ordinals[digest] = 0
                    self._connection.execute(studies.insert().values(**row._mapping))
            with source.engine.connect() as old:
                rows = old.execute(select(participants).order_by(participants.c.ordinal)).all()
                for person in rows:
                    if person.study in source.studies:
                        ordinal = ordinals[person.study]
                        ordinals[person.study] += 1
                        self._copy_person(source, old, person, codes[source.number, person.id], ordinal)
                        self.people[source.place] += 1
                        self.codes[source.place][person.code] = codes[source.number, person.id]
                        done += 1
                        if progress is not None:
                            progress(done, len(codes))
                for gone in old.execute(select(withdrawn)).all():
                    if gone.study in source.studies and (gone.study, gone.code) not in left:
                        left.add((gone.study, gone.code))
                        ordinal = ordinals[gone.study]
                        ordinals[gone.study] += 1
                        self._connection.execute(
                            withdrawn.insert().values(
                                study=gone.study, code=gone.code, ordinal=ordinal, at=gone.at, text=gone.text
                            )
                        )
            place = source.place if "://" in source.place else str(Path(source.place).expanduser().absolute())
            back = json.dumps({"codes": {new: old for old, new in self.codes[source.place].items()}})
            self._connection.execute(
                copies.insert().values(kind="source", place=place, study="", settings=back, at=utc_now())
            )

    def _copy_person(self, source: _Source, old: Connection, person: Row[Any], code: str, ordinal: int) -> None:
        new = self._insert(participants, person, code=code, ordinal=ordinal)
        for session in old.execute(select(sessions).where(sessions.c.participant == person.id)).all():
            number = self._insert(sessions, session, participant=new)
            renamed = "" if code == person.code else f", code {person.code}"
            where = mask_password(source.place)
            for table in _SESSION_TABLES:
                rows = [
                    {key: value for key, value in row._mapping.items() if key != "id"} | {"session": number}
                    for row in old.execute(select(table).where(table.c.session == session.id).order_by(table.c.id))
                ]
                if table is trials:
                    self.trials += len(rows)
                    self._copy_recordings(source, person.study, number, rows)
                if rows:
                    self._connection.execute(table.insert(), rows)
            self._connection.execute(
                events.insert().values(
                    session=number, kind="merged", trial=0, at=utc_now(),
                    text=f"from {where}, session {session.id}{renamed}",
                )
            )  # fmt: skip

    def _insert(self, table: Table, row: Row[Any], **changed: Any) -> int:
        values = {key: value for key, value in row._mapping.items() if key != "id"} | changed
        key = self._connection.execute(table.insert().values(**values)).inserted_primary_key
        assert key is not None
        return int(key[0])

    def _copy_recordings(self, source: _Source, digest: str, session: int, rows: list[dict[str, Any]]) -> None:
        """Copy or link the recordings beside the new database, under its session numbers."""
        folder, known = folder_of(source.place), dict[Path, str]()
        name = source.studies[digest].name
        for row in rows:
            if not row["recording"]:
                continue
            named = Path(row["recording"].partition("#t=")[0])
            path = locate_recording(folder, row["recording"]) or folder / named.name
            if path not in known:
                if locate_recording(folder, row["recording"]) is None or not path.is_file():
                    self.missing.add(str(path))
                    known[path] = str(path)  # its original path
                else:
                    first = int(name_parts(path).get("first_trial", row["number"] + 1))
                    new = name_recording(self._target.parent, name, session, first)
                    _link_or_copy(path, new)
                    self._made.append(new)
                    self.files += 1
                    known[path] = new.name
            row["recording"] = known[path] + row["recording"][len(row["recording"].partition("#t=")[0]) :]


def _link_or_copy(old: Path, new: Path) -> None:
    try:
        os.link(old, new)
    except OSError:
        try:
            shutil.copy2(old, new)
        except OSError as cause:
            new.unlink(missing_ok=True)
            raise RecordingError(f"recording {old} cannot be copied to {new}: {cause.strerror or cause}") from cause
