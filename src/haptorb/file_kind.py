"""Detection of a file's kind from its first bytes, for messages such as on a recording given as a calibration."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Mapping
from contextlib import closing, suppress
from enum import Enum
from pathlib import Path
from time import monotonic
from typing import Any

from haptorb.errors import HaptorbError, quote
from haptorb.files import open_regular, parse_json, parse_toml

__all__ = ["FileKind", "find_kind"]

_HEAD_BYTES = 256 * 1024  #: bytes that are examined; more than the longest text file that a person writes
_SQLITE = b"SQLite format 3\0"
_DATABASE_TIMEOUT_S = 0.5  #: timeout of reading a database's list of tables


class FileKind(Enum):
    """Kinds of files that haptorb reads or writes: name and use of each."""

    RECORDING = "a recording (MCAP)", "`haptorb info`, `view`, `replay` and `export` read it"
    DEVICE = "a device file", "`haptorb inspect` and `haptorb run` read it"
    CALIBRATION = "a calibration", "`haptorb run DEVICE --calibration` reads it"
    CALIBRATION_STEPS = "an unfinished calibration", "`haptorb calibrate` continues it"
    HAND = "a hand's script", "`haptorb run --hand` reads it"
    FRAME = "a tracker's frame", "`haptorb run omni --tracker osc:9000 --frame FILE` reads it"
    DESIGN = "a device design file", "`haptorb design sweep` and `optimise` read it"
    RESULTS = "results of `haptorb design`", "`haptorb design report` and `show` read them"
    FELT_DESIGNS = "a snap-fit file", "`haptorb feel` reads it"
    STUDY = "a study file", "`haptorb study check` and `run` read it"
    REGISTRATION = "the registration of a study", "`haptorb study analyse --registration` reads it"
    STUDY_DATABASE = "the database of a study", "`haptorb study analyse`, `participants` and `export` read it"
    DATABASE = "a database of another program", ""
    EMPTY_DATABASE = "a database without tables, or one that a program has open", ""
    SCENE = "a scene (MJCF)", "`haptorb run --scene` reads it"
    WORLD = "a Python file", "`haptorb run --world FILE.py:NAME` runs a world in it"
    NETWORK = "trained networks", "`haptorb run --estimator network` uses what `haptorb train` wrote"
    TABLE = "a table (CSV)", ""
    ARRAYS = "an export (NumPy arrays)", "NumPy's `load` reads it"
    PARQUET = "an export (Parquet)", "pandas and DuckDB read it"
    PAGE = "a page (HTML)", "a browser shows it"
    PICTURE = "a picture", ""

    @property
    def title(self) -> str:
        """Name of the kind, with its article."""
        return str(self.value[0])

    @property
    def use(self) -> str:
        """Commands that read it; "" if there are none."""
        return str(self.value[1])

    def explain_other(self, path: str | Path, head: bytes) -> str:
        """Explain why the file `path`, which begins with `head`, is of another kind; "" if it may be of this one."""
        found = _find(head[:_HEAD_BYTES], Path(path))
        if found in (None, self) or (found is FileKind.EMPTY_DATABASE and self in _DATABASES):  # safety: kind-told
            return ""
        return self.explain_found(path, found)

    def explain_found(self, path: str | Path, found: FileKind) -> str:
        """Explain in one line that the file `path` is `found` and not of this kind, and what reads it."""
        if found is self:
            return f"{quote(str(path), 300)[1:-1]} is {found.title}, whose name has another ending"
        use = f": {found.use}" if found.use else ""
        return f"{quote(str(path), 300)[1:-1]} is {found.title}, not {self.title}{use}"


_MAGIC = (
    (b"\x89MCAP0\r\n", FileKind.RECORDING),
    (b"PAR1", FileKind.PARQUET),
    (b"PK\x03\x04", FileKind.ARRAYS),
    (b"\x89PNG\r\n", FileKind.PICTURE),
    (b"\xff\xd8\xff", FileKind.PICTURE),
    (b"II*\0", FileKind.PICTURE),
    (b"MM\0*", FileKind.PICTURE),
    (b"%PDF-", FileKind.PICTURE),
)
#: prefixes of the texts under `format` or `kind` in a JSON file
_FORMATS = (
    ("haptorb-calibration-steps", FileKind.CALIBRATION_STEPS),
    ("haptorb-calibration", FileKind.CALIBRATION),
    ("haptorb-tracker-frame", FileKind.FRAME),
    ("haptorb networks", FileKind.NETWORK),
)
_TABLES = (("haptorb_schema", FileKind.STUDY_DATABASE), ("haptorb_design_schema", FileKind.RESULTS))
_DATABASES = (FileKind.STUDY_DATABASE, FileKind.RESULTS)
_STUDY_KEYS = frozenset(
    {"procedure", "set_points", "trials", "conditions", "levels", "instructions", "consent", "questions", "rating",
     "order_version", "model_version"}
)  # fmt: skip
_DEVICE_KEYS = frozenset({"kind", "based_on", "coils", "dome", "limits", "thermal", "magnets"})
_TAG = re.compile(r"\s*(?:<\?xml[^>]*>\s*)?(?:<!--.*?-->\s*)*<!?(\w+)", re.DOTALL)
#: comments and empty lines, then the first command of every script
_SCRIPT = re.compile(r"(?:[ \t]*(?:#[^\n]*)?\n)*[ \t]*start[ \t]+(?:turn\b|[-+.\d])")
_HEADED = re.compile(r"[\w.\[\]]+(?: \[[^\]\n]*\])?(?:[,;\t][\w.\[\]]+(?: \[[^\]\n]*\])?)+\s*")


def find_kind(path: str | Path) -> FileKind | None:
    """Return the kind of the regular file `path`; None if it cannot be read, or its kind is unknown."""
    place = Path(path)
    try:
        with open_regular(place, "file", HaptorbError) as file:
            head = file.read(_HEAD_BYTES)
    except HaptorbError:
        return None
    return _find(head, place)


def _find(head: bytes, path: Path) -> FileKind | None:
    for magic, kind in _MAGIC:
        if head.startswith(magic):
            return kind
    if head.startswith(_SQLITE):
        return _find_database(path)
    try:
        text = head.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = ""
    if not text:
        text = head.partition(b"\n")[0].decode("utf-8", "replace")  # of networks, binary numbers follow
    if text.lstrip().startswith("{"):
        return _find_json(text)
    if (tag := _TAG.match(text)) is not None:
        name = tag[1].lower()
        return {"mujoco": FileKind.SCENE, "svg": FileKind.PICTURE, "html": FileKind.PAGE, "doctype": FileKind.PAGE}.get(
            name
        )
    if path.suffix.lower() == ".py":
        return FileKind.WORLD
    if _SCRIPT.match(text):
        return FileKind.HAND
    with suppress(ValueError):
        return _find_toml(parse_toml(text))
    return FileKind.TABLE if _HEADED.fullmatch(text.partition("\n")[0]) else None


def _find_json(text: str) -> FileKind | None:
    raw: Any = None
    for part in (text, text.partition("\n")[0]):
        with suppress(ValueError):
            raw = parse_json(part)
            break
    if not isinstance(raw, Mapping):
        return None
    stated = str(raw.get("format") or raw.get("kind"))
    return next((kind for start, kind in _FORMATS if stated.startswith(start)), None)


def _find_toml(raw: Mapping[str, Any]) -> FileKind | None:
    """Return the kind by keys that no other kind has."""
    keys = set(raw)
    if isinstance(raw.get("registration"), Mapping):
        return FileKind.REGISTRATION
    if isinstance(raw.get("design"), Mapping) and "base" not in keys:
        return FileKind.FELT_DESIGNS
    if isinstance(raw.get("base"), str) and keys & {"objectives", "parameters", "constraints", "evaluation"}:
        return FileKind.DESIGN
    if keys & _STUDY_KEYS and not keys & _DEVICE_KEYS:
        return FileKind.STUDY
    if keys & {"kind", "based_on"} and not keys & _STUDY_KEYS:
        return FileKind.DEVICE
    return None


def _find_database(path: Path) -> FileKind:
    """Return the kind by the names of its tables, read without a lock and without changing any file."""
    names: set[str] = set()
    with suppress(sqlite3.Error, ValueError, MemoryError):  # SQLite reports some damaged files as the last one
        place = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(place, uri=True)) as connection:
            end = monotonic() + _DATABASE_TIMEOUT_S
            connection.set_progress_handler(lambda: monotonic() > end, 10_000)
            connection.execute("PRAGMA trusted_schema = OFF")
            names = {row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if not names:
        return FileKind.EMPTY_DATABASE  # its tables may be in the write-ahead log
    return next((kind for name, kind in _TABLES if name in names), FileKind.DATABASE)
