"""Short recording written without a servo: a stylus that circles over the dome, two worlds, and one trip."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

import numpy as np

from haptorb.devices.loader import load
from haptorb.recording.mcap import Recorder
from haptorb.recording.row import RowLayout
from haptorb.version import __version__

RATE = 1000.0
TRIP, WORLD = 1200, 2000  #: ticks at which the guard trips, and the world becomes another


def make_rows(layout: RowLayout, count: int, turn: float = 0.5) -> np.ndarray:
    """(count, width) rows; `turn`: turns per second of the stylus."""
    rows = np.zeros((count, layout.width))
    tick = np.arange(count)
    t = 3.0 + tick / RATE
    angle = 2 * np.pi * turn * (t - 3.0)

    def put(name: str, *values: object) -> None:
        rows[:, layout[name]] = np.column_stack([np.broadcast_to(np.asarray(x, float), count) for x in values])

    put("tick", tick)
    put("t", t)
    put("wall", 100.0 + t)
    put("lateness", 20e-6)
    put("guard", np.where((tick >= TRIP) & (tick < TRIP + 300), 4, 2))
    put("trip", np.where(tick >= TRIP, 1, 0))
    put("coil_state", 1)
    put("gain", 1)
    put("world", np.where(tick >= WORLD, 1, 0))
    put("valid", 1)
    put("p", 0.02 * np.cos(angle), 0.02 * np.sin(angle), 0.045)
    put("q", 0, 0, 0, 1)
    put("hand_goal", 0.02 * np.cos(angle), 0.02 * np.sin(angle), 0.045)
    put("hand_goal_q", 0, 0, 0, 1)
    put("wrench_actual", 0, 0, 0.3 + 0.2 * np.sin(angle), 0, 0, 0)
    put("wrench_commanded", 0, 0, 0.3 + 0.2 * np.sin(angle), 0, 0, 0)
    put("current_measured", np.sin(angle), np.cos(angle), 1.0)
    put("winding", *[300 + tick / max(count, 1)] * 3)
    rows[:, layout["part"]] = -1
    rows[:, layout["memory"]] = np.nan
    return rows


def make_recording(
    path: Path, seconds: float = 3.0, *, turn: float = 0.5, version: str = __version__, end: bool = True,
    device: bool = True,
) -> np.ndarray:  # fmt: skip
    """Write `path`; returns the rows. Without `end` the file is as a killed recorder leaves it."""
    omni = load("omni")
    layout = RowLayout.of(omni)
    rows = make_rows(layout, round(seconds * RATE), turn)
    text = (resources.files("haptorb.devices.catalogue") / "omni.toml").read_text(encoding="utf-8")
    with path.open("wb") as file:
        recorder = Recorder(file, layout, RATE, 10**18)
        if device:
            recorder.add_metadata("device", {"name": "omni", "digest": omni.digest, "title": omni.title, "file": text})
        models = {"model": "exact", "models": " ".join(omni.models)}
        recorder.add_metadata("run", {"driver": "sim", "tracker": "pointer", **models})
        recorder.add_metadata("versions", {"haptorb": version})
        worlds = ({"name": "dome", "values": {"moment": 2.0}}, {"name": "dome", "values": {"moment": 1.0}})
        for number, world in enumerate(worlds):
            recorder.add_metadata(
                "world", {"change": str(number), "tick": str(number * WORLD), "world": json.dumps(world)}
            )
        for part in np.array_split(rows, max(len(rows) // 20, 1)):
            recorder.append(part)
        if end:
            recorder.finish()
    return rows
