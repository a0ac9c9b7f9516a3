"""Trace of a presentation: state of the part at every tick, and its CSV file."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from time import sleep
from typing import final

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import State
from haptorb.errors import RecordingError
from haptorb.files import read_text, replace_file
from haptorb.recording.row import RowLayout
from haptorb_study.feel.designs import Candidate

__all__ = ["COLUMNS", "FELT", "HAND", "Trace", "is_felt", "read_trace", "trace_rows", "write_trace"]


COLUMNS = ("t_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "fx_n", "fy_n", "fz_n", "tx_nm", "ty_nm", "tz_nm")
#: quantities at the handle: torque requested and commanded, guard's scale, whether the device was saturated
HAND = ("asked_nm", "given_nm", "guard_gain", "saturated")

_FELT_FORCE_N, _FELT_TORQUE_NM = 0.1, 0.002  #: perception limits on the part [N], [N·m]
_FELT_MOTION_M, _FELT_ROTATION_RAD = (
    0.5e-3,
    np.radians(1.0),
)  #: perception limits of motion since the first tick [m], [rad]
FELT = "0.1 N or 2 mN·m on the part, or 0.5 mm or 1° of motion, since it was chosen"  #: as text
_MAX_TRACE_BYTES = 256 * 1024 * 1024  #: maximum size of a trace [bytes]
_BLOCK_ROWS = 500  #: rows written at a time
_BLOCK_PAUSE_S = 0.002  #: pause between two blocks while a servo runs: this process must send its keep-alive [s]


@final
class Trace:
    """Trace of a presentation: append ticks or rows, then store it with `FeelSession.store_trace`."""

    def __init__(self, design: Candidate) -> None:
        self.design = design
        self._parts: list[Array] = []

    def append(self, body: State, wrench: Array) -> None:
        """Append a tick: state of the object and wrench on it (6,); the quantities at the handle are unknown."""
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_matrix(body.R_SR).as_quat()
        row = [body.t, *body.p.tolist(), *turn.tolist(), *np.asarray(wrench, dtype=float).tolist()]
        self._parts.append(np.array([row + [np.nan] * len(HAND)]))

    def extend(self, rows: Array) -> None:
        """Append ticks (n, 18) by COLUMNS and HAND."""
        if len(rows):
            self._parts.append(rows)

    def __len__(self) -> int:
        return sum(map(len, self._parts))

    @property
    def rows(self) -> Array:
        """(n, 14) by COLUMNS."""
        return self.all_rows[:, : len(COLUMNS)]

    @property
    def all_rows(self) -> Array:
        """(n, 18) by COLUMNS and HAND."""
        width = len(COLUMNS) + len(HAND)
        return np.concatenate([np.empty((0, width)), *self._parts])


def is_felt(rows: Array, first: Array | None = None) -> bool:
    """Whether `rows` (n, 14 or 18) exceed the perception limits FELT; `first` (14 or 18,) is the first tick."""
    if not len(rows):
        return False
    start = rows[0] if first is None else first
    force, torque = (np.linalg.norm(rows[:, columns], axis=1) for columns in (slice(8, 11), slice(11, 14)))
    moved = np.linalg.norm(rows[:, 1:4] - start[1:4], axis=1)
    cosine = np.abs(rows[:, 4:8] @ start[4:8])
    turned = 2 * np.arccos(np.clip(cosine, 0.0, 1.0))
    return bool(
        np.any(force >= _FELT_FORCE_N)
        or np.any(torque >= _FELT_TORQUE_NM)
        or np.any(moved >= _FELT_MOTION_M)
        or np.any(turned >= _FELT_ROTATION_RAD)
    )


def trace_rows(layout: RowLayout, rows: Array) -> Array:
    """(n, 18) by COLUMNS and HAND: ticks of the servo's `rows` (n, width) with a valid pose."""
    known = rows[rows[:, layout["valid"].start] > 0]
    parts = [known[:, layout[name]] for name in ("t", "object", "object_q", "object_wrench")]
    torques = [np.linalg.norm(known[:, layout[name]][:, 3:], axis=1) for name in ("wrench_commanded", "wrench_actual")]
    out: Array = np.column_stack([*parts, *torques, known[:, layout["gain"]], known[:, layout["saturated"]]])
    return out


def write_trace(path: Path, rows: Array, *, gently: bool = False) -> None:
    """Write `rows` (n, 14 or 18), complete or not at all; `gently` while a servo of this process runs."""
    head = (COLUMNS + HAND)[: rows.shape[1]]
    try:
        with replace_file(path, sync=True) as part, part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(head)
            for block in _blocks(rows):
                writer.writerows([f"{value:.9g}" for value in row] for row in block.tolist())
                if gently:
                    sleep(_BLOCK_PAUSE_S)
    except OSError as cause:
        raise RecordingError(f"{path}: cannot be written ({cause.strerror})") from cause


def _blocks(rows: Array) -> Iterator[Array]:
    for start in range(0, len(rows), _BLOCK_ROWS):
        yield rows[start : start + _BLOCK_ROWS]


def read_trace(path: Path) -> Array:
    """(n, 18) rows by COLUMNS and HAND; NaN for columns that an older file lacks. RecordingError if invalid."""
    try:
        text = read_text(path, "trace", RecordingError, _MAX_TRACE_BYTES)
        head, *lines = csv.reader(text.splitlines())
        if tuple(head) not in (COLUMNS, COLUMNS + HAND):
            raise ValueError("the columns differ")
        found = np.array(lines, dtype=float).reshape(-1, len(head))
    except (ValueError, csv.Error) as cause:
        raise RecordingError(f"{path}: is not a trace ({cause})") from cause
    missing = len(COLUMNS) + len(HAND) - found.shape[1]
    return np.pad(found, ((0, 0), (0, missing)), constant_values=np.nan)
