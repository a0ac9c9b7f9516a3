"""libHD: frames, units, error stack and scheduler, through the real library in a separate program."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb.control.trip_reasons import GuardState, Trip
from serve.native.conftest import ServedFile

PREFACE = """
import ctypes, os, sys, threading, time
hd = ctypes.CDLL(LIBRARY)
class Error(ctypes.Structure):
    _fields_ = [("code", ctypes.c_uint), ("internal", ctypes.c_int), ("device", ctypes.c_uint)]
hd.hdGetError.restype = Error
hd.hdInitDevice.restype = hd.hdGetCurrentDevice.restype = ctypes.c_uint
hd.hdGetString.restype = ctypes.c_char_p
hd.hdGetSchedulerTimeStamp.restype = ctypes.c_double
hd.hdScheduleAsynchronous.restype = ctypes.c_ulong
CALL = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p)
def doubles(parameter, count):
    found = (ctypes.c_double * count)()
    hd.hdGetDoublev(parameter, found)
    return list(found)
def force(x, y, z): hd.hdSetDoublev(0x2700, (ctypes.c_double * 3)(x, y, z))
def errors():
    found = []
    while (one := hd.hdGetError()).code: found.append(hex(one.code))
    return found
def say(*words): print(*words, flush=True)
def schedule(function): return hd.hdScheduleAsynchronous(function, None, 100)
"""


@pytest.fixture
def program(libraries: Path, served: ServedFile) -> Any:
    """Start a program with the functions of PREFACE, before `served`."""
    running: list[subprocess.Popen[str]] = []

    def start(source: str) -> subprocess.Popen[str]:
        text = PREFACE.replace("LIBRARY", repr(str(libraries / "libHD.so"))) + textwrap.dedent(source)
        running.append(
            subprocess.Popen(
                [sys.executable, "-c", text], env={**os.environ, **served.run}, text=True, stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )
        )  # fmt: skip
        return running[-1]

    yield start
    for one in running:
        one.kill()
        one.communicate()


def read_lines(process: subprocess.Popen[str]) -> list[str]:
    out, errors = process.communicate(timeout=30)
    assert process.returncode == 0, errors
    return out.splitlines()


def test_units_and_frame(served: ServedFile, program: Any) -> None:
    """Millimetres; x right, y up, z towards the user: the stator's z is up, and its y points away from the user."""
    rest = served.loop.device.shell.contact_distance  # type: ignore[union-attr]
    served.publish(p=(0.003, -0.007, rest + 0.002), v=(0.1, 0.2, 0.3), w=(1.0, 2.0, 3.0), q=(0.0, 0.0, 0.6, 0.8))
    said = read_lines(
        program("""
        h = hd.hdInitDevice(None)
        hd.hdBeginFrame(h)
        say(*doubles(0x2050, 3)); say(*doubles(0x2051, 3)); say(*doubles(0x2053, 3)); say(*doubles(0x2052, 16))
        hd.hdEndFrame(h)
        say(*doubles(0x2551, 6)); say(hd.hdGetString(0x2501).decode(), *errors())
        """)
    )
    values = [np.array(line.split(), float) for line in said[:5]]
    assert values[0] == pytest.approx([3.0, 2.0, 7.0])
    assert values[1] == pytest.approx([100.0, 300.0, -200.0])
    assert values[2] == pytest.approx([1.0, 3.0, -2.0])
    transform = values[3].reshape(4, 4)  # column by column
    angle = 2.0 * np.arctan2(0.6, 0.8)  # about the way up, which is y here
    up = [[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]]
    rotation = transform[:3, :3].T
    assert rotation == pytest.approx(np.array(up), abs=1e-12)
    assert transform[3] == pytest.approx([3.0, 2.0, 7.0, 1.0])
    assert (values[4][:3] < 0.0).all()
    assert (values[4][3:] > 0.0).all()
    assert said[5] == "haptorb omni"


def test_force_goes_out_at_the_end_of_a_frame(served: ServedFile, program: Any) -> None:
    process = program("""
        h = hd.hdInitDevice(b"Default Device")
        hd.hdEnable(0x4000); hd.hdDisable(0x4002)
        hd.hdBeginFrame(h); force(0.1, 0.2, 0.3); say("set"); sys.stdin.readline(); hd.hdEndFrame(h)
        say(*doubles(0x2800, 3)); sys.stdin.readline()
        hd.hdDisableDevice(h); say(*errors())
    """)
    assert process.stdout.readline() == "set\n"
    assert served.receive()[0] == [0.0, 0.0, 0.0]
    process.stdin.write("\n")
    process.stdin.flush()
    served.await_force((0.1, -0.3, 0.2))
    assert process.stdout.readline() == "0.1 0.2 0.3\n"
    assert process.communicate("\n", timeout=30)[0] == "\n"


def test_errors_are_a_stack(served: ServedFile, program: Any) -> None:
    """Newest first; each misuse has its own."""
    said = read_lines(
        program("""
        hd.hdBeginFrame(5); say(*errors())
        h = hd.hdInitDevice(None); say(h, hd.hdInitDevice(None) == 0xFFFFFFFF, *errors())
        hd.hdEndFrame(h); say(*errors())
        force(0, 0, 0.1); say(*errors())
        hd.hdBeginFrame(h); hd.hdBeginFrame(h); hd.hdEndFrame(h); say(*errors())
        doubles(0x1234, 1); say(*errors())
        doubles(0x2054, 16); say(*errors())
        hd.hdEnable(1); hd.hdSetSchedulerRate(9000); say(*errors())
        keep = [CALL(lambda _: 0) for i in range(70)]
        for one in keep: schedule(one)
        say(len(errors()))
        hd.hdDisableDevice(h); hd.hdDisableDevice(h); say(*errors())
        """)
    )
    assert said == ["0x104", "0 True 0x301", "0x401", "0x402", "0x400", "0x100", "0x103", "0x101 0x100", "6", "0x104"]


@pytest.mark.parametrize("numbers", ["float('nan'), 0, 0", "0, float('inf'), 0"])
def test_no_number_is_no_force(served: ServedFile, program: Any, numbers: str) -> None:
    process = program(f"""
        h = hd.hdInitDevice(None); hd.hdEnable(0x4000); hd.hdDisable(0x4002)
        hd.hdBeginFrame(h); force(0, 0.5, 0); hd.hdEndFrame(h); sys.stdin.readline()
        hd.hdBeginFrame(h); force({numbers}); hd.hdEndFrame(h); say(*errors()); sys.stdin.readline()
    """)
    served.await_force((0.0, 0.0, 0.5), 20.0)
    process.stdin.write("\n")
    process.stdin.flush()
    assert process.stdout.readline() == "0x204\n"
    served.await_force((0.0, 0.0, 0.0))


def test_more_force_than_there_is_switches_off(served: ServedFile, program: Any) -> None:
    """Unless the program has it clamped."""
    most = served.loop.device.limits.force
    process = program("""
        h = hd.hdInitDevice(None); hd.hdEnable(0x4000); hd.hdEnable(0x4001); hd.hdDisable(0x4002)
        hd.hdBeginFrame(h); force(0, 100, 0); hd.hdEndFrame(h); say(hd.hdIsEnabled(0x4000), *errors())
        sys.stdin.readline()
        hd.hdDisable(0x4001)
        hd.hdBeginFrame(h); force(0, 100, 0); hd.hdEndFrame(h); say(hd.hdIsEnabled(0x4000), *errors())
    """)
    assert process.stdout.readline() == "1\n"
    served.await_force((0.0, 0.0, most))
    assert process.communicate("\n", timeout=30)[0] == "0 0x201\n"
    client = served.loop._client
    served.receive()
    assert client["lost"][0] > 0.0


@pytest.mark.parametrize(
    ("trip", "error"), [(Trip.OVERHEATED, "0x200"), (Trip.DRIVER_FAILED, "0x302"), (Trip.STOPPED, "0x300")]
)
def test_a_trip_is_an_error_once(served: ServedFile, program: Any, trip: Trip, error: str) -> None:
    """Forces are off until the program enables them again, and a person engages."""
    process = program("""
        h = hd.hdInitDevice(None); hd.hdEnable(0x4000); say("open"); sys.stdin.readline()
        while True:
            hd.hdBeginFrame(h); hd.hdEndFrame(h)
            if found := errors(): break
            time.sleep(0.001)
        hd.hdBeginFrame(h); hd.hdEndFrame(h)
        say(hd.hdIsEnabled(0x4000), *found, *errors())
    """)
    assert process.stdout.readline() == "open\n"
    served.publish(guard=GuardState.TRIPPED, trip=trip)
    assert process.communicate("\n", timeout=30)[0] == f"0 {error}\n"


def test_scheduler(served: ServedFile, program: Any) -> None:
    """By priority, until a callback is done; one may unschedule itself or another; synchronous calls wait."""
    said = read_lines(
        program("""
        h, order, times, started = hd.hdInitDevice(None), [], [], time.monotonic()
        low = CALL(lambda _: order.append("low") or 0)
        high = CALL(lambda _: order.append("high") or 0)
        hd.hdScheduleAsynchronous(low, None, 1); hd.hdScheduleAsynchronous(high, None, 65535)
        tick = CALL(lambda _: times.append(time.monotonic()) or 1)
        handle = schedule(tick)
        hd.hdStartScheduler(); hd.hdStartScheduler()
        waits = []
        def three(_):
            waits.append(hd.hdGetSchedulerTimeStamp()); return int(len(waits) < 3)
        hd.hdScheduleSynchronous(CALL(three), None, 5)
        say(len(waits), order, hd.hdWaitForCompletion(handle, 0))
        time.sleep(0.3)
        hd.hdUnschedule(handle); count = len(times); time.sleep(0.05)
        say(len(times) == count, count > 20, hd.hdWaitForCompletion(handle, 1))
        hd.hdStopScheduler(); hd.hdStopScheduler()
        done = []
        hd.hdScheduleSynchronous(CALL(lambda _: done.append(1) or 0), None, 5)
        say(done, *errors())
        """)
    )
    assert said == ["3 ['high', 'low'] 1", "True True 0", "[1]"]


def test_a_callback_that_never_returns_ends_the_force(served: ServedFile, program: Any) -> None:
    """The force fades by its age; hdStopScheduler comes back, and the program ends."""
    process = program("""
        h = hd.hdInitDevice(None); hd.hdEnable(0x4000); hd.hdDisable(0x4002)
        def stuck(_):
            hd.hdBeginFrame(h); force(0, 0.5, 0); hd.hdEndFrame(h)
            while True: time.sleep(1)
        schedule(CALL(stuck)); hd.hdStartScheduler()
        sys.stdin.readline()
        hd.hdStopScheduler(); say(*errors()); os._exit(0)
    """)
    served.await_force((0.0, 0.0, 0.5), 20.0)
    client = served.loop._client
    while client["age"][0] < 0.07:
        served.receive()
    assert process.communicate("\n", timeout=30)[0] == "0x304\n"


def test_a_callback_that_throws_ends_the_program_and_its_force(
    served: ServedFile, libraries: Path, tmp_path: Path
) -> None:
    """A C++ exception finds no handler in the scheduler's thread: the program aborts, and the server sees its end."""
    if shutil.which("c++") is None:
        pytest.skip("c++ is not installed (Debian: apt-get install g++)")
    source, binary = tmp_path / "throws.cpp", tmp_path / "throws"
    source.write_text(
        "#include <HD/hd.h>\n#include <stdexcept>\n#include <unistd.h>\n"
        "static HDCallbackCode call(void *count) {\n"
        "  HHD h = hdGetCurrentDevice(); double f[3] = {0, 0.5, 0};\n"
        "  hdBeginFrame(h); hdSetDoublev(HD_CURRENT_FORCE, f); hdEndFrame(h);\n"
        '  if (++*(int *)count > 200) throw std::runtime_error("lost");\n  return HD_CALLBACK_CONTINUE;\n}\n'
        "int main() { int count = 0; hdInitDevice(HD_DEFAULT_DEVICE); hdEnable(HD_FORCE_OUTPUT);\n"
        "  hdScheduleAsynchronous(call, &count, HD_DEFAULT_SCHEDULER_PRIORITY); hdStartScheduler();\n"
        "  for (;;) pause(); }\n"
    )
    build = ["c++", source, "-o", binary, f"-I{libraries.parent / 'include'}", f"-L{libraries}", "-lHD"]
    subprocess.run(build, check=True)
    run = {**os.environ, **served.run, "LD_LIBRARY_PATH": str(libraries)}
    with subprocess.Popen([binary], env=run, stderr=subprocess.PIPE) as process:
        served.await_force((0.0, 0.0, 0.5), 10.0)
        assert process.wait(30) == -6
        assert process.stderr is not None
        assert b"lost" in process.stderr.read()
    client = served.loop._client
    served.await_force((0.0, 0.0, 0.5))
    assert client["lost"][0] > 0.0
