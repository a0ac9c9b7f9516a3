"""Simulation, studies and pages work on other systems than Linux; real devices and servers report one line."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from time import monotonic, sleep

import pytest
import typer

import haptorb
from haptorb.cli.program import app
from haptorb.errors import PlatformError
from haptorb.runtime.linux import WORKS_ANYWHERE, require_linux

PROGRAM = str(Path(__file__).with_name("other_system.py"))


def own_temporary_files(folder):
    """Programs of Linux beside these would remove files that nobody has locked: there are no locks on Windows."""
    (folder / "temporary").mkdir()
    return {"TMPDIR": str(folder / "temporary")}


def use(system, folder, *only):
    """What each part came to, in a process from which modules, names and folders of Linux are hidden."""
    command = [sys.executable, "-X", "warn_default_encoding", PROGRAM, system, str(folder), *only]
    environment = {**os.environ, **own_temporary_files(folder), "COLUMNS": "100"}
    done = subprocess.run(command, capture_output=True, encoding="utf-8", env=environment)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


#: parts that start a loop again, four to seven seconds of processor time each; every suite has "run", and a page with
#: "design show"
NIGHTLY = ("servo", "hang", "run console", "study run", "feel", "feel headless")


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    return use("win32", tmp_path_factory.mktemp("elsewhere"), "without", *NIGHTLY)


@pytest.fixture(scope="module")
def told_at_night(tmp_path_factory):
    return use("win32", tmp_path_factory.mktemp("night"), *NIGHTLY)


@pytest.fixture
def result(request):
    """What a part returned; its traceback if it failed."""

    def find(name):
        told = request.getfixturevalue("told_at_night" if name in NIGHTLY else "told")
        assert "error" not in told[name], told[name]["error"][-1]
        return told[name]["result"]

    return find


def test_every_module_is_imported(result):
    assert result("imports") == {}


def test_magnetics_and_recordings(result):
    found = result("compute")
    assert found["missing"] == []
    assert found["force"] > 0.01
    assert found["torque"] > 0.01
    assert result("record") is True


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        ("help", "Usage: "),
        ("devices", "omni"),
        ("worlds", "half_width_deg"),
        ("inspect", '"layers"'),
        ("inspect pmsm", "N·m"),
        ("check world", '"verdict"'),
        ("fit", "fitted"),
        ("reproduce", '"verdict"'),
        ("simulate", "SIMULATED trials"),
        ("analyse", "report: "),
        ("analyse json", "accuracy"),
        ("export", "answers.csv"),
        ("info", "complete"),
        ("export recording", "ticks.npz: 50 ticks"),
        ("replay", "bit for bit"),
        ("view", '"ticks": 50'),
        ("design sweep", "4 designs"),
        ("run", '"coil_state": "off"'),
        pytest.param("feel headless", "pull_out_force_n", marks=pytest.mark.slow),
    ],
)
def test_a_command_works(result, part, expected):
    code, out, err = result(part)
    assert code in (0, 1), err  # 1: its verdict is no
    assert expected in out
    assert "Traceback" not in err


def test_a_run_says_what_is_promised_about_time(result):
    assert "Windows has no real-time scheduler for the loop" in " ".join(result("run")[2].split())


@pytest.mark.parametrize(
    "part",
    ["design show", *(pytest.param(part, marks=pytest.mark.slow) for part in ("run console", "study run", "feel"))],
)
def test_a_page_is_served_until_ctrl_c(result, part):
    code, page, err = result(part)
    assert code in (0, None, 130), err
    assert page.startswith("page of "), err
    assert "Traceback" not in err


@pytest.mark.slow
@pytest.mark.parametrize("system", ["win32", "darwin"])
def test_a_world_is_felt_from_python(request, system, tmp_path):
    there = request.getfixturevalue("told_at_night") if system == "win32" else use(system, tmp_path, "servo")
    assert "error" not in there["servo"], there["servo"]["error"]
    found = there["servo"]["result"]
    assert found["rows"] > 100
    assert found["force"] > 0.01
    assert found["last"] == 0.0


@pytest.mark.slow
def test_a_world_that_does_not_return_is_ended(result):
    code, _, err = result("hang")
    assert code == 2
    assert "world 'stuck' hangs" in err


@pytest.mark.parametrize("system", [pytest.param("win32", marks=pytest.mark.slow), "darwin"])
def test_nothing_is_left_of_a_run_that_was_killed(system, tmp_path):
    """No parent-death signal there: servo and recorder find it out, and the recording is whole up to then."""
    record = tmp_path / "run.mcap"
    words = ["haptorb", "run", "--headless", "--record", str(record)]
    mark = f"MARK={tmp_path}"
    environment = {**os.environ, **own_temporary_files(tmp_path), "MARK": str(tmp_path)}
    command = [sys.executable, PROGRAM, system, "-m", *words]
    run = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE)
    try:
        wait_until(lambda: record.exists() and record.stat().st_size > 20_000 and len(find(mark)) >= 3, 60)
    finally:
        run.kill()
        run.communicate()
    wait_until(lambda: not find(mark), 10)
    recording = haptorb.Recording(record)
    assert len(recording.rows) > 10
    assert (recording.rows[-1, recording.layout["duty_applied"]] == 0).all()


def find(mark):
    """Processes whose environment holds `mark`."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (entry / "environ").read_bytes():
                found.append(int(entry.name))
        except OSError:
            continue
    return found


def wait_until(holds, patience):
    end = monotonic() + patience
    while not holds():
        assert monotonic() < end
        sleep(0.05)


@pytest.mark.parametrize(
    "part",
    ["serve", "check", "probe", "monitor", "emulate", "calibrate", "bench", "exec", "libraries", "tracker"],
)
def test_what_needs_linux_says_so_in_one_line(result, part):
    code, out, err = result(part)
    assert (code, out) == (2, "")
    assert "needs Linux, and this is Windows. Available here: " in " ".join(err.split())


def test_a_session_in_a_terminal_is_refused(result):
    code, out, err = result("study run in a terminal")
    assert (code, out) == (2, "")
    assert "leave it out" in " ".join(err.split())


def test_every_command_is_told_to_work_or_not(root):
    """What the refusal names, and what the page's table says, is all that there is."""
    page = (root / "docs" / "reference" / "command-line.md").read_text(encoding="utf-8")
    table = [line.split("|") for line in page.splitlines() if line.startswith("| `")]
    works = re.findall(r"[a-z-]+", WORKS_ANYWHERE.partition("; in Python")[0])
    for name in typer.main.get_command(app).commands:
        rows = [row for row in table if re.search(rf"`(haptorb )?{name}[` ]", row[1])]
        assert rows, f"{name} is not in the table"
        if any(row[3].strip() == "yes" for row in rows) and name != "bench":  # of bench the message is its own
            assert name in works


def test_a_servo_of_a_real_device_says_so_too(told):
    kind, message, _ = told["real servo"]["error"]
    assert kind == "PlatformError"
    assert message.startswith("a real driver needs Linux, and this is Windows. ")
    assert "\n" not in message


@pytest.mark.parametrize(("system", "name"), [("darwin", "macOS"), ("win32", "Windows"), ("freebsd14", "freebsd14")])
def test_the_message_names_the_system_and_what_works(monkeypatch, system, name):
    monkeypatch.setattr(sys, "platform", system)
    with pytest.raises(PlatformError) as refused:
        require_linux("it")
    assert str(refused.value) == f"it needs Linux, and this is {name}. Available here: {WORKS_ANYWHERE}"


def test_on_linux_nothing_is_refused(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    require_linux("it")
