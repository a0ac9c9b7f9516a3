"""Files of older versions can still be read: recording, calibration, study and device."""

from __future__ import annotations

import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from haptorb import worlds
from haptorb.devices.base import DeviceText
from haptorb.devices.build_checks import BuildError
from haptorb.devices.loader import load
from haptorb.errors import CalibrationError, RecordingError
from haptorb.estimation.calibration_file import read_calibration, read_frame
from haptorb.recording.recording import Recording
from haptorb.recording.row import RowLayout
from haptorb.web.view import find_device
from haptorb.worlds.user_world import load_noted_world, note_world
from haptorb_design.store import read_results
from haptorb_study.columns import read_study as find_study
from haptorb_study.columns import tidy
from haptorb_study.database import database
from haptorb_study.study_file import list_older, read_study, study_of
from haptorb_study.template import make_study_text
from oracles.command import run_command

OLDER = Path(__file__).with_name("older")


def test_a_recording_opens_and_its_fields_are_found_by_the_names_of_today(tmp_path: Path) -> None:
    recording = Recording(OLDER / "omni.mcap")
    assert not recording.truncated
    assert (np.diff(recording.t) >= 0).all()
    assert recording["p"].shape == (len(recording), 3)
    assert set(recording["guard"]) <= {0, 1, 2, 3, 4}
    assert {field.name for field in recording.fields} <= {field.name for field in RowLayout(3, 9).fields}
    assert recording["current_measured"].shape == (len(recording), 3)
    assert recording["contacts"].shape == (len(recording), 16)  # every device had room for two
    assert recording.memory == {}
    assert recording.metadata["versions"]["haptorb"]
    with pytest.raises(RecordingError, match="read its fields by name"):
        _ = recording.layout
    recording.plot(tmp_path / "figure.svg")
    recording.to_csv(tmp_path / "rows.csv")


def test_a_recording_is_drawn_with_the_device_that_it_was_made_with() -> None:
    """Also where that could not be built: its coils are those of the recording, not of today's catalogue."""
    text = DeviceText((OLDER / "omni.toml").read_text(encoding="utf-8"))
    device, remark = find_device(OLDER / "omni.mcap", {"name": "omni", **text.as_note()}, None)
    assert remark == ""
    assert device.windings.outer_radius[2] == pytest.approx(26.3e-3)


def test_a_recording_of_rows_with_two_contacts_and_a_coil_state_is_read_by_name() -> None:
    recording = Recording(OLDER / "omni_contacts.mcap")
    assert recording["contacts"].shape == (20, 16)
    assert recording["current_measured"].shape == (20, 3)
    assert recording["coil_state"].shape == (20,)
    assert recording.memory == {}
    with pytest.raises(RecordingError, match="read its fields by name"):
        _ = recording.layout


def test_a_calibration_that_took_coils_for_points_is_refused_for_coils_and_believed_in_its_recording() -> None:
    calibration, device = read_calibration(OLDER / "omni.calibration.json"), load(OLDER / "omni.toml", override=True)
    with pytest.raises(CalibrationError, match=r"treated each coil as a point.* % from those.*haptorb calibrate omni"):
        calibration.apply(device)
    assert calibration.apply(device.with_recorded_models(("exact", "published"))).channels == 3


def test_the_frame_of_a_tracker_is_the_same() -> None:
    frame = read_frame(OLDER / "omni.frame.json")
    assert (frame.device, frame.tracker, frame.simulated) == ("omni", "osc:19877", True)
    assert frame.residual == pytest.approx(0.12e-3, abs=1e-5)
    assert json.loads(frame.text()) == json.loads((OLDER / "omni.frame.json").read_text(encoding="utf-8"))
    device = load(OLDER / "omni_of_frame.toml", override=True)
    assert frame.check_for(device, "osc:19877") is frame


def test_exact_of_an_earlier_recording_is_point_coils() -> None:
    device = load("omni").with_recorded_models(("exact", "published"))
    assert device.models == ("point-coils", "published")
    assert load("omni").with_recorded_models(()).models == device.models
    today = load("omni")
    assert today.with_recorded_models(today.models).models == today.models == ("exact", "point-coils", "published")
    motor = load("pmsm")
    assert motor.with_recorded_models(motor.models) is motor


def test_a_device_file_describes_the_same_device() -> None:
    with pytest.raises(BuildError, match=r"coil y inside coil z: 25\.91 mm"):  # what nobody can wind is told
        load(OLDER / "omni.toml")
    older, today = load(OLDER / "omni.toml", override=True), load("omni")
    assert (older.coils.current_limit == today.coils.current_limit).all()
    assert older.limits == today.limits


def test_a_study_file_asks_the_same() -> None:
    study = read_study(OLDER / "study.toml")
    assert study.trials.repetitions == 2
    assert (
        list_older(study)[0].digest == "672fe57ef4ed5c83"
    )  # as commit 5e5cc684 computes it: its sessions are continued


@pytest.mark.parametrize(
    ("template", "digest"),
    [
        ("zarate2020", "833b36e84db2d0c8"),
        ("identification", "b3e903f1d46b688e"),
        ("staircase", "b1ec908a2bfdc794"),
        ("magnitude", "395f7113312357e9"),
        ("comparison", "2a3ba953d52c582e"),
    ],
)
def test_a_study_of_a_template_keeps_its_digest(template: str, digest: str) -> None:
    """As commit 5e5cc684 computes it for the same text."""
    study = study_of(make_study_text("older", template))
    begun = list_older(study)[0]
    assert begun.digest == digest
    assert begun.model_on(begun.load_device()) == "point-coils"
    assert study.model_on(study.load_device()) in (None, "exact")


def test_a_study_database_keeps_every_answer(tmp_path: Path) -> None:
    place = Path(shutil.copy(OLDER / "study.db", tmp_path))
    with closing(sqlite3.connect(place)) as raw:
        before = raw.execute("SELECT session, number, answer, seconds, answered FROM trials ORDER BY id").fetchall()
    engine = database(place, make=False)
    columns = tidy(engine, find_study(engine))
    found = find_study(engine)
    with closing(sqlite3.connect(place)) as raw:
        assert raw.execute("SELECT digest FROM studies").fetchall() == [(found.digest,)]
    engine.dispose()
    with closing(sqlite3.connect(place)) as raw:
        after = raw.execute("SELECT session, number, answer, seconds, answered FROM trials ORDER BY id").fetchall()
    assert after == before
    assert len(before) == len(columns["answer"]) == 18
    assert set(columns["participant"]) == {"SIM01", "SIM02"}


def test_design_results_keep_every_evaluation(tmp_path: Path) -> None:
    results = read_results(shutil.copy(OLDER / "designs.sqlite", tmp_path))
    (run,) = results.runs
    assert len(run.evaluations) == 4
    assert results.design.name == "omni-core"


def test_designs_that_nobody_can_build_are_still_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Base and found design have windings that cross: the page says so of each, and nothing that was found is lost."""
    path = tmp_path / "older.sqlite"
    shutil.copy(OLDER / "designs.sqlite", path)
    made = json.dumps({goal.name: 0.05 for goal in read_results(path).design.goals})
    with closing(sqlite3.connect(path)) as file, file:  # as a search of that time stored what it found
        file.execute("UPDATE evaluations SET refused_by = '', reason = '', objectives = ? WHERE number = 1", (made,))
    code, told, error = run_command(capsys, "design", "report", str(path), "-o", str(tmp_path / "r.html"))
    assert code == 0, error
    assert "omni-core-1.toml" in told + error
    assert "It cannot be built" in (tmp_path / "r.html").read_text(encoding="utf-8")
    with pytest.raises(BuildError, match="cross"):
        load(tmp_path / "omni-core-1.toml")


def test_every_world_that_an_older_recording_names_is_found() -> None:
    """As commit 5e5cc684 noted them, with the modules and parameters of that time."""
    notes = json.loads((OLDER / "worlds.json").read_text(encoding="utf-8"))
    assert len(notes) == 28
    for name, note in notes.items():
        world = load_noted_world(json.dumps(note))
        assert type(world).__name__ == note["made"]["kind"].partition(":")[2], name
        assert json.loads(note_world(world))["made"]["fields"].keys() >= note["made"]["fields"].keys(), name


def test_a_clients_force_is_found_by_the_module_it_had_before() -> None:
    """Until 28 November 2026 it was in `worlds.dynamic`, with worlds that are still there."""
    note = {"kind": "haptorb.worlds.dynamic:Remote", "fields": {"limit": 10.0}}
    assert load_noted_world(json.dumps({"made": note})) == worlds.Remote(limit=10.0)
