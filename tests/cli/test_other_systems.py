"""What needs no real-time loop works where nothing of Linux is; what needs one says so in one line."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from haptorb.cli.program import app
from haptorb.errors import PlatformError
from haptorb.runtime.linux import WORKS_ANYWHERE, require_linux


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """What each part came to, in a process from which modules, names and folders of Linux are hidden."""
    folder = tmp_path_factory.mktemp("elsewhere")
    program = Path(__file__).with_name("other_system.py")
    command = [sys.executable, "-X", "warn_default_encoding", str(program), "win32", str(folder)]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", env={**os.environ, "COLUMNS": "100"})
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture
def result(told):
    """What a part returned; its traceback if it failed."""

    def find(name):
        assert "error" not in told[name], told[name]["error"][-1]
        return told[name]["result"]

    return find


def test_every_module_but_the_loop_s_own_is_imported(result):
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
    ],
)
def test_a_command_without_a_loop_works(result, part, expected):
    code, out, err = result(part)
    assert code in (0, 1), err  # 1: its verdict is no
    assert expected in out
    assert "Traceback" not in err


@pytest.mark.parametrize(
    "part", ["run", "study run", "feel", "check", "design show", "probe", "monitor", "emulate", "calibrate", "bench"]
)
def test_what_needs_linux_says_so_in_one_line(result, part):
    code, out, err = result(part)
    assert (code, out) == (2, "")
    assert "needs Linux, and this is Windows. Available here: " in " ".join(err.split())


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


def test_a_servo_says_so_too(told):
    kind, message, _ = told["servo"]["error"]
    assert kind == "PlatformError"
    assert message.startswith("haptorb.Servo needs Linux, and this is Windows. ")
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
