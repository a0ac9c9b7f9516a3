"""The emulated microcontroller: built once, started for each test, spoken to over its standard input."""

from __future__ import annotations

import re
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import Empty, Queue

import pytest

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE = ROOT / "firmware"
#: while coils are engaged, firmware time runs at this share of ours: tests share their computer, and a host that is
#: kept from running for 15 ms is a silent host
PACE = 0.05


class Emulator:
    """A running emulator; `said` holds its lines."""

    def __init__(self, board: str, link: Path, *more: str) -> None:
        mcu = {"m328p": "atmega328p", "m2560": "atmega2560"}[board]
        program = [FIRMWARE / "build" / "emulator", FIRMWARE / "build" / f"omni-{board}.elf"]
        self.port = str(link)
        self.process = subprocess.Popen(
            [*map(str, program), "--mcu", mcu, "--link", str(link), *more],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            bufsize=1,
        )
        self._lines: Queue[str] = Queue()
        threading.Thread(target=self._listen, daemon=True).start()
        self.heard("@ready")

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith("@"):
                self._lines.put(line.strip())

    def heard(self, start: str, patience: float = 20.0) -> str:
        """The next line that begins so; others before it are dropped."""
        end = time.monotonic() + patience
        while True:
            try:
                line = self._lines.get(timeout=max(end - time.monotonic(), 0.001))
            except Empty:
                raise AssertionError(f"the emulator did not say {start} within {patience} s") from None
            if line.startswith(start):
                return line

    def say(self, command: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()

    def tell(self, command: str) -> None:
        """Say it and wait until it is done, keeping what happens because of it."""
        kept: list[str] = []
        self.say(command)
        while not (line := self._lines.get(timeout=20)).startswith("@done"):
            kept.append(line)
        for one in kept:
            self._lines.put(one)

    def slow(self) -> None:
        """Firmware time slows down: before the coils are engaged."""
        self.tell(f"pace {PACE}")

    def forget(self) -> None:
        """Drop everything said so far."""
        while not self._lines.empty():
            self._lines.get()

    def status(self) -> dict[str, str]:
        self.say("status")
        words = dict(re.findall(r"(\w+)=(\S+)", self.heard("@status")))
        self.heard("@done")
        return words

    def off(self, patience: float = 20.0) -> dict[str, float]:
        """When the coils went off: the numbers of the next @off."""
        return {k: float(v) for k, v in re.findall(r"(\w+)=([-\d.]+)", self.heard("@off", patience))}

    def close(self) -> None:
        if self.process.poll() is None:
            try:
                self.say("quit")
                self.process.wait(5)
            except (OSError, subprocess.TimeoutExpired):
                self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()


@pytest.fixture(scope="session")
def built() -> Path:
    """The folder with firmware and emulator; skipped where the tools to make them are missing."""
    for tool, package in (("avr-gcc", "gcc-avr avr-libc"), ("gcc", "gcc"), ("make", "make")):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed (Debian: apt-get install {package})")
    if not any(Path(folder, "simavr", "sim_avr.h").exists() for folder in ("/usr/include", "/usr/local/include")):
        pytest.skip("libsimavr is not installed (Debian: apt-get install libsimavr-dev libelf-dev)")
    made = subprocess.run(["make", "-C", str(FIRMWARE), "all", "emulator"], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    return FIRMWARE / "build"


@pytest.fixture
def emulator(built: Path, tmp_path: Path) -> Iterator[Emulator]:
    one = Emulator("m328p", tmp_path / "omni")
    yield one
    one.close()


@pytest.fixture
def started(built: Path, tmp_path: Path) -> Iterator[Callable[..., Emulator]]:
    """Start emulators with arguments of your own."""
    running: list[Emulator] = []

    def start(board: str = "m328p", *more: str) -> Emulator:
        running.append(Emulator(board, tmp_path / f"omni{len(running)}", *more))
        return running[-1]

    yield start
    for one in running:
        one.close()
