"""Builds firmware and emulator once; a second process waits for the first."""

from __future__ import annotations

import fcntl
import subprocess
from pathlib import Path

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"


def make_firmware(*targets: str, folder: Path = FIRMWARE) -> Path:
    """`make` in `folder`; its build folder. AssertionError with what make said if it fails."""
    with (folder / "Makefile").open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        made = subprocess.run(["make", "-C", str(folder), *targets], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    return folder / "build"
