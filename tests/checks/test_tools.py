"""Checks by other tools, as tests."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

#: mypy without looking for garbage, of which it makes none: a third of its time, for 1 GB of memory more
MYPY = """
import gc
from mypy.__main__ import console_entry
gc.disable()
gc.enable = gc.freeze = gc.unfreeze = lambda: None
console_entry()
"""


def passes(root: Path, *command: str) -> None:
    """Run a command of the virtual environment from the project's folder; its own words are the failure's message."""
    _passes(root, str(Path(sys.executable).parent / command[0]), *command[1:])


def _passes(root: Path, *command: str) -> None:
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.fail(f"{' '.join(command)} exited with {done.returncode}\n{done.stdout}{done.stderr}", pytrace=False)


def test_ruff_finds_nothing(root: Path) -> None:
    passes(root, "ruff", "check", ".")


def test_files_are_formatted(root: Path) -> None:
    passes(root, "ruff", "format", "--check", ".")


@pytest.mark.timeout(3600)  # it gives way to everybody else
def test_types_hold(root: Path) -> None:
    once = ("--cache-dir", os.devnull) if os.environ.get("CI") else ()  # what is written for the next time takes 4 s
    _passes(root, sys.executable, "-c", MYPY, *once)


def test_imports_run_one_way(root: Path) -> None:
    passes(root, "lint-imports")
