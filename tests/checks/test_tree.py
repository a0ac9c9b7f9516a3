"""Content that must not be in the tree: local paths, unfinished marks, third-party code, copied bundles."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

#: folders that only exist on a developer's machine
LOCAL = re.compile(r"(?<![\w.~$}-])/(?:home|root|Users|work|mnt|opt)/\w|(?<![\w/])\.\./shared\b")
UNFINISHED = re.compile(r"\b(?:TODO|FIXME|XXX|HACK)\b|raise NotImplementedError\b")


def project_files(root: Path) -> list[Path]:
    """Files that belong to the project: known to git, or new and not ignored."""
    try:
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=root,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
    except (OSError, subprocess.CalledProcessError) as cause:
        pytest.skip(f"not a git checkout: {cause}")
    return [path for name in listed.split("\0") if name and (path := root / name).is_file()]


def lines(path: Path) -> list[str]:
    """The lines of a text file; none for a picture."""
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError:
        return []


def find_lines(pattern: re.Pattern[str], root: Path, folders: tuple[str, ...] = ("",)) -> list[str]:
    """Every `file:line: text` in which `pattern` occurs, outside this file, which must spell what it looks for."""
    return [
        f"{path.relative_to(root)}:{number}: {line.strip()[:120]}"
        for path in project_files(root)
        if path != Path(__file__).resolve() and any(path.is_relative_to(root / folder) for folder in folders)
        for number, line in enumerate(lines(path), 1)
        if pattern.search(line)
    ]


def test_no_path_of_a_particular_machine(root: Path) -> None:
    assert find_lines(LOCAL, root) == []


@pytest.mark.parametrize(
    ("line", "local"),
    [
        ("open('/home/ada/x')", True),
        ("see /home/me/project", True),
        ("../shared/spec", True),
        ("https://example.org/home/page", False),
        ("~/.cache/haptorb", False),
        ("/usr/lib/avr", False),
        ("make run PYTHON=/path/to/python3", False),
    ],
)
def test_the_pattern_for_local_paths_sees_what_it_must(line: str, local: bool) -> None:
    assert bool(LOCAL.search(line)) is local


def test_nothing_is_marked_unfinished(root: Path) -> None:
    assert find_lines(UNFINISHED, root, ("src", "papers", "web", "firmware", "examples", "benchmarks")) == []


def test_lock_file_has_no_download_addresses(root: Path) -> None:
    for lock in (path for path in project_files(root) if path.name == "package-lock.json"):
        assert '"resolved"' not in lock.read_text(), f"{lock.relative_to(root)}: a registry of its own would be ignored"


def test_no_file_is_large(root: Path) -> None:
    large = [f"{path.relative_to(root)}: {path.stat().st_size} bytes" for path in project_files(root)
             if path.stat().st_size > 1_000_000]  # fmt: skip
    assert large == []
