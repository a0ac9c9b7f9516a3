"""The figures in README are those that the stored benchmark holds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from haptorb.apps.bench import load_result


@pytest.fixture(scope="module")
def script(load_script: Callable[[str], ModuleType]) -> ModuleType:
    return load_script("benchmark_table")


def test_readme_quotes_the_stored_benchmarks(root: Path, script: ModuleType) -> None:
    readme = (root / "README.md").read_text(encoding="utf-8")
    assert script.with_table(readme) == readme, "run: python scripts/benchmark_table.py"
    altered = readme.replace(" µs |", " ns |", 1)
    assert altered != readme
    assert script.with_table(altered) == readme


def test_the_stored_benchmarks_are_whole(root: Path) -> None:
    found = load_result(root / "docs" / "benchmarks.json")
    assert {"magnetics", "estimation", "allocation", "tick", "training", "recording"} <= {
        row.benchmark for row in found.rows
    }
    assert found.command.startswith("haptorb bench")
