"""The ways through the code that the documentation describes: every file is there, and each way goes forward."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = "docs/explanation/three_ways.md"
FILE = re.compile(r"`([\w./]+\.(?:py|ts))`")


def ways(text: str) -> dict[str, list[str]]:
    """Title → files of the table's second column, in order."""
    found: dict[str, list[str]] = {}
    for section in text.split("\n## ")[1:]:
        title, *lines = section.splitlines()
        rows = [line.split("|") for line in lines if line.startswith("| ")]
        found[title] = [file for row in rows for file in FILE.findall(row[2])]
    return found


@pytest.fixture(scope="module")
def page(root: Path) -> str:
    return (root / PAGE).read_text(encoding="utf-8")


def test_there_are_three_ways_and_none_names_a_file_twice(page: str) -> None:
    assert [len(files) > 10 for files in ways(page).values()] == [True] * 3
    assert [file for files in ways(page).values() for file in set(files) if files.count(file) > 1] == []


def test_every_file_of_the_ways_is_there(page: str, root: Path) -> None:
    files = [file for file in FILE.findall(page) if "/" in file]
    missing = [file for file in files if not any((root / place / file).is_file() for place in ("src/haptorb", "."))]
    assert missing == [], f"mend {PAGE}"


def test_a_file_that_is_only_named_is_on_its_way(page: str) -> None:
    """A bare name in a sentence is short for a file of the same section's table."""
    for section in page.split("\n## ")[1:]:
        names = {Path(file).name for file in FILE.findall(section) if "/" in file}
        assert {file for file in FILE.findall(section) if "/" not in file} <= names


def test_a_repeated_file_would_be_found() -> None:
    assert ways("# x\n## y\n| step | file |\n|---|---|\n| a | `a/b.py`, `c.ts` |\n| b | `a/b.py` |\n") == {
        "y": ["a/b.py", "c.ts", "a/b.py"]
    }
