"""Figures that commands write: check of the path, and atomic writing."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from haptorb.errors import InputError, quote
from haptorb.files import replace_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FORMATS", "check_figure_file", "write_figure"]

#: supported formats, by file name extension
FORMATS = (".png", ".svg", ".pdf")


def check_figure_file(path: Path, option: str) -> Path:
    """Return `path` if a figure can be written there; otherwise InputError that names the `option`.

    >>> check_figure_file(Path("card.pdf"), "--plot").name
    'card.pdf'
    """
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{option} must be a .png, .svg or .pdf file; got {quote(str(path), 300)}")
    if path.is_dir():
        raise InputError(f"{option}: '{path}' is a folder; give the name of a file in it")
    if not path.parent.is_dir():
        raise InputError(f"{option}: the folder '{path.parent}' does not exist")
    try:
        tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as cause:
        raise InputError(f"{option}: cannot write '{path}' ({cause.strerror}); choose another folder") from cause
    return path


def write_figure(figure: Figure, path: Path, option: str) -> None:
    """Write `figure` in the format of the extension of `path`; InputError if the folder is not writable."""
    try:
        with replace_file(path) as part:
            figure.savefig(part, format=path.suffix.lower()[1:], dpi=150)
    except OSError as cause:
        raise InputError(f"{option}: cannot write '{path}': {cause.strerror or cause}") from cause
