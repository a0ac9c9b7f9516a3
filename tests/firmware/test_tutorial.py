"""Tutorial "Bring up hardware": its commands in order, on the emulated board."""

import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "tutorials" / "hardware.md"
HAPTORB = "import sys; from haptorb.cli import main; sys.exit(main(sys.argv[1:]))"

pytestmark = [pytest.mark.firmware, pytest.mark.realtime]


def commands(port: Path, built: Path) -> list[list[str]]:
    """The page's commands, run from this virtual environment, on a port of this test's own; its runs are shorter."""
    found = []
    for block in re.findall(r"^```sh\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
        for line in block.splitlines():
            words = shlex.split(line.replace("/tmp/omni", str(port)).replace("--duration 3", "--duration 1"))
            assert words[0] == "haptorb"
            found.append([sys.executable, "-c", HAPTORB, *words[1:]])
    found[0] += ["--build", str(built), "--duration", "240"]
    return found


def run_checked(words: list[str]) -> str:
    """What a command says; again where this computer was too busy for a device that switches off after 15 ms."""
    for _ in range(8):
        ended = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)
        if "the host was silent" not in ended.stderr:
            break
    assert ended.returncode == 0, f"{words[3:]}: {ended.stdout}{ended.stderr}"
    return ended.stdout + ended.stderr


@pytest.mark.slow
@pytest.mark.timeout(280)
def test_the_tutorial(built, tmp_path):
    port = tmp_path / "omni"
    emulate, *others = commands(port, built)
    assert [words[3:6] for words in (emulate, *others)] == [
        ["hardware", "emulate", "--port"],
        ["hardware", "probe", "--port"],
        ["hardware", "monitor", "--driver"],
        ["hardware", "jog", "x"],
        ["run", "omni", "--driver"],
        ["run", "omni", "--driver"],
    ]
    with subprocess.Popen(emulate, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as emulator:
        try:
            until = time.monotonic() + 60
            while not port.exists() and emulator.poll() is None and time.monotonic() < until:
                time.sleep(0.1)
            assert port.exists()
            told = []
            for words in others:
                told.append(run_checked(words))
        finally:
            emulator.terminate()
            started = emulator.communicate(timeout=30)[0]
    probe, monitor, jog, run, felt = told
    assert "starting an emulated device" in started
    assert "firmware" in probe
    assert re.search(r"^ +\d\.\d\d s [^m]* A [^m]* °C [^m]* mT$", monitor, re.MULTILINE)  # on two lines of 80 columns
    assert "x" in jog
    assert "ticks" in run or "%" in run
    assert re.search(r"peak force \d\.\d\d N|tripped at", felt)
