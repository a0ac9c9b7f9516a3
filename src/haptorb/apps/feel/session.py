"""What was felt and said of it, kept: ratings and the choice as JSON lines, every trace as CSV, in one folder.

    FOLDER/ratings.jsonl          one line per rating or choice, written through to the disk before the next begins
    FOLDER/traces/NAME-0001.csv   pose of the target and wrench on it, tick by tick

A line that a crash cut short is left out when read, and said.
"""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from haptorb.apps.asking.prompt import Answer
from haptorb.apps.asking.rating import SCALE
from haptorb.apps.asking.rating import rating as rating_of
from haptorb.apps.feel.candidates import Candidate, Candidates
from haptorb.devices.state import State
from haptorb.errors import InputError, RecordingError
from haptorb.files.replace_file import replace_file
from haptorb.files.text_file import parse_json, read_bytes
from haptorb.numerics.arrays import Array

__all__ = ["COLUMNS", "SCORES", "Choice", "DesignRating", "FeelSession", "Trace"]

_MOST = 64 * 1024 * 1024  #: bytes of all ratings

SCORES = SCALE  #: the scale that studies have as well
COLUMNS = ("t_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "fx_n", "fy_n", "fz_n", "tx_nm", "ty_nm", "tz_nm")


@dataclass(frozen=True)
class DesignRating:
    """What a person said of a design after feeling it."""

    design: str
    digest: str
    score: int
    person: str
    comment: str
    time: str
    trace: str = ""


@dataclass(frozen=True)
class Choice:
    """The design that was settled on, and why."""

    design: str
    digest: str
    person: str
    comment: str
    time: str


class Trace:
    """One feeling of one design, as it happens: append ticks, then keep it with `FeelSession.keep`."""

    def __init__(self, design: Candidate) -> None:
        self.design = design
        self._rows: list[tuple[float, ...]] = []

    def append(self, target: State, wrench: Array) -> None:
        """A tick: where the target was and what acted on it (6,)."""
        x, y, z, w = _quaternion(target.R_SR)
        self._rows.append((target.t, *target.p.tolist(), x, y, z, w, *np.asarray(wrench, dtype=float).tolist()))

    @property
    def rows(self) -> Array:
        """(n, 14) by COLUMNS."""
        return np.array(self._rows, dtype=float).reshape(-1, len(COLUMNS))


def _quaternion(R: Array) -> tuple[float, float, float, float]:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(R).as_quat()
    return float(x), float(y), float(z), float(w)


class FeelSession:
    """A folder of ratings and traces about one set of candidates; made if it is not there, continued if it is."""

    def __init__(self, folder: str | Path, candidates: Candidates) -> None:
        self.folder = Path(folder)
        self.candidates = candidates
        self.skipped = 0  #: lines that could not be read the last time
        try:
            (self.folder / "traces").mkdir(parents=True, exist_ok=True)
        except OSError as cause:
            raise RecordingError(f"{self.folder}: cannot be created ({cause.strerror})") from cause

    @property
    def _path(self) -> Path:
        return self.folder / "ratings.jsonl"

    def rate(self, name: str, score: int, *, person: str = "", comment: str = "", trace: str = "") -> DesignRating:
        """Keep what `person` says of design `name`; on the disk when this returns."""
        design = self.candidates[name]
        try:
            rating_of(name, SCORES).check_answer(Answer(score))
        except InputError as cause:
            raise InputError(f"a score is a whole number from {SCORES[0]} to {SCORES[1]}; got {score!r}") from cause
        if trace and not (self.folder / trace).is_file():
            raise InputError(f"{self.folder}: there is no trace '{trace}'")
        rating = DesignRating(name, design.digest, score, person, comment, _utc_now(), trace)
        self._write("rating", rating)
        return rating

    def choose(self, name: str, *, person: str = "", comment: str = "") -> Choice:
        """Record that `name` is the one; a later choice replaces it, both stay on record."""
        choice = Choice(name, self.candidates[name].digest, person, comment, _utc_now())
        self._write("choice", choice)
        return choice

    def keep(self, trace: Trace) -> str:
        """Write `trace` to its file; returns the name to be given to `rate`."""
        if not len(trace.rows):
            raise InputError(
                f"the trace of design '{trace.design.name}' is empty: no tick with a valid pose was recorded"
            )
        folder = self.folder / "traces"
        number = 1 + max(
            (int(p.stem.rsplit("-", 1)[1]) for p in folder.glob(f"{trace.design.name}-[0-9]*.csv")), default=0
        )
        path = folder / f"{trace.design.name}-{number:04d}.csv"
        try:
            with replace_file(path, sync=True) as part, part.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file)
                writer.writerow(COLUMNS)
                writer.writerows([f"{value:.9g}" for value in row] for row in trace.rows.tolist())
        except OSError as cause:
            raise RecordingError(f"{path}: cannot be written ({cause.strerror})") from cause
        return f"traces/{path.name}"

    def trace(self, name: str) -> Array:
        """(n, 14) rows of a kept trace, by COLUMNS."""
        path = self.folder / name
        try:
            with path.open(newline="", encoding="utf-8") as file:
                head, *rows = csv.reader(file)
            if tuple(head) != COLUMNS:
                raise ValueError("the columns differ")
            return np.array(rows, dtype=float).reshape(-1, len(COLUMNS))
        except (OSError, ValueError, csv.Error) as cause:
            raise RecordingError(f"{path}: is not a trace ({cause})") from cause

    def ratings(self) -> tuple[DesignRating, ...]:
        """All ratings, oldest first."""
        return tuple(DesignRating(**line) for line in self._lines("rating") if _is_score(line["score"]))

    def choice(self) -> Choice | None:
        """The last choice, if any."""
        made = [Choice(**line) for line in self._lines("choice")]
        return made[-1] if made else None

    def scores(self) -> dict[str, tuple[int, float]]:
        """Design → how often it was rated, as it is now in the file, and the mean score (NaN: never)."""
        given: dict[str, list[int]] = {design.name: [] for design in self.candidates.designs}
        for rating in self.ratings():
            if rating.design in given and self.candidates[rating.design].digest == rating.digest:
                given[rating.design].append(rating.score)
        return {name: (len(s), sum(s) / len(s) if s else math.nan) for name, s in given.items()}

    def find_outdated(self) -> tuple[DesignRating, ...]:
        """Ratings of designs that have been changed, or removed, since."""
        now = {design.name: design.digest for design in self.candidates.designs}
        return tuple(rating for rating in self.ratings() if now.get(rating.design) != rating.digest)

    def _write(self, kind: str, record: DesignRating | Choice) -> None:
        line = json.dumps({"kind": kind, **asdict(record)}, ensure_ascii=False)
        try:
            with self._path.open("ab+") as file:
                end = file.seek(0, os.SEEK_END)
                if end:  # a line cut short by a crash must not swallow this one
                    file.seek(end - 1)
                    if file.read(1) != b"\n":
                        file.write(b"\n")
                file.write(line.encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as cause:
            raise RecordingError(f"{self._path}: cannot be written ({cause.strerror})") from cause

    def _lines(self, kind: str) -> Iterable[dict[str, Any]]:
        try:
            if not self._path.exists():
                return []
        except OSError as cause:
            raise RecordingError(f"{self._path}: cannot be read ({cause.strerror})") from cause
        text = read_bytes(self._path, _MOST, "ratings", RecordingError).decode("utf-8", "replace")
        keys = set((DesignRating if kind == "rating" else Choice).__dataclass_fields__)
        found, self.skipped = [], 0
        for line in text.splitlines():
            try:
                record = parse_json(line)
                named = record.pop("kind")
            except (ValueError, AttributeError, KeyError, TypeError):
                self.skipped += bool(line.strip())
                continue
            texts = all(isinstance(value, str) for key, value in record.items() if key != "score")
            if named == kind and set(record) == keys and texts:
                found.append(record)
        return found


def _is_score(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and SCORES[0] <= value <= SCORES[1]


def _utc_now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
