"""Walks through the code in CONTRIBUTING.md: every file exists, and a walk is short."""

from __future__ import annotations

import re
from pathlib import Path

FILE = re.compile(r"^\|.*\| `([\w./]+\.(?:py|ts))` \|$", re.MULTILINE)


def test_every_file_of_a_walk_is_there_and_a_walk_has_at_most_eight(root: Path) -> None:
    text = (root / "CONTRIBUTING.md").read_text(encoding="utf-8")
    walks = [FILE.findall(part) for part in re.split(r"^\*\*", text, flags=re.MULTILINE)[1:]]
    walks = [files for files in walks if files]
    assert len(walks) == 3
    for files in walks:
        assert len(set(files)) == len(files) <= 8
        missing = [
            file for file in files if not any((root / at / file).is_file() for at in ("src/haptorb", "src", "."))
        ]
        assert missing == []
