"""A path in a table: one point per line, in millimetres."""

from __future__ import annotations

import math
from pathlib import Path

from haptorb.errors import InputError, quote
from haptorb.files.file_kind import FileKind
from haptorb.files.text_file import read_text
from haptorb.worlds.path_guidance.guidance_path import GuidancePath, make_path

__all__ = ["load_path"]

_HEAD = "x_mm,y_mm,z_mm"


def load_path(file: str | Path, *, closed: bool | None = None, smooth: bool = True) -> GuidancePath:
    """The path through the points of a CSV file whose first line is x_mm,y_mm,z_mm; see `make_path` for the rest.

    Raises InputError, with the line, for a file that cannot be read, another header, or an invalid number.
    """
    path = Path(file).expanduser()
    # Spreadsheet programs begin a file with a byte order mark.
    lines = read_text(path, "path file", InputError, kind=FileKind.TABLE).removeprefix("\ufeff").splitlines()
    if not lines or "".join(lines[0].split()) != _HEAD:
        raise InputError(
            f"path file {path}, line 1: the header must be '{_HEAD}'; got "
            f"{quote(lines[0] if lines else 'an empty file')}"
        )
    points = []
    for number, line in enumerate(lines[1:], 2):
        if not line.strip():
            continue
        try:
            x, y, z = (1e-3 * float(cell) for cell in line.split(","))
            finite = math.isfinite(x + y + z)
        except ValueError:
            finite = False
        if not finite:
            raise InputError(f"path file {path}, line {number}: expected three numbers; got {quote(line)}")
        points.append((x, y, z))
    try:
        return make_path(points, closed=closed, smooth=smooth)
    except InputError as mistake:
        raise InputError(f"path file {path}: {mistake}") from mistake
