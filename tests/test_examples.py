"""Every example runs, as a program and as a notebook, and its assertions hold."""

from __future__ import annotations

import ast
import importlib.util
import json
import re
from pathlib import Path
from types import ModuleType

import pytest

from oracles.program_runner import ProgramRunner

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "examples").glob("*.py"))
#: examples that compute for four seconds and more: they run at night, and their notebooks are compared in every suite
LONG = ("01_", "02_", "04_", "05_")


def _mark(example: Path) -> object:
    return pytest.param(example, marks=[pytest.mark.slow] if example.name.startswith(LONG) else [], id=example.stem)


@pytest.mark.parametrize("example", [*map(_mark, EXAMPLES)])
def test_example_runs_and_ends_in_an_assertion(example: Path, tmp_path: Path, programs: ProgramRunner) -> None:
    assert re.match(r"\d\d_\w+\.py", example.name)
    assert isinstance(ast.parse(example.read_text(encoding="utf-8")).body[-1], ast.Assert)
    done = programs.run(example, tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def notebooks(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the notebooks that `scripts/write_notebooks.py` writes."""
    pytest.importorskip("sphinx_gallery")
    spec = importlib.util.spec_from_file_location("write_notebooks", root / "scripts" / "write_notebooks.py")
    assert spec
    assert spec.loader
    module: ModuleType = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    folder: Path = tmp_path_factory.mktemp("notebooks")
    assert module.main(folder) == 0
    return folder


def read_cells(example: Path, notebooks: Path) -> list[str]:
    """The code cells of an example's notebook, which begins with its title."""
    notebook = json.loads((notebooks / f"{example.stem}.ipynb").read_text(encoding="utf-8"))
    assert notebook["nbformat"] == 4
    first, *others = notebook["cells"]
    assert first["cell_type"] == "markdown"
    assert "".join(first["source"]).lstrip().startswith("# ")
    return ["".join(cell["source"]) for cell in others if cell["cell_type"] == "code"]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_notebook_is_the_program_in_cells(example: Path, notebooks: Path) -> None:
    """Statement by statement, so that what runs as a program runs as a notebook."""
    cells = read_cells(example, notebooks)
    assert len(cells) >= 2
    assert "assert" in cells[-1]
    title, *program = ast.parse(example.read_text(encoding="utf-8")).body
    assert isinstance(title, ast.Expr)
    assert [ast.dump(one) for cell in cells for one in ast.parse(cell).body] == [ast.dump(one) for one in program]


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_notebook_runs_cell_by_cell(
    example: Path, notebooks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import matplotlib.pyplot as plt

    cells = read_cells(example, notebooks)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    try:
        for number, cell in enumerate(cells, 1):
            exec(compile(cell, f"{example.stem}, cell {number}", "exec"), names)
    finally:
        plt.close("all")


def test_there_are_examples() -> None:
    assert len(EXAMPLES) >= 4
