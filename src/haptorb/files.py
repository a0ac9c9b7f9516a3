"""Reading of untrusted files: regular files of bounded size, TOML and JSON of bounded depth; errors are one sentence.

A file's content cannot be trusted: it may be an endless device, a megabyte of brackets, or a number of a thousand
digits. Each of them must raise the reader's own error, quickly and with little memory.
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
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from time import time
from typing import Any, BinaryIO, Literal, Protocol, final, get_args

from haptorb.cache_folder import cache_folder, can_write_to, explain_shared, find_base, private_folder
from haptorb.errors import HaptorbError, quote

__all__ = [
    "RECORDING",
    "SHARED",
    "FileLock",
    "FolderUse",
    "create_private_folder",
    "describe_size_limit",
    "escape_formula",
    "folders",
    "foreign_name",
    "foreign_text",
    "named_file",
    "open_regular",
    "parse_json",
    "parse_toml",
    "private_temporary_folder",
    "read_bytes",
    "read_text",
    "replace_file",
    "replace_files",
    "replace_folder",
    "state_folder",
    "sweep",
    "visible",
]


_MAX_TOML_BYTES = 256 * 1024  #: bytes of a TOML file
_MAX_DEPTH = 16  #: nesting depth of tables and lists
_MAX_KEY_PARTS = 64  #: parts of a dotted key: parsing time grows with their square
#: One part of a key, possibly quoted. What a part has taken it does not give back: the search takes linear time.
_KEY_PART = r"""(?:(?<![\w-])[\w-]++|(?<!\\)"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')[ \t]*+"""
_DOTTED = re.compile(rf"(?:{_KEY_PART}\.[ \t]*+){{{_MAX_KEY_PARTS}}}{_KEY_PART}")


class RecognisedKind(Protocol):
    """A kind of file that can be distinguished from others."""

    def explain_other(self, path: str | Path, head: bytes) -> str:
        """Explain why the file `path`, which begins with `head`, is of another kind; "" if it may be of this one."""


class _File(io.FileIO):
    """Non-blocking file: some regular files of /proc and /sys block until there is new data."""

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
    """Open the regular file `path` for reading; every file named by a user or another file is opened here.

    Pipes and devices are neither waited for, nor read, nor changed, as a terminal would be.

    Raises `error`, which names `what` it is, if the file cannot be opened or read, or is not a regular file.
    """
    name = quote(str(path), 300)[1:-1]
    try:
        file = io.BufferedReader(_File(Path(path).expanduser(), "rb", opener=_open_at_once))
    except OSError as cause:
        raise error(f"{what} {name}: cannot be read ({cause.strerror})") from cause
    except (ValueError, RuntimeError) as cause:  # a zero byte in the name, or the home of an unknown user
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
    """Return the bytes of the regular file `path`, at most `most`.

    Raises `error`, which names `what` it is, if it cannot be read, is not regular or is longer, or if it is recognised
    as another `kind` of file.
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
    path: str | Path,
    what: str,
    error: type[HaptorbError],
    most: int = _MAX_TOML_BYTES,
    kind: RecognisedKind | None = None,
) -> str:
    """Return the UTF-8 text of the file `path`, without a byte order mark. Raises `error` as `read_bytes` does, and if
    it is not text or has another encoding."""
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
    """Parse TOML into tables. Raises ValueError (one line) if it is invalid or nested too deeply."""
    if len(text) > _MAX_TOML_BYTES:
        raise ValueError(f"it is longer than {_MAX_TOML_BYTES} characters")
    if _DOTTED.search(text):
        raise ValueError(f"a key has more than {_MAX_KEY_PARTS} parts")
    try:
        raw = tomllib.loads(text)
    except RecursionError as cause:
        raise ValueError(f"it is nested deeper than {_MAX_DEPTH} levels") from cause
    _check_depth(raw)
    return raw


def parse_json(text: str | bytes) -> Any:
    """Parse JSON. Raises ValueError (one line) if it is invalid or nested too deeply."""
    try:
        raw = json.loads(text)
    except RecursionError as cause:
        raise ValueError(f"it is nested deeper than {_MAX_DEPTH} levels") from cause
    _check_depth(raw)
    return raw


def _open_at_once(path: str, flags: int) -> int:
    """Open a file without waiting for the writer of a pipe; an `opener` for Python's `open`."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0))


def _check_depth(raw: Any) -> None:
    level = [raw]
    for _ in range(_MAX_DEPTH):
        level = [
            part
            for found in level
            if isinstance(found, dict | list)
            for part in (found.values() if isinstance(found, dict) else found)
        ]
        if not level:
            return
    raise ValueError(f"it is nested deeper than {_MAX_DEPTH} levels")


# --------------------------------------------------------------------------------------------------
# Atomic replacement of a file: it is written beside its destination, then moved there.


def describe_size_limit() -> str:
    """Return what limits the size of the files that this process may write, and what to do; empty without a limit."""
    try:
        import resource  # not at the top: Windows lacks it
    except ImportError:
        return ""
    most = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    if most == resource.RLIM_INFINITY:
        return ""
    return f"no file may be larger than {most / 1024:.0f} KiB in this shell (ulimit -f): raise that limit"


@contextmanager
def replace_file(path: Path, *, sync: bool = False) -> Iterator[Path]:
    """Yield a path beside `path` to write to; that file replaces `path` when the block ends.

    If the block raises, `path` is unchanged and no other file remains. The name is new for each call: several processes
    may write the same file at once. `sync` waits until the content is on the disk, so that a power cut loses nothing.

    Raises OSError if `path` exists and is not a regular file: a device such as /dev/null, or a pipe, is never replaced.

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
            with part.open("rb+") as file:  # some systems cannot flush a file that is open for reading only
                os.fsync(file.fileno())
        os.replace(part, path)
    except BaseException:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise


# --------------------------------------------------------------------------------------------------
# Atomic replacement of several files, or a folder: written beside their destinations, then moved there.


@contextmanager
def replace_files(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """Yield a path beside each of `paths` to write to; all replace `paths` when the block ends, or none does.

    A link is replaced, not followed. Raises OSError if one of `paths` exists and is neither a regular file nor a link.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     with replace_files([Path(folder, "a"), Path(folder, "b")]) as parts:
    ...         _ = [part.write_text("1") for part in parts]
    ...     sorted(file.name for file in Path(folder).iterdir())
    ['a', 'b']
    """
    for path in paths:
        if path.exists() and not path.is_symlink() and not path.is_file():
            raise OSError(errno.EINVAL, "not a regular file", str(path))
    parts = [_name_beside(path, "part") for path in paths]
    try:
        yield parts
        _move_all(list(zip(parts, paths, strict=True)))
    finally:
        for part in parts:
            _remove(part)


@contextmanager
def replace_folder(path: Path) -> Iterator[Path]:
    """Yield a new folder beside `path` to write into; it replaces `path`, if that exists, at the end."""
    part = _name_beside(path, "part")
    try:
        part.mkdir(parents=True)
        yield part
        _move_all([(part, path)])
    finally:
        _remove(part)


def _move_all(moves: list[tuple[Path, Path]]) -> None:
    """Move every first path to its second; if one move fails, undo all."""
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
    """Remove a file or folder if it exists; of a link only the link."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
        return
    with suppress(OSError):
        path.unlink(missing_ok=True)


# --------------------------------------------------------------------------------------------------
# Untrusted text in files: shown literally, never interpreted by a terminal, spreadsheet or file system.
#
# A recording, database or scene may come from anybody. `visible` is for all printed text, `foreign_text` for one
# line of it, `foreign_name` for names of columns, files and archive members, and `escape_formula` for table cells.
# `tests/contracts/test_poisoned_files.py` lists the commands that print or write such text, and tests each.


#: control characters but line feed and tab; bidirectional marks; line separators; surrogates; letters without a shape,
#: tags and selectors, which can carry a hidden text. U+200C and U+200D join letters of some scripts, and are kept
_HIDDEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u034f\u061c\u115f\u1160\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\u3164\ufeff"
    "\uffa0\ufff9-\ufffb\ud800-\udfff\U0001bca0-\U0001bca3\U0001d173-\U0001d17a\U000e0000-\U000e0fff]"
)
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029]")
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")
_NUMBER = re.compile(r"[+-]?[0-9]+(\.[0-9]+)?")
_MAX_NAME_LENGTH = 64  #: characters of a name, at most


def visible(text: str, spell: Callable[[str], str] | None = None) -> str:
    r"""Escape, as `\x1b`, characters that control a terminal, are invisible, or change the writing direction.

    Lines and tabs are kept. `spell` returns another escape of a character, as JSON has it.

    >>> print(visible("a\x1b]52;c;cm0=\x07b"))
    a\x1b]52;c;cm0=\x07b
    """
    return _HIDDEN.sub(lambda found: (spell or _spell)(found[0]), text)  # safety: text-visible


def _spell(letter: str) -> str:
    number = ord(letter)
    return f"\\x{number:02x}" if number < 0x100 else f"\\u{number:04x}" if number < 0x10000 else f"\\U{number:08x}"


def foreign_text(value: object, most: int = 200) -> str:
    r"""Return `value` as one visible line of at most `most` characters.

    >>> print(foreign_text("one\ntwo" + "x" * 10, 12))
    one\ntwoxxx…
    """
    text = visible(str(value)[: 8 * most]).replace("\n", "\\n").replace("\t", "\\t")
    return text if len(text) <= most and len(str(value)) <= 8 * most else f"{text[: most - 1]}…"


def foreign_name(value: object) -> str:
    """Return `value` as a name of a column, file or archive member: letters, digits, `_`, `-` and single dots.

    >>> foreign_name("ball.place"), foreign_name("../../.bashrc"), foreign_name("=cmd|' /C calc'!A0")
    ('ball.place', 'bashrc', 'cmd_C_calc_A0')
    """
    text = "".join(
        letter if letter.isalnum() or letter in "_.-" else "_" for letter in str(value)[: 4 * _MAX_NAME_LENGTH]
    )
    text = re.sub(r"\.{2,}", ".", re.sub(r"_{2,}", "_", text)).strip("._-")
    return text[:_MAX_NAME_LENGTH].rstrip("._-") or "unnamed"


def escape_formula(text: str) -> str:
    """Return `text` for a table cell, with `'` before it if a spreadsheet would take it for a formula.

    Control characters but line feed and tab are made visible; all else is unchanged.

    >>> escape_formula("=1+1"), escape_formula("-3"), escape_formula("as it is")
    ("'=1+1", '-3', 'as it is')
    """
    text = _CONTROL.sub(lambda found: _spell(found[0]), text)  # safety: cell-visible
    return f"'{text}" if text.lstrip(" ").startswith(_FORMULA) and not _NUMBER.fullmatch(text) else text


def named_file(
    name: str, folder: Path, what: str, error: type[HaptorbError], limit: Path | None = None,
    remedy: str = "copy it there",
) -> Path:  # fmt: skip
    """Return the file `name` that a file in `folder` refers to: it must be below it, or below `limit`, links resolved.

    Raises `error`, which names `what` it is, for another place: a file's author must not select other files to read.
    """
    try:
        root = folder.resolve()
        found = (root / name).resolve()
        edge = root if limit is None else limit.resolve()
        inside = found.is_relative_to(edge)
        found.exists()  # raises for a name that is too long
    except (OSError, ValueError, RuntimeError) as cause:  # a zero byte, or circular links
        raise error(f"{what} {quote(name)}: not the name of a file") from cause
    if not inside:  # safety: named-inside
        raise error(f"{what} {quote(name)}: is not read, as it lies outside {edge}; {remedy}")
    return found


# --------------------------------------------------------------------------------------------------
# State of programs of this account that persists between runs and cannot be recomputed.


def state_folder() -> Path:
    """Return the folder for the state of programs: $XDG_STATE_HOME/haptorb, else ~/.local/state/haptorb; below the
    cache folder if this account has no writable home."""
    if home := find_base("XDG_STATE_HOME", ".local", "state"):
        folder = Path(home) / "haptorb"
        if can_write_to(folder):
            return folder
    return cache_folder() / "state"


# --------------------------------------------------------------------------------------------------
# Files that exist only while a program runs, and removal of those whose owner has ended.
#
# An owner holds a lock on its file (`flock`), which the kernel releases when the owner ends in any way. A file of this
# package that can be locked has no owner, and is removed.


#: what a folder is for; its name has this word and eight characters that nobody chose, as "haptorb-servo-x3_f0aq1"
FolderUse = Literal["servo", "serve", "page", "scene", "libraries", "testrun"]
SHARED = ".shared"  #: suffix of a shared memory's name, whose prefix is haptorb-
RECORDING = ".temporary.mcap"  #: suffix of a temporary recording's name, whose prefix is haptorb-

_OURS = re.compile(
    rf"haptorb-\w+(?:{re.escape(SHARED)}|{re.escape(RECORDING)})|haptorb-(?:{'|'.join(get_args(FolderUse))})-\w{{8}}",
    re.ASCII,
)


@final
class FileLock:
    """Locks the file or folder at `path`, which was just created, until `close` or the end of this process.

    `there` is whether the file still exists: between its creation and the lock, another program's `sweep` may have
    removed it.
    """

    def __init__(self, path: Path | str) -> None:
        self.there = False
        self._descriptor = -1
        try:
            import fcntl
        except ImportError:  # Windows: a file in use cannot be removed
            self.there = os.path.exists(path)
            return
        with suppress(FileNotFoundError):
            self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            with suppress(OSError):  # a file system without locks: then `sweep` cannot lock it either, and leaves it
                fcntl.flock(self._descriptor, fcntl.LOCK_EX)
            self.there = os.fstat(self._descriptor).st_nlink > 0

    def close(self) -> None:
        """Release the lock. May be called twice."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def __del__(self) -> None:
        self.close()


def folders() -> list[Path]:
    """Return the folders of such files: in memory, if the system has such a folder, and the temporary folder."""
    return [Path("/dev/shm"), Path(tempfile.gettempdir())]


def create_private_folder(use: FolderUse) -> tuple[Path, FileLock]:
    """Create a new folder that no other account can write to, rename or replace, because its files may be executed.

    Returns it with its lock: when that is released, by `close` or the end of this process, any program's `sweep` may
    remove the folder. It is in the temporary folder; in the cache folder of this account, if others may rename what is
    in that one. Raises HaptorbError if they may in both.
    """
    while True:
        folder = _make_private_folder(f"haptorb-{use}-")
        lock = FileLock(folder)
        if lock.there:
            return folder, lock


def _make_private_folder(prefix: str) -> Path:
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix))
        shared = explain_shared(folder)
        if not shared:  # safety: private-temporary
            return folder
        with suppress(FileNotFoundError):
            folder.rmdir()
            break
        # Another program that starts removed it: it has no lock yet, as one that is left behind.
    try:
        return Path(tempfile.mkdtemp(prefix=prefix, dir=private_folder("temporary")))
    except OSError as cause:
        raise HaptorbError(
            f"no folder for temporary files is only this account's: {folder} {shared}; set TMPDIR to a folder of yours"
        ) from cause


@contextmanager
def private_temporary_folder(use: FolderUse) -> Iterator[Path]:
    """Context with a folder of `create_private_folder`, which is removed at its end."""
    folder, lock = create_private_folder(use)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        lock.close()


def sweep() -> int:
    """Remove files left by ended owners of this user; return the number of files and folders removed.

    Files whose owner still runs, and files that this package did not name, are kept.
    """
    removed = 0
    for folder in dict.fromkeys([*folders(), cache_folder() / "temporary"]):
        with suppress(OSError), os.scandir(folder) as entries:
            for entry in entries:
                if _OURS.fullmatch(entry.name):
                    removed += _remove_if_stale(entry)  # safety: leftovers-swept
    return removed


def _remove_if_stale(entry: os.DirEntry[str]) -> bool:
    """Remove `entry` if it has no owner; return whether it was removed."""
    try:
        import fcntl
    except ImportError:
        return _remove_if_old(entry)
    try:
        found = entry.stat(follow_symlinks=False)
        private = stat.S_ISDIR(found.st_mode) and not found.st_mode & 0o077  # as `create_private_folder` makes them
        if found.st_uid != os.geteuid() or not (private or stat.S_ISREG(found.st_mode)):
            return False
        descriptor = os.open(entry.path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # safety: living-files
        # The lock is held meanwhile: a program that creates such a file waits for it, and sees that the file is gone.
        if stat.S_ISDIR(found.st_mode):
            shutil.rmtree(entry.path)
        else:
            os.unlink(entry.path)
    except OSError:  # another user's, or already removed
        return False
    finally:
        os.close(descriptor)
    return True


_OLD_S = 7 * 86400.0  #: age from which a file without a lock has no owner; on Windows, a file in use cannot be removed


def _remove_if_old(entry: os.DirEntry[str]) -> bool:
    """Remove `entry` if it is old, on a system without locks; return whether it was removed."""
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
