"""The checks that other tools make, as tests: one run and one summary for everything."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


def passes(root: Path, *command: str) -> None:
    """Run a command of the virtual environment from the project's folder; its own words are the failure's message."""
    program = Path(sys.executable).parent / command[0]
    done = subprocess.run([program, *command[1:]], cwd=root, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.fail(f"{' '.join(command)} exited with {done.returncode}\n{done.stdout}{done.stderr}", pytrace=False)


def test_ruff_finds_nothing(root: Path) -> None:
    passes(root, "ruff", "check", ".")


def test_files_are_formatted(root: Path) -> None:
    passes(root, "ruff", "format", "--check", ".")


@pytest.mark.timeout(3600)  # it gives way to everybody else
def test_types_hold(root: Path) -> None:
    passes(root, "mypy")


def test_imports_run_one_way(root: Path) -> None:
    passes(root, "lint-imports")
