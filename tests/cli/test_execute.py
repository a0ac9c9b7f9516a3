"""`haptorb exec` and `haptorb libraries`: unmodified programs on a simulated device, and what cannot run."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import textwrap
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from haptorb.errors import DriverError, InputError
from haptorb.recording.recording import Recording
from haptorb.serve.native_libraries import find_libraries
from haptorb.serve.program_check import check_program
from oracles.command import run_command

PROGRAM = "from haptorb.cli import main; import sys; sys.exit(main())"


@pytest.fixture(scope="module", autouse=True)
def libraries() -> Path:
    """Built before the first test, or all are skipped."""
    try:
        return find_libraries()[0]
    except DriverError as cause:
        if "not installed" in str(cause):
            pytest.skip(str(cause))
        raise


def execute(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", PROGRAM, "exec", "--headless", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.realtime
def test_openhaptics_program(tmp_path: Path) -> None:
    """pyOpenHaptics as it is published: a callback at 1 kHz, a floor below the tool, buttons; and the exit status."""
    if find_spec("pyOpenHaptics") is None:
        pytest.skip("pyOpenHaptics is not installed")
    program = tmp_path / "floor.py"
    program.write_text(
        textwrap.dedent("""
        import json, sys, time
        from pyOpenHaptics.hd_device import HapticDevice
        from pyOpenHaptics.hd_callback import hd_callback
        import pyOpenHaptics.hd as hd

        places, pushes, buttons, floor = [], [], [], []

        @hd_callback
        def callback():
            place = hd.get_transform()[3][:3]
            places.append(place[1])
            floor[:] = floor or [place[1] + 2.0]
            push = max(0.03 * (floor[0] - place[1]), 0.0)
            hd.set_force([0, push, 0])
            pushes.append(push)
            buttons.append(hd.get_buttons())

        device = HapticDevice(callback=callback, device_name="Default Device", scheduler_type="async")
        time.sleep(1.0)
        name, vendor = hd.get_model(), hd.get_vendor()
        device.close()
        time.sleep(0.3)  # the force fades meanwhile
        half = len(places) // 2
        push, raised = sum(pushes[half:]) / (len(pushes) - half), sum(places[half:]) / (len(places) - half) - places[0]
        print(json.dumps([name, vendor, len(places), max(buttons), push, raised]))
        sys.exit(7)
        """)
    )
    recording = tmp_path / "floor.mcap"
    done = execute("--record", str(recording), "--", sys.executable, "-W", "ignore", str(program))
    assert done.returncode == 7, done.stdout + done.stderr
    name, vendor, count, buttons, push, raised = json.loads(done.stdout.splitlines()[-1])
    assert (name, vendor, buttons) == ("haptorb omni", "haptorb", 0)
    assert count > 50  # 1000 where a processor is free
    assert 0.0 < push <= 0.06
    assert raised > 0.0, "the floor raises a tool that is held loosely"
    assert np.ptp(Recording(recording)["hand_goal"], axis=0).max() == 0.0, "the hand is still before the program comes"
    asked = np.asarray(Recording(recording)["wrench_commanded"])
    assert 0.0 < asked[:, 2].max() < 0.1
    assert abs(asked[-50:]).max() == 0.0, "the force ends with the program"


@pytest.mark.realtime
@pytest.mark.slow
def test_a_killed_program() -> None:
    assert execute("--", "sh", "-c", "kill -9 $$").returncode == 137


@pytest.mark.parametrize(
    ("head", "why"),
    [
        (b"\x7fELF\x01\x01\x01" + bytes(80), "32-bit program"),
        (b"\x7fELF\x02\x01\x01" + bytes(11) + b"\xf3\x00" + bytes(60), "another processor"),
    ],
)
def test_programs_that_cannot_load_the_libraries(tmp_path: Path, head: bytes, why: str) -> None:
    path = tmp_path / "program"
    path.write_bytes(head)
    path.chmod(0o755)
    script = tmp_path / "script"
    script.write_text(f"#!{path} -x\n")
    script.chmod(0o755)
    for one in (path, script):
        with pytest.raises(InputError, match=why):
            check_program(str(one))


def test_a_program_of_musl(tmp_path: Path) -> None:
    """By the dynamic linker that it asks for."""
    path = tmp_path / "program"
    loader = b"/lib/ld-musl-x86_64.so.1\0"
    machine = {"x86_64": 62, "aarch64": 183}[os.uname().machine]
    header = b"\x7fELF\x02\x01\x01" + bytes(9) + struct.pack("<HHIQQQIHHH", 3, machine, 1, 0, 64, 0, 0, 64, 56, 1)
    entry = struct.pack("<IIQQQQQQ", 3, 4, 120, 0, 0, len(loader), len(loader), 1)
    path.write_bytes((header.ljust(64, b"\0") + entry).ljust(120, b"\0") + loader)
    path.chmod(0o755)
    with pytest.raises(InputError, match="linked with musl"):
        check_program(str(path))


def test_a_program_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, error = run_command(capsys, "exec", "--", "no-such-program")
    assert code == 2
    assert "'no-such-program' was not found" in error
    check_program("sh")
    check_program(sys.executable)


def test_libraries_into_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As a kit: every name that programs look for leads to the one library."""
    folder = tmp_path / "kit"
    assert run_command(capsys, "libraries", str(folder))[0] == 0
    lib = folder / "lib"
    names = ("libdrd.so", "libdhd.so", "libdhd.so.3", f"release/lin-{os.uname().machine}-gcc/libdrd.so.3")
    for name in names:
        assert (lib / name).resolve() == lib / "libdrd.so.3"
    assert (lib / "libHD.so").resolve() == lib / "libHD.so.3.4"
    assert (folder / "include/HD/hd.h").exists()
    code, _, error = run_command(capsys, "libraries", str(folder))
    assert code == 2
    assert "is there already" in error
    assert run_command(capsys, "libraries", str(folder), "--force")[0] == 0
