"""Files that documents name for those who change the code: they exist, and a walk through the code is short."""

from __future__ import annotations

import re
from pathlib import Path

#: the last column of a row
CELL = re.compile(r"^\|.*\|([^|]*)\|$", re.MULTILINE)
FILE = re.compile(r"`([\w./]+\.(?:py|ts))`")


def test_every_file_of_a_walk_is_there_and_a_walk_has_at_most_eight(root: Path) -> None:
    text = (root / "CONTRIBUTING.md").read_text(encoding="utf-8")
    parts = re.split(r"^\*\*", text, flags=re.MULTILINE)[1:]
    walks = [[file for cell in CELL.findall(part) for file in FILE.findall(cell)] for part in parts]
    walks = [files for files in walks if files]
    assert len(walks) == 3
    for files in walks:
        assert 5 < len(set(files)) == len(files) <= 8
        missing = [
            file for file in files if not any((root / at / file).is_file() for at in ("src/haptorb", "src", "."))
        ]
        assert missing == []


def test_every_file_to_which_modules_went_is_there(root: Path) -> None:
    """A name without a folder is in the folder of the one before it."""
    page = (root / "docs/decisions/15-where-modules-went.md").read_text(encoding="utf-8")
    named = []
    for cell in re.findall(r"^\| (`.*?) \|", page, re.MULTILINE):
        folder = ""
        for name in re.findall(r"`([^`]+)`", cell):
            folder = name.rpartition("/")[0] if "/" in name else folder
            named.append(name if "/" in name else f"{folder}/{name}".removeprefix("/"))
    assert len(named) > 200
    places = [root / at for at in ("src/haptorb", "src", "papers", "benchmarks")]
    assert [name for name in named if not any((place / name).exists() for place in places)] == []
