"""Several files, or a folder, that are there whole or not at all: written beside their places, then moved there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["replace_files", "replace_folder"]


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
