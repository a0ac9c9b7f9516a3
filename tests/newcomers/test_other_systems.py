"""First hour of users on other systems: the same tests with commands that hide Linux."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from oracles.other_account import needs_root
from test_container import run_in_scratch, scratch


@pytest.mark.slow
@pytest.mark.parametrize("system", ["win32", "darwin"])
@pytest.mark.parametrize("user", ["application_developer", "researcher", "engineer", "designer"])
def test_the_first_hour(user: str, system: str) -> None:
    file = Path(__file__).with_name(f"test_{user}.py")
    command = [sys.executable, "-m", "pytest", str(file), "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    done = subprocess.run(
        command, env={**os.environ, "HAPTORB_NEWCOMERS_SYSTEM": system}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-6000:]
    assert " passed" in done.stdout


@needs_root
@scratch
@pytest.mark.slow
@pytest.mark.parametrize("user", ["application_developer", "researcher", "engineer", "designer"])
def test_the_first_hour_of_another_account_without_a_home(user: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    """With 8 MB of /dev/shm, and a root that is read-only."""
    file = Path(__file__).with_name(f"test_{user}.py")
    folder = tmp_path_factory.mktemp("a")  # a browser's socket has a short name
    browser = "mkdir $TMPDIR/browser; HAPTORB_NEWCOMERS_WITHOUT=HOME HOME=$TMPDIR/browser "
    options = "-q -p no:cacheprovider -p no:xdist --basetemp=$TMPDIR/first-hour"
    done = run_in_scratch(folder, f"{browser if user == 'designer' else ''}{sys.executable} -m pytest {file} {options}")
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
    assert " passed" in done.stdout
