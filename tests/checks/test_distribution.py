"""`make dist`: the wheel runs in an empty environment, and the source archive is complete."""

from __future__ import annotations

import ctypes
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

from haptorb.version import __version__

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
#: of Python, as stated in the classifiers
VERSIONS = [one.rpartition(" ")[2] for one in PROJECT["classifiers"] if re.search(r":: Python :: 3\.\d+$", one)]


@pytest.fixture(scope="module")
def archives(root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Wheel and source archive of this tree, by the tool that publishes them; no network is needed."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--skip-dependency-check", "--wheel", "--sdist"]
    done = subprocess.run([*command, "--outdir", folder, root], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,) = folder.glob(f"haptorb-{__version__}-py3-none-*.whl")
    return wheel, folder / f"haptorb-{__version__}.tar.gz"


@pytest.fixture(scope="module")
def installed(archives: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with nothing but the wheel; other packages are those of the tests."""
    folder = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-index", "--no-deps"]
    done = subprocess.run(
        [*pip, "--prefix", folder, "--ignore-installed", archives[0]], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return folder


def _run(installed: Path, folder: Path, *words: str) -> str:
    """What the installed `haptorb` prints, started in an empty folder."""
    packages = sysconfig.get_path("purelib", vars={"base": str(installed)})
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment["PYTHONPATH"] = packages
    program = [sys.executable, str(installed / "bin" / "haptorb")] if words[0] != "-c" else [sys.executable]
    done = subprocess.run([*program, *words], cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


#: what the command does with each of the words, in one process
COMMANDS = """
from contextlib import suppress
import haptorb, haptorb_study, haptorb_design
from haptorb.cli import main

print(haptorb.__file__, haptorb_design.__file__)
for word in ("--version", "--help"):
    with suppress(SystemExit):
        main([word])
"""


def test_the_installed_command_is_this_version_and_reads_its_devices(installed: Path, tmp_path: Path) -> None:
    assert re.search(r"^omni ", _run(installed, tmp_path, "devices"), re.MULTILINE)
    where, version, listed = _run(installed, tmp_path, "-c", COMMANDS).split("\n", 2)
    assert __version__ in version
    for command in ("run", "inspect", "study", "design"):
        assert re.search(rf"\b{command}\b", listed), command
    assert where.split() == [
        str(next(installed.rglob(f"{name}/__init__.py"))) for name in ("haptorb", "haptorb_design")
    ]


def test_the_wheel_of_a_platform_has_its_libraries(
    archives: tuple[Path, Path], installed: Path, tmp_path: Path
) -> None:
    """Where there is a compiler, on Linux with x86-64; a pure wheel says how to get them."""
    builds = all(shutil.which(tool) for tool in ("make", "cc", "objcopy"))
    if platform.system() == "Linux" and platform.machine() == "x86_64" and builds:
        assert re.search(r"-py3-none-manylinux_2_\d+_x86_64\.whl$", archives[0].name)
        _run(installed, tmp_path, "libraries", str(tmp_path / "kit"))
        library = ctypes.CDLL(str(tmp_path / "kit/lib/libdhd.so"))
        assert library.dhdErrorGetLast() == 0
        assert (tmp_path / "kit/include/dhdc.h").exists()
    else:
        assert archives[0].name.endswith("-py3-none-any.whl")


@pytest.mark.slow
def test_the_installed_command_runs_a_device(installed: Path, tmp_path: Path) -> None:
    report = json.loads(_run(installed, tmp_path, "run", "omni", "--headless", "--duration", "0.5", "--json"))
    assert report["ticks"] > 300
    assert report["error"] == ""


def _find_python(version: str) -> str | None:
    """Return a program that is this version of Python; pyenv's `python3.13` may be one that says there is none."""
    inside = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
    for program in (shutil.which(f"python{version}"), *map(str, sorted(inside.glob(f"{version}.*/bin/python")))):
        ask = [program or "false", "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        if subprocess.run(ask, capture_output=True, text=True, check=False).stdout.strip() == version:
            return program
    return None


def test_the_stated_versions_of_python_begin_with_the_oldest_that_installs() -> None:
    assert PROJECT["requires-python"] == f">={VERSIONS[0]}"
    assert f"{sys.version_info.major}.{sys.version_info.minor}" in VERSIONS


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("version", VERSIONS)
def test_every_stated_version_of_python_runs_what_the_wheel_installs(
    version: str, archives: tuple[Path, Path], tmp_path: Path
) -> None:
    """In an environment of its own, with the packages that pip chooses for that version."""
    program = _find_python(version)
    if program is None:
        pytest.skip(f"Python {version} is not installed here")
    subprocess.run([program, "-m", "venv", tmp_path / "venv"], check=True)
    programs = tmp_path / "venv" / "bin"
    pip = [programs / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--retries", "1"]
    if subprocess.run([*pip, "cloudpickle"], capture_output=True, check=False).returncode != 0:
        pytest.skip("no package index can be reached")
    wanted = f"haptorb[study,design,scenes] @ {archives[0].as_uri()}"
    done = subprocess.run([*pip, wanted], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "NUMBA_"))}
    environment["XDG_CACHE_HOME"] = str(tmp_path / "cache")  # that version compiles the kernels

    def run(words: str, *, by: Path = programs / "haptorb") -> str:
        done = subprocess.run(
            [by, *words.split()], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
        return done.stdout

    assert run("-V", by=programs / "python").startswith(f"Python {version}.")
    report = json.loads(run("run omni --headless --duration 0.5 --json"))
    assert report["ticks"] > 300
    assert report["error"] == ""
    run("run pmsm --scene peg --headless --duration 0.5 --record peg.mcap")
    assert json.loads(run("info peg.mcap --json"))["ticks"] > 300
    here = subprocess.run(
        [sys.executable, "-P", "-m", "haptorb", "inspect", "omni", "--json"], capture_output=True, text=True, check=True
    )
    assert _read_rounded(run("inspect omni --json")) == _read_rounded(here.stdout)
    run("study new study.toml --like staircase")
    run("study simulate study.toml --db s.db --participants 1")
    assert len(json.loads(run("study participants s.db --json"))["participants"]) == 1


def _read_rounded(text: str) -> dict[str, object]:
    """Return what the JSON `text` of `haptorb inspect` holds, with four digits, but the corners of polyhedra: other
    versions of NumPy differ in the last digits, and in the order of corners."""
    found: dict[str, object] = json.loads(text, parse_float=lambda number: f"{float(number):.4g}")
    del found["feasible"]
    return found


def test_the_wheel_has_every_file_of_the_packages_and_the_built_pages(root: Path, archives: tuple[Path, Path]) -> None:
    with zipfile.ZipFile(archives[0]) as wheel:
        names = set(wheel.namelist())
    tracked = [name.removeprefix("src/") for name in _list_tracked(root) if name.startswith("src/haptorb")]
    assert [name for name in tracked if name not in names] == []
    for page in ("haptorb/web/console_static/console.js", "haptorb_study/static/participant.js"):
        assert page in names
    assert not [name for name in names if name.startswith(("haptorb_papers", "haptorb_bench", "tests", "papers"))]


def test_links_and_pictures_of_the_documents_in_the_wheel_are_in_it(installed: Path) -> None:
    shared = installed / "share" / "doc" / "haptorb"
    dead = []
    for page in shared.rglob("*.md"):
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        dead += [
            f"{page.relative_to(shared)}: {target}"
            for target in re.findall(r"\]\(([^)#:]+\.(?:md|png|svg))(?:#[^)]*)?\)", text)
            if not (page.parent / target).exists()
        ]
    assert dead == []


def test_the_source_archive_has_every_source(root: Path, archives: tuple[Path, Path]) -> None:
    with tarfile.open(archives[1]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert [name for name in _list_tracked(root) if name not in names] == []
    assert not [name for name in names if "node_modules" in name or name.endswith(("console.js", "participant.js"))]


def _list_tracked(root: Path) -> list[str]:
    done = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True)
    return [name for name in done.stdout.split("\0") if name and not name.startswith(".")]
