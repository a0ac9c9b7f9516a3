"""Stored feel session: ratings and choice as JSON lines, every trace as CSV, in one folder.

    FOLDER/ratings.jsonl          one line per rating, feeling or choice, durable before the next begins
    FOLDER/traces/NAME-0001.csv   pose of the object and wrench on it at every tick

A line truncated by a crash is skipped when read, and reported.
"""

from __future__ import annotations

import json
import math
import os
import stat
from collections.abc import Iterable
from dataclasses import MISSING, asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from haptorb.arrays import Array, whole_number
from haptorb.errors import InputError, RecordingError, quote
from haptorb.files import named_file, parse_json, read_bytes
from haptorb_study.feel.designs import Candidates
from haptorb_study.feel.trace import COLUMNS, HAND, Trace, is_felt, read_trace, write_trace
from haptorb_study.json_values import utc_now
from haptorb_study.participant_codes import find_other_spelling, suggest_code
from haptorb_study.prompts import SCALE, Answer
from haptorb_study.prompts import rating as rating_of

__all__ = [
    "SCORES",
    "Choice",
    "DesignRating",
    "FeelSession",
    "Feeling",
    "Record",
    "check_person",
    "parse_records",
    "write_line",
]


# --------------------------------------------------------------------------------------------------
# Records of the session's file: ratings, presentations, choice; one JSON object per line, parsed strictly.


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


# --------------------------------------------------------------------------------------------------
# Folder of a session.


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
        self._check_links()
        self._check_designs()
        try:
            (self.folder / "traces").mkdir(parents=True, exist_ok=True)
        except OSError as cause:
            raise RecordingError(
                f"{self.folder}: cannot be created ({cause.strerror}); choose another folder with --session"
            ) from cause

    def _check_links(self) -> None:
        """Raise RecordingError for links: the folder lies beside the file of designs, and may have come with it."""
        for path in (self.folder, self._path, self.folder / "traces"):
            if path.is_symlink():  # safety: feel-link
                raise RecordingError(
                    f"{path} is a link, which is not followed: remove it, or name another folder with --session"
                )

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
        if trace and not self.has_trace(trace):
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
        number = 1 + max((whole_number(text) or 0 for text in taken), default=0)
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
        return read_trace(self._locate(name))

    def has_trace(self, name: str) -> bool:
        """Whether there is a stored trace of this name; False for a name of a file elsewhere."""
        try:
            return self._locate(name).is_file()
        except RecordingError:
            return False

    def _locate(self, name: str) -> Path:
        """File of a trace; RecordingError if it lies elsewhere: the records name it, and may be a stranger's."""
        return named_file(name, self.folder, "trace", RecordingError, remedy="traces lie in the session's folder")

    def ratings(self) -> tuple[DesignRating, ...]:
        """All valid ratings, oldest first: the last one of each presentation."""
        given = [one for one in self._records() if isinstance(one, DesignRating) and _is_score(one.score)]
        last = {one.feeling: one for one in given if one.feeling}
        return tuple(one for one in given if not one.feeling or last[one.feeling] is one)

    def was_felt(self, name: str) -> bool:
        """Whether a stored trace of the current version of design `name` exceeds the perception limits."""
        digest = self.candidates[name].digest
        return any(
            (one.design, one.digest) == (name, digest) and self.has_trace(one.trace) and is_felt(self.trace(one.trace))
            for one in self.feelings()
        )

    def feelings(self) -> tuple[Feeling, ...]:
        """All presentations of designs, oldest first; also those from before there was such a record,
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
        """Design → number of ratings of its current version, and their mean (NaN: none); by one `person`,
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
            self._check_links()
            with open(self._path, "ab+", opener=_open_own) as file:
                if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                    raise RecordingError(f"{self._path}: cannot be written (not a regular file)")
                end = file.seek(0, os.SEEK_END)
                if end:  # a line truncated by a crash must not absorb this one
                    file.seek(end - 1)
                    if file.read(1) != b"\n":
                        file.write(b"\n")
                file.write(write_line(record).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as cause:
            why = cause.strerror or "not a regular file"  # Python's own error of a pipe has no words of the system
            raise RecordingError(f"{self._path}: cannot be written ({why})") from cause

    def _records(self) -> list[Record]:
        try:
            if not self._path.exists():
                return []
        except OSError as cause:
            raise RecordingError(f"{self._path}: cannot be read ({cause.strerror})") from cause
        text = read_bytes(self._path, _MAX_RECORD_BYTES, "ratings", RecordingError).decode("utf-8-sig", "replace")
        found, self.skipped = parse_records(text.splitlines())
        return found


def _open_own(path: str, flags: int) -> int:
    """Open a file without following a link, and without waiting for the reader of a pipe; an `opener` for `open`."""
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0), 0o666)


def _is_score(value: int) -> bool:
    return SCORES[0] <= value <= SCORES[1]
