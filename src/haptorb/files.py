"""Files from people and programs: regular files of bounded size, TOML and JSON of bounded depth, or one sentence.

A file's content cannot be trusted: it may be a device that never ends, a megabyte of brackets, or a number of a
thousand digits. Each of them must end in the reader's own error, at once and with little memory.
"""

from __future__ import annotations

import errno
import io
import json
import os
import re
import shutil
import stat
import tempfile
import tomllib
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from time import time
from typing import Any, BinaryIO, Protocol, final

from haptorb.cache_folder import cache_folder, find_home
from haptorb.errors import HaptorbError, quote

__all__ = [
    "FOLDER",
    "RECORDING",
    "SHARED",
    "FileLock",
    "escape_formula",
    "folders",
    "foreign_name",
    "foreign_text",
    "named_file",
    "open_regular",
    "parse_json",
    "parse_toml",
    "read_bytes",
    "read_text",
    "replace_file",
    "replace_files",
    "replace_folder",
    "state_folder",
    "sweep",
    "visible",
]


_TOML = 256 * 1024  #: bytes of a TOML file
_DEEP = 16  #: tables and lists within one another
_DOTS = 64  #: parts of a dotted key: the time to read one grows with their square
_DOTTED = re.compile(r"[\w\"'-]+(?:[ \t]*\.[ \t]*[\w\"'-]+)*")


class RecognisedKind(Protocol):
    """A kind of file that can be told from others."""

    def explain_other(self, path: str | Path, head: bytes) -> str:
        """Why the file `path`, which begins with `head`, is of another kind; "" if it may be of this one."""


class _File(io.FileIO):
    """A file that is never waited for: some of /proc and /sys are regular, and reading them waits for news."""

    def readinto(self, buffer: Any, /) -> int:
        count = super().readinto(buffer)
        if count is None:
            raise BlockingIOError(errno.EAGAIN, "it has nothing to read now")
        return count

    def readall(self) -> bytes:
        content = super().readall()
        if content is None:
            raise BlockingIOError(errno.EAGAIN, "it has nothing to read now")
        return content


@contextmanager
def open_regular(path: str | Path, what: str, error: type[HaptorbError]) -> Iterator[BinaryIO]:
    """The regular file `path`, open for reading; every file that a person or another file names is opened here.

    Neither a pipe nor a device is waited for, read or, as a terminal would be, changed.

    Raises `error`, naming `what` it is, if the file cannot be opened or read, or is no regular file.
    """
    name = quote(str(path), 300)[1:-1]
    try:
        file = io.BufferedReader(_File(Path(path).expanduser(), "rb", opener=_open_at_once))
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
    """The UTF-8 text of the file `path`, without a byte order mark. Raises `error` as `read_bytes` does, and if it is
    no text or has another encoding."""
    content = read_bytes(path, most, what, error, kind)
    where = f"{what} {quote(str(path), 300)[1:-1]}"
    if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) or content.count(0) > len(content) // 4 > 0:
        raise error(f"{where}: cannot be read: it is UTF-16 text or no text; save it as UTF-8")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as cause:
        if b"\0" in content:
            raise error(f"{where}: cannot be read (not a text file)") from cause
        line, byte = content.count(b"\n", 0, cause.start) + 1, content[cause.start]
        raise error(
            f"{where}, line {line}: cannot be read: byte 0x{byte:02x} is not UTF-8, the text has another encoding such "
            f"as Latin-1; save it as UTF-8"
        ) from cause


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


# --------------------------------------------------------------------------------------------------
# Files that are there whole or not at all: written beside their place, then moved there.


@contextmanager
def replace_file(path: Path, *, sync: bool = False) -> Iterator[Path]:
    """Yield a path beside `path` to write to; the file there takes the place of `path` when the block ends.

    If the block raises, `path` stays as it was and nothing is left beside it. The name is new for each call: processes
    may write the same file at once. `sync` waits until the content is on the disk: a power cut loses nothing.

    Raises OSError for what is there and no file: a device such as /dev/null, or a pipe, must not be replaced by one.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     place = Path(folder, "numbers")
    ...     with replace_file(place) as part:
    ...         _ = part.write_text("1 2 3")
    ...     [(file.name, file.read_text()) for file in Path(folder).iterdir()]
    [('numbers', '1 2 3')]
    """
    if path.exists() and not (path.is_file() or path.is_dir()):  # the system itself refuses a folder
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    part = path.with_name(f".{path.name}-{os.urandom(4).hex()}.part")
    try:
        yield part
        if sync:
            with part.open("rb+") as file:  # not every system writes out a file that is open for reading only
                os.fsync(file.fileno())
        os.replace(part, path)
    except BaseException:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise


# --------------------------------------------------------------------------------------------------
# Several files, or a folder, that are there whole or not at all: written beside their places, then moved there.


@contextmanager
def replace_files(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """Yield a path beside each of `paths` to write to; all take their places when the block ends, or none does.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     with replace_files([Path(folder, "a"), Path(folder, "b")]) as parts:
    ...         _ = [part.write_text("1") for part in parts]
    ...     sorted(file.name for file in Path(folder).iterdir())
    ['a', 'b']
    """
    parts = [_name_beside(path, "part") for path in paths]
    try:
        yield parts
        _move_all(list(zip(parts, paths, strict=True)))
    finally:
        for part in parts:
            _remove(part)


@contextmanager
def replace_folder(path: Path) -> Iterator[Path]:
    """Yield a new folder beside `path` to write into; it takes the place of `path`, if that exists, at the end."""
    part = _name_beside(path, "part")
    try:
        part.mkdir(parents=True)
        yield part
        _move_all([(part, path)])
    finally:
        _remove(part)


def _move_all(moves: list[tuple[Path, Path]]) -> None:
    """Move every first path to its second; if one cannot be moved, all that was there is there again."""
    old = {path: _name_beside(path, "old") for _, path in moves}
    done: list[Path] = []
    try:
        for part, path in moves:
            if path.exists():
                os.replace(path, old[path])
            done.append(path)
            os.replace(part, path)
    except BaseException:
        for path in reversed(done):
            with suppress(OSError):
                _remove(path)
                if old[path].exists():
                    os.replace(old[path], path)
        raise
    for path in done:
        _remove(old[path])


def _name_beside(path: Path, end: str) -> Path:
    return path.with_name(f".{path.name}-{os.urandom(4).hex()}.{end}")


def _remove(path: Path) -> None:
    """Without a word where there is nothing; a link goes, not what it leads to."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
        return
    with suppress(OSError):
        path.unlink(missing_ok=True)


# --------------------------------------------------------------------------------------------------
# Text that a file brings with it: shown as it is written, and never as what a terminal, table or system makes of it.
#
# A recording, database or scene may come from anybody. `visible` is for all that is printed, `foreign_text` for one
# line of it, `foreign_name` for names of columns, files and members, and `escape_formula` for cells of a table.
# `tests/contracts/test_poisoned_files.py` lists the commands that print or write such text, and tries each.


#: control characters but line feed and tab; marks that turn the direction of writing; separators of lines; surrogates
_HIDDEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028\u2029\u202a-\u202e\u2060-\u2069\ufeff\ud800-\udfff"
    "\U000e0000-\U000e007f]"
)
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029]")
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")
_NUMBER = re.compile(r"[+-]?[0-9]+(\.[0-9]+)?")
_NAME = 64  #: characters of a name


def visible(text: str) -> str:
    r"""`text` with `\x1b` and the like in place of what would act on a terminal, or hide or turn what is read.

    Lines and tabs stay.

    >>> print(visible("a\x1b]52;c;cm0=\x07b"))
    a\x1b]52;c;cm0=\x07b
    """
    return _HIDDEN.sub(lambda found: _spell(found[0]), text)  # safety: text-visible


def _spell(letter: str) -> str:
    number = ord(letter)
    return f"\\x{number:02x}" if number < 0x100 else f"\\u{number:04x}" if number < 0x10000 else f"\\U{number:08x}"


def foreign_text(value: object, most: int = 200) -> str:
    r"""`value` as one visible line of at most `most` characters.

    >>> print(foreign_text("one\ntwo" + "x" * 10, 12))
    one\ntwoxxx…
    """
    text = visible(str(value)[: 8 * most]).replace("\n", "\\n").replace("\t", "\\t")
    return text if len(text) <= most and len(str(value)) <= 8 * most else f"{text[: most - 1]}…"


def foreign_name(value: object) -> str:
    """`value` as a name of a column, a file or a member of an archive: letters, digits, `_`, `-` and single dots.

    >>> foreign_name("ball.place"), foreign_name("../../.bashrc"), foreign_name("=cmd|' /C calc'!A0")
    ('ball.place', 'bashrc', 'cmd_C_calc_A0')
    """
    text = "".join(letter if letter.isalnum() or letter in "_.-" else "_" for letter in str(value)[: 4 * _NAME])
    text = re.sub(r"\.{2,}", ".", re.sub(r"_{2,}", "_", text)).strip("._-")
    return text[:_NAME].rstrip("._-") or "unnamed"


def escape_formula(text: str) -> str:
    """`text` for a cell that no spreadsheet takes for a formula: where it begins like one, `'` stands before it.

    Control characters but line feed and tab are made visible; all else is as it was typed.

    >>> escape_formula("=1+1"), escape_formula("-3"), escape_formula("as it is")
    ("'=1+1", '-3', 'as it is')
    """
    text = _CONTROL.sub(lambda found: _spell(found[0]), text)  # safety: cell-visible
    return f"'{text}" if text.lstrip(" ").startswith(_FORMULA) and not _NUMBER.fullmatch(text) else text


def named_file(
    name: str, folder: Path, what: str, error: type[HaptorbError], limit: Path | None = None,
    remedy: str = "copy it there",
) -> Path:  # fmt: skip
    """The file `name` that a file in `folder` names: it must lie there or below, or below `limit`, links followed.

    Raises `error`, naming `what` it is, for another place: who wrote the file does not choose what is read elsewhere.
    """
    try:
        root = folder.resolve()
        found = (root / name).resolve()
        edge = root if limit is None else limit.resolve()
        inside = found.is_relative_to(edge)
        found.exists()  # raises for a name that is too long
    except (OSError, ValueError, RuntimeError) as cause:  # a zero byte, or links in a circle
        raise error(f"{what} {quote(name)}: not the name of a file") from cause
    if not inside:  # safety: named-inside
        raise error(f"{what} {quote(name)}: is not read, as it lies outside {edge}; {remedy}")
    return found


# --------------------------------------------------------------------------------------------------
# Where programs of this account keep what lasts longer than a run, and is not computed again.


def state_folder() -> Path:
    """Folder for the state of programs: $XDG_STATE_HOME/haptorb, else ~/.local/state/haptorb; below the cache folder
    where this account has no home in which it may write."""
    home = os.environ.get("XDG_STATE_HOME") or find_home(".local", "state")
    if home:
        folder = Path(home) / "haptorb"
        there = next(one for one in (folder, *folder.absolute().parents) if one.exists())
        if os.access(there, os.W_OK):
            return folder
    return cache_folder() / "state"


# --------------------------------------------------------------------------------------------------
# Files that a program keeps only while it runs, and how the next one finds those whose owner has ended.
#
# An owner holds a lock on its file (`flock`), which the kernel takes away when the owner ends, however it ends. A file
# of ours that can be locked has no owner, and goes.


FOLDER = "haptorb-servo-"  #: beginning of a folder's name
SHARED = ".shared"  #: end of a shared memory's name; it begins with haptorb-
RECORDING = ".temporary.mcap"  #: end of a temporary recording's name; it begins with haptorb-

_OURS = re.compile(rf"haptorb-\w+(?:{re.escape(SHARED)}|{re.escape(RECORDING)})|{FOLDER}\w+", re.ASCII)


@final
class FileLock:
    """Holds the file or folder at `path`, which was just made, until `close` or the end of this process.

    `there` says whether the file still exists: between its creation and this, another program's `sweep` may have
    removed it.
    """

    def __init__(self, path: Path | str) -> None:
        self.there = False
        self._descriptor = -1
        try:
            import fcntl
        except ImportError:  # Windows: a file that is in use cannot be removed there
            self.there = os.path.exists(path)
            return
        with suppress(FileNotFoundError):
            self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            with suppress(OSError):  # a file system without locks: then `sweep` cannot lock it either, and lets it be
                fcntl.flock(self._descriptor, fcntl.LOCK_EX)
            self.there = os.fstat(self._descriptor).st_nlink > 0

    def close(self) -> None:
        """Release it. May be called twice."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def __del__(self) -> None:
        self.close()


def folders() -> list[Path]:
    """Where such files are made: in memory, where the system has a place for that, and for what is temporary."""
    return [Path("/dev/shm"), Path(tempfile.gettempdir())]


def sweep() -> int:
    """Remove what ended owners of this user left; returns how many files and folders that were.

    Nothing whose owner still runs is touched, nor anything that this package did not name.
    """
    removed = 0
    for folder in dict.fromkeys(folders()):
        with suppress(OSError), os.scandir(folder) as entries:
            for entry in entries:
                if _OURS.fullmatch(entry.name):
                    removed += _remove_if_stale(entry)  # safety: leftovers-swept
    return removed


def _remove_if_stale(entry: os.DirEntry[str]) -> bool:
    """Whether `entry` had no owner; then it is gone."""
    try:
        import fcntl
    except ImportError:
        return _remove_if_old(entry)
    try:
        found = entry.stat(follow_symlinks=False)
        if found.st_uid != os.geteuid() or not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
            return False
        descriptor = os.open(entry.path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # safety: living-files
        # While the lock is held: a program that creates such a file waits for it, and sees that the file is gone.
        if stat.S_ISDIR(found.st_mode):
            shutil.rmtree(entry.path)
        else:
            os.unlink(entry.path)
    except OSError:  # another user's, or gone already
        return False
    finally:
        os.close(descriptor)
    return True


_OLD_S = 7 * 86400.0  #: age from which a file without a lock has no owner; on Windows, one in use cannot be removed


def _remove_if_old(entry: os.DirEntry[str]) -> bool:
    """Whether `entry` was old, on a system without locks; then it is gone."""
    try:
        if time() - entry.stat(follow_symlinks=False).st_mtime < _OLD_S:
            return False
        if entry.is_dir(follow_symlinks=False):
            shutil.rmtree(entry.path)
        else:
            os.unlink(entry.path)
    except OSError:
        return False
    return True
