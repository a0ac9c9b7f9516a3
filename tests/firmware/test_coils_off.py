"""Coils off within 20 ms of any failure of host, cable, line or processor; shown to fail with broken firmware."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from firmware.make_firmware import make_firmware
from haptorb.errors import DriverError
from haptorb.runtime.drivers.emulator_process import Emulator

pytestmark = [pytest.mark.firmware, pytest.mark.realtime, pytest.mark.timeout(1200)]

HOST = Path(__file__).with_name("minimal_host.py")
LIMIT_MS = 20.0
PACE = 0.15


def kill(emulator: Any, host: subprocess.Popen[str]) -> str:
    host.kill()
    return "since_byte_ms"


def freeze(emulator: Any, host: subprocess.Popen[str]) -> str:
    os.kill(host.pid, signal.SIGSTOP)
    return "since_byte_ms"


def pull(emulator: Any, host: subprocess.Popen[str]) -> str:
    emulator.execute("pull")
    return "since_mark_ms"


def garbage(emulator: Any, host: subprocess.Popen[str]) -> str:
    emulator.execute("noise 1")
    return "since_mark_ms"


def reset(emulator: Any, host: subprocess.Popen[str]) -> str:
    emulator.execute("reset")
    return "since_mark_ms"


def brown_out(emulator: Any, host: subprocess.Popen[str]) -> str:
    emulator.execute("brownout")
    return "since_mark_ms"


def hang(emulator: Any, host: subprocess.Popen[str]) -> str:
    emulator.execute("hang")
    return "since_mark_ms"


def button(emulator: Any, host: subprocess.Popen[str]) -> str:
    emulator.execute("button 1")
    return "since_mark_ms"


def bus_stuck(emulator: Any, host: subprocess.Popen[str]) -> str:
    emulator.execute("stuck")
    return "since_mark_ms"


def current_sensor_gone(emulator: Any, host: subprocess.Popen[str]) -> str:
    emulator.execute("absent ina219-y")
    return "since_mark_ms"


def chip_forgot(emulator: Any, host: subprocess.Popen[str]) -> str:
    emulator.execute("forget")
    return "since_mark_ms"


def short_circuit(emulator: Any, host: subprocess.Popen[str]) -> str:
    emulator.execute("resistance 0 0.05")
    return "since_mark_ms"


def mend(emulator: Any, fault: Callable[[Any, Any], str]) -> None:
    """All is well again, and the firmware has had the quarter of a second in which it looks at every chip; after a
    restart, the second in which it learns how warm the coils are, before which it does not engage."""
    for command in ("noise 0", "free", "button 0", "present ina219-y", "resistance 0 0.6"):
        emulator.execute(command)
    emulator.execute("pace 1")
    emulator.wait(1.5 if fault in (reset, brown_out, hang) else 0.25)
    emulator.execute(f"pace {PACE}")


#: those that the protocol document promises, a hundred times each in the nightly run
PROMISED = (kill, freeze, pull, garbage, reset)
OTHERS = (brown_out, hang, button, bus_stuck, current_sensor_gone, chip_forgot, short_circuit)


def off_times(emulator: Any, fault: Callable[[Any, Any], str], repetitions: int, timeout: float = 20.0) -> list[float]:
    """Milliseconds of firmware time from the fault to coils off; repeated when the host was kept from running."""
    emulator.execute("pace 1")
    emulator.wait(max(1.5 - float(emulator.status()["t"]), 0.0))
    emulator.execute(f"pace {PACE}")
    times: list[float] = []
    tries = 0
    while len(times) < repetitions:
        tries += 1
        assert tries < 4 * repetitions + 10, "this computer is too busy to keep a host alive for a few milliseconds"
        emulator.discard_lines()
        host = subprocess.Popen(
            [sys.executable, "-S", "-E", str(HOST), emulator.port], stdout=subprocess.PIPE, text=True
        )
        assert host.stdout is not None
        try:
            if host.stdout.readline() != "engaged\n":
                continue
            emulator.expect_line("@on")
            if float(emulator.status()["on"]) != 1:
                continue  # the host was kept waiting and the firmware has switched off already
            which = fault(emulator, host)
            off = dict(re.findall(r"(\w+)=([-\d.]+)", emulator.expect_line("@off", timeout)))
            times.append(float(off[which]))
        finally:
            host.kill()
            host.wait()
            host.stdout.close()
            if fault is pull:
                emulator.execute("plug")
            mend(emulator, fault)
    return times


@pytest.mark.parametrize("fault", PROMISED + OTHERS, ids=lambda f: f.__name__)
def test_coils_are_off_in_time(
    emulator: Any, fault: Callable[[Any, Any], str], check_limit: Callable[[str, float, float, str], None]
) -> None:
    check_limit(f"{fault.__name__}: coils off after", max(off_times(emulator, fault, 3)), LIMIT_MS, "ms")
    assert float(emulator.status()["on"]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("fault", PROMISED, ids=lambda f: f.__name__)
def test_coils_are_off_a_hundred_times_of_a_hundred(
    emulator: Any, fault: Callable[[Any, Any], str], check_limit: Callable[[str, float, float, str], None]
) -> None:
    times = off_times(emulator, fault, 100)
    assert len(times) == 100
    check_limit(f"{fault.__name__}, 100 times: coils off after at most", max(times), LIMIT_MS, "ms")


@pytest.mark.parametrize("board", ["m328p", "m2560"])
def test_coils_are_off_at_boot(started: Callable[..., Any], board: str) -> None:
    emulator = started(board)
    emulator.execute("pace 1")
    words = emulator.status()
    assert words["on"] == "0"
    assert words["resets"] == "1"
    for _ in range(3):
        emulator.execute("reset")
        assert emulator.status()["on"] == "0"


def test_a_hung_program_is_restarted_by_the_watchdog(emulator: Any) -> None:
    before = int(emulator.status()["resets"])
    emulator.execute("hang")
    emulator.wait(0.1)
    assert int(emulator.status()["resets"]) == before + 1


@pytest.fixture(scope="module")
def broken(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str, str], Path]:
    """A function that builds the board's firmware with one thing wrong, each once; the emulator is the usual one."""

    @cache
    def build(file: str, right: str, wrong: str) -> Path:
        folder = tmp_path_factory.mktemp("broken") / "firmware"
        shutil.copytree(built.parent, folder, ignore=shutil.ignore_patterns("build"))
        source = folder / file
        assert right in source.read_text()
        source.write_text(source.read_text().replace(right, wrong))
        make_firmware("build/omni-m328p.elf", folder=folder)
        shutil.copy(built / "emulator", folder / "build")
        return folder / "build"

    return build


@pytest.mark.parametrize(
    ("file", "right", "wrong", "fault"),
    [
        ("core/config.h", "#define SILENCE_MS 15", "#define SILENCE_MS 40", kill),
        pytest.param(
            "core/config.h", "#define SILENCE_MS 15", "#define SILENCE_MS 40", garbage, marks=pytest.mark.slow
        ),
        (
            "core/bridge.c",
            "guard_trip(&bridge->guard, REASON_STOP_BUTTON);",
            "guard_millisecond(&bridge->guard);",
            button,
        ),
    ],
    ids=["silence too long, host killed", "silence too long, garbage", "stop button ignored"],
)
def test_the_tests_above_can_fail(
    broken: Callable[[str, str, str], Path],
    tmp_path: Path,
    file: str,
    right: str,
    wrong: str,
    fault: Callable[[Any, Any], str],
) -> None:
    """A firmware broken on purpose keeps its coils on for longer than it may."""
    with Emulator(broken(file, right, wrong), tmp_path / "port") as emulator:
        if fault is button:
            with pytest.raises(DriverError, match="did not report '@off'"):
                off_times(emulator, fault, 1, timeout=3.0)
        else:
            assert min(off_times(emulator, fault, 1)) > LIMIT_MS
