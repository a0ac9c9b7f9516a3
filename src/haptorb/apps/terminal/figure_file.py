"""`--plot FILE`: checked before anything is computed, so that hours of work do not end in a file that cannot be."""

from __future__ import annotations

import tempfile
from pathlib import Path

from haptorb.errors import InputError

__all__ = ["check_figure"]

_SUFFIXES = (".png", ".svg")


def check_figure(path: Path | None, suffixes: tuple[str, ...] = _SUFFIXES, option: str = "--plot") -> None:
    """Raise InputError unless a figure can be written to `path`; None: no figure is wanted."""
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        kinds = f"{', '.join(suffixes[:-1])} or {suffixes[-1]}"
        raise InputError(f"{option} must be a {kinds} file; got '{path}'")
    if not path.parent.is_dir():
        raise InputError(f"{option}: the folder '{path.parent}' does not exist")
    try:
        if path.exists():
            path.open("r+b").close()
        else:
            tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as cause:
        raise InputError(f"{option}: cannot write '{path}' ({cause.strerror}); choose another place") from cause
