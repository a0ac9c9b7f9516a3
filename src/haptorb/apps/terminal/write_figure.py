"""Pictures that commands write: whole or not at all, in the format of the file's name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from haptorb.errors import InputError
from haptorb.files.replace_file import replace_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FORMATS", "write_figure"]

#: endings of file names, which are the formats
FORMATS = (".png", ".svg", ".pdf")


def write_figure(figure: Figure, path: Path, option: str) -> None:
    """Write `figure` in the format of the name of `path`; InputError, which names `option`, where that cannot be."""
    try:
        with replace_file(path) as part:
            figure.savefig(part, format=path.suffix.lower()[1:], dpi=150)
    except OSError as cause:
        raise InputError(f"{option}: cannot write '{path}' ({cause.strerror}); choose another place") from cause
