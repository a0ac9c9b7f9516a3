"""Portable core of the firmware on this computer: its own checks under sanitizers, and ten million random bytes."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

pytestmark = pytest.mark.firmware

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"


@pytest.fixture(scope="module", autouse=True)
def compiler() -> None:
    if shutil.which("gcc") is None or shutil.which("make") is None:
        pytest.skip("gcc and make are not installed (Debian: apt-get install gcc make)")


def make(target: str) -> str:
    done = subprocess.run(["make", "-C", str(FIRMWARE), target], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


def test_core_does_what_it_says() -> None:
    found = re.search(r"(\d+) checks, 0 failures", make("test"))
    assert found is not None
    assert int(found[1]) > 10_000


def test_ten_million_random_bytes_make_no_wrong_duty() -> None:
    found = re.search(r"(\d+) bytes, (\d+) answers, (\d+) true frames taken, .* (\d+) wrong duties", make("fuzz"))
    assert found is not None
    assert int(found[1]) >= 10_000_000
    assert int(found[3]) > 1000  # it was listening all the time
    assert int(found[4]) == 0


def test_fuzzing_would_notice_a_parser_without_check_sum(tmp_path: Path) -> None:
    make("fuzz")
    core = FIRMWARE / "core"
    shutil.copytree(core, tmp_path / "core")
    shutil.copytree(FIRMWARE / "tests", tmp_path / "tests")
    source = tmp_path / "core" / "frame.c"
    text = source.read_text()
    check = "parser->crc == (uint16_t)((uint16_t)byte << 8) ? FRAME_COMPLETE : FRAME_DAMAGED"
    assert check in text
    source.write_text(text.replace(check, "FRAME_COMPLETE"))
    program = tmp_path / "fuzz"
    files = [str(path) for path in (tmp_path / "core").glob("*.c")]
    subprocess.run(["gcc", "-O1", "-o", str(program), str(tmp_path / "tests" / "fuzz_core.c"), *files], check=True)
    done = subprocess.run([str(program), "50000"], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert " 0 wrong duties" not in done.stdout


def test_firmware_fits_with_margin(built: Path) -> None:
    sizes = subprocess.run(["make", "-C", str(FIRMWARE), "all"], capture_output=True, text=True, check=True).stdout
    found = re.findall(r"flash (\d+) of (\d+) bytes .* RAM (\d+) of (\d+) bytes", sizes)
    assert len(found) == 2
    for flash, flash_size, ram, ram_size in found:
        assert int(flash) < 0.5 * int(flash_size)
        assert int(ram) < 0.5 * int(ram_size)
