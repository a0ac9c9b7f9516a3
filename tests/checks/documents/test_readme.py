"""README: its two commands and four examples run, in its order; its figures are those of the stored benchmarks."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from haptorb_bench import load_result
from oracles.program_runner import ProgramRunner

HAPTORB = "import sys; from haptorb.cli import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture(scope="module")
def readme(root: Path) -> str:
    return (root / "README.md").read_text(encoding="utf-8")


def test_four_examples_for_four_users_run_and_say_a_number(
    readme: str, tmp_path: Path, programs: ProgramRunner
) -> None:
    users = re.findall(r"^\*\*The ([\w ]+)\*\*", readme, re.MULTILINE)
    assert users == ["device engineer", "HCI researcher", "product designer", "application developer"]
    blocks = re.findall(r"^```python\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)
    assert len(blocks) == len(users)
    program = tmp_path / "readme.py"
    program.write_text("\nprint('---')\n".join(blocks), encoding="utf-8")
    done = programs.run(program, tmp_path)
    assert done.returncode == 0, done.stderr
    said = done.stdout.split("---\n")
    assert all(re.search(r"\d\.\d+ N", one) for one in said)
    assert [len(one.splitlines()) for one in said] == [2, 1, 3, 1]
    assert (tmp_path / "run.csv").stat().st_size > 10_000


def test_the_command_that_is_named_runs(readme: str) -> None:
    words = ["run", "pmsm", "--world", "outlet"]
    assert "haptorb " + " ".join(words) in readme
    command = [sys.executable, "-c", HAPTORB, *words, "--headless", "--duration", "0.5"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=240)
    assert done.returncode == 0, done.stderr


def test_what_a_newcomer_must_find(root: Path, readme: str) -> None:
    first = readme.split("## Four ways", 1)[0]
    assert re.search(r"^make run ", first, re.MULTILINE)
    assert re.search(r"^make test ", first, re.MULTILINE)
    assert re.search(r"<!-- first-run --> \d+ s <!-- /first-run -->", first)
    pictures = re.findall(r'<img src="([^"]+)" width="640" alt="[^"]+">', readme)
    assert len(pictures) == 1
    for target in [*pictures, *re.findall(r"(?<!!)\[[^\]]+\]\(([^)#]+)\)", readme)]:
        assert (root / target).exists(), target
    known = subprocess.run([sys.executable, "-c", HAPTORB, "--help"], capture_output=True, text=True, check=True).stdout
    for command in set(re.findall(r"`haptorb (\w+)", readme)):
        assert command in known


def test_readme_quotes_the_stored_benchmarks(readme: str, load_script: Callable[[str], ModuleType]) -> None:
    script = load_script("benchmark_table")
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
