"""First hour of a device engineer: copy, change, compare, draw, check and run a device; her mistakes."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

from haptorb.cli import main
from newcomers.newcomer_shell import HAPTORB, SYSTEM

INNER = 24.17  #: radius of the z winding [mm]
CHANGES = (
    ('name = "omni"', 'name = "mine"'),
    ("[92, 91, 84]", "[92, 91, 83]"),
    ("[18.0, 22.55, 27.25]", "[18.0, 22.55, 27.3]"),
    ("[38.891, 38.891, 0.0]", "[38.891, 38.891, 5.0]"),
    ('length = "24 mm"', 'length = "30 mm"'),
)


class Shell:
    """Commands as she types them, in her folder."""

    def __init__(self, capfd: pytest.CaptureFixture[str]) -> None:
        self._capfd = capfd

    def __call__(self, line: str) -> tuple[int, str, str]:
        """Exit code, standard output and standard error of `haptorb LINE`."""
        if SYSTEM:  # it is hidden in a process of its own
            done = subprocess.run([*HAPTORB, *line.split()], capture_output=True, text=True, check=False, timeout=240)
            code, out, err = done.returncode, done.stdout, done.stderr
        else:
            try:
                code = main(line.split())
            except SystemExit as end:
                code = int(end.code or 0)
            out, err = self._capfd.readouterr()
        assert "Traceback" not in out + err
        return code, out, err

    def run_checked(self, line: str) -> str:
        """Standard output of a command that must do its work."""
        code, out, err = self(line)
        assert code == 0, err
        return out


@pytest.fixture
def shell(capfd, tmp_path, monkeypatch):
    """Her folder, with a copy of the Omni in which she changed some values."""
    monkeypatch.chdir(tmp_path)
    shell = Shell(capfd)
    text = shell.run_checked("devices omni")
    for before, after in CHANGES:
        assert text.count(before) == 1, before
        text = text.replace(before, after)
    Path("mine.toml").write_text(text, encoding="utf-8")
    return shell


def edit(before: str, after: str) -> None:
    """Change her file as she does in her editor."""
    text = Path("mine.toml").read_text(encoding="utf-8")
    assert text.count(before) == 1, before
    Path("mine.toml").write_text(text.replace(before, after), encoding="utf-8")


def test_what_is_there_and_a_copy_of_it(shell):
    assert shell.run_checked("--version").startswith("haptorb ")
    assert "omni" in shell.run_checked("devices")
    text = shell.run_checked("devices omni")
    Path("copy.toml").write_text(text, encoding="utf-8")
    omni, copy = json.loads(shell.run_checked("inspect omni copy.toml --json"))
    assert omni == copy


def test_a_turn_less_and_a_longer_magnet_are_seen_in_the_card(shell):
    omni, mine = json.loads(shell.run_checked("inspect omni mine.toml --json"))
    less, before = mine["predicted_moment_per_current_m2"][2][2], omni["predicted_moment_per_current_m2"][2][2]
    area = ((27.3**3 - INNER**3) / (27.3 - INNER)) / ((27.25**3 - INNER**3) / (27.25 - INNER))  # of the mean turn
    assert less / before == pytest.approx(83 / 84 * area, rel=0.002)  # the core answers nearly alike
    assert mine["tool_moment_a_m2"] == pytest.approx(1.25 * omni["tool_moment_a_m2"])
    table = shell.run_checked("inspect omni mine.toml --plot both.svg")
    row = next(line for line in table.splitlines() if line.startswith("moment of the tool"))
    assert row.split()[-3:] == ["2.41", "3.01", "+25"]
    assert Path("both.svg").read_text(encoding="utf-8").startswith("<?xml")


def test_the_drawing_has_the_values_of_the_file(shell):
    assert "mine.drawing.png" in shell.run_checked("show mine.toml --view section")
    assert Path("mine.drawing.png").stat().st_size > 10_000
    parts = json.loads(shell.run_checked("show mine.toml --json"))
    coil = next(part for part in parts["parts"] if part["name"] == "z")
    assert coil["outer_radius_m"] == pytest.approx(0.0273, abs=1e-9)
    sensors = [spot["position_m"] for spot in parts["spots"] if spot["role"] == "sensor"]
    assert [0.038891, 0.038891, 0.005] in [[round(x, 9) for x in place] for place in sensors]


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ('length = "30 mm"', 'length = "30 kg"', "tool.length must be a length; got '30 kg'"),
        ('length = "30 mm"', "length = 30", "tool.length"),
        ('core_radius = "15 mm"', 'core_radios = "15 mm"', "did you mean 'core_radius'"),
        ('core_radius = "15 mm"', 'core_radius = "35 mm"', "core"),
        ("[18.0, 22.55, 27.3]", "[18.0, 22.55, 37.3]", "coil z: 38.18 mm"),
        ('names = ["x", "y", "z"]', 'names = ["x", "y"]', "coils has 2 names"),
        ("[coils]", "[coils", "not a TOML file"),
    ],
)
def test_her_mistakes_are_told_with_file_and_key_and_nothing_is_written(shell, before, after, said):
    edit(before, after)
    was = sorted(os.listdir())
    for command in ("inspect omni mine.toml --plot a.png", "show mine.toml -o a.png", "check mine.toml --world dome"):
        code, out, err = shell(command)
        assert code == 2, command
        assert said in " ".join(err.split())
        assert "mine.toml" in err
        assert not out
    assert sorted(os.listdir()) == was


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("inspect mime.toml", "mime.toml: cannot be read"),
        ("inspect omny", "did you mean 'omni'"),
        ("inspect mine.toml mine.toml", "given twice"),
        ("show mine.toml -o drawing.dwg", ".png, .svg or .pdf"),
        ("show mine.toml -o nowhere/drawing.png", "the folder 'nowhere' does not exist"),
        ("devices omny", "did you mean 'omni'"),
        ("train mine.toml", "works for spherical motors"),
    ],
)
def test_what_she_types_wrong_is_told_in_one_message(shell, line, said):
    code, out, err = shell(line)
    assert code == 2
    assert said in " ".join(err.split())
    assert not out


def test_she_checks_her_device_with_a_world(shell):
    code, out, _ = shell("check mine.toml --world dome --json")
    told = json.loads(out)
    assert told["device"] == "mine"
    assert (told["verdict"] == "outside") is (code == 1)


@pytest.mark.slow
@pytest.mark.realtime
def test_she_runs_her_device_for_a_second(shell):
    run = subprocess.run(
        [*HAPTORB, "run", "mine.toml", "--headless", "--duration", "1", "--json"],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    report = json.loads(run.stdout)
    assert report["ticks"] > 500
    assert report["peak_force_n"] > 0.05
    assert report["trips"] == []
