"""The documentation's programs run: all Python blocks of a page in sequence."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from oracles.program_runner import ProgramRunner

ROOT = Path(__file__).resolve().parents[3]
PAGES = sorted(
    path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts and "generated" not in path.parts
)
CODE = re.compile(r"^```python\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
WITH_CODE = [path for path in PAGES if CODE.search(path.read_text(encoding="utf-8"))]
#: of the pages that start servos, the one that runs every day: a servo takes two seconds of a processor to start
DAILY = ROOT / "docs" / "tutorials" / "dome.md"
#: pages that compute for three seconds and more; what they call has tests of its own
LONG = tuple(ROOT / "docs" / "how-to" / f"{name}.md" for name in ("design", "error-budget", "guidance"))


def _mark(page: Path) -> object:
    starts = any("Servo(" in code for code in CODE.findall(page.read_text(encoding="utf-8")))
    marks = [pytest.mark.slow] if (starts and page != DAILY) or page in LONG else []
    return pytest.param(page, marks=marks, id=str(page.relative_to(ROOT)))


@pytest.mark.parametrize("page", [*map(_mark, WITH_CODE)])
def test_python_in_the_documentation_runs(page: Path, tmp_path: Path, programs: ProgramRunner) -> None:
    """All ```python blocks of a page, one after the other, as one program; ```py blocks are only shown."""
    program = tmp_path / "page.py"
    program.write_text("\n\n".join(CODE.findall(page.read_text(encoding="utf-8"))), encoding="utf-8")
    done = programs.run(program, tmp_path)
    assert done.returncode == 0, done.stderr
