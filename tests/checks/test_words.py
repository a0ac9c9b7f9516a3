"""What people read is written in words that a manual would use. See CONTRIBUTING, Words."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "haptorb"
#: a word or phrase that an engineer's manual would not have → what it would
ODD = {
    r"\banew\b": "again, or a new one",
    r"\bmend(s|ed|ing)?\b": "fix, correct",
    r"\bforet(old|ell)\w*": "predict, predicted",
    r"\bfor ever\b": "without limit, permanently",
    r"\bwhat it comes to\b|\bit comes to\b": "what it is, the total",
    r"\b(is|are|was|were|unless|as|when|if) told\b": "is set, is given, as configured",
    r"\bgo(es)? on\b": "continue",
    r"\blets? (it )?go\b(?! of)": "release",
    r"\bheld back\b": "limited",
    r"\bstands? still\b": "stop, at rest",
    r"\bwhoever\b": "the user, the operator, anyone who",
    r"\bcomes? along\b": "appear, arrive",
    r"\bthe like\b|\band such\b": "name the things",
}
PATTERN = re.compile("|".join(ODD), re.IGNORECASE)
#: Python files whose docstrings are documentation too: what the API reference is made of
PUBLIC = ("errors.py", "worlds", "runtime/servo", "apps/cli")
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/**/*.md")
WEB = ("*.html", "src/**/*.html", "src/**/*.ts")
STRING = re.compile(r'"[^"\n]*"|`[^`]*`|>[^<>{};]*<')


def strip_code(text: str) -> str:
    """The prose of a Markdown page: no code, and no word that the page names in order to warn of it."""
    text = re.sub(r"^```.*?^```", lambda code: "\n" * code[0].count("\n"), text, flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"`[^`\n]*`|(?<!\*)\*[^*\n]+\*(?!\*)|\bNot: .*", "", text)


def read_markdown() -> Iterator[tuple[Path, int, str]]:
    """Every line of the pages."""
    for path in sorted(path for pattern in PAGES for path in ROOT.glob(pattern)):
        for number, line in enumerate(strip_code(path.read_text(encoding="utf-8")).splitlines(), start=1):
            yield path, number, line


def read_strings(path: Path, text: str) -> Iterator[tuple[int, str]]:
    """Every string of a Python file, and its docstrings where people read them."""
    tree = ast.parse(text)
    public = path.relative_to(SOURCE).as_posix().startswith(PUBLIC)
    docstrings = {
        id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and (public or id(node) not in docstrings):
            yield node.lineno, " ".join(node.value.split())


def read_sources() -> Iterator[tuple[Path, int, str]]:
    """What the commands, the messages, the pages and the catalogue say; a file without an odd word is not parsed."""
    for path in sorted(SOURCE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if PATTERN.search(re.sub(r'\s*"?\n\s*(f?")?', " ", text)):
            for number, string in read_strings(path, text):
                yield path, number, string
    for path in sorted(SOURCE.rglob("*.toml")):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            yield path, number, line
    for path in sorted(path for pattern in WEB for path in (ROOT / "web").glob(pattern)):
        text = path.read_text(encoding="utf-8")
        for string in STRING.finditer(text):
            yield path, text.count("\n", 0, string.start()) + 1, " ".join(string[0].split())


@cache
def find_odd_words() -> list[str]:
    """Where an odd word stands, and what would be said instead."""
    odd = []
    for read in (read_markdown, read_sources):
        for path, number, line in read():
            for found in PATTERN.finditer(line):
                better = next(ODD[each] for each in ODD if re.fullmatch(each, found[0], re.IGNORECASE))
                odd.append(f"{path.relative_to(ROOT)}:{number}: {found[0]!r}; say {better!r}")
    return odd


def test_what_people_read_has_no_odd_words() -> None:
    assert find_odd_words() == []


@pytest.mark.parametrize(
    ("sentence", "odd"),
    [
        ("The file is loaded anew.", True),
        ("Start it again after mending it.", True),
        ("what it\ncomes to", True),
        ("The current that the driver is told", True),
        ("The motor is told", True),
        ("The told position", False),
        ("A recommended value", False),
    ],
)
def test_the_list_finds_odd_words_and_no_others(sentence: str, odd: bool) -> None:
    assert bool(PATTERN.search(" ".join(sentence.split()))) == odd
