"""README: its commands and examples run in order; its figures are those of the stored benchmarks."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
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


@pytest.mark.realtime
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


def test_every_page_has_what_the_program_knows(root: Path, load_script: Callable[[str], ModuleType]) -> None:
    script = load_script("reference_tables")
    command = "run: python scripts/reference_tables.py"
    pages = {path: path.read_text(encoding="utf-8") for path in script.find_pages()}
    assert [str(path.relative_to(root)) for path, text in pages.items() if script.fill_page(text) != text] == [], (
        command
    )
    reference = pages[root / "docs" / "reference" / "device-file.md"]
    altered = reference.replace("coils.heat.ambient", "coils.heat.outside")
    assert altered != reference
    assert script.fill_page(altered) == reference
    parts = "".join(pages.values())
    assert [name for name in script.TABLES if f"<!-- {name}: begin -->" not in parts] == []


def test_pages_can_be_read_without_a_build(root: Path) -> None:
    for path in sorted(root.glob("docs/**/*.md")):
        if {"_build", "gallery", "generated"} & {*path.parts}:
            continue
        text = path.read_text(encoding="utf-8")
        assert re.findall(r"^`{3,}\{(?:literal)?include\}.*", text, re.MULTILINE) == [], path
        assert re.findall(r"\{doc\}`[^`]*`", text) == [], f"{path}: a link that only the built pages have"
        for target in re.findall(r"(?<!!)\[[^\]]+\]\(([^)#:]+\.md)\)", re.sub(r"```.*?```", "", text, flags=re.DOTALL)):
            assert (path.parent / target).exists(), f"{path}: {target}"
    folder = root / "docs" / "reference"
    for name, known in (("device-file", "coils.heat.ambient"), ("study-file", "levels.reference"),
                        ("device-design", "objectives.NAME.quantity"), ("design-file", "design.NAME."),
                        ("command-line", "Usage: haptorb run")):  # fmt: skip
        assert known in (folder / f"{name}.md").read_text(encoding="utf-8")
    assert "| `/haptorb/subscribe`" in (root / "docs" / "how-to" / "application.md").read_text(encoding="utf-8")


def test_the_wheel_has_the_references(root: Path) -> None:
    shared = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    shipped = shared["tool"]["hatch"]["build"]["targets"]["wheel"]["shared-data"]
    assert "docs/reference" in shipped
    assert [name for name in shipped if not (root / name).exists()] == []


def test_the_stored_benchmarks_are_whole(root: Path) -> None:
    found = load_result(root / "docs" / "benchmarks.json")
    assert {"magnetics", "estimation", "allocation", "tick", "training", "recording"} <= {
        row.benchmark for row in found.rows
    }
    assert found.command.startswith("haptorb bench")
