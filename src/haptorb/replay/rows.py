"""Rows of a recording for a replay, by field: complete, or approximated for recordings of earlier versions."""

from __future__ import annotations

import mmap
import multiprocessing
import signal
import sys
import warnings
from collections.abc import Callable, Mapping
from functools import cached_property
from multiprocessing.process import BaseProcess
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.child_process import count_cores
from haptorb.control.linkage import MODES
from haptorb.control.trip_reasons import CoilState, GuardState, Trip
from haptorb.errors import HaptorbError, RecordingError
from haptorb.recording.recording import Recording
from haptorb.recording.row import STAGES, Field
from haptorb.runtime.linux import is_linux
from haptorb.runtime.tick_log import MODEL, NO_TICK, TickCommand, TickFailure

__all__ = ["SAMPLE_FIELDS", "PlayedRows", "UnpackedRows", "count_bytes", "count_processors", "start_child"]


# --------------------------------------------------------------------------------------------------
# Forked processes that compute a part of a replay, with all loaded code.


def count_processors() -> int:
    """Number of processors available to this process; 1 where forking is impossible or unsafe."""
    return count_cores() if is_linux() else 1


def start_child(work: Callable[..., None], *given: Any) -> BaseProcess:
    """Start a forked process that runs `work(*given)`; it ends with this one.

    On a HaptorbError it prints nothing and exits with a nonzero code: the parent repeats the work and gets the error.
    """
    process = multiprocessing.get_context("fork").Process(target=_work, args=(work, given), daemon=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # other threads: the child only computes
        process.start()
    return process


def _work(work: Callable[..., None], given: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles ^C; its end terminates this process
    try:
        work(*given)
    except HaptorbError:
        sys.exit(1)


# --------------------------------------------------------------------------------------------------
# All rows of a recording in memory, unpacked by another process while this one loads its code.


_UNPACKED_ROWS_PIECE = 1024  #: rows that are read at once


def count_bytes(recording: Recording) -> int:
    """Bytes of all rows of `recording`, unpacked."""
    return 8 * len(recording) * sum(field.width for field in recording.fields)


@final
class UnpackedRows:
    """All rows of `recording`, unpacked by a child process that starts at once."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._names = [field.name for field in recording.fields]
        shared = mmap.mmap(-1, count_bytes(recording))
        self._rows: Array = np.frombuffer(shared, np.float64).reshape(len(recording), -1)
        self._process = start_child(self._unpack)

    def _unpack(self) -> None:
        for first in range(0, len(self._rows), _UNPACKED_ROWS_PIECE):
            last = min(first + _UNPACKED_ROWS_PIECE, len(self._rows))
            self._rows[first:last] = self._recording.read(first, last, self._names)

    def wait_for_rows(self) -> Array:
        """Wait for all rows and return them, (n, width), each value in the unit [SI] of its field.

        Raises RecordingError where the file is damaged.
        """
        self._process.join()
        if self._process.exitcode:
            self._unpack()
        return self._rows


#: fields of the samples; without them the estimator's recorded output is replayed instead
SAMPLE_FIELDS = (
    "duty_commanded", "current_age", "field_age", "pose_t", "pose_valid", "pose_p", "pose_r", "pose_v", "pose_w",
    "commands", "torque_scale", "failures", "coil_state",
)  # fmt: skip
_NEEDED = ("tick", "t", "guard", "trip", "world", "valid", "age", "p", "q", "v", "w", "current_measured",
           "boundary", "duty_applied")  # fmt: skip
_PLAYED_ROWS_PIECE = 1024  #: rows that are read at once: whole rows are unpacked
_COMMANDS = 2.0**31  #: exclusive upper bound of a sum of command flags
#: limit of unpacked rows kept in memory; above it, each block is unpacked again
_MAX_UNPACKED_BYTES = 512 * 1024 * 1024
_MODES = {MODES.index("translate") + 1: TickCommand.TRANSLATE, MODES.index("rotate") + 1: TickCommand.ROTATE}


@final
class PlayedRows:
    """Ticks of `recording`, in blocks.

    missing  fields that an earlier version did not record; the replay is then approximate, not bit-exact

    Raises RecordingError for a recording that has no rows, or lacks a field that cannot be approximated.
    """

    def __init__(self, recording: Recording) -> None:
        names = {field.name for field in recording.fields}
        lacking = [name for name in _NEEDED if name not in names]
        if lacking:
            raise RecordingError(
                f"{recording.path} cannot be replayed: it has no field '{lacking[0]}'; another program wrote it"
            )
        recording.check()
        if not len(recording):
            raise RecordingError(f"{recording.path} cannot be replayed: it has no rows")
        self._recording = recording
        self._names = [field.name for field in recording.fields]
        self._at: dict[str, slice] = {}
        start = 0
        for field in recording.fields:
            self._at[field.name] = slice(start, start + field.width)
            start += field.width
        self.missing = tuple(name for name in SAMPLE_FIELDS if name not in names)
        self._keeps = not recording.long or count_bytes(recording) <= _MAX_UNPACKED_BYTES
        self._unpacked: UnpackedRows | None = None

    def unpack_beside(self) -> None:
        """Start to unpack the rows in a child process, if the recording is long and within the memory limit."""
        if self._recording.long and self._keeps:
            self._unpacked = UnpackedRows(self._recording)

    @cached_property
    def _whole(self) -> Array | None:
        if not self._keeps:
            return None
        if self._unpacked is not None:
            return self._unpacked.wait_for_rows()
        return self._recording.read(0, len(self), self._names)

    @cached_property
    def _columns(self) -> dict[str, Array]:
        names: list[str] = [name for name in ("t", "tick", "commands") if name in self._at]
        columns: dict[str, Array]
        if self._whole is not None:
            columns = {name: self._whole[:, self._at[name].start].copy() for name in names}
        else:
            count, read = len(self), self._recording.read
            pieces = [
                read(first, min(first + _PLAYED_ROWS_PIECE, count), names)
                for first in range(0, count, _PLAYED_ROWS_PIECE)
            ]
            columns = dict(zip(names, np.concatenate(pieces).T.copy(), strict=True))
        if "commands" not in columns:
            columns["commands"] = self._read_commands()
        commands = columns["commands"]
        whole = (commands >= NO_TICK) & (commands < _COMMANDS) & (commands == np.floor(commands))
        if not whole.all():  # safety: commands-are-flags
            at = int(np.argmin(whole))
            raise RecordingError(
                f"{self._recording.path} cannot be replayed: its row {at + 1} has the commands {commands[at]:g}, "
                "which no loop has written"
            )
        return columns

    @property
    def t(self) -> Array:
        """(n,) times of all ticks [s]."""
        return self._columns["t"]

    @property
    def ticks(self) -> Array:
        """(n,) numbers of all ticks [1]."""
        return self._columns["tick"]

    @property
    def commands(self) -> Array:
        """(n,) commands before each tick, a sum of flags [1]."""
        return self._columns["commands"]

    @property
    def fields(self) -> tuple[Field, ...]:
        """Fields of the recording."""
        return self._recording.fields

    def __len__(self) -> int:
        return len(self._recording)

    def read(self, first: int, last: int) -> Array:
        """(n, width) the rows of the ticks `first` up to `last`, as the recording has them [SI]."""
        whole = self._whole
        return self._recording.read(first, last, self._names) if whole is None else whole[first:last]

    def split(self, rows: Array) -> dict[str, Array]:
        """Split `rows` (n, all) by field: name → (n, width) in its unit [SI]; missing fields are approximated."""
        block = {name: rows[:, place] for name, place in self._at.items()}
        return block if not self.missing else self._fill_in(block)

    def read_one(self, number: int) -> dict[str, Array]:
        """Field → (1, width) of the tick `number`, as `split` has it [SI], without reading any other tick."""
        return self.split(self._recording.read(number, number + 1, self._names))

    def _fill_in(self, block: dict[str, Array]) -> dict[str, Array]:
        """Approximate missing fields: the tracker's pose by the pose in use, readings as taken at the tick."""
        count = len(block["t"])
        valid = np.nan_to_num(block["valid"]) == 1.0
        failed = np.isnan(block["current_measured"]).all(axis=1, keepdims=True) & ~np.isfinite(block["p"][:, :1])
        made: Mapping[str, Array] = {
            "duty_commanded": np.full_like(block["duty_applied"], np.nan),
            "current_age": np.zeros((count, 1)),
            "field_age": np.zeros((count, 1)),
            "pose_t": block["t"] - np.nan_to_num(block["age"], posinf=1e9),
            "pose_valid": valid.astype(np.float64),
            "pose_p": block["p"],
            "pose_r": _rotations(block["q"]),
            "pose_v": block["v"],
            "pose_w": block["w"],
            "torque_scale": np.ones((count, 1)),
            "coil_state": np.full((count, 1), float(CoilState.UNKNOWN)),
            "failures": np.where(failed, float(TickFailure.READ), 0.0),
        }
        widths = {"hand_goal": 3, "hand_goal_q": 4, "wrench_actual": 6}
        others = {name: np.full((count, width), np.nan) for name, width in widths.items()}
        others["stages"] = np.zeros((count, len(STAGES)))
        return {**others, **made, **block}

    def _read_commands(self) -> Array:
        """(n,) commands inferred from the changes of state that followed them [1]."""
        recording, names = self._recording, set(self._names)
        guard, trip = recording["guard"][:], recording["trip"][:]
        found = np.zeros(len(guard))
        off = np.array([GuardState.OFF, GuardState.TRIPPED])
        tripped = (guard == GuardState.TRIPPED) & (trip == Trip.STOPPED)
        found[1:] += TickCommand.STOP * (tripped[1:] & ~tripped[:-1])
        found[1:] += TickCommand.ENGAGE * ((guard[:-1] == GuardState.TRIPPED) & ~np.isin(guard[1:], off))
        world = recording["world"][:]
        found[1:] += TickCommand.WORLD * (world[1:] > world[:-1])
        if {"mode", "engaged"} <= names:
            mode, engaged = recording["mode"][:], recording["engaged"][:]
            for number, command in _MODES.items():
                found[1:] += command * ((mode[1:] == number) & (mode[:-1] != number) & (mode[:-1] > 0))
            found[1:] += TickCommand.HOLD * ((engaged[1:] == 1) & (engaged[:-1] == 0))
            found[1:] += TickCommand.RELEASE * ((engaged[1:] == 0) & (engaged[:-1] == 1))
        if "model" in names:
            model = recording["model"][:]
            changed = np.isfinite(model[1:]) & (model[1:] != model[:-1]) & np.isfinite(model[:-1])
            found[1:] += np.where(changed, MODEL * (np.nan_to_num(model[1:]) + 1), 0.0)
        last = (trip == Trip.CLOSING) & (guard == GuardState.OFF)
        found[last] = -1.0
        return found


def _rotations(q: Array) -> Array:
    """(n, 9) rotation matrices, row by row, of quaternions (n, 4) (x, y, z, w); identity where one is not finite."""
    x, y, z, w = np.where(np.isfinite(q).all(axis=1, keepdims=True), q, (0.0, 0.0, 0.0, 1.0)).T
    return np.stack(
        (
            1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
            2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
            2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
        ),
        axis=1,
    )  # fmt: skip
