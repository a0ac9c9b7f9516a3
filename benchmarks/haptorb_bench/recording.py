"""Rows per second into a recording, and bytes per row, against simple ways to store the same numbers."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, time_ns

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.loader import load
from haptorb.recording.mcap import Recorder
from haptorb.recording.row import RowLayout
from haptorb.runtime.servo import Servo
from haptorb_bench.result import Metric

__all__ = ["rows"]

_RATE, _BURST = 1000.0, 20  #: rows that the recorder finds when it looks


def rows(effort: float, notify: Callable[[str], None]) -> list[Metric]:
    """Rows of a real run, written again and again; a servo at 1 kHz needs a thousand a second."""
    notify("a run to record")
    run = _run(max(2.0 * effort, 0.5))
    many = np.concatenate([run] * max(1, round(20_000 * effort / len(run))))
    layout = RowLayout.of(load("omni"))
    with TemporaryDirectory() as folder:
        notify("recording")
        speed, size = _time_recording(Path(folder, "run.mcap"), layout, many)
        notify("plain files")
        plain = {"plain float64": _write(Path(folder, "run.bin"), many), "JSON lines": _lines(Path(folder, "r"), many)}
    out = []
    for name, (their_speed, their_size) in plain.items():
        out += [
            Metric("recording", "rows written per second (MCAP, zstd)", speed, "1/s", name, their_speed, limit=_RATE,
                at_least=True, note="a plain file is neither compressed nor self-describing"),
            Metric("recording", "bytes per row", size, "B", name, their_size),
        ]  # fmt: skip
    return out


def _run(seconds: float) -> Array:
    with Servo("omni", "dome") as servo:
        servo.run(seconds=seconds)
    return np.asarray(servo.recording.rows)  # complete only now, however late the recorder was


def _time_recording(path: Path, layout: RowLayout, many: Array) -> tuple[float, float]:
    with path.open("wb") as file:
        recorder = Recorder(file, layout, _RATE, time_ns())
        t0 = perf_counter()
        for start in range(0, len(many), _BURST):
            recorder.append(many[start : start + _BURST])
        took = perf_counter() - t0
        recorder.finish()
    return len(many) / took, path.stat().st_size / len(many)


def _write(path: Path, many: Array) -> tuple[float, float]:
    with path.open("wb") as file:
        t0 = perf_counter()
        for start in range(0, len(many), _BURST):
            file.write(many[start : start + _BURST].tobytes())
            file.flush()
        took = perf_counter() - t0
    return len(many) / took, path.stat().st_size / len(many)


def _lines(path: Path, many: Array) -> tuple[float, float]:
    with path.open("w") as file:
        t0 = perf_counter()
        for start in range(0, len(many), _BURST):
            for row in many[start : start + _BURST].tolist():
                file.write(json.dumps(row) + "\n")
            file.flush()
        took = perf_counter() - t0
    return len(many) / took, path.stat().st_size / len(many)
