"""Stored feel session: ratings and choice as JSON lines, every trace as CSV, in one folder.

    FOLDER/ratings.jsonl          one line per rating, feeling or choice, durable before the next begins
    FOLDER/traces/NAME-0001.csv   pose of the object and wrench on it at every tick

A line truncated by a crash is skipped when read, and reported.
"""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Iterable, Iterator
from dataclasses import MISSING, asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from time import sleep
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import State
from haptorb.errors import InputError, RecordingError, quote
from haptorb.files import parse_json, read_bytes, read_text, replace_file
from haptorb.recording.row import RowLayout
from haptorb_study.codes import find_other_spelling, suggest_code
from haptorb_study.feel.designs import Candidate, Candidates
from haptorb_study.procedures import SCALE, Answer
from haptorb_study.procedures import rating as rating_of

__all__ = [
    "COLUMNS",
    "FELT",
    "HAND",
    "SCORES",
    "Choice",
    "DesignRating",
    "FeelSession",
    "Feeling",
    "Record",
    "Trace",
    "check_person",
    "is_felt",
    "parse_records",
    "read_trace",
    "trace_rows",
    "utc_now",
    "write_line",
    "write_trace",
]


# --------------------------------------------------------------------------------------------------
# Records of a session's file: ratings, presentations, choice; one JSON object per line, parsed strictly.


@dataclass(frozen=True)
class DesignRating:
    """A person's rating of a design."""

    design: str
    digest: str
    score: int
    person: str
    comment: str
    time: str
    trace: str = ""
    feeling: str = ""  #: presentation that was rated; a later rating of the same presentation replaces an earlier one
    blind: bool = False  #: whether the designs were hidden from the person


@dataclass(frozen=True)
class Feeling:
    """One presentation of a design to one person."""

    design: str
    digest: str
    person: str
    time: str
    trace: str
    feeling: str = ""
    blind: bool = False
    scale: float = 1.0  #: factor of all torques of the handle


@dataclass(frozen=True)
class Choice:
    """The selected design, and the reason."""

    design: str
    digest: str
    person: str
    comment: str
    time: str


Record = DesignRating | Feeling | Choice

_KINDS: dict[str, type[Record]] = {"rating": DesignRating, "feeling": Feeling, "choice": Choice}
_TYPES: dict[str, tuple[type, ...]] = {"score": (int,), "blind": (bool,), "scale": (int, float)}  # others are strings


def write_line(record: Record) -> str:
    """`record` as one line of JSON, without line end."""
    kind = next(name for name, known in _KINDS.items() if isinstance(record, known))
    return json.dumps({"kind": kind, **asdict(record)}, ensure_ascii=False)


def parse_records(lines: Iterable[str]) -> tuple[list[Record], int]:
    """Records in `lines`, and the number of invalid lines: truncated by a crash, or foreign."""
    found: list[Record] = []
    skipped = 0
    for line in lines:
        record = _parse_record(line)
        if record is None:
            skipped += bool(line.strip())
        else:
            found.append(record)
    return found, skipped


def _parse_record(line: str) -> Record | None:
    try:
        values: dict[str, Any] = parse_json(line)
        kind = _KINDS[values.pop("kind")]
    except (ValueError, AttributeError, KeyError, TypeError):
        return None
    known = {field.name: field.default is MISSING for field in fields(kind)}
    needed = {name for name, must in known.items() if must}
    if not needed <= set(values) <= set(known):
        return None
    for name, value in values.items():
        wanted = _TYPES.get(name, (str,))
        if not isinstance(value, wanted) or (isinstance(value, bool) and bool not in wanted):
            return None
    return kind(**values)


def utc_now() -> str:
    """Time stamp of a record."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


# --------------------------------------------------------------------------------------------------
# Trace of a presentation: state of the part at every tick, and its CSV file.


COLUMNS = ("t_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "fx_n", "fy_n", "fz_n", "tx_nm", "ty_nm", "tz_nm")
#: quantities at the handle: torque requested and commanded, guard's scale, whether the device was saturated
HAND = ("asked_nm", "given_nm", "guard_gain", "saturated")

_FELT_FORCE_N, _FELT_TORQUE_NM = 0.1, 0.002  #: perception limits on the part [N], [N·m]
_FELT_MOTION_M, _FELT_ROTATION_RAD = (
    0.5e-3,
    np.radians(1.0),
)  #: perception limits of motion since the first tick [m], [rad]
FELT = "0.1 N or 2 mN·m on the part, or 0.5 mm or 1° of motion, since it was chosen"  #: as text
_MAX_TRACE_BYTES = 256 * 1024 * 1024  #: maximum size of a trace [bytes]
_BLOCK_ROWS = 500  #: rows written at a time
_BLOCK_PAUSE_S = 0.002  #: pause between two blocks while a servo runs: this process must send its keep-alive [s]


@final
class Trace:
    """Trace of a presentation: append ticks or rows, then store it with `FeelSession.store_trace`."""

    def __init__(self, design: Candidate) -> None:
        self.design = design
        self._parts: list[Array] = []

    def append(self, target: State, wrench: Array) -> None:
        """Append a tick: state of the object and wrench on it (6,); the quantities at the handle are unknown."""
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_matrix(target.R_SR).as_quat()
        row = [target.t, *target.p.tolist(), *turn.tolist(), *np.asarray(wrench, dtype=float).tolist()]
        self._parts.append(np.array([row + [np.nan] * len(HAND)]))

    def extend(self, rows: Array) -> None:
        """Append ticks (n, 18) by COLUMNS and HAND."""
        if len(rows):
            self._parts.append(rows)

    def __len__(self) -> int:
        return sum(map(len, self._parts))

    @property
    def rows(self) -> Array:
        """(n, 14) by COLUMNS."""
        return self.all_rows[:, : len(COLUMNS)]

    @property
    def all_rows(self) -> Array:
        """(n, 18) by COLUMNS and HAND."""
        width = len(COLUMNS) + len(HAND)
        return np.concatenate([np.empty((0, width)), *self._parts])


def is_felt(rows: Array, first: Array | None = None) -> bool:
    """Whether `rows` (n, 14 or 18) exceed the perception limits FELT; `first` (14 or 18,) is the first tick."""
    if not len(rows):
        return False
    start = rows[0] if first is None else first
    force, torque = (np.linalg.norm(rows[:, columns], axis=1) for columns in (slice(8, 11), slice(11, 14)))
    moved = np.linalg.norm(rows[:, 1:4] - start[1:4], axis=1)
    cosine = np.abs(rows[:, 4:8] @ start[4:8])
    turned = 2 * np.arccos(np.clip(cosine, 0.0, 1.0))
    return bool(
        np.any(force >= _FELT_FORCE_N)
        or np.any(torque >= _FELT_TORQUE_NM)
        or np.any(moved >= _FELT_MOTION_M)
        or np.any(turned >= _FELT_ROTATION_RAD)
    )


def trace_rows(layout: RowLayout, rows: Array) -> Array:
    """(n, 18) by COLUMNS and HAND: ticks of the servo's `rows` (n, width) with a valid pose."""
    known = rows[rows[:, layout["valid"].start] > 0]
    parts = [known[:, layout[name]] for name in ("t", "object", "object_q", "object_wrench")]
    torques = [np.linalg.norm(known[:, layout[name]][:, 3:], axis=1) for name in ("asked", "given")]
    out: Array = np.column_stack([*parts, *torques, known[:, layout["gain"]], known[:, layout["saturated"]]])
    return out


def write_trace(path: Path, rows: Array, *, gently: bool = False) -> None:
    """Write `rows` (n, 14 or 18), complete or not at all; `gently` while a servo of this process runs."""
    head = (COLUMNS + HAND)[: rows.shape[1]]
    try:
        with replace_file(path, sync=True) as part, part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(head)
            for block in _blocks(rows):
                writer.writerows([f"{value:.9g}" for value in row] for row in block.tolist())
                if gently:
                    sleep(_BLOCK_PAUSE_S)
    except OSError as cause:
        raise RecordingError(f"{path}: cannot be written ({cause.strerror})") from cause


def _blocks(rows: Array) -> Iterator[Array]:
    for start in range(0, len(rows), _BLOCK_ROWS):
        yield rows[start : start + _BLOCK_ROWS]


def read_trace(path: Path) -> Array:
    """(n, 18) rows by COLUMNS and HAND; NaN for columns that an older file lacks. RecordingError if invalid."""
    try:
        text = read_text(path, "trace", RecordingError, _MAX_TRACE_BYTES)
        head, *lines = csv.reader(text.splitlines())
        if tuple(head) not in (COLUMNS, COLUMNS + HAND):
            raise ValueError("the columns differ")
        found = np.array(lines, dtype=float).reshape(-1, len(head))
    except (ValueError, csv.Error) as cause:
        raise RecordingError(f"{path}: is not a trace ({cause})") from cause
    missing = len(COLUMNS) + len(HAND) - found.shape[1]
    return np.pad(found, ((0, 0), (0, missing)), constant_values=np.nan)


_MAX_RECORD_BYTES = 64 * 1024 * 1024  #: maximum size of all ratings [bytes]
_MAX_CODE_CHARACTERS = 40  #: of a person's code [characters]

SCORES = SCALE  #: the scale of studies


def check_person(code: str, known: Iterable[str] = ()) -> str:
    """Validate the person's `code`; InputError if it is invalid or another spelling of a `known` one."""
    meant = suggest_code(code)
    if code and code != meant and meant:
        raise InputError(
            "a person's code is typed without spaces and with plain letters and digits: enter "
            f"'{meant[:_MAX_CODE_CHARACTERS]}', if that is meant; got {quote(code)}"
        )
    if len(code) > _MAX_CODE_CHARACTERS or not code.isprintable() or code != meant or "\ufffd" in code:
        raise InputError(
            f"a person's code must have at most {_MAX_CODE_CHARACTERS} printable characters; got {quote(code)}"
        )
    other = find_other_spelling(code, known) if code else None
    if other is not None:
        raise InputError(f"a person's code '{code}' is another spelling of '{other}', who has rated: enter '{other}'")
    return code


class FeelSession:
    """Folder of ratings and traces of one set of candidates; created or continued.

    Raises InputError if the folder holds ratings of other designs only: it belongs to another file.
    """

    def __init__(self, folder: str | Path, candidates: Candidates) -> None:
        self.folder = Path(folder)
        self.candidates = candidates
        self.skipped = 0  #: invalid lines at the last reading
        self._check_designs()
        try:
            (self.folder / "traces").mkdir(parents=True, exist_ok=True)
        except OSError as cause:
            raise RecordingError(f"{self.folder}: cannot be created ({cause.strerror})") from cause

    def _check_designs(self) -> None:
        rated = {record.design for record in self._records()}
        known = [design.name for design in self.candidates.designs]
        if rated and rated.isdisjoint(known):
            others = ", ".join(quote(name) for name in sorted(rated)[:4])
            raise InputError(
                f"{self._path} belongs to other designs ({others}), none of which is in this file "
                f"({', '.join(known[:8])}); choose another folder with --session, or use the file it belongs to"
            )

    @property
    def _path(self) -> Path:
        return self.folder / "ratings.jsonl"

    def rate(
        self,
        name: str,
        score: int,
        *,
        person: str = "",
        comment: str = "",
        trace: str = "",
        feeling: str = "",
        blind: bool = False,
    ) -> DesignRating:
        """Store the rating of design `name` by `person`, durably."""
        design = self.candidates[name]
        try:
            rating_of(name, SCORES).check_answer(Answer(score))
        except InputError as cause:
            raise InputError(f"a score is a whole number from {SCORES[0]} to {SCORES[1]}; got {score!r}") from cause
        if trace and not (self.folder / trace).is_file():
            raise InputError(f"{self.folder}: there is no trace '{trace}'")
        rating = DesignRating(name, design.digest, score, person, comment, utc_now(), trace, feeling, blind)
        self._write(rating)
        return rating

    def choose(self, name: str, *, person: str = "", comment: str = "") -> Choice:
        """Store the choice of `name`; a later choice replaces it, both remain on record."""
        choice = Choice(name, self.candidates[name].digest, person, comment, utc_now())
        self._write(choice)
        return choice

    def reserve(self, name: str) -> str:
        """Reserve a name for a new trace of design `name`: creates an empty file."""
        folder = self.folder / "traces"
        taken = [p.stem.rsplit("-", 1)[1] for p in folder.glob("*.csv") if p.stem.rpartition("-")[0] == name]
        number = 1 + max((int(text) for text in taken if text.isdecimal()), default=0)
        path = folder / f"{name}-{number:04d}.csv"
        write_trace(path, np.empty((0, len(COLUMNS) + len(HAND))))
        return f"traces/{path.name}"

    def store_trace(
        self,
        trace: Trace,
        *,
        name: str = "",
        person: str = "",
        feeling: str = "",
        blind: bool = False,
        scale: float = 1.0,
        gently: bool = False,
    ) -> str:
        """Write `trace` to its file, by default a new one; returns its name, for `rate`.

        `gently` while a servo of this process runs.
        """
        design = trace.design
        if not len(trace):
            raise InputError(f"the trace of design '{design.name}' is empty: no tick with a valid pose was recorded")
        name = name or self.reserve(design.name)
        rows = trace.all_rows
        write_trace(self.folder / name, rows, gently=gently)
        self._write(Feeling(design.name, design.digest, person, utc_now(), name, feeling, blind, scale))
        return name

    def trace(self, name: str) -> Array:
        """(n, 14) rows of a stored trace, by COLUMNS."""
        return self.trace_with_hand(name)[:, : len(COLUMNS)]

    def trace_with_hand(self, name: str) -> Array:
        """(n, 18) rows of a stored trace, by COLUMNS and HAND."""
        return read_trace(self.folder / name)

    def ratings(self) -> tuple[DesignRating, ...]:
        """All ratings that count, oldest first: of one feeling, the last."""
        given = [one for one in self._records() if isinstance(one, DesignRating) and _is_score(one.score)]
        last = {one.feeling: one for one in given if one.feeling}
        return tuple(one for one in given if not one.feeling or last[one.feeling] is one)

    def was_felt(self, name: str) -> bool:
        """Whether a stored trace of the current version of design `name` exceeds the perception limits."""
        digest = self.candidates[name].digest
        return any(
            (one.design, one.digest) == (name, digest)
            and (self.folder / one.trace).is_file()
            and is_felt(self.trace(one.trace))
            for one in self.feelings()
        )

    def feelings(self) -> tuple[Feeling, ...]:
        """Every design that was felt, as often as it was, oldest first; also those of before there was such a record,
        which only ratings tell of."""
        records = self._records()
        found = [one for one in records if isinstance(one, Feeling)]
        known = {one.trace for one in found}
        for one in records:
            if isinstance(one, DesignRating) and one.trace and one.trace not in known:
                known.add(one.trace)
                found.append(Feeling(one.design, one.digest, one.person, one.time, one.trace))
        return tuple(sorted(found, key=lambda one: one.time))

    def choice(self) -> Choice | None:
        """The last choice, if any."""
        made = [one for one in self._records() if isinstance(one, Choice)]
        return made[-1] if made else None

    def scores(self, person: str | None = None) -> dict[str, tuple[int, float]]:
        """Design → how often it was rated, as it is now in the file, and the mean score (NaN: never); by one `person`,
        or by all."""
        given: dict[str, list[int]] = {design.name: [] for design in self.candidates.designs}
        for rating in self.ratings():
            known = rating.design in given and self.candidates[rating.design].digest == rating.digest
            if known and person in (None, rating.person):
                given[rating.design].append(rating.score)
        return {name: (len(s), sum(s) / len(s) if s else math.nan) for name, s in given.items()}

    def people(self) -> tuple[str, ...]:
        """All persons who rated, in the order of their first rating; "" for one without a code."""
        return tuple(dict.fromkeys(rating.person for rating in self.ratings()))

    def find_outdated(self) -> tuple[DesignRating, ...]:
        """Ratings of designs that have been changed or removed since."""
        now = {design.name: design.digest for design in self.candidates.designs}
        return tuple(rating for rating in self.ratings() if now.get(rating.design) != rating.digest)

    def _write(self, record: Record) -> None:
        try:
            with self._path.open("ab+") as file:
                end = file.seek(0, os.SEEK_END)
                if end:  # a line truncated by a crash must not absorb this one
                    file.seek(end - 1)
                    if file.read(1) != b"\n":
                        file.write(b"\n")
                file.write(write_line(record).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as cause:
            raise RecordingError(f"{self._path}: cannot be written ({cause.strerror})") from cause

    def _records(self) -> list[Record]:
        try:
            if not self._path.exists():
                return []
        except OSError as cause:
            raise RecordingError(f"{self._path}: cannot be read ({cause.strerror})") from cause
        text = read_bytes(self._path, _MAX_RECORD_BYTES, "ratings", RecordingError).decode("utf-8", "replace")
        found, self.skipped = parse_records(text.splitlines())
        return found


def _is_score(value: int) -> bool:
    return SCORES[0] <= value <= SCORES[1]
