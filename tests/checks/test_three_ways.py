"""The ways through the code that the documentation describes: every file is there, and each way goes forward."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = "docs/explanation/three_ways.md"
FILE = re.compile(r"`([\w./]+\.(?:py|ts))`")


@pytest.fixture(scope="module")
def page(root: Path) -> str:
    return (root / PAGE).read_text(encoding="utf-8")


def test_every_file_of_the_ways_is_there(page: str, root: Path) -> None:
    files = [file for file in FILE.findall(page) if "/" in file]
    missing = [
        file for file in files if not any((root / place / file).is_file() for place in ("src/haptorb", "src", "."))
    ]
    assert missing == [], f"mend {PAGE}"


def test_a_file_that_is_only_named_is_on_its_way(page: str) -> None:
    """A bare name in a sentence is short for a file of the same section's table."""
    for section in page.split("\n## ")[1:]:
        names = {Path(file).name for file in FILE.findall(section) if "/" in file}
        assert {file for file in FILE.findall(section) if "/" not in file} <= names
