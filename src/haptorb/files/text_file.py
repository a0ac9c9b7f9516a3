"""Files from people and programs: regular files of bounded size, TOML and JSON of bounded depth, or one sentence.

A file's content cannot be trusted: it may be a device that never ends, a megabyte of brackets, or a number of a
thousand digits. Each of them must end in the reader's own error, at once and with little memory.
"""

from __future__ import annotations

import json
import os
import re
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from haptorb.errors import HaptorbError, quote

__all__ = ["open_regular", "parse_json", "parse_toml", "read_bytes", "read_text"]

_TOML = 256 * 1024  #: bytes of a TOML file
_DEEP = 16  #: tables and lists within one another
_DOTS = 64  #: parts of a dotted key: the time to read one grows with their square
_DOTTED = re.compile(r"[\w\"'-]+(?:[ \t]*\.[ \t]*[\w\"'-]+)*")


class RecognisedKind(Protocol):
    """A kind of file that can be told from others."""

    def explain_other(self, path: str | Path, head: bytes) -> str:
        """Why the file `path`, which begins with `head`, is of another kind; "" if it may be of this one."""


@contextmanager
def open_regular(path: str | Path, what: str, error: type[HaptorbError]) -> Iterator[BinaryIO]:
    """The regular file `path`, open for reading; every file that a person or another file names is opened here.

    Neither a pipe nor a device is waited for, read or, as a terminal would be, changed.

    Raises `error`, naming `what` it is, if the file cannot be opened or read, or is no regular file.
    """
    name = quote(str(path), 300)[1:-1]
    try:
        file = open(Path(path).expanduser(), "rb", opener=_open_at_once)  # noqa: SIM115 (closed below)
    except OSError as cause:
        raise error(f"{what} {name}: cannot be read ({cause.strerror})") from cause
    except (ValueError, RuntimeError) as cause:  # a zero byte in its name, or the folder of an unknown user
        raise error(f"{what} {name}: cannot be read (not the name of a file)") from cause
    with file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):  # safety: regular-file
            raise error(f"{what} {name}: cannot be read (not a regular file)")
        try:
            yield file
        except OSError as cause:
            raise error(f"{what} {name}: cannot be read ({cause.strerror})") from cause


def read_bytes(
    path: str | Path, most: int, what: str, error: type[HaptorbError], kind: RecognisedKind | None = None
) -> bytes:
    """The bytes of the regular file `path`, at most `most`.

    Raises `error` naming `what` it is if it cannot be read, is no regular file, is longer, or if it is recognised as
    another `kind` of file.
    """
    name = quote(str(path), 300)[1:-1]
    with open_regular(path, what, error) as file:
        content = file.read(most + 1)
    if kind is not None and (other := kind.explain_other(path, content)):
        raise error(other)
    if len(content) > most:  # safety: file-size
        raise error(f"{what} {name}: cannot be read (longer than {most} bytes)")
    return content


def read_text(
    path: str | Path, what: str, error: type[HaptorbError], most: int = _TOML, kind: RecognisedKind | None = None
) -> str:
    """The UTF-8 text of the file `path`. Raises `error` as `read_bytes` does, and if it is no text."""
    try:
        content = read_bytes(path, most, what, error, kind)
        return content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as cause:
        raise error(f"{what} {quote(str(path), 300)[1:-1]}: cannot be read (not a text file)") from cause


def parse_toml(text: str) -> dict[str, Any]:
    """The tables that `text` describes. Raises ValueError (one line) if it is no TOML, or is nested too deep."""
    if len(text) > _TOML:
        raise ValueError(f"it is longer than {_TOML} characters")
    if any(found.group().count(".") > _DOTS for found in _DOTTED.finditer(text)):
        raise ValueError(f"a key has more than {_DOTS} parts")
    try:
        raw = tomllib.loads(text)
    except RecursionError as cause:
        raise ValueError(f"it is nested deeper than {_DEEP} levels") from cause
    _check_depth(raw)
    return raw


def parse_json(text: str | bytes) -> Any:
    """What the JSON `text` says. Raises ValueError (one line) if it is no JSON, or is nested too deep."""
    try:
        raw = json.loads(text)
    except RecursionError as cause:
        raise ValueError(f"it is nested deeper than {_DEEP} levels") from cause
    _check_depth(raw)
    return raw


def _open_at_once(path: str, flags: int) -> int:
    """An `opener` for Python's `open`: a pipe without a writer is not waited for, where the system has such pipes."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0))


def _check_depth(raw: Any) -> None:
    level = [raw]
    for _ in range(_DEEP):
        level = [
            part
            for found in level
            if isinstance(found, dict | list)
            for part in (found.values() if isinstance(found, dict) else found)
        ]
        if not level:
            return
    raise ValueError(f"it is nested deeper than {_DEEP} levels")
