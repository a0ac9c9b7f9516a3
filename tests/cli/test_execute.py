"""`haptorb exec` and `haptorb libraries`: unmodified programs on a simulated device, and unsupported ones."""

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

from haptorb.devices.loader import load
from haptorb.errors import DriverError, InputError
from haptorb.recording.recording import Recording
from haptorb.runtime.hand_file import read_hand
from haptorb.serve.native_libraries import find_libraries
from haptorb.serve.native_program_check import check_program
from haptorb.testing import haptic_device, scripted_hand
from oracles.command import run_command
from oracles.fork_server import HAPTORB, get_fork_server


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
    return get_fork_server().run_program("-c", HAPTORB, "exec", "--headless", *words, timeout=120)


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


GRASP = """
import json, time
from ctypes import c_double
from forcedimension_core import dhd
import forcedimension_core.dhd.expert as expert

assert dhd.open() == 0
expert.setTimeGuard(0)
kind, gap, worst, count = int(dhd.getSystemType()), c_double(), 0, 0
R, p, f, t, squeezed = [[0.0] * 3 for _ in range(3)], [0.0] * 3, [0.0] * 3, [0.0] * 3, c_double()
begin = time.monotonic()
while time.monotonic() - begin < 2.5:
    worst = max(worst, abs(dhd.getPosition(p)), abs(dhd.getGripperGap(gap)), abs(dhd.getOrientationFrame(R)))
    squeeze = max(1000.0 * (0.010 - gap.value), 0.0)  # something soft, 10 mm wide, between the fingers
    worst = max(worst, abs(dhd.setForceAndTorqueAndGripperForce([0.0, 0.0, 1.0], [0.0, 0.0, 0.05], squeeze)))
    count += 1
    time.sleep(0.0005)
dhd.getForceAndTorqueAndGripperForce(f, t, squeezed)
print(json.dumps([kind, worst, count, gap.value, f, t, squeezed.value, R[0][1], dhd.close()]))
"""


@pytest.mark.realtime
@pytest.mark.slow
def test_a_program_with_torque_and_gripper(tmp_path: Path) -> None:
    """forcedimension-core as it is published, on the arm after a sigma.7: fingers close on something soft, the end
    effector turns. The hand begins with the program, and its goals are those of its file from there on."""
    if find_spec("forcedimension_core") is None:
        pytest.skip("forcedimension_core is not installed")
    program, script, recording = (tmp_path / name for name in ("grasp.py", "grasp.hand", "run.mcap"))
    program.write_text(GRASP)
    script.write_text("start 0 0 0 mm\ngrip 20 mm\nmove 10 0 0 mm in 0.5 s\nwait 200 ms\ngrip 2 mm in 0.5 s\n")
    done = execute(
        "--device", "arm-sigma", "--hand", str(script), "--record", str(recording), "--", sys.executable, "-W",
        "ignore", str(program),
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "a program sees a box of 130 × 190 × 190 mm" in done.stderr
    kind, worst, count, gap, force, torque, squeezed, turned, closed = json.loads(done.stdout.splitlines()[-1])
    assert (kind, worst, closed) == (104, 0, 0)
    assert count > 100
    # Two springs, of the fingers (300 N/m at 2 mm) and of what they hold (1000 N/m, 10 mm wide), within dry friction.
    assert gap == pytest.approx((10.0 + 0.6) / 1300.0, abs=2e-4)
    assert squeezed == pytest.approx(1000.0 * (0.010 - gap), abs=0.1)
    assert force == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)
    assert torque == pytest.approx([0.0, 0.0, 0.05], abs=1e-6)
    assert turned < -0.2, "about z, by 50 mN·m against 0.15 N·m/rad"
    rows = Recording(recording)
    assert rows.metadata["run"]["hand_start"] == "program"
    t, target = np.asarray(rows["hand_t"]), np.asarray(rows["hand_goal"])
    before = np.isnan(t)
    assert before[0], "the hand waits for the program"
    assert not target[before].any()
    assert t[~before][0] == 0.0
    motion = read_hand(script, load("arm-sigma"))
    assert np.array_equal(target[~before], [motion.at(one)[0] for one in t[~before]]), "bit for bit"
    forces, openings = np.asarray(rows["gripper_force"]), np.asarray(rows["gripper"])
    assert (forces[-50:] == 0.0).all(), "the force ends with the program"
    assert openings[np.nanargmax(forces)] < 0.0095


MOTOR = """
import json, sys, time
from forcedimension_core import dhd
import forcedimension_core.dhd.expert as expert

assert dhd.open() == 0
expert.setTimeGuard(0)
p, f, t, answers = [0.0] * 3, [0.0] * 3, [0.0] * 3, set()
print("open", flush=True)
begin = time.monotonic()
found = {}
while (now := time.monotonic() - begin) < 3.0:
    dhd.getPosition(p)
    answers.add(dhd.setForceAndTorque([2.0, 3.0, 4.0], [0.4, 0.3, 0.2]))
    dhd.getForceAndTorque(f, t)
    found["translate" if now < 1.4 else "rotate"] = [*f, *t]
    time.sleep(0.001)
print(json.dumps([found, sorted(answers), p, dhd.close()]))
"""


@pytest.mark.realtime
@pytest.mark.slow
def test_a_program_on_a_motor(libraries: Path, tmp_path: Path) -> None:
    """forcedimension-core as published: forces on the object in mode translate, torques in mode rotate, which come
    back as torques of the rotor (Bai 2012, eqs. 5b and 6b)."""
    if find_spec("forcedimension_core") is None:
        pytest.skip("forcedimension_core is not installed")
    sdk = tmp_path / "sdk/lib/release"
    sdk.mkdir(parents=True)
    (sdk / f"lin-{os.uname().machine}-gcc").symlink_to(libraries)
    with haptic_device("pmsm", hand=scripted_hand("start turn 0 0 0 °"), real_time=True, serve=["native"]) as run:
        address = next(line for line in run._serving.lines if line.startswith("native: ")).removeprefix("native: ")
        environment = {
            **os.environ, "FDSDK": str(tmp_path / "sdk"), "LD_LIBRARY_PATH": str(libraries), "HAPTORB_RUN": address,
        }  # fmt: skip
        with subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", MOTOR], env=environment, stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "open\n"
            run.play(1.4)
            run.servo.set_mode("rotate")
            out = process.communicate(timeout=60)[0]
    found, answers, p, closed = json.loads(out.splitlines()[-1])
    assert (answers, closed) == ([0], 0)
    assert found["translate"] == pytest.approx([2.0, 3.0, 4.0, 0.0, 0.0, 0.0], abs=1e-3)
    assert found["rotate"] == pytest.approx([0.0, 0.0, 0.0, 0.4, 0.3, 0.2], abs=1e-3)
    assert np.abs(p).max() < 0.2
    rows = run.recording
    mode, share, asked = (np.asarray(rows[name]) for name in ("mode", "clutch_share", "wrench_commanded"))
    q = np.asarray(rows["q"])
    upright = np.abs(q[:, :2]).max(axis=1) < 0.15
    pushed = (mode == 1) & (share[:, 0] == 1.0) & (np.abs(rows["object_wrench"][:, 2] - 4.0) < 1e-6) & upright
    turned = (mode == 2) & (share[:, 1] == 1.0) & (np.abs(rows["object_wrench"][:, 5] - 0.2) < 1e-6) & upright
    assert pushed.sum() > 100
    assert turned.sum() > 100
    # The program's (x, y, z) = (−y, x, z) of the object: F = (3, −2, 4) N, T = (0.3, −0.4, 0.2) N·m.
    assert np.median(asked[pushed, 3:], axis=0) == pytest.approx([-0.004 * 2.0, 0.024 * 3.0, 0.01 * 4.0], abs=0.01)
    assert np.median(asked[turned, 3:], axis=0) == pytest.approx([0.075, -0.1, 0.05], abs=0.02)


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


def test_a_wheel_without_libraries_says_how_to_build_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the pure wheel is installed: neither shipped libraries nor the clone's sources."""
    for name in ("_SHIPPED", "_SOURCES"):
        monkeypatch.setattr(f"haptorb.serve.native_libraries.{name}", tmp_path / "nowhere")
    for words in (("libraries", str(tmp_path / "kit")), ("exec", "--headless", "--", "sh", "-c", "true")):
        code, _, error = run_command(capsys, *words)
        assert code != 0
        assert "make -C native" in error
        assert "Traceback" not in error


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
    other = tmp_path / "project"
    (other / "include").mkdir(parents=True)
    (other / "include/dhdc.h").write_text("mine")
    assert run_command(capsys, "libraries", str(other))[0] == 2
    assert [path.name for path in other.rglob("*") if path.is_file()] == ["dhdc.h"]
    assert (other / "include/dhdc.h").read_text() == "mine"
    assert run_command(capsys, "libraries", str(folder), "--force")[0] == 0
