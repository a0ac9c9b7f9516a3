"""`make test` calls pytest three times: each test runs once, and the last line sums up the results."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

CONFIGURATION = "[pytest]\nmarkers =\n  realtime\n  slow\n  browser\n"
ENDS = """import os
def pytest_sessionfinish(session):
    if session.config.option.markexpr.startswith('realtime and browser') and not hasattr(session.config, 'workerinput'):
        os._exit(0)
"""
FILES = (
    "import os\ndef test_shared():\n    assert 'PYTEST_XDIST_WORKER' in os.environ and os.nice(0) == 19\n",
    "def test_fails():\n    assert False\n",
    """import os, pytest
@pytest.mark.realtime
def test_in_threes():
    assert os.environ['PYTEST_XDIST_WORKER_COUNT'] == '3'
@pytest.mark.realtime
@pytest.mark.browser
def test_in_twos():
    assert os.environ['PYTEST_XDIST_WORKER_COUNT'] == '2'
@pytest.mark.realtime
@pytest.mark.slow
def test_slow_one():
    assert False
""",
)


@pytest.fixture(scope="module")
def program(load_script: Callable[[str], ModuleType]) -> Any:
    return load_script("run_tests")


@pytest.mark.slow
def test_all_calls_run_and_one_line_adds_them_up(root: Path, tmp_path: Path) -> None:
    """The next call follows though the first fails, and a process that ends early is an error though it says 0."""
    (tmp_path / "pytest.ini").write_text(CONFIGURATION)
    (tmp_path / "conftest.py").write_text(ENDS)
    for number, text in enumerate(FILES):
        (tmp_path / f"test_{number}.py").write_text(text)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    environment |= {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_PLUGINS": "xdist.plugin"}  # ten processes load it
    done = subprocess.run(
        [sys.executable, root / "scripts" / "run_tests.py", "--markers", "not slow"],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=200,
    )  # fmt: skip
    assert re.fullmatch(
        r"=+ 1 failed, 2 passed, 1 error in [\d.]+s \(0:\d\d:\d\d\) =+", done.stdout.splitlines()[-1]
    ), done.stdout
    assert done.returncode == 1


@pytest.mark.parametrize(
    ("text", "counts"),
    [
        ("....\n=== 4 passed in 0.10s ===\n", {"passed": 4}),
        ("4 passed, 1 warning in 61.10s (0:01:01)\n", {"passed": 4, "warning": 1}),
        ("= \x1b[31m1 failed\x1b[0m, 2 passed, 3 deselected, 2 errors, 4 rerun in 1.00s =\n",
            {"failed": 1, "passed": 2, "error": 2, "rerun": 4}),
        ("=== 4 passed in 0.10s ===\nlater\n= 5 passed, 1 skipped in 0.20s =\n", {"passed": 5, "skipped": 1}),
        ("=== no tests ran in 0.10s ===\n", {}),
        ("==== 7 deselected in 0.10s ====\n", {}),
        ("Killed\n", {"error": 1}),
        ("", {"error": 1}),
    ],
)  # fmt: skip
def test_counts_are_those_of_the_last_summary(program: Any, text: str, counts: dict[str, int]) -> None:
    assert program.count_outcomes(text) == counts


def test_the_summary_is_written_as_pytest_writes_it(program: Any) -> None:
    counts = program.count_outcomes("= 2 failed, 5000 passed, 3 skipped, 2 warnings, 1 error, 4 rerun in 9.0s =")
    assert program.format_summary(counts, 3723.4).startswith(
        "= 2 failed, 5000 passed, 3 skipped, 2 warnings, 1 error, 4 rerun in 3723.40s (1:02:03) ="
    )
    assert program.format_summary(counts - counts, 1.0) == " no tests ran in 1.00s (0:00:01) ".center(80, "=")


@pytest.mark.parametrize(
    ("codes", "code"), [([0, 0], 0), ([1, 0], 1), ([0, 1], 1), ([5, 0], 0), ([0, 5], 0), ([5, 5], 5), ([5, 3], 3)]
)
def test_a_call_without_tests_is_no_failure_but_two_are(program: Any, codes: list[int], code: int) -> None:
    assert program.combine_codes(codes) == code


#: a verdict on elapsed time, less than 2 s, which a busy machine can turn
SPEED = re.compile(r"\b(?:monotonic|perf_counter|time)\(\) - [\w.\[\]]+ <=? [01]\.\d")


def test_a_verdict_that_hangs_on_speed_has_the_mark(root: Path) -> None:
    """Loops that try again until a time has passed are none: only `assert`, and what another process prints."""
    found = []
    for path in sorted((root / "tests").rglob("test_*.py")):
        text = path.read_text(encoding="utf-8")
        if SPEED.search(text) and not re.search(r"^pytestmark = .*realtime", text, re.MULTILINE):
            for part in re.split(r"\n\n\n", text):
                wrong = [
                    line
                    for line in part.splitlines()
                    if SPEED.search(line) and re.search(r"assert|say\(|errors\(", line)
                ]
                if wrong and "@pytest.mark.realtime" not in part:
                    found.append(f"{path.relative_to(root)}: {wrong[0].strip()}")
    assert found == []
