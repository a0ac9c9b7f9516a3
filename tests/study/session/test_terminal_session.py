"""Terminal session without a terminal: keys, stored answers, device commands; and once with the real loop."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sqlalchemy import text

from haptorb import Recording
from haptorb.control.trip_reasons import Trip
from haptorb_study.columns import tidy
from haptorb_study.database import database
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study, study_of
from haptorb_study.terminal_session import END, Keys, TerminalSession, View
from haptorb_study.trial_device import TrialDevice

STUDY = """
name = "short"
[set_points]
points = [{ number = 1, theta_deg = 0 }, { number = 12, theta_deg = 36 }]
[trials]
repetitions = 1
pause_seconds = 0.0
"""


def _module() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fake_servo", Path(__file__).parents[1] / "fake_servo.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


FakeServo: Any = _module().FakeServo


class Script(Keys):
    """Keys as they are written; a callable among them is called instead."""

    def __init__(self, *keys: Any) -> None:
        self._keys = list(keys)

    def next_key(self, wait: float) -> str | None:
        key = self._keys.pop(0) if self._keys else END
        return key() if callable(key) else key


@pytest.fixture
def short() -> Study:
    return study_of(STUDY)


def run(study: Study, place: Path, *keys: Any, servo: Any = None) -> SimpleNamespace:
    servo, views = servo or FakeServo(), []

    def show(view: View) -> None:
        views.append((view.state, view.typed, view.message))

    with StoredSession(database(place), study, "P01") as session:
        asked = [session.prompt]
        how = TerminalSession(session, TrialDevice(study, servo), Script(*keys), show, "run.mcap").run()  # type: ignore[arg-type]
    return SimpleNamespace(how=how, servo=servo, views=views, first=asked[0])


def test_a_magnitude_has_one_decimal_point(tmp_path: Path) -> None:
    study = study_of(
        'name = "m"\nprocedure = "magnitude"\n[levels]\nreference = 1.0\nvalues = [1.0, 2.0]\n'
        "[trials]\nrepetitions = 1\npause_seconds = 0.0\n"
    )
    ran = run(
        study,
        tmp_path / "s.db",
        *(key for typed in (".", "2,.5", "1,000", "2,5", "0", "40") for key in (*typed, "enter")),
    )
    assert ran.how == "done"
    assert sum("must be a number" in message for _, _, message in ran.views) >= 3
    assert any("above 0" in message for _, _, message in ran.views)
    assert tidy(database(tmp_path / "s.db"), study)["answer"].tolist() == [2.5, 40.0]


@pytest.mark.parametrize("typed", ["-1", "1e9", "1a", "01", "+1", "１", "1.0", "0x1", "12 ", "1\t", "1;", "²"])
def test_what_is_no_answer_is_refused_as_it_was_typed_and_nothing_is_stored(
    short: Study, tmp_path: Path, typed: str
) -> None:
    keys = [{" ": "space", "\t": "tab"}.get(key, key) for key in typed]
    ran = run(short, tmp_path / "s.db", *keys, "enter", "q")
    assert ran.how == "left"
    with database(tmp_path / "s.db").connect() as connection:
        assert connection.execute(text("SELECT count(*) FROM trials")).scalar() == 0


def test_numbers_are_typed_and_kept_and_the_summit_is_the_prompted_one(short: Study, tmp_path: Path) -> None:
    ran = run(short, tmp_path / "s.db", "1", "enter", "1", "2", "enter")
    assert ran.how == "done"
    columns = tidy(database(tmp_path / "s.db"), short)
    assert columns["answer"].tolist() == [1, 12]
    assert [call for call in ran.servo.calls if call[0] == "dome"] == [
        ("dome", short.point(int(n)).direction) for n in columns["set_point"]
    ]
    assert ran.servo.calls[-1] == ("nothing", None)
    assert columns["recording"][0].startswith("run.mcap#t=")


def test_a_wrong_number_is_told_and_may_be_typed_again(short: Study, tmp_path: Path) -> None:
    ran = run(short, tmp_path / "s.db", "7", "enter", "enter", "1", "3", "back", "2", "enter", "1", "enter")
    assert ran.how == "done"
    assert any("1, 12" in message for _, _, message in ran.views)
    assert any("choose the number first" in message for _, _, message in ran.views)
    assert tidy(database(tmp_path / "s.db"), short)["answer"].tolist() == [12, 1]


def test_leaving_keeps_what_was_answered_and_resumes_there(short: Study, tmp_path: Path) -> None:
    assert run(short, tmp_path / "s.db", "1", "enter", "q").how == "left"
    assert run(short, tmp_path / "s.db", "1", "enter").how == "done"
    assert tidy(database(tmp_path / "s.db"), short)["trial"].tolist() == [1, 2]


def test_a_pause_switches_the_coils_off_and_is_no_safety_event(short: Study, tmp_path: Path) -> None:
    ran = run(short, tmp_path / "s.db", "space", "1", "space", "enter", "e", "1", "enter", "1", "enter")
    assert ran.how == "done"
    assert [call for call in ran.servo.calls if isinstance(call, str)] == ["stop", "engage"]
    assert tidy(database(tmp_path / "s.db"), short)["safety"].tolist() == ["", ""]
    with database(tmp_path / "s.db").connect() as connection:
        kinds = connection.execute(text("SELECT kind FROM events ORDER BY id")).scalars().all()
    assert kinds == ["begin", "pause", "resume", "repeat"]


def test_a_trip_is_marked_on_its_trial_only(short: Study, tmp_path: Path) -> None:
    servo = FakeServo()
    hot = Trip.OVERHEATED
    run(short, tmp_path / "s.db", lambda: servo.trip(hot), "1", "enter", "e", "1", "enter", "1", "enter", servo=servo)
    assert tidy(database(tmp_path / "s.db"), short)["safety"].tolist() == ["OVERHEATED", ""]


def test_no_answer_counts_while_the_device_is_off_and_the_trial_begins_anew(short: Study, tmp_path: Path) -> None:
    servo, answered = FakeServo(), []

    def count() -> None:
        with database(tmp_path / "s.db").connect() as connection:
            answered.append(connection.execute(text("SELECT count(*) FROM trials")).scalar_one())

    keys = [
        "1",
        lambda: servo.trip(Trip.POSE_EXPIRED),
        "enter",
        count,
        "e",
        count,
        "1",
        "2",
        "enter",
        count,
        "1",
        "enter",
    ]
    ran = run(short, tmp_path / "s.db", *keys, servo=servo)
    assert (ran.how, answered) == ("done", [0, 0, 1])
    assert any(state == "device off" and "please wait" in message for state, _, message in ran.views)
    columns = tidy(database(tmp_path / "s.db"), short)
    assert (columns["answer"].tolist(), columns["repeats"].tolist()) == ([12, 1], [1, 0])
    domes = [call for call in servo.calls if call[0] == "dome"]
    assert len(domes) == 3
    assert domes[0] == domes[1]  # the same trial, felt from its beginning
    with database(tmp_path / "s.db").connect() as connection:
        kept = connection.execute(text("SELECT trial, text FROM events WHERE kind = 'repeat'")).all()
    assert [tuple(row) for row in kept] == [(0, "the device was off: POSE_EXPIRED")]


def test_a_trip_that_is_over_before_anybody_looks_repeats_the_trial_too(short: Study, tmp_path: Path) -> None:
    servo = FakeServo()

    def blink() -> None:
        servo.trip(Trip.POSE_EXPIRED)
        servo.off = False

    ran = run(short, tmp_path / "s.db", "1", blink, "enter", "2", "back", "1", "enter", "1", "enter", servo=servo)
    assert ran.how == "done"
    assert tidy(database(tmp_path / "s.db"), short)["repeats"].tolist() == [1, 0]


def test_a_trial_waits_for_a_device_that_tripped_in_the_rest_before_it(short: Study, tmp_path: Path) -> None:
    servo = FakeServo()
    servo.trip(Trip.POSE_LOST)
    ran = run(short, tmp_path / "s.db", "1", "enter", "e", "1", "enter", "1", "enter", servo=servo)
    assert ran.how == "done"
    assert ran.views[0][0] == "device off"
    columns = tidy(database(tmp_path / "s.db"), short)  # nothing of a trial was felt, so none began anew
    assert (columns["repeats"].tolist(), columns["safety"].tolist()) == ([0, 0], ["", ""])


def test_the_driver_is_kept_with_every_trial(short: Study, tmp_path: Path) -> None:
    servo = FakeServo()
    servo.driver = "serial:/dev/ttyUSB0"
    run(short, tmp_path / "s.db", "1", "enter", "q", servo=servo)
    run(short, tmp_path / "s.db", "1", "enter")
    assert tidy(database(tmp_path / "s.db"), short)["simulated_device"].tolist() == [False, True]


def test_abort_asks_first(short: Study, tmp_path: Path) -> None:
    assert run(short, tmp_path / "s.db", "A", "n", "1", "enter", "A", "y").how == "aborted"


def test_arrows_move_the_pen_and_not_out_of_the_workspace(short: Study, tmp_path: Path) -> None:
    servo = FakeServo()
    run(short, tmp_path / "s.db", *["right"] * 40, "1", "enter", servo=servo)
    x, y, z = servo.p
    assert np.degrees(np.arctan2(x, z)) == pytest.approx(60.0)
    assert y == pytest.approx(0.0, abs=1e-12)


def test_the_other_interval_is_felt_at_a_key(tmp_path: Path) -> None:
    study = study_of(
        'name = "x"\nprocedure = "constant"\n[levels]\nreference = 1.2\nvalues = [1.0, 1.5]\n'
        "[trials]\nrepetitions = 1\npause_seconds = 0"
    )
    ran = run(study, tmp_path / "s.db", "tab", "1", "enter", "2", "enter", "tab", "2", "enter")
    assert ran.how == "done"
    assert len([call for call in ran.servo.calls if call[0] == "dome"]) == 4
    assert any("interval 2 has not been felt yet" in message for _, _, message in ran.views)


RATED = 'name = "r"\nprocedure = "{0}"\n[trials]\nrepetitions = 2\npause_seconds = 0\n{1}'
RATED_LEVELS = "[levels]\nreference = 1.0\nvalues = [1.0, 2.0]\n"


@pytest.mark.parametrize(("procedure", "more"), [("rating", ""), ("magnitude", RATED_LEVELS)])
def test_what_was_not_felt_is_not_judged(tmp_path: Path, procedure: str, more: str) -> None:
    study, servo = study_of(RATED.format(procedure, more)), FakeServo()
    servo.asked = 0.0
    ran = run(study, tmp_path / "s.db", "5", "enter", servo=servo)
    assert any("has not been felt yet: not stored" in message for _, _, message in ran.views)
    with database(tmp_path / "s.db").connect() as connection:
        assert connection.execute(text("SELECT count(*) FROM trials")).scalar() == 0
    # Somebody who moves the tool feels that there is no force, as in a control condition.
    servo = FakeServo()
    servo.asked = 0.0
    ran = run(study, tmp_path / "s.db", "right", None, None, "5", "enter", servo=servo)
    assert tidy(database(tmp_path / "s.db"), study)["answer"].tolist() == [5]
    ran = run(study, tmp_path / "s.db", "4", "enter", servo=FakeServo())
    assert tidy(database(tmp_path / "s.db"), study)["answer"].tolist() == [5, 4]


def test_a_trial_whose_time_is_up_before_anything_was_felt_starts_again(tmp_path: Path) -> None:
    study, servo = study_of(RATED.format("rating", "") + "time_limit = 0.05\n"), FakeServo()
    servo.asked = 0.0
    later = [lambda: time.sleep(0.06)] * 2
    ran = run(study, tmp_path / "s.db", *later, "5", "enter", *later, "5", "enter", servo=servo)
    assert sum("The trial starts again" in message for _, _, message in ran.views) > 0
    with database(tmp_path / "s.db").connect() as connection:
        assert connection.execute(text("SELECT count(*) FROM trials")).scalar() == 0
        kinds = connection.execute(text("SELECT text FROM events WHERE kind = 'repeat'")).scalars().all()
    assert set(kinds) == {"answered before this was felt"}


@pytest.mark.slow
@pytest.mark.realtime
def test_a_session_at_the_command_line_with_the_real_loop(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(STUDY)
    command = [sys.executable, "-c", "import sys; from haptorb.cli import main; sys.exit(main())", "study"]
    environment = {**os.environ, "COLUMNS": "120"}
    ran = subprocess.run(
        [*command, "run", "s.toml", "--terminal", "-p", "P01", "--db", "s.db"], cwd=tmp_path, input=b"\n1\n1\n",
        timeout=200, capture_output=True, env=environment, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr.decode()
    assert b"done" in ran.stderr
    columns = tidy(database(tmp_path / "s.db"), study_of(STUDY))
    assert columns["answer"].tolist() == [1, 1]
    assert np.isfinite(columns["x_m"]).all()
    assert (tmp_path / "short-session-1-trial-1.mcap").is_file()
    again = subprocess.run(
        [*command, "run", "s.toml", "--terminal", "-p", "P01", "--db", "s.db"], cwd=tmp_path, input=b"", timeout=100,
        capture_output=True, env=environment, check=False,
    )  # fmt: skip
    assert again.returncode == 2
    assert b"another code" in again.stderr
    assert b"Traceback" not in again.stderr


@pytest.mark.slow
@pytest.mark.realtime
def test_nothing_is_recorded_while_stopped_and_no_lock_stays(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(STUDY)
    command = [sys.executable, "-c", "import sys; from haptorb.cli import main; sys.exit(main())", "study"]
    recording = tmp_path / "short-session-1-trial-1.mcap"
    ran = subprocess.Popen(
        [*command, "run", "s.toml", "--terminal", "-p", "P01", "--db", "s.db"], cwd=tmp_path, stdin=subprocess.PIPE,
        stderr=subprocess.DEVNULL, env={**os.environ, "COLUMNS": "120"},
    )  # fmt: skip
    assert ran.stdin is not None
    with ran.stdin as keys:
        for key, wait in ((b"\n", 1.0), (b" ", 3.5), (b"e", 0.7), (b"1\n", 0.7)):
            keys.write(key)
            keys.flush()
            end = time.monotonic() + 60
            while not (recording.exists() and recording.stat().st_size > 100_000) and time.monotonic() < end:
                time.sleep(0.1)  # the loop runs
            time.sleep(wait)
            assert list(tmp_path.glob("*.lock"))
        keys.write(b"q")
    assert ran.wait(60) == 0
    gaps = np.diff(np.ravel(Recording(recording)["t"]))
    assert gaps.max() > 1.5  # 3.5 s less the second after the stop, which is kept
    assert (gaps > 0.5).sum() == 1
    assert list(tmp_path.glob("*.lock*")) == []
