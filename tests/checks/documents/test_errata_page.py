"""Errata page: every erratum once, with all five entries, and with existing tests."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

PARTS = ("Printed.", "What is wrong.", "Evidence.", "We use", "If you followed the")
LAST = 31


@pytest.fixture(scope="module")
def page(root: Path) -> str:
    return (root / "docs" / "errata.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("number", range(1, LAST + 1))
def test_every_erratum_says_what_it_must(page: str, number: int) -> None:
    sections = re.findall(rf"^### E{number} · .*?(?=^\(e\d+\)=|^## |\Z)", page, flags=re.MULTILINE | re.DOTALL)
    assert len(sections) == 1
    for part in PARTS:
        assert f"**{part}" in sections[0], f"E{number} lacks '{part}'"
    assert f"[E{number}](#e{number})" in page, f"E{number} is not in the table"
    assert "`tests/" in sections[0], f"E{number} names no test"


def test_named_tests_exist(root: Path) -> None:
    named = set()
    for text in (root / "docs").rglob("*.md"):
        named |= set(re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", text.read_text(encoding="utf-8")))
    assert named
    missing = []
    for file, name in sorted(named):
        path = root / file
        tree = ast.parse(path.read_text(encoding="utf-8")) if path.is_file() else ast.Module([], [])
        if name not in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}:
            missing.append(f"{file}::{name}")
    assert missing == []
