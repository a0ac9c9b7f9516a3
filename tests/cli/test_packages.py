"""Operation without extras, messages of commands that need one, and commands of other packages."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from importlib.metadata import EntryPoint, requires
from pathlib import Path

import pytest

from haptorb.cli import main, program
from haptorb.errors import InputError
from haptorb.terminal import CommandLine

#: modules that only the extras `study` and `design` install
OF_EXTRAS = ("sqlalchemy", "pyarrow", "psycopg", "pylsl", "tomli_w", "threadpoolctl", "pymoo")
METADATA = "Metadata-Version: 2.1\nName: made-up\nVersion: 1.0\n"
WHEEL = "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
MADE_UP = '''
def register(app):
    @app.command("made-up")
    def made_up() -> None:
        """Say what a package of somebody else says."""
        print("made up")
'''
OWN = '''
import numpy as np
from haptorb.worlds import World


class Flat(World):
    """No force at all."""

    def wrench(self, state):
        return np.zeros(6)
'''


def install(folder: Path, entry_points: str, **modules: str) -> None:
    """Install a wheel with these modules into `folder`, by pip."""
    wheel = folder / "made_up-1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as file:
        for name, text in modules.items():
            file.writestr(f"{name}.py", text)
        for name, text in (
            ("METADATA", METADATA),
            ("WHEEL", WHEEL),
            ("entry_points.txt", entry_points),
            ("RECORD", ""),
        ):
            file.writestr(f"made_up-1.0.dist-info/{name}", text)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--disable-pip-version-check"]
    subprocess.run([*pip, "--target", folder, wheel], check=True)


def haptorb(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """The command in a new process that finds modules in `folder` first."""
    places = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))
    return subprocess.run(
        [sys.executable, "-P", "-m", "haptorb", *words],
        env={**os.environ, "PYTHONPATH": places, "COLUMNS": "80"},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_command_of_another_package_is_listed_and_runs(tmp_path: Path) -> None:
    entry_points = "[haptorb.commands]\nmade-up = made_up\nbroken = made_up_too\nold = made_up_old\n"
    outdated = "import haptorb\nhaptorb.nonsense\n"
    install(tmp_path, entry_points, made_up=MADE_UP, made_up_too="import nowhere_to_be_found\n", made_up_old=outdated)
    listed = haptorb(tmp_path, "--help")
    assert listed.returncode == 0
    assert "Say what a package of somebody else says." in " ".join(listed.stdout.split())
    made_up = haptorb(tmp_path, "made-up")
    assert (made_up.stdout, made_up.stderr) == ("made up\n", "")
    lines = {
        "broken": "haptorb: `haptorb broken`, of the package made_up_too, cannot be loaded: ModuleNotFoundError: No "
        "module named 'nowhere_to_be_found'",
        "old": "haptorb: `haptorb old`, of the package made_up_old, cannot be loaded: AttributeError: module 'haptorb' "
        "has no attribute 'nonsense'",
    }
    broken = haptorb(tmp_path, "old", "--anything")
    assert broken.returncode == 2
    assert [" ".join(text.split()) for text in (broken.stderr, listed.stderr)] == [
        lines["old"], " ".join(lines.values())
    ]  # fmt: skip


@pytest.mark.parametrize("cause", [ImportError("an earlier name"), SyntaxError("invalid\n\x1b[2J"), SystemExit(3)])
def test_whatever_a_package_of_somebody_else_raises_is_one_line(
    cause: BaseException, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(program, "_broken", [])
    app = CommandLine()
    monkeypatch.setattr(program, "app", app)
    program._register_broken(EntryPoint("theirs", "made_up.commands", "haptorb.commands"), cause)
    (command,) = app.registered_commands
    assert (command.name, command.hidden) == ("theirs", True)
    assert command.callback is not None
    with pytest.raises(InputError, match="`haptorb theirs`, of the package made_up, cannot be loaded") as found:
        command.callback()
    assert type(cause).__name__ in str(found.value)
    assert str(found.value).isprintable()
    assert program._broken == [str(found.value)]


@pytest.mark.parametrize(
    ("words", "missing", "extra"),
    [
        ("study participants mine.db", "sqlalchemy", "study"),
        ("study analyse mine.db", "sqlalchemy", "study"),
        ("design sweep small.toml", "sqlalchemy", "design"),
        ("design optimise small.toml", "pymoo", "design"),
        ("design optimise small.toml", "threadpoolctl", "design"),
    ],
)
def test_a_command_without_its_extra_says_which(
    words: str, missing: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    example = Path(__file__).parents[2] / "examples" / "design" / "omni-sensors.toml"
    Path("small.toml").write_text(example.read_text(encoding="utf-8"))
    Path("mine.db").touch()
    for name in [
        name for name in sys.modules if name.partition(".")[0] in ("haptorb_study", "haptorb_design", missing)
    ]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    assert main(words.split()) == 2
    said = capsys.readouterr().err.splitlines()
    assert said[-1].endswith(f"needs {missing}, which is not installed: pip install 'haptorb[{extra}]'")
    assert len(said) == 1


@pytest.mark.slow
def test_the_package_without_extras_runs_a_device_a_world_of_ones_own_and_the_console(tmp_path: Path) -> None:
    for name in OF_EXTRAS:
        (tmp_path / f"{name}.py").write_text(f"raise ModuleNotFoundError(name={name!r})\n")
    (tmp_path / "own.py").write_text(OWN)
    for words in (
        "run omni --world own.py:Flat --headless --duration 0.2 --record own.mcap --json",
        "run omni --port 0 --duration 0.2",
        "info own.mcap --json",
        "replay own.mcap",
        "inspect omni --json",
    ):
        done = haptorb(tmp_path, *words.split())
        assert done.returncode == 0, f"{words}: {done.stderr}"
    assert "Traceback" not in done.stderr
    assert json.loads(done.stdout)


def test_every_package_that_an_extra_alone_installs_is_named_in_it() -> None:
    core = {line.partition(">")[0] for line in requires("haptorb") or () if "extra ==" not in line}
    assert not core & {name.replace("_", "-") for name in OF_EXTRAS}
