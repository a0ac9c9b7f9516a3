"""Child processes run no code of the current folder, but find the user's own modules."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import venv
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from pathlib import Path

import numpy
import pytest

import haptorb
from haptorb._numba_patches import ignore_local_settings, load_numba
from haptorb.child_process import append_folders, environment, python_command, spawn_context

SOURCES = Path(haptorb.__file__).resolve().parents[1]  #: `src`
#: every program of this package that is started as a module
PROGRAMS = sorted(
    ".".join(path.relative_to(SOURCES).with_suffix("").parts)
    for path in SOURCES.rglob("*.py")
    if '__name__ == "__main__"' in path.read_text(encoding="utf-8") and path.name != "__main__.py"
)
#: says that it ran, without an import: the folder has a file for every module
POISON = "open({log!r}, 'a').write(__name__ + '\\n')\nraise SystemExit(99)\n"


@pytest.fixture
def poisoned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with a file for every module of Python and of what this package needs; the log of those
    that ran."""
    folder, log = tmp_path / "here", tmp_path / "ran"
    folder.mkdir()
    names = {name for name in sys.stdlib_module_names if not name.startswith("_")} - set(sys.builtin_module_names)
    names -= {
        "encodings"
    }  # imported before a file can be opened: a program without the right one does not start at all
    for name in names | {"numba", "numpy", "scipy", "mcap", "zstandard", "llvmlite", "cloudpickle", "pint", "msgpack"}:
        (folder / f"{name}.py").write_text(POISON.format(log=str(log)))
    monkeypatch.chdir(folder)
    return log


def _run(command: list[str], **options: object) -> None:
    subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False, timeout=120, **options)  # type: ignore[call-overload]


@pytest.mark.parametrize("module", PROGRAMS)
def test_a_child_runs_nothing_from_the_current_folder(poisoned: Path, module: str) -> None:
    """Without arguments each fails, after its imports."""
    _run(python_command(module), env=environment())
    assert not poisoned.exists(), poisoned.read_text()


def test_an_isolated_child_runs_nothing_from_the_users_path_either(poisoned: Path) -> None:
    found = environment() | {"PYTHONPATH": "."}
    command = python_command("haptorb.runtime.drivers.i2c_guardian", "nothing", isolated=True)
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=found)
    assert not poisoned.exists(), poisoned.read_text()
    assert "invalid literal for int() with base 10: 'nothing'" in done.stderr  # it is that program


@pytest.mark.parametrize("found", ["by PYTHONPATH", "by sys.path"])
@pytest.mark.parametrize("isolated", [True, False])
def test_a_child_runs_the_version_of_the_process_that_starts_it(tmp_path: Path, found: str, isolated: bool) -> None:
    """One version is installed, another one, a checkout, runs by way of PYTHONPATH or of the program's `sys.path`."""
    shutil.copytree(SOURCES / "haptorb", tmp_path / "haptorb", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "colorsys.py").write_text("raise SystemExit('not the one of Python')" if isolated else "")
    (tmp_path / "haptorb" / "which.py").write_text("import colorsys, haptorb; print(haptorb.__file__)")
    host = (
        f"import subprocess, sys; sys.path.insert(0, {str(tmp_path)!r} if {found == 'by sys.path'} else sys.path[0]); "
        "from haptorb.child_process import environment, python_command; "
        f"subprocess.run(python_command('haptorb.which', isolated={isolated}), env=environment())"
    )
    path = {"PYTHONPATH": str(tmp_path)} if found == "by PYTHONPATH" else {}
    without = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-P", "-c", host], capture_output=True, text=True, check=False, cwd=tmp_path,
        env={**without, **path}, timeout=60,
    )  # fmt: skip
    assert done.stdout.strip() == str(tmp_path / "haptorb" / "__init__.py"), done.stderr


def test_a_source_folder_that_is_installed_in_place_hides_nothing_in_a_child(tmp_path: Path) -> None:
    """What else lies in the source folder goes after Python's own modules, as in the process that starts the child."""
    shutil.copytree(SOURCES / "haptorb", tmp_path / "src" / "haptorb", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "src" / "colorsys.py").write_text("raise SystemExit('not the one of Python')")
    (tmp_path / "src" / "haptorb" / "which.py").write_text("import colorsys, haptorb; print(haptorb.__file__)")
    venv.create(tmp_path / "venv", symlinks=True)
    (packages,) = (tmp_path / "venv").glob("lib/*/site-packages")
    (packages / "in_place.pth").write_text(f"{tmp_path / 'src'}\n{Path(numpy.__file__).parents[1]}\n")
    (packages / "another.pth").write_text(f"{tmp_path}\n")
    host = (
        "import subprocess, colorsys; from haptorb.child_process import environment, python_command; "
        "subprocess.run(python_command('haptorb.which'), env=environment())"
    )
    command = [str(tmp_path / "venv" / "bin" / "python"), "-P", "-c", host]
    without = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=without, timeout=60)
    assert done.stdout.strip() == str(tmp_path / "src" / "haptorb" / "__init__.py"), done.stderr


def test_an_empty_entry_of_the_path_is_not_the_current_folder(poisoned: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", f":{SOURCES}")
    _run(python_command("haptorb.runtime.servo_process", "nowhere", "1"), env=environment())
    assert not poisoned.exists(), poisoned.read_text()


def test_a_spawned_worker_runs_nothing_from_the_current_folder(poisoned: Path) -> None:
    with ProcessPoolExecutor(1, spawn_context()) as pool:
        assert pool.submit(abs, -2).result(60) == 2
    assert not poisoned.exists(), poisoned.read_text()


def test_what_a_host_sends_hides_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = list(sys.path)
    monkeypatch.setattr(sys, "path", list(before))
    monkeypatch.chdir(tmp_path)
    append_folders(["", str(tmp_path), *before])
    assert sys.path == [*before, str(tmp_path)]


def test_python_is_started_in_one_place() -> None:
    """A program that is started elsewhere would not be tried here."""
    # The other two with -I -S: they need the standard library only.
    apart = {"haptorb/child_process.py", "haptorb/runtime/keep_core_awake.py", "haptorb/limited_process.py"}
    for path in SOURCES.rglob("*.py"):
        name, text = str(path.relative_to(SOURCES)), path.read_text(encoding="utf-8")
        if "executable" not in text and "get_context" not in text:
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Attribute) and node.attr == "executable":
                assert name in apart, f"{name} starts Python by itself: use python_command"
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "get_context":
                assert node.args[0].value != "spawn", f"{name}: use spawn_context"  # type: ignore[attr-defined]


# --------------------------------------------------------------------------------------------------
# Settings that libraries read from the current folder.


def test_numba_reads_no_settings_from_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They may name a folder of compiled code, which numba executes."""
    load_numba()
    monkeypatch.chdir(tmp_path)
    Path(".numba_config.yaml").write_text(f"cache_dir: {tmp_path}\ndisable_jit: 1\n")
    settings = import_module("numba.core.config")
    monkeypatch.setattr(settings, "_config_fname", ".numba_config.yaml")  # as numba is when it has just been imported
    settings.reload_config()
    assert (str(tmp_path), 1) == (settings.CACHE_DIR, settings.DISABLE_JIT)
    ignore_local_settings()  # as after the import
    assert (settings.CACHE_DIR, settings.DISABLE_JIT) == ("", 0)
    settings.reload_config()  # before every compilation
    assert settings.CACHE_DIR == ""


def test_matplotlib_reads_no_settings_from_the_current_folder(tmp_path: Path) -> None:
    """With a pipe in their place it would wait for ever, with a file of this text start LaTeX."""
    Path(tmp_path / "matplotlibrc").write_text("text.usetex: True\n")
    program = (
        "import os, contextlib\n"
        "from haptorb.cli.program import main\n"
        "with contextlib.suppress(SystemExit):\n"
        "    main(['--version'])\n"
        "import matplotlib\n"
        "print(matplotlib.rcParams['text.usetex'], os.getcwd())"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", program], capture_output=True, text=True, check=False, cwd=tmp_path,
        env=environment(), timeout=60,
    )  # fmt: skip
    assert done.stdout.splitlines()[-1] == f"False {tmp_path}", done.stderr
    assert "matplotlibrc in the current folder is not read" in done.stderr


OWN = "from mymodule import MyWorld\n"
MODULE = """import numpy as np
from haptorb.worlds import World

class MyWorld(World):
    def wrench(self, state):
        return np.zeros(6)
"""


@pytest.mark.slow
@pytest.mark.realtime
def test_a_whole_run_in_a_poisoned_folder_renders_the_users_own_world(poisoned: Path) -> None:
    """Servo, recorder, server, and what computes beside; with modules of the user's in the same folder."""
    Path("own.py").write_text(OWN)
    Path("mymodule.py").write_text(MODULE)
    command = python_command(
        "haptorb", "run", "omni", "--world", "own.py:MyWorld", "--headless", "--duration", "0.3", "--record", "a.mcap",
        "--serve", "osc:127.0.0.1:0", "--json",
    )  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=180, env=environment())
    assert done.returncode == 0, done.stderr
    assert not poisoned.exists(), poisoned.read_text()
