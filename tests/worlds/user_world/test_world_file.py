"""A world in a user's file: permitted content, and messages if it cannot be used."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError, UnknownName
from haptorb.runtime.servo import Servo
from haptorb.worlds.user_world import WorldFile, is_world_file, make_world, parse_world_file, try_world
from oracles import groove

GROOVE = Path(groove.__file__).read_text(encoding="utf-8")
STATE = State.at((0.0, 0.01, 0.05))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "groove.py").write_text(GROOVE)
    return tmp_path


@pytest.mark.parametrize(("name", "force"), [("", -0.2), ("Groove", -0.2), ("stiff", -0.5), ("push", 0.0)])
def test_a_class_a_world_and_a_function_can_be_named(folder: Path, name: str, force: float) -> None:
    world = WorldFile(folder / "groove.py", name).load()
    assert world.wrench(STATE)[1] == pytest.approx(force)


def test_values_are_checked_against_the_parameters(folder: Path) -> None:
    file = folder / "groove.py"
    assert WorldFile(file, "Groove", {"stiffness": 100.0}).load().wrench(STATE)[1] == pytest.approx(-1.0)
    with pytest.raises(InputError, match="between 0 and 200 N/m"):
        WorldFile(file, "Groove", {"stiffness": 300.0}).load()
    with pytest.raises(UnknownName, match="did you mean 'stiffness'"):
        WorldFile(file, "Groove", {"stifness": 1.0}).load()


def test_modules_beside_the_file_are_found(folder: Path) -> None:
    (folder / "how_hard_here.py").write_text("HARD = 7.0\n")
    file = folder / "other.py"
    file.write_text(
        GROOVE.replace("import numpy", "from how_hard_here import HARD\nimport numpy").replace("20.0", "HARD")
    )
    assert WorldFile(file).load().wrench(STATE)[1] == pytest.approx(-0.07)


@pytest.mark.parametrize(
    ("text", "name", "said"),
    [
        ("def groove(:\n", "", r"line 1[\s\S]*SyntaxError"),
        ("x = 1\n\n1 / 0\n", "", r'ZeroDivisionError: division by zero\n  File "[^"]*mine\.py", line 3'),
        ("import sys\nsys.exit(3)\n", "", r"SystemExit: 3\n.*line 2"),
        ("x = 1\n", "", "no class that derives from haptorb.worlds.World"),
        ("x = 1\n", "x", "function of a State"),
        ("class Mine: pass\n", "Mine", "must derive from"),
        (GROOVE, "Grove", "did you mean 'Groove'"),
        (GROOVE.replace("Groove", "Dome"), "Dome", "name of a world of the catalogue"),
        (GROOVE.replace("def wrench", "def wrnch"), "", "method wrench|abstract"),
        (GROOVE + "\nclass Second(Groove): pass\n", "", "name the world as mine.py:NAME"),
    ],
)
def test_a_file_that_cannot_be_used_is_explained(folder: Path, text: str, name: str, said: str) -> None:
    file = folder / "mine.py"
    file.write_text(text)
    with pytest.raises(InputError, match=said):
        WorldFile(file, name).load()


def test_names_of_files_are_told_from_names_of_worlds(tmp_path: Path) -> None:
    assert [is_world_file(name) for name in ("a.py", "x/a.py:B", "outlet-published")] == [True, True, False]
    assert parse_world_file("a.py:B", tmp_path) == WorldFile(tmp_path / "a.py", "B")
    assert parse_world_file("/tmp/a:b/a.py").name == ""


@pytest.mark.parametrize(
    ("end", "said"),
    [
        ("return None", r"got None\n  File .*groove\.py\", line 19"),
        ("return wrench[:3]", r"shape \(3,\)"),
        ("return 1 / 0", r"ZeroDivisionError: division by zero\n  File .*line 22, in Groove.wrench\n    return 1 / 0"),
    ],
)
def test_a_bug_is_found_by_one_call_before_the_coils_are_on(folder: Path, end: str, said: str) -> None:
    file = folder / "groove.py"
    file.write_text(GROOVE.replace("return wrench\n\n", end + "\n\n"))
    with pytest.raises(InputError, match=said):
        try_world(WorldFile(file, "Groove").load(), load("omni"))


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("return 1 / 0", r"ZeroDivisionError: division by zero\n  File .*groove\.py\", line \d+, in Groove.for_device"),
        ("raise SystemExit(3)", r"sys\.exit\(3\)\n  File .*groove\.py"),
        ("pass", r"for_device of world 'groove' must return a World for the device \(may be the same one\); got None"),
    ],
)
def test_a_bug_in_for_device_is_told_with_its_place(folder: Path, body: str, said: str) -> None:
    file = folder / "groove.py"
    method = f"    def for_device(self, device):\n        {body}\n\n    def wrench"
    file.write_text(GROOVE.replace("    def wrench", method))
    with pytest.raises(InputError, match=said):
        try_world(WorldFile(file, "Groove").load(), load("omni"))
    with pytest.raises(InputError, match=said):
        Servo("omni", f"{file}:Groove")


def test_a_world_that_does_not_fit_the_device_says_so_itself(folder: Path) -> None:
    class Refusing(WorldFile(folder / "groove.py", "Groove").load().__class__):  # type: ignore[misc]
        def for_device(self, device):
            raise InputError("it needs a dome")

    with pytest.raises(InputError, match=r"^it needs a dome$"):
        try_world(Refusing(), load("omni"))


def test_what_is_no_world_is_refused_with_what_is_wanted() -> None:
    assert make_world(lambda state: state.p).name == "function"
    with pytest.raises(InputError, match="function of a State that returns an array"):
        make_world(3)
