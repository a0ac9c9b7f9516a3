"""Files that are there whole or not at all: written beside their place, then moved there."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["replace_file"]


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
