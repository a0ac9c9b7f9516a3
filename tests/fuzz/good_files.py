"""A valid file of each kind that haptorb reads or writes, small or complete."""

from __future__ import annotations

import contextlib
import io
import shutil
import sqlite3
from importlib.resources import files
from pathlib import Path

import numpy as np
from PIL import Image

from haptorb.cli import main
from haptorb.devices.loader import load
from haptorb.estimation.calibration_file import Calibration
from haptorb.estimation.network import Perceptron, Scaling, TrainedNetworks, write_networks
from haptorb.estimation.tracker_frame import TrackerFrame
from haptorb.file_kind import FileKind
from haptorb.recording.mcap import Recorder
from haptorb.recording.row import RowLayout
from haptorb.worlds.scene_physics import find_scene_file
from haptorb_design.store import open_database
from haptorb_study.database import database
from haptorb_study.feel.designs import load_designs
from oracles.recorded_chain import record_chain

__all__ = ["NAMES", "fill", "fill_whole"]

K = FileKind
NAMES = {
    K.RECORDING: "run.mcap", K.DEVICE: "mine.toml", K.CALIBRATION: "omni.calibration.json",
    K.CALIBRATION_STEPS: "omni.calibration.json.steps", K.FRAME: "omni.frame.json", K.DESIGN: "search.toml",
    K.RESULTS: "results.sqlite", K.FELT_DESIGNS: "felt.toml", K.STUDY: "study.toml", K.REGISTRATION: "plan.toml",
    K.STUDY_DATABASE: "study.db", K.DATABASE: "other.db", K.SCENE: "scene.xml", K.WORLD: "groove.py",
    K.NETWORK: "pmsm.network", K.TABLE: "run.csv", K.ARRAYS: "run.npz", K.PARQUET: "run.parquet", K.PAGE: "report.html",
    K.PICTURE: "picture.png", K.HAND: "push.hand",
}  # fmt: skip

_THERMAL = ",".join(
    ["t_s", *(f"{what}_{coil}_{unit}" for what, unit in (("power", "w"), ("winding", "degc"), ("boundary", "degc"))
              for coil in "xyz")]
)  # fmt: skip
_HEATING = "\n".join(f"{t},3.5,3.5,3.5," + ",".join([f"{25 + t / 10}"] * 3 + [f"{25 + t / 30}"] * 3) for t in range(40))
_LOADS = ",".join(
    ["x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", *(f"current_{name}_a" for name in "xyz"), "fx_n", "fy_n", "fz_n",
     "tx_nm", "ty_nm", "tz_nm"]
) + "\n" + "".join(
    f"{0.03 * (n % 3 - 1):g},{0.03 * (n // 3 % 3 - 1):g},0.055,0,0,0,1,{n % 3},{n % 5 - 2},{n % 4},0.1,0,{n / 50:g},0,"
    "0.001,0\n" for n in range(16)
)  # fmt: skip
_PATH = "x_mm,y_mm,z_mm\n" + "".join(f"{3 * n - 15},{n % 3},{54 - n % 2}\n" for n in range(11))
_MAPPING = """unit = "mm"
axes = ["x", "-z", "y"]
[[messages]]
address = "/pose"
values = ["x", "y", "z", "qx", "qy", "qz", "qw"]
"""
_STUDY = """name = "one"
procedure = "identification"
[trials]
pause_seconds = 5
[plan]
participants = 12
[[plan.tests]]
measure = "upward-bias"
smallest_effect = 2.0
"""


def fill_whole(folder: Path) -> None:
    """The same files, but a recording that can be replayed, a study with answers and results of a search."""
    fill(folder)
    record_chain(folder / NAMES[K.RECORDING], ticks=40)
    (folder / NAMES[K.TABLE]).write_text(f"{_THERMAL}\n{_HEATING}\n")
    (folder / "loads.csv").write_text(_LOADS)
    (folder / "path.csv").write_text(_PATH)
    (folder / "mapping.toml").write_text(_MAPPING)
    Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8)).save(folder / NAMES[K.PICTURE])
    (folder / NAMES[K.STUDY]).write_text(_STUDY)
    for name in (K.RESULTS, K.STUDY_DATABASE, K.REGISTRATION):
        (folder / NAMES[name]).unlink()
    study, search, registration = (str(folder / NAMES[kind]) for kind in (K.STUDY, K.DESIGN, K.REGISTRATION))
    for words in (
        ["study", "check", study, "--register", registration],
        ["study", "simulate", study, "--db", str(folder / NAMES[K.STUDY_DATABASE]), "--participants", "1"],
        ["study", "simulate", study, "--db", str(folder / "second.db"), "--participants", "2", "--first", "5"],
        ["design", "sweep", search, "--into", str(folder / NAMES[K.RESULTS]), "--count", "2"],
    ):
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            try:
                code: object = main(words)
            except SystemExit as end:
                code = end.code or 0
        if code:
            raise AssertionError(f"{words} did not make a good file")
    # whole in one file: else the answers lie in the log beside it
    for place in (NAMES[K.RESULTS], NAMES[K.STUDY_DATABASE], "second.db"):
        with contextlib.closing(sqlite3.connect(folder / place)) as made:
            made.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def fill(folder: Path) -> None:
    """One file of each kind in `folder`."""
    omni = load("omni")
    n = omni.channels
    catalogue = files("haptorb.devices") / "catalogue"
    (folder / NAMES[K.DEVICE]).write_bytes((catalogue / "omni.toml").read_bytes())
    layout = RowLayout(3, 2)
    with (folder / NAMES[K.RECORDING]).open("wb") as file:
        recorder = Recorder(file, layout, 1000.0, 10**18)
        recorder.append(np.zeros((30, layout.width)))
        recorder.finish()
    calibration = Calibration(
        "omni", omni.digest, 0.2 * np.eye(n), np.eye(n), np.zeros((9, 3)), np.ones(n), 0.0, 1.0, 0.0, None, True
    )
    (folder / NAMES[K.CALIBRATION]).write_text(calibration.text())
    (folder / NAMES[K.CALIBRATION_STEPS]).write_text('{"format": "haptorb-calibration-steps-1", "device": "omni"}')
    frame = TrackerFrame(
        "omni", omni.digest, "osc:9000", True, np.eye(3), np.zeros(3), np.zeros(3), np.array([0, 0, 0.01]),
        np.array([0.0, 0.0, 1.0]), 1e-4, 4.5, 1e-4, 3e-3,
    )  # fmt: skip
    (folder / NAMES[K.FRAME]).write_text(frame.text())
    (folder / NAMES[K.HAND]).write_text("# onto the dome\nstart 0 0 62 mm\nmove 0 0 49 mm in 1 s\npress a\n")
    (folder / NAMES[K.DESIGN]).write_text(
        'name = "wider"\nbase = "omni"\n[parameters.ball]\nlow = "30 mm"\nhigh = "31 mm"\nplaces = ["dome.radius"]\n'
        "[objectives.heat_per_force_squared]\n"
    )
    open_database(folder / NAMES[K.RESULTS], make=True).dispose()
    example = Path(str(files("haptorb_study.feel") / "example.toml"))
    load_designs(example)
    shutil.copy(example, folder / NAMES[K.FELT_DESIGNS])
    (folder / NAMES[K.STUDY]).write_text('name = "one"\nprocedure = "identification"\n')
    (folder / NAMES[K.REGISTRATION]).write_text('[registration]\nname = "one"\nstudy = "0"\n')
    database(folder / NAMES[K.STUDY_DATABASE]).dispose()
    with sqlite3.connect(folder / NAMES[K.DATABASE]) as other:
        other.execute("CREATE TABLE bookmarks (url)")
    other.close()
    shutil.copy(find_scene_file("peg"), folder / NAMES[K.SCENE])
    (folder / NAMES[K.WORLD]).write_text("from haptorb.worlds import World\n\n\nclass Groove(World):\n    pass\n")
    scaling = Scaling(np.zeros(2), np.ones(2)), Scaling(np.zeros(1), np.ones(1))
    network = Perceptron(np.ones((3, 3)), np.ones((1, 4)), *scaling)
    write_networks(TrainedNetworks("pmsm", "d" * 64, 0.5, (network,), {"nodes": 3}), folder / NAMES[K.NETWORK])
    (folder / NAMES[K.TABLE]).write_text("tick,t [s],p[0] [m]\n0.0,0.0,0.0\n")
    np.savez(folder / NAMES[K.ARRAYS], t=np.zeros(3))
    (folder / NAMES[K.PARQUET]).write_bytes(b"PAR1" + bytes(20) + b"PAR1")
    (folder / NAMES[K.PAGE]).write_text("<!doctype html><title>a report</title>")
    (folder / NAMES[K.PICTURE]).write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(20))
