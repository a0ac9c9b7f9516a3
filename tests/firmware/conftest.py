"""The emulated microcontroller: built once, started for each test."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from firmware.make_firmware import make_firmware
from haptorb.runtime.drivers.emulator_process import Emulator


@pytest.fixture(scope="session")
def built() -> Path:
    """The folder with firmware and emulator; skipped where the tools to make them are missing."""
    for tool, package in (("avr-gcc", "gcc-avr avr-libc"), ("gcc", "gcc"), ("make", "make")):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed (Debian: apt-get install {package})")
    if not any(Path(folder, "simavr", "sim_avr.h").exists() for folder in ("/usr/include", "/usr/local/include")):
        pytest.skip("libsimavr is not installed (Debian: apt-get install libsimavr-dev libelf-dev)")
    return make_firmware("all", "emulator")


@pytest.fixture
def emulator(built: Path, tmp_path: Path) -> Iterator[Emulator]:
    with Emulator(built, tmp_path / "omni") as one:
        yield one


@pytest.fixture
def started(built: Path, tmp_path: Path) -> Iterator[Callable[[str], Emulator]]:
    """Start emulators of boards of your own choice."""
    running: list[Emulator] = []

    def start(board: str = "m328p") -> Emulator:
        running.append(Emulator(built, tmp_path / f"omni{len(running)}", board))
        return running[-1]

    yield start
    for one in running:
        one.close()
