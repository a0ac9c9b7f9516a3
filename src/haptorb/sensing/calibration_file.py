"""Calibrations and trackers' frames as files: written whole or not at all, and never over another by accident."""

from __future__ import annotations

from pathlib import Path

from haptorb.errors import CalibrationError
from haptorb.files.file_kind import FileKind
from haptorb.files.replace_file import replace_file
from haptorb.files.text_file import read_text
from haptorb.sensing.calibration.calibration import Calibration
from haptorb.sensing.frame.tracker_frame import TrackerFrame

__all__ = ["check_writable", "read_calibration", "read_frame", "write_calibration", "write_frame"]

_MOST = 1024 * 1024  #: bytes


def read_calibration(path: str | Path) -> Calibration:
    """The calibration in the file; CalibrationError if it cannot be read or is none."""
    return Calibration.parse(read_text(path, "calibration", CalibrationError, _MOST, FileKind.CALIBRATION), str(path))


def read_frame(path: str | Path) -> TrackerFrame:
    """The tracker's frame in the file; CalibrationError if it cannot be read or is none."""
    return TrackerFrame.parse(read_text(path, "frame", CalibrationError, _MOST, FileKind.FRAME), str(path))


def check_writable(path: str | Path, *, overwrite: bool) -> Path:
    """`path`, if a calibration or frame may be written there; asked before anything is measured.

    Raises CalibrationError if the file exists and `overwrite` is not set, or if there is no folder for it.
    """
    try:
        place = Path(path).expanduser()
        if place.exists() and not overwrite:
            text = f"{path} exists; choose another name, or replace it"
            raise CalibrationError(f"{text} with overwrite=True", command=f"{text} with --force")
        if not place.parent.is_dir():
            raise CalibrationError(f"{path}: the folder '{place.parent}' does not exist")
    except OSError as cause:
        raise CalibrationError(f"cannot write {path}: {cause.strerror}") from cause
    except (ValueError, RuntimeError) as cause:  # a zero byte in its name, or the folder of an unknown user
        raise CalibrationError(f"cannot write {str(path)!r}: not the name of a file") from cause
    return place


def write_calibration(calibration: Calibration, path: str | Path, *, overwrite: bool = False) -> None:
    """Write the file; nothing is written half.

    Raises CalibrationError for what `check_writable` does not allow, or if the system cannot write it.
    """
    _write(calibration.text(), path, overwrite)


def write_frame(frame: TrackerFrame, path: str | Path, *, overwrite: bool = False) -> None:
    """Write the file; nothing is written half. Raises CalibrationError as `write_calibration` does."""
    _write(frame.text(), path, overwrite)


def _write(text: str, path: str | Path, overwrite: bool) -> None:
    place = check_writable(path, overwrite=overwrite)
    try:
        with replace_file(place) as part:
            part.write_text(text, encoding="utf-8")
    except OSError as cause:
        raise CalibrationError(f"cannot write {path}: {cause.strerror}") from cause
