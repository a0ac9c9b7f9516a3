"""Inputs that `haptorb study` rejects before a session: clear messages, and no files left."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptorb.cli import main
from haptorb.devices.loader import load
from haptorb.estimation.calibration_file import write_frame
from haptorb.estimation.tracker_frame import TrackerFrame

GOOD = 'name = "good"\n[set_points]\npoints = [{ number = 1, theta_deg = 0 }]\n[trials]\nrepetitions = 1\n'
FRAME = TrackerFrame(
    "omni", load("omni").digest, "osc:9000", False, np.eye(3), np.zeros(3), np.array([0.0, 0.0, -0.05]), np.zeros(3),
    np.array([0.0, 0.0, 1.0]), 1e-4, 4.5, 1e-4, 3e-3,
)  # fmt: skip


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--driver", "nonsense"), "unknown driver"),
        (("--tracker", "nobody"), "unknown tracker"),
        (("--frame", "no-such.frame.json"), "no-such.frame.json"),
        (("--tracker", "osc:9001", "--frame", "other.frame.json"), "to tracker 'osc:9000', not"),
        (("--lsl", "moon"), "'computer' or 'network'"),
        (("--port", "70000"), "port must be"),
        (("--terminal",), "--participant"),
        (("--terminal", "-p", "P01", "--lsl", "computer"), "leave out --terminal"),
        (("-p", "Anna"), "never a name"),
        (("--db", "postgresql://study@127.0.0.1:9/x"), "nothing was started"),
        (("--db", "postgresql://study:very-secret@127.0.0.1:9/x"), "PGPASSWORD"),
        (("--db", "no-such-folder/s.db"), "cannot be opened"),
    ],
)
def test_a_run_that_cannot_be(
    words: tuple[str, ...],
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(GOOD)
    write_frame(FRAME, "other.frame.json")
    try:
        code = main(["study", "run", "s.toml", *words])
    except SystemExit as end:
        code = int(end.code or 0)
    said = capsys.readouterr()
    assert code == 2
    assert told in said.out + said.err
    assert "Traceback" not in said.out + said.err
    assert "very-secret" not in said.out + said.err
    made = {path.name for path in tmp_path.iterdir()} - {"s.toml", "other.frame.json"}
    assert not {name for name in made if not name.startswith("study.db")}
    if "--port" not in words:  # a port is looked at last, when the database is there
        assert not made


def test_a_frame_reaches_the_servo_and_the_command_that_resumes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(GOOD)
    write_frame(FRAME, "a.frame.json")
    made = []

    def hold(session: object, start: object, recording: Path | None) -> str:
        made.append(start(recording))  # type: ignore[operator]
        return "left"

    monkeypatch.setattr("haptorb_study.terminal_session.run_session", hold)
    words = ["s.toml", "--tracker", "osc:9000", "--frame", "a.frame.json", "--terminal", "-p", "P01", "--no-record"]
    with pytest.raises(SystemExit) as end:
        main(["study", "run", *words])
    assert not end.value.code
    (servo,) = made
    assert (servo.tracker, servo.config.frame.text()) == ("osc:9000", FRAME.text())
    again = "haptorb study run s.toml --terminal -p P01 --db study.db --tracker osc:9000 --frame a.frame.json"
    assert f"`{again}` resumes at trial 1" in capsys.readouterr().err
