"""The first hour of the users on other systems: the same tests, with commands from which Linux is hidden."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
@pytest.mark.parametrize("system", ["win32", "darwin"])
@pytest.mark.parametrize("user", ["application_developer", "researcher", "designer"])
def test_the_first_hour(user: str, system: str) -> None:
    file = Path(__file__).with_name(f"test_{user}.py")
    command = [sys.executable, "-m", "pytest", str(file), "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    done = subprocess.run(
        command, env={**os.environ, "HAPTORB_NEWCOMERS_SYSTEM": system}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-6000:]
    assert " passed" in done.stdout
