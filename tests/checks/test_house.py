"""The house: every folder of Python files can be taken in at a glance, and imports make no circle."""

from __future__ import annotations

import ast
import re
import subprocess
import tomllib
from collections import Counter
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path, PurePosixPath

import pytest

pytestmark = pytest.mark.background

ROOT = Path(__file__).resolve().parents[2]
MOST = 16  #: Python files in one folder
LONGEST = 300  #: lines of a source file
SOURCES = ROOT / "src"


def _files() -> list[PurePosixPath]:
    found = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True)
    return [path for line in found.stdout.splitlines() if (ROOT / (path := PurePosixPath(line))).exists()]


def _imports() -> dict[str, set[str]]:
    """Module → modules of haptorb that it imports anywhere, for types only too."""
    files = {path: ".".join(path.relative_to(SOURCES).with_suffix("").parts) for path in SOURCES.rglob("*.py")}
    modules = {path: name.removesuffix(".__init__") for path, name in files.items()}
    known = set(modules.values())
    found: dict[str, set[str]] = {}
    for path, module in modules.items():
        names = found.setdefault(module, set())
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                inside = {f"{node.module}.{alias.name}" for alias in node.names}
                names.update(name if name in known else node.module for name in inside)
        names &= known - {module}
    return found


def test_no_folder_holds_more_python_files_than_can_be_taken_in_at_a_glance() -> None:
    folders = Counter(path.parent for path in _files())
    assert {str(folder): count for folder, count in folders.items() if count > MOST} == {}


def test_no_source_file_is_long() -> None:
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in SOURCES.rglob("*.py")}
    assert {str(path): length for path, length in lengths.items() if length > LONGEST} == {}


def _child(module: str, package: str) -> str:
    """The module or package directly inside `package` to which `module` belongs; "" if it stands outside."""
    return f"{package}.{module[len(package) + 1 :].split('.')[0]}" if module.startswith(f"{package}.") else ""


def test_imports_make_no_circle_those_for_types_counted_too() -> None:
    """Neither between modules nor between what stands side by side in any package."""
    imports = _imports()
    packages = {module.rpartition(".")[0] for module in imports} - {""}
    for package in sorted(packages):
        graph: dict[str, set[str]] = {}
        for module, others in imports.items():
            if child := _child(module, package):
                inside = {_child(other, package) for other in others} - {"", child}
                graph.setdefault(child, set()).update(inside)
        try:
            list(TopologicalSorter(graph).static_order())
        except CycleError as circle:
            pytest.fail(" → ".join(circle.args[1]))


def test_every_package_that_holds_packages_has_its_floors() -> None:
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = [one for one in pyproject["tool"]["importlinter"]["contracts"] if one["type"] == "layers"]
    assert all(contract["exhaustive"] for contract in contracts)
    folders = {path.parent.parent for path in SOURCES.glob("haptorb/*/**/__init__.py")}
    packages = {".".join(folder.relative_to(SOURCES).parts) for folder in folders}
    assert packages <= {one for contract in contracts for one in contract["containers"]}


def test_the_picture_of_the_house_shows_every_floor_from_the_top_down() -> None:
    page = next((ROOT / "docs" / "decisions").glob("0001-*.md")).read_text(encoding="utf-8")
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = {
        contract["containers"][0]: [re.split(r" [|:] ", layer) for layer in contract["layers"]]
        for contract in pyproject["tool"]["importlinter"]["contracts"]
        if contract["type"] == "layers"
    }
    rooms, room = dict[str, list[str]](), ""
    known = {name for layer in contracts["haptorb"] for name in layer}
    for line in page.split("```text")[1].split("```")[0].splitlines():
        room = line[15:26].strip() or room
        assert not room or room in known or room.startswith("─"), f"there is no room '{room}'"
        parts = re.split(r"\s{3,}", line[26:].strip())  # one of names, or name, explanation, name, explanation
        rooms.setdefault(room, []).extend(re.findall(r"\w+", " ".join(parts[::2])))
    assert set(rooms) >= known - {"version"}
    for container, layers in contracts.items():
        if container.count(".") != 1:  # the picture shows rooms, not what stands inside them
            continue
        words = rooms[container.removeprefix("haptorb.")]
        places = [[words.index(name) if name in words else -1 for name in layer] for layer in layers]
        assert -1 not in [place for layer in places for place in layer], (container, "a room is missing in the picture")
        assert all(max(above) < min(below) for above, below in pairwise(places)), (container, "in another order")
