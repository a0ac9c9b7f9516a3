"""Calibrations as files: written whole or not at all, and never over another one by accident."""

from __future__ import annotations

import os
from pathlib import Path

from haptorb.errors import CalibrationError
from haptorb.sensing.calibration import Calibration

__all__ = ["read_calibration", "writable", "write_calibration"]


def read_calibration(path: str | Path) -> Calibration:
    """The calibration in the file; CalibrationError if it cannot be read or is none."""
    try:
        text = Path(path).expanduser().read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as cause:
        reason = cause.strerror if isinstance(cause, OSError) else "not a text file"
        raise CalibrationError(f"calibration {path}: cannot be read ({reason})") from cause
    return Calibration.parse(text, str(path))


def writable(path: str | Path, *, overwrite: bool) -> Path:
    """`path`, if a calibration may be written there; asked before anything is measured.

    Raises CalibrationError if the file exists and `overwrite` is not set, or if there is no folder for it.
    """
    place = Path(path).expanduser()
    if place.exists() and not overwrite:
        raise CalibrationError(f"{path} exists; choose another name, or allow it to be replaced (--force)")
    if not place.parent.is_dir():
        raise CalibrationError(f"{path}: the folder '{place.parent}' does not exist")
    return place


def write_calibration(calibration: Calibration, path: str | Path, *, overwrite: bool = False) -> None:
    """Write the file; nothing is written half.

    Raises CalibrationError for what `writable` does not allow, or if the system cannot write it.
    """
    place = writable(path, overwrite=overwrite)
    part = place.with_name(place.name + ".part")
    try:
        part.write_text(calibration.text(), encoding="utf-8")
        os.replace(part, place)
    except OSError as cause:
        part.unlink(missing_ok=True)
        raise CalibrationError(f"cannot write {path}: {cause.strerror}") from cause
