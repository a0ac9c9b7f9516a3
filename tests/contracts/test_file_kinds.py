"""What a file is: every command calls a file of another kind by its name, in one message, and changes nothing."""

from __future__ import annotations

import hashlib
import json
import shutil
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from haptorb.apps.cli import main
from haptorb.apps.feel.candidates import load_designs
from haptorb.apps.study.store.database import database
from haptorb.design.store.tables import open_database
from haptorb.devices.loader import load
from haptorb.files.file_kind import FileKind, find_kind
from haptorb.runtime.recording.recorder import Recorder
from haptorb.runtime.row import RowLayout
from haptorb.sensing.calibration.calibration import Calibration
from haptorb.sensing.frame.tracker_frame import TrackerFrame
from haptorb.sensing.torque_maps.network import TrainedNetworks
from haptorb.sensing.torque_maps.network_file import write_networks
from haptorb.sensing.torque_maps.perceptron import Perceptron, Scaling
from haptorb.worlds.scene.scene_model import find_scene_file

K = FileKind
NAMES = {
    K.RECORDING: "run.mcap", K.DEVICE: "mine.toml", K.CALIBRATION: "omni.calibration.json",
    K.CALIBRATION_STEPS: "omni.calibration.json.steps", K.FRAME: "omni.frame.json", K.DESIGN: "search.toml",
    K.RESULTS: "results.sqlite", K.FELT_DESIGNS: "felt.toml", K.STUDY: "study.toml", K.REGISTRATION: "plan.toml",
    K.STUDY_DATABASE: "study.db", K.DATABASE: "other.db", K.SCENE: "scene.xml", K.WORLD: "groove.py",
    K.NETWORK: "pmsm.network", K.TABLE: "run.csv", K.ARRAYS: "run.npz", K.PARQUET: "run.parquet", K.PAGE: "report.html",
    K.PICTURE: "picture.png",
}  # fmt: skip

#: command, with FILE where a file is named → the kinds that it reads
COMMANDS: dict[str, tuple[FileKind, ...]] = {
    "info FILE": (K.RECORDING,),
    "export FILE -o new.csv": (K.RECORDING,),
    "replay FILE": (K.RECORDING,),
    "view FILE --duration 0.01": (K.RECORDING,),
    "run omni --headless --duration 0.1 --tracker replay:FILE": (K.RECORDING,),
    "run FILE --headless --duration 0.1": (K.DEVICE,),
    "inspect FILE": (K.DEVICE,),
    "show FILE": (K.DEVICE,),
    "check FILE": (K.DEVICE,),
    "calibrate FILE": (K.DEVICE,),
    "frame FILE --rehearse": (K.DEVICE,),
    "train FILE": (K.DEVICE,),
    "run omni --headless --duration 0.1 --calibration FILE": (K.CALIBRATION,),
    "run omni --headless --duration 0.1 --tracker osc:9000 --frame FILE": (K.FRAME,),
    "run omni --headless --duration 0.1 --world FILE": (K.WORLD,),
    "run omni --headless --duration 0.1 --scene FILE": (K.SCENE,),
    "check omni --world FILE": (K.WORLD,),
    "check omni --scene FILE": (K.SCENE,),
    "calibrate omni --out new.json --thermal FILE": (K.TABLE, K.RECORDING),
    "feel FILE --headless": (K.FELT_DESIGNS,),
    "study check FILE": (K.STUDY,),
    "study run FILE": (K.STUDY,),
    "study simulate FILE --db new.db": (K.STUDY,),
    "study power FILE": (K.STUDY,),
    "study participants FILE": (K.STUDY_DATABASE,),
    "study analyse FILE": (K.STUDY_DATABASE,),
    "study figures FILE": (K.STUDY_DATABASE,),
    "study export FILE new.csv": (K.STUDY_DATABASE,),
    "study analyse STUDY_DB --registration FILE": (K.REGISTRATION,),
    "study simulate STUDY --db FILE": (K.STUDY_DATABASE,),
    "design sweep FILE": (K.DESIGN,),
    "design optimise FILE": (K.DESIGN,),
    "design sweep DESIGN --into FILE --count 1": (K.RESULTS,),
    "design report FILE -o new.html": (K.RESULTS,),
    "design show FILE --duration 0.01": (K.RESULTS,),
}


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
    (folder / NAMES[K.DESIGN]).write_text(
        'name = "wider"\nbase = "omni"\n[parameters.ball]\nlow = "29 mm"\nhigh = "30 mm"\nplaces = ["dome.radius"]\n'
        "[objectives.heat_per_force_squared]\n"
    )
    open_database(folder / NAMES[K.RESULTS], make=True).dispose()
    example = Path(str(files("haptorb.apps.feel") / "example.toml"))
    load_designs(example)
    shutil.copy(example, folder / NAMES[K.FELT_DESIGNS])
    (folder / NAMES[K.STUDY]).write_text('name = "one"\nprocedure = "identification"\n')
    (folder / NAMES[K.REGISTRATION]).write_text('[registration]\nname = "one"\nstudy = "0"\n')
    database(folder / NAMES[K.STUDY_DATABASE]).dispose()
    import sqlite3

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


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kinds")
    fill(folder)
    return folder


def test_each_kind_is_recognised(made: Path) -> None:
    assert set(NAMES) == set(FileKind) - {FileKind.EMPTY_DATABASE}
    assert {kind: find_kind(made / name) for kind, name in NAMES.items()} == {kind: kind for kind in NAMES}
    assert find_kind("/dev/zero") is None
    assert find_kind(made / "nothing") is None
    for device in (files("haptorb.devices") / "catalogue").iterdir():
        assert find_kind(str(device)) is FileKind.DEVICE, device
    for study in (files("haptorb.apps.study") / "templates").iterdir():
        assert not study.name.endswith(".toml") or find_kind(str(study)) is FileKind.STUDY, study


def _state(folder: Path) -> dict[str, str]:
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.rglob("*") if path.is_file()}


def _run(words: list[str]) -> int:
    try:
        return main(words)
    except SystemExit as end:
        return int(end.code or 0)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_of_another_kind_is_called_by_its_name(
    made: Path, command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    before, wrong = _state(made), []
    for kind, name in NAMES.items():
        if kind in COMMANDS[command]:
            continue
        swap = {"FILE": name, "replay:FILE": f"replay:{name}", "STUDY_DB": NAMES[K.STUDY_DATABASE],
                "STUDY": NAMES[K.STUDY], "DESIGN": NAMES[K.DESIGN]}  # fmt: skip
        code = _run([swap.get(word, word) for word in command.split()])
        said = capsys.readouterr().err.strip()
        if code != 2 or kind.title not in said or len(said.splitlines()) != 1 or len(said) > 400:
            wrong.append((name, code, said[-300:]))
    assert wrong == [], "\n".join(map(str, wrong))
    assert _state(made) == before


def test_a_database_that_a_program_has_open_is_read(tmp_path: Path) -> None:
    """Its tables are in the write-ahead log still, where nothing can see them without a lock."""
    engine = database(tmp_path / "study.db")
    with engine.connect():
        assert find_kind(tmp_path / "study.db") in (FileKind.EMPTY_DATABASE, FileKind.STUDY_DATABASE)
        database(tmp_path / "study.db", make=False).dispose()
    engine.dispose()


def test_what_is_damaged_is_not_called_something_else(tmp_path: Path) -> None:
    for text in ("", "\0\0\0", "name = ", '{"format": 3}', "[[[[", json.dumps({"kind": ["haptorb networks"]})):
        (tmp_path / "it").write_text(text)
        assert find_kind(tmp_path / "it") is None, text
