"""The house: every folder of Python files can be taken in at a glance, and imports make no circle."""

from __future__ import annotations

import ast
import subprocess
from collections import Counter
from graphlib import CycleError, TopologicalSorter
from pathlib import Path, PurePosixPath

import pytest

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


def test_imports_make_no_circle_those_for_types_counted_too() -> None:
    try:
        list(TopologicalSorter(_imports()).static_order())
    except CycleError as circle:
        pytest.fail(" → ".join(circle.args[1]))
