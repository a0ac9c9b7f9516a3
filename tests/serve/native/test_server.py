"""Rows read and commands written by a program, through the real library."""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Iterator
from pathlib import Path
from time import monotonic, monotonic_ns, sleep
from typing import Any

import numpy as np
import pytest

from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.loader import catalogue, load
from haptorb.errors import InputError
from haptorb.rotations import rotation_from_euler
from haptorb.runtime.shared_memory import Word
from haptorb.serve.native import FACTS, Placement, describe_hardware, prepare
from haptorb.worlds.client_force import FADE_TIME_S, HOLD_TIME_S
from oracles.other_account import as_nobody, needs_root
from serve.native.conftest import ServedFile

ANY = ctypes.c_char(b"\xff")


def numbers(function: Any, count: int) -> list[float]:
    values = [ctypes.c_double() for _ in range(count)]
    assert function(*(ctypes.byref(one) for one in values), ANY) >= 0
    return [one.value for one in values]


def set_force(dhd: Any, *force: float) -> int:
    return int(dhd.dhdSetForce(*(ctypes.c_double(one) for one in force), ANY))


def await_position(dhd: Any, wanted: tuple[float, ...]) -> None:
    end = monotonic() + 2.0
    while numbers(dhd.dhdGetPosition, 3) != pytest.approx(wanted, abs=1e-12):
        assert monotonic() < end, numbers(dhd.dhdGetPosition, 3)
        sleep(0.001)


def run_program(served: ServedFile, libraries: Path, source: str, **options: Any) -> subprocess.Popen[str]:
    """A program of its own that has `dhd`, open; its text is Python."""
    text = (
        "import ctypes, os, sys, time, signal\n"
        f"dhd = ctypes.CDLL({str(libraries / 'libdrd.so.3')!r})\n"
        "dhd.dhdErrorGetLastStr.restype = ctypes.c_char_p\n"
        "ANY, D = ctypes.c_char(b'\\xff'), ctypes.c_double\n"
        "def force(x, y, z): return dhd.dhdSetForce(D(x), D(y), D(z), ANY)\n"
        "def say(*words): print(*words, flush=True)\n"
    )
    return subprocess.Popen(
        [sys.executable, "-c", text + textwrap.dedent(source)], env={**os.environ, **served.run}, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, **options,
    )  # fmt: skip


def test_pose_in_the_programs_frame(served: ServedFile, dhd: Any) -> None:
    """x towards the user, y to the right, z up; the origin is the tool's place of rest."""
    rest = served.loop.device.shell.contact_distance  # type: ignore[union-attr]
    served.publish(p=(0.003, -0.007, rest + 0.002), v=(0.1, 0.2, 0.3), w=(1.0, 2.0, 3.0))
    await_position(dhd, (0.007, 0.003, 0.002))
    assert numbers(dhd.dhdGetLinearVelocity, 3) == pytest.approx([-0.2, 0.1, 0.3])
    assert numbers(dhd.dhdGetAngularVelocityRad, 3) == pytest.approx([-2.0, 1.0, 3.0])


def test_orientation_turns_what_it_says(served: ServedFile, dhd: Any) -> None:
    """A turn about the user's right is one about +y here, +x in the stator's frame."""
    served.publish(q=(np.sin(0.2), 0.0, 0.0, np.cos(0.2)), p=(0.001, 0.0, 0.05))
    await_position(dhd, (0.0, 0.001, 0.05 - served.loop.device.shell.contact_distance))  # type: ignore[union-attr]
    matrix = (ctypes.c_double * 9)()
    assert dhd.dhdGetOrientationFrame(matrix, ANY) == 0
    assert np.reshape(matrix, (3, 3)) == pytest.approx(rotation_from_euler(0.0, 0.4, 0.0))
    assert numbers(dhd.dhdGetOrientationRad, 3) == pytest.approx([0.0, 0.4, 0.0])
    assert numbers(dhd.dhdGetOrientationDeg, 3) == pytest.approx([0.0, np.degrees(0.4), 0.0])


def test_force_reaches_the_loop_in_the_stators_frame(served: ServedFile, dhd: Any) -> None:
    assert set_force(dhd, 0.1, 0.2, 0.3) == 0
    assert served.await_force((0.2, -0.1, 0.3)) > 0.0


def test_placement_is_a_rotation() -> None:
    """Turned there and back nothing has changed; lengths stay."""
    vector = (1.0, 2.0, 3.0)
    assert Placement.turn_back(Placement.turn(vector)) == vector
    axes = np.array([Placement.turn(one) for one in np.eye(3)])
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes @ axes.T == pytest.approx(np.eye(3))


def test_no_number_is_no_force(served: ServedFile, dhd: Any) -> None:
    """And what was commanded before it has ended."""
    for bad in (np.nan, np.inf, -np.inf):
        assert set_force(dhd, 0.0, 0.0, 0.5) == 0
        served.await_force((0.0, 0.0, 0.5))
        assert set_force(dhd, 0.0, bad, 0.5) == -1
        served.await_force((0.0, 0.0, 0.0))
    assert b"finite" in dhd.dhdErrorGetLastStr()


@pytest.mark.parametrize("huge", [2.0, 1e6, 1e300, 1.7e308])
def test_huge_forces_keep_their_direction(served: ServedFile, dhd: Any, huge: float) -> None:
    assert set_force(dhd, 0.6 * huge, 0.0, -0.8 * huge) == 2
    most = served.loop.device.limits.force
    served.await_force((0.0, -0.6 * most, -0.8 * most))


def test_a_file_with_nonsense_commands_nothing(served: ServedFile, dhd: Any) -> None:
    """Whatever a broken library writes: the server believes no number that is none."""
    set_force(dhd, 0.0, 0.0, 0.5)
    served.await_force((0.0, 0.0, 0.5))
    with served.path.open("r+b") as file:
        file.seek(2 * 4096 + 40)
        file.write(np.array([np.nan, 1e300, np.inf]).tobytes())
        file.seek(2 * 4096 + 8)
        file.write(np.int64(1 << 40).tobytes())
    sleep(0.02)
    force, _ = served.receive()
    assert np.isfinite(force).all()
    assert np.abs(force).max() <= 0.5


def test_a_command_under_another_claim_is_none(served: ServedFile, dhd: Any) -> None:
    """A process that was overtaken, in the middle of its last command, commands nothing any more."""
    set_force(dhd, 0.0, 0.0, 0.5)
    served.await_force((0.0, 0.0, 0.5))
    command = np.memmap(served.path, np.int64, "r+", 2 * 4096, (11,))
    command[2] += 1
    command.view(np.float64)[5:8] = 0.1, 0.0, 0.0
    command[1] += 2
    sleep(0.02)
    assert served.receive()[0] == [0.0, 0.0, 0.5]


def test_close_frees_the_device_at_once(served: ServedFile, dhd: Any, libraries: Path) -> None:
    set_force(dhd, 0.0, 0.0, 0.5)
    first = served.await_force((0.0, 0.0, 0.5))
    second = run_program(
        served, libraries, "dhd.dhdOpen(); sys.stdin.readline(); say(force(0, 0, 0.25)); time.sleep(5)"
    )
    with second:
        try:
            assert dhd.dhdClose(ANY) == 0
            client = served.loop._client
            served.receive()
            end = monotonic() + 1.0
            while client["lost"][0] <= 0.0:
                assert monotonic() < end
                served.receive()
            assert second.stdin is not None
            assert second.stdout is not None
            second.stdin.write("\n")
            second.stdin.flush()
            assert second.stdout.readline().strip() == "0"
            assert served.await_force((0.0, 0.0, 0.25)) != first
        finally:
            second.kill()


def test_one_program_commands_and_others_read(served: ServedFile, dhd: Any, libraries: Path) -> None:
    set_force(dhd, 0.0, 0.0, 0.5)
    session = served.await_force((0.0, 0.0, 0.5))
    source = """
        say(dhd.dhdOpen(), dhd.dhdGetPosition(ctypes.byref(D()), ctypes.byref(D()), ctypes.byref(D()), ANY))
        say(force(0, 0, 0), force(0, 0, 0.1), dhd.dhdErrorGetLastStr().decode())
        say(dhd.dhdGetAvailableCount(), dhd.dhdGetDeviceCount())
    """
    said = run_program(served, libraries, source).communicate(timeout=30)[0].splitlines()
    assert said[0] == "0 0"
    assert said[1].startswith("0 -1 device in use")
    assert str(os.getpid()) in said[1]
    assert said[2] == "0 1"
    assert served.receive() == ([0.0, 0.0, 0.5], session)


@pytest.mark.realtime(retry=False)
def test_killed_programs_forces_end_at_once(served: ServedFile, libraries: Path) -> None:
    """By their end, not by their silence: within some looks of the server, and the next may command."""
    source = "dhd.dhdOpen()\nwhile True:\n    force(0, 0, 0.5); time.sleep(0.001)"
    sessions = set()
    for delay in (0.0, 0.0003, 0.0011, 0.0127, 0.0234):
        with run_program(served, libraries, source, stderr=subprocess.PIPE) as program:
            client = served.loop._client
            end = monotonic() + 10.0
            while client["session"][0] in (0.0, *sessions):
                served.receive()
                assert monotonic() < end
            session = float(client["session"][0])
            sleep(delay)
            program.kill()
            killed = monotonic()
            while client["lost"][0] <= 0.0:
                served.receive()
                assert monotonic() - killed < 0.5
        assert client["session"][0] == session
        sessions.add(session)
    assert not any(served.path.read_bytes()[2 * 4096 : 2 * 4096 + 8]), "the claim of a dead program stays"


def test_a_claim_of_no_process_is_none(served: ServedFile, dhd: Any) -> None:
    """A number that was left, or invented: of a process that has ended, and of one that started at another time."""
    gone = subprocess.Popen(["true"])
    gone.wait()
    for claim in ((5 << 24) | (1 << 22) | gone.pid, (5 << 24) | (1 << 22) | os.getpid()):
        with served.path.open("r+b") as file:
            file.seek(2 * 4096)
            file.write(np.int64(claim).tobytes())
        end = monotonic() + 1.0
        while any(served.path.read_bytes()[2 * 4096 : 2 * 4096 + 8]):
            assert monotonic() < end
            sleep(0.001)
    assert set_force(dhd, 0.0, 0.0, 0.5) == 0
    served.await_force((0.0, 0.0, 0.5))


def test_a_fork_does_not_command(served: ServedFile, dhd: Any, libraries: Path) -> None:
    source = """
        dhd.dhdOpen()
        say(force(0, 0, 0.5))
        if os.fork() == 0:
            say(force(0, 0, 0.25), dhd.dhdErrorGetLastStr().decode())
            say(dhd.dhdOpen(), force(0, 0, 0.25), dhd.dhdErrorGetLastStr().decode())
            os._exit(0)
        os.wait()
        say(force(0, 0, 0.5))
    """
    said = run_program(served, libraries, source).communicate(timeout=30)[0].splitlines()
    assert said[0] == "0"
    assert said[1].startswith("-1 device not ready: the device was opened before a fork")
    assert said[2].startswith("0 -1 device in use")
    assert said[3] == "0"


def test_calls_before_open_after_close_and_of_numbers_that_are_none(libraries: Path, tmp_path: Path) -> None:
    """Each says so; none crashes."""
    with ServedFile() as served:
        source = """
            say(force(0, 0, 1), dhd.dhdErrorGetLastStr().decode())
            say(dhd.dhdOpenID(7), dhd.dhdErrorGetLastStr().decode())
            say(dhd.dhdOpenID(0), dhd.dhdGetPosition(None, None, None, ANY), dhd.dhdErrorGetLastStr().decode())
            say(dhd.dhdSetForce(D(), D(), D(), ctypes.c_char(b'\\x63')), dhd.dhdErrorGetLastStr().decode())
            say(dhd.dhdClose(ANY), dhd.dhdClose(ANY), force(0, 0, 1))
        """
        program = run_program(served, libraries, source, stderr=subprocess.PIPE)
        said = program.communicate(timeout=30)[0].splitlines()
    assert said[0].startswith("-1 device not ready")
    assert said[1] == "-1 no device found: there is no device 7; there are 1"
    assert said[2].startswith("0 -1 null argument")
    assert said[3].startswith("-1 invalid index")
    assert said[4] == "0 -1 -1"
    assert program.returncode == 0


@pytest.mark.realtime(retry=False)
def test_without_a_device(libraries: Path, tmp_path: Path) -> None:
    """At once, with one line that says how to start one; a file that was left is no device."""
    with ServedFile() as served:
        left = tmp_path / "left.device"
        left.write_bytes(served.path.read_bytes())
        left.chmod(0o600)
    for path, why in ((tmp_path / "none.device", "No such file"), (left, "was left by a run that has ended")):
        served.run = {"HAPTORB_RUN": str(path)}
        program = run_program(
            served, libraries, "t = time.monotonic(); say(dhd.dhdOpen(), dhd.dhdGetDeviceCount()); dhd.dhdOpen(); "
            "say(dhd.dhdErrorGetLastStr().decode()); say(time.monotonic() - t < 0.2)", stderr=subprocess.PIPE,
        )  # fmt: skip
        out, errors = program.communicate(timeout=30)
        said = out.splitlines()
        assert said[0] == "-1 0"
        assert said[1].startswith("no device found")
        assert why in said[1]
        assert said[2] == "True"
        assert errors.count("\n") == 1
        assert "haptorb run omni --serve native" in errors


def test_the_end_of_the_run_is_told(served: ServedFile, dhd: Any) -> None:
    served.loop.served.ending = True
    end = monotonic() + 2.0
    while dhd.dhdGetPosition(*(ctypes.byref(ctypes.c_double()) for _ in range(3)), ANY) == 0:
        assert monotonic() < end
        sleep(0.01)
    assert b"the servo has ended" in dhd.dhdErrorGetLastStr()
    assert not served.path.exists()


@pytest.mark.parametrize("where", ["0", "-1", "nan", "x", "1e9"])
def test_a_scale_that_is_none(where: str) -> None:
    with pytest.raises(InputError, match="metres for a program"):
        prepare(where)


@pytest.mark.realtime(retry=False)
def test_a_stopped_programs_force_fades(served: ServedFile, libraries: Path) -> None:
    """By the time of its last command, which no message could tell."""
    program = run_program(served, libraries, "dhd.dhdOpen()\nwhile True:\n    force(0, 0, 0.5); time.sleep(0.001)")
    with program:
        served.await_force((0.0, 0.0, 0.5), 10.0)
        program.send_signal(signal.SIGSTOP)
        stopped = monotonic()
        client = served.loop._client
        while client["age"][0] < HOLD_TIME_S + FADE_TIME_S:
            served.receive()
            assert monotonic() - stopped < 1.0
        assert monotonic() - stopped < 0.5
        assert client["lost"][0] == 0.0
        program.kill()


def test_threads_of_one_program(served: ServedFile, dhd: Any) -> None:
    """Many at once, beside one that opens and closes: no call crashes, and no half of a force is felt."""
    wrong, over = list[int](), threading.Event()

    def command(size: float) -> None:
        while not over.is_set():
            if set_force(dhd, size, size, size) not in (0, -1):
                wrong.append(1)
            numbers_or_none(dhd)

    threads = [threading.Thread(target=command, args=(0.1 * (i + 1),)) for i in range(4)]
    for one in threads:
        one.start()
    seen = set()
    end = monotonic() + 0.5
    while monotonic() < end:
        dhd.dhdClose(ANY)
        dhd.dhdOpen()
        force, _ = served.receive()
        seen.add(tuple(np.round(force, 12)))
    over.set()
    for one in threads:
        one.join()
    assert not wrong
    assert all(x == -y == z for x, y, z in seen), seen
    assert len(seen) > 1


def numbers_or_none(dhd: Any) -> None:
    dhd.dhdGetPosition(*(ctypes.byref(ctypes.c_double()) for _ in range(3)), ANY)


def test_forces_of_a_program_that_has_switched_them_off(served: ServedFile, dhd: Any) -> None:
    set_force(dhd, 0.0, 0.0, 0.5)
    served.await_force((0.0, 0.0, 0.5))
    status = (ctypes.c_int * 17)()
    assert dhd.dhdGetStatus(status, ANY) == 0
    assert (status[5], status[14]) == (1, 0)
    assert dhd.dhdEnableForce(ctypes.c_ubyte(0), ANY) == 0
    assert set_force(dhd, 0.0, 0.0, 0.5) == -1
    assert b"switched its forces off" in dhd.dhdErrorGetLastStr()
    client = served.loop._client
    end = monotonic() + 1.0
    while client["lost"][0] <= 0.0:
        served.receive()
        assert monotonic() < end
    assert dhd.dhdEnableForce(ctypes.c_ubyte(1), ANY) == 0
    assert set_force(dhd, 0.0, 0.0, 0.25) == 0
    served.await_force((0.0, 0.0, 0.25))


@pytest.mark.parametrize(
    ("trip", "cause"), [(Trip.STOPPED, 1), (Trip.POSE_LOST, 6), (Trip.HOST_SILENT, 3), (Trip.OVERHEATED, 4)]
)
def test_a_trip_is_a_cause_of_forces_off(served: ServedFile, dhd: Any, trip: Trip, cause: int) -> None:
    served.publish(guard=GuardState.TRIPPED, trip=trip)
    status = (ctypes.c_int * 17)()
    end = monotonic() + 1.0
    while dhd.dhdGetStatus(status, ANY) != 0 or status[14] != cause:
        assert monotonic() < end, list(status)
    assert (status[5], status[9]) == (0, 1)


def test_the_time_guard_repeats_a_pose(served: ServedFile, dhd: Any) -> None:
    """Sooner than the program allows, the last pose comes again, with 1; 0 switches that off."""
    values = [ctypes.c_double() for _ in range(3)]
    assert dhd.dhdSetTimeGuard(100_000, ANY) == 0
    sleep(0.11)
    answers = [dhd.dhdGetPosition(*map(ctypes.byref, values), ANY) for _ in range(3)]
    assert answers == [0, 1, 1]
    assert dhd.dhdSetTimeGuard(-2, ANY) == -1
    assert dhd.dhdSetTimeGuard(0, ANY) == 0
    assert dhd.dhdGetPosition(*map(ctypes.byref, values), ANY) == 0


def test_what_has_no_meaning_says_why(served: ServedFile, dhd: Any) -> None:
    """Expert functions want the expert mode first, as in the maker's library."""
    encoders = (ctypes.c_int * 8)()
    assert dhd.dhdGetEnc(encoders, ctypes.c_ubyte(0xFF), ANY) == -1
    assert dhd.dhdErrorGetLastStr() == b"expert mode is disabled: call dhdEnableExpertMode first"
    assert dhd.dhdEnableExpertMode() == 0
    assert dhd.dhdGetEnc(encoders, ctypes.c_ubyte(0xFF), ANY) == -1
    assert dhd.dhdErrorGetLast() == 6
    assert dhd.dhdErrorGetLastStr() == b"not available: the device has no such motors or encoders"
    assert dhd.dhdDisableExpertMode() == 0
    assert dhd.dhdGetGripperGap(ctypes.byref(ctypes.c_double()), ANY) == -1
    assert dhd.dhdErrorGetLastStr() == b"not available: the device has no gripper"
    assert dhd.dhdSetWatchdog(ctypes.c_ubyte(0), ANY) == -1
    assert b"50 ms" in dhd.dhdErrorGetLastStr()


def test_buttons(served: ServedFile, dhd: Any) -> None:
    served.loop.shared.words[Word.BUTTONS] = 0b101
    end = monotonic() + 1.0
    while dhd.dhdGetButtonMask(ANY) != 0b101:
        assert monotonic() < end
    assert [dhd.dhdGetButton(i, ANY) for i in range(3)] == [1, 0, 1]
    assert dhd.dhdGetButton(32, ANY) == -1


def test_regulation_is_a_spring_on_the_way(served: ServedFile, dhd: Any) -> None:
    """It holds the place where it begins; a move shifts the place at which the spring is fixed, no faster than said."""
    facts = np.fromfile(served.path, np.float64, 64)
    stiffness = 0.5 * facts[FACTS["stiffness_max"][0] // 8]
    assert 10.0 < stiffness < 1000.0
    at = numbers(dhd.dhdGetPosition, 3)
    x, y, z = (ctypes.c_double(one) for one in (at[0], at[1], at[2] + 0.001))
    block = ctypes.c_ubyte(1)
    assert dhd.drdMoveToPos(x, y, z, block, ANY) == -1
    assert b"no regulation" in dhd.dhdErrorGetLastStr()
    assert dhd.drdAutoInit(ANY) == 0
    assert dhd.drdStop(ctypes.c_ubyte(1), ANY) == 0, "as the maker's own examples do after drdAutoInit"
    assert dhd.drdStart(ANY) == 0
    assert dhd.drdMoveToPos(ctypes.c_double(1.0), y, z, block, ANY) == -1
    assert b"outside of the device's workspace" in dhd.dhdErrorGetLastStr()
    assert dhd.drdMoveToRot(x, y, z, block, ANY) == -1
    begin = monotonic()
    assert dhd.drdMoveToPos(x, y, z, block, ANY) == 0
    assert monotonic() - begin > 0.1, "1 mm with the least jerk takes 0.14 s"
    served.await_force((0.0, 0.0, 0.001 * stiffness))
    assert set_force(dhd, 0.0, 0.0, 0.1) == -1
    assert dhd.drdHold(ANY) == 0
    served.await_force((0.0, 0.0, 0.0))
    assert dhd.drdStop(ctypes.c_ubyte(0), ANY) == 0
    assert dhd.drdIsRunning(ANY) % 256 == 0
    assert set_force(dhd, 0.0, 0.0, 0.1) == 0


def drd_set(dhd: Any, *force: float) -> int:
    zero = ctypes.c_double(0.0)
    values = [*(ctypes.c_double(one) for one in force), zero, zero, zero, zero]
    return int(dhd.drdSetForceAndTorqueAndGripperForce(*values, ANY))


def test_a_force_beside_a_regulation_lasts_as_long_as_any_other(served: ServedFile, dhd: Any) -> None:
    """The library's own thread goes on when the program hangs: what it commanded must not."""
    assert dhd.drdStart(ANY) == 0
    assert drd_set(dhd, 0.0, 0.0, 0.2) == 0
    served.await_force((0.0, 0.0, 0.2))
    begin = monotonic()
    served.await_force((0.0, 0.0, 0.0), patience=HOLD_TIME_S + 0.2)
    assert monotonic() - begin < HOLD_TIME_S + 0.2
    for _ in range(20):
        assert drd_set(dhd, 0.0, 0.0, 0.2) == 0
        sleep(0.01)
    served.await_force((0.0, 0.0, 0.2))


@pytest.mark.parametrize("fields", [{"guard": GuardState.TRIPPED}, {"guard": GuardState.OFF}, {"valid": 0.0}])
def test_a_regulation_commands_nothing_while_the_coils_are_off(
    served: ServedFile, dhd: Any, fields: dict[str, float]
) -> None:
    """When they are on again its spring is fixed where the hand has gone meanwhile."""
    stiffness = 0.5 * np.fromfile(served.path, np.float64, 64)[FACTS["stiffness_max"][0] // 8]
    assert dhd.drdStart(ANY) == 0
    served.publish(p=(0.0, 0.0, 0.051))
    served.await_force((0.0, 0.0, -0.001 * stiffness))
    served.publish(p=(0.0, 0.0, 0.051), **fields)
    served.await_force((0.0, 0.0, 0.0))
    served.publish(p=(0.0, 0.0, 0.051), guard=GuardState.TRIPPED)
    sleep(0.02)
    served.publish(p=(0.0, 0.0, 0.051))
    sleep(0.05)
    assert served.receive()[0] == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


@needs_root
def test_a_program_of_another_account(served: ServedFile, dhd: Any, libraries: Path) -> None:
    """It finds no device, and is told why; the file is this account's alone."""
    folder = Path("/tmp") / f"haptorb-nobody-{os.getpid()}-{monotonic_ns()}"
    folder.mkdir()
    folder.chmod(0o777)
    copy, said = folder / "libdrd.so", folder / "said"
    copy.write_bytes((libraries / "libdrd.so.3").read_bytes())
    copy.chmod(0o755)

    def try_to_open() -> None:
        library = ctypes.CDLL(str(copy))
        library.dhdErrorGetLastStr.restype = ctypes.c_char_p
        answer = library.dhdOpen()
        (folder / "part").write_bytes(b"%d %s" % (answer, library.dhdErrorGetLastStr()))
        (folder / "part").rename(said)

    try:
        with as_nobody(try_to_open):
            end = monotonic() + 20.0
            while not said.exists():
                assert monotonic() < end
                sleep(0.01)
        assert said.read_text().startswith("-1 no device found")
        assert "belongs to another account" in said.read_text()
        assert served.path.stat().st_mode & 0o777 == 0o600
        assert served.path.parent.stat().st_mode & 0o777 == 0o700
    finally:
        shutil.rmtree(folder)


@pytest.mark.parametrize(
    ("device", "kind", "wrist", "active"), [("arm", 33, 0, 0), ("arm-touch", 34, 1, 0), ("arm-sigma", 104, 1, 1)]
)
def test_an_arm_is_what_its_file_says(
    libraries: Path, monkeypatch: pytest.MonkeyPatch, device: str, kind: int, wrist: int, active: int
) -> None:
    """In its own size, with the type and the limits of the same abilities."""
    with ServedFile(device, limit=100.0) as served:
        monkeypatch.setenv("HAPTORB_RUN", str(served.path))
        dhd = ctypes.CDLL(str(libraries / "libdrd.so.3"))
        names = ("dhdHasWrist", "dhdHasGripper", "dhdHasActiveWrist", "dhdHasActiveGripper")
        for name in names:
            getattr(dhd, name).restype = ctypes.c_bool
        number = dhd.dhdOpen()
        try:
            assert number >= 0
            dhd.dhdSetTimeGuard(0, ANY)
            assert dhd.dhdGetSystemType(ANY) == kind
            assert [getattr(dhd, name)(ANY) for name in names] == [wrist, active, active, active]
            served.publish(p=(0.01, 0.02, 0.03))
            await_position(dhd, (-0.02, 0.01, 0.03))
            assert set_force(dhd, 0.0, 0.0, 2.0) == 0
            served.await_force((0.0, 0.0, 2.0))
            most = served.loop.device.limits.force
            assert set_force(dhd, 0.0, 0.0, 1e3) == 2
            served.await_force((0.0, 0.0, most))
            assert set_all(dhd, (0.0, 0.0, 0.0), (0.0, 0.0, 1e3), 1e3) == 2, "less than was asked"
            torque, grip = served.await_rest((0.0, 0.0, 0.0))
            assert torque == pytest.approx([0.0, 0.0, served.loop.device.limits.torque if active else 0.0])
            assert grip == pytest.approx(8.0 if active else 0.0)
            enabled = dhd.dhdEnableGripperForce(ctypes.c_ubyte(1), ANY)
            assert enabled == (0 if active else -1)
            if not active:
                assert dhd.dhdGetGripperGap(ctypes.byref(ctypes.c_double()), ANY) == -1
        finally:
            dhd.dhdClose(ANY)


def set_all(dhd: Any, force: tuple[float, ...], torque: tuple[float, ...], grip: float) -> int:
    values = (ctypes.c_double(one) for one in (*force, *torque, grip))
    return int(dhd.dhdSetForceAndTorqueAndGripperForce(*values, ANY))


@pytest.fixture
def sigma(libraries: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[ServedFile, Any]]:
    """A served arm with six actuated directions and a gripper, and the library with it open."""
    with ServedFile("arm-sigma", limit=100.0) as served:
        monkeypatch.setenv("HAPTORB_RUN", str(served.path))
        dhd = ctypes.CDLL(str(libraries / "libdrd.so.3"))
        dhd.dhdErrorGetLastStr.restype = ctypes.c_char_p
        assert dhd.dhdOpen() >= 0
        dhd.dhdSetTimeGuard(0, ANY)
        yield served, dhd
        dhd.dhdClose(ANY)


def test_torque_and_gripper_force_reach_the_loop(sigma: tuple[ServedFile, Any]) -> None:
    """In the stator's frame: x towards the user is −y there. A gripper's force has no frame; positive opens."""
    served, dhd = sigma
    assert set_all(dhd, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3), -2.0) == 0
    torque, grip = served.await_rest((2.0, -1.0, 3.0))
    assert torque == pytest.approx([0.2, -0.1, 0.3])
    assert grip == -2.0
    assert dhd.dhdSetForceAndTorque(*map(ctypes.c_double, (1.0, 0.0, 0.0, 0.0, 0.0, 0.2)), ANY) == 0
    torque, grip = served.await_rest((0.0, -1.0, 0.0))
    assert (torque, grip) == (pytest.approx([0.0, 0.0, 0.2]), 0.0)
    assert dhd.dhdSetForceAndGripperForce(*map(ctypes.c_double, (0.0, 0.0, 1.0, 3.0)), ANY) == 0
    torque, grip = served.await_rest((0.0, 0.0, 1.0))
    assert (torque, grip) == ([0.0, 0.0, 0.0], 3.0)


def test_force_and_torque_one_after_the_other(sigma: tuple[ServedFile, Any]) -> None:
    """As older programs command them: neither takes the other away, for as long as a command lasts."""
    served, dhd = sigma
    end = monotonic() + 20.0
    while True:
        begin = monotonic()
        for _ in range(3):
            assert set_force(dhd, 0.0, 0.0, 1.0) == 0
            assert dhd.dhdSetTorque(*map(ctypes.c_double, (0.0, 0.0, 0.1)), ANY) == 0
        assert set_force(dhd, 0.0, 0.0, 2.0) == 0
        if monotonic() - begin < 0.04:  # else this process did not run for as long as a torque lasts: once more
            break
        assert monotonic() < end
    torque, _ = served.await_rest((0.0, 0.0, 2.0))
    assert torque == pytest.approx([0.0, 0.0, 0.1])
    sleep(0.06)
    assert set_force(dhd, 0.0, 0.0, 3.0) == 0
    torque, _ = served.await_rest((0.0, 0.0, 3.0))
    assert torque == [0.0, 0.0, 0.0], "a torque of long ago has ended"


def test_a_torque_keeps_the_force_commanded_just_before(sigma: tuple[ServedFile, Any]) -> None:
    served, dhd = sigma
    end = monotonic() + 20.0
    while True:
        begin = monotonic()
        assert set_force(dhd, 0.0, 0.0, 1.0) == 0
        assert dhd.dhdSetTorque(*map(ctypes.c_double, (0.0, 0.0, 0.1)), ANY) == 0
        if monotonic() - begin < 0.04:
            break
        assert monotonic() < end
    while served.receive()[0] != pytest.approx([0.0, 0.0, 1.0]) or served.torque != pytest.approx([0.0, 0.0, 0.1]):
        assert monotonic() < end
        sleep(0.001)
    sleep(0.06)
    assert dhd.dhdSetTorque(*map(ctypes.c_double, (0.0, 0.0, 0.2)), ANY) == 0
    assert served.await_rest((0.0, 0.0, 0.0))[0] == pytest.approx([0.0, 0.0, 0.2]), "a force of long ago has ended"


def test_torque_and_gripper_end_with_the_program(sigma: tuple[ServedFile, Any]) -> None:
    served, dhd = sigma
    assert set_all(dhd, (0.0, 0.0, 1.0), (0.0, 0.0, 0.2), 4.0) == 0
    assert served.await_rest((0.0, 0.0, 1.0)) == ([0.0, 0.0, 0.2], 4.0)
    assert dhd.dhdClose(ANY) == 0
    end = monotonic() + 1.0
    while served.loop._client["lost"][0] <= 0.0:
        served.receive()
        assert monotonic() < end
    assert dhd.dhdOpen() >= 0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_no_number_is_no_torque_and_no_gripper_force(sigma: tuple[ServedFile, Any], bad: float) -> None:
    served, dhd = sigma
    for torque, grip in (((0.0, bad, 0.0), 1.0), ((0.1, 0.0, 0.0), bad)):
        assert set_all(dhd, (0.0, 0.0, 1.0), (0.1, 0.0, 0.0), 1.0) == 0
        served.await_rest((0.0, 0.0, 1.0))
        assert set_all(dhd, (0.0, 0.0, 1.0), torque, grip) == -1
        assert b"finite" in dhd.dhdErrorGetLastStr()
        assert served.await_rest((0.0, 0.0, 0.0)) == ([0.0, 0.0, 0.0], 0.0)


def test_a_gripper_as_it_is_measured(sigma: tuple[ServedFile, Any]) -> None:
    """Angle, gap, rates, thumb and finger are those of two fingers of 100 mm; its force is what is rendered."""
    served, dhd = sigma
    served.publish(p=(0.01, 0.02, 0.031), gripper=0.012, gripper_v=-0.05, gripper_force=1.5, part=-1.0)
    await_position(dhd, (-0.02, 0.01, 0.031))
    assert numbers(dhd.dhdGetGripperGap, 1) == pytest.approx([0.012])
    angle = 2.0 * np.arcsin(0.06)
    assert numbers(dhd.dhdGetGripperAngleRad, 1) == pytest.approx([angle])
    assert numbers(dhd.dhdGetGripperAngleDeg, 1) == pytest.approx([np.degrees(angle)])
    assert numbers(dhd.dhdGetGripperLinearVelocity, 1) == pytest.approx([-0.05])
    assert numbers(dhd.dhdGetGripperAngularVelocityRad, 1) == pytest.approx([-0.5 / np.cos(0.5 * angle)])
    thumb, finger = numbers(dhd.dhdGetGripperThumbPos, 3), numbers(dhd.dhdGetGripperFingerPos, 3)
    assert np.linalg.norm(np.subtract(thumb, finger)) == pytest.approx(0.012)
    assert numbers(dhd.dhdGetForceAndTorqueAndGripperForce, 7)[6] == 1.5


def test_a_gripper_that_is_switched_off(sigma: tuple[ServedFile, Any]) -> None:
    served, dhd = sigma
    assert dhd.dhdEnableGripperForce(ctypes.c_ubyte(0), ANY) == 0
    assert set_all(dhd, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 4.0) == 0
    assert served.await_rest((0.0, 0.0, 1.0))[1] == 0.0
    assert dhd.dhdEnableGripperForce(ctypes.c_ubyte(1), ANY) == 0
    assert set_all(dhd, (0.0, 0.0, 2.0), (0.0, 0.0, 0.0), 4.0) == 0
    assert served.await_rest((0.0, 0.0, 2.0))[1] == 4.0


def test_torques_are_told_as_they_are_rendered(served: ServedFile, dhd: Any) -> None:
    """Of a tool whose force alone is rendered there is none, though one is asked; and the other way round."""
    asked = (0.1, 0.2, 0.3, 0.01, 0.02, 0.03)
    for part, force, torque in ((0.0, (-0.2, 0.1, 0.3), (0, 0, 0)), (2.0, (-0.2, 0.1, 0.3), (-0.02, 0.01, 0.03)),
                                (1.0, (0, 0, 0), (-0.02, 0.01, 0.03))):  # fmt: skip
        served.publish(wrench_commanded=asked, part=part, p=(0.0, 1e-3 * part, 0.05))
        end = monotonic() + 2.0
        while (found := numbers(dhd.dhdGetForceAndTorque, 6)) != pytest.approx([*force, *torque], abs=1e-12):
            assert monotonic() < end, found


def test_a_hand_begins_when_a_program_opens_the_device(
    libraries: Path, monkeypatch: pytest.MonkeyPatch, served: ServedFile
) -> None:
    """Not when one counts the devices."""
    monkeypatch.setenv("HAPTORB_RUN", str(served.path))
    dhd = ctypes.CDLL(str(libraries / "libdrd.so.3"))
    assert dhd.dhdGetDeviceCount() == 1
    assert dhd.dhdGetAvailableCount() == 1
    sleep(0.02)
    assert not served.loop.shared.hand.begun
    assert dhd.dhdOpen() >= 0
    try:
        end = monotonic() + 1.0
        while not served.loop.shared.hand.begun:
            assert monotonic() < end
    finally:
        dhd.dhdClose(ANY)


def test_a_motor_shows_its_object(libraries: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Place, orientation and angular velocity of the object, in ten times its size; the force that comes back."""
    with ServedFile("pmsm", limit=100.0) as served:
        monkeypatch.setenv("HAPTORB_RUN", str(served.path))
        dhd = ctypes.CDLL(str(libraries / "libdrd.so.3"))
        assert dhd.dhdOpen() >= 0
        try:
            dhd.dhdSetTimeGuard(0, ANY)
            turned = (0.0, 0.0, np.sin(0.1), np.cos(0.1))
            served.publish(
                object=(0.001, 0.002, 0.003), object_q=turned, q=(1.0, 0.0, 0.0, 0.0), w=(9.0, 9.0, 9.0), gain=0.5,
                clutch_share=(1.0, 0.0), object_wrench=(2.0, 4.0, 6.0, 1.0, 1.0, 1.0),
            )  # fmt: skip
            await_position(dhd, (-0.02, 0.01, 0.03))
            matrix = (ctypes.c_double * 9)()
            assert dhd.dhdGetOrientationFrame(matrix, ANY) == 0
            assert np.reshape(matrix, (3, 3)) == pytest.approx(rotation_from_euler(0.0, 0.0, 0.2))
            assert numbers(dhd.dhdGetAngularVelocityRad, 3) == pytest.approx([0.0, 0.0, 0.0])
            joints = (ctypes.c_double * 8)()
            rotor = (np.sin(0.15), 0.0, 0.0, np.cos(0.15))  # about the user's right, which is y there
            served.publish(object=(0.002, 0.0, 0.0), q=rotor, clutch_share=(1.0, 0.0), gain=1.0)
            await_position(dhd, (0.0, 0.02, 0.0))
            assert dhd.dhdGetJointAngles(joints, ANY) == 0
            assert list(joints) == pytest.approx([0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1e-12)
            served.publish(
                object=(0.001, 0.002, 0.003), object_q=turned, q=(1.0, 0.0, 0.0, 0.0), gain=0.5,
                clutch_share=(1.0, 0.0),
                object_wrench=(2.0, 4.0, 6.0, 1.0, 1.0, 1.0),
            )  # fmt: skip
            await_position(dhd, (-0.02, 0.01, 0.03))
            assert numbers(dhd.dhdGetForceAndTorque, 6) == pytest.approx([-2.0, 1.0, 3.0, 0.0, 0.0, 0.0])
            limits = served.loop.device.limits
            assert set_all(dhd, (0.0, 0.0, 1e3), (0.0, 0.0, 1e3), 0.0) == 2
            torque, _ = served.await_rest((0.0, 0.0, limits.torque / 0.024))
            assert torque == pytest.approx([0.0, 0.0, limits.torque / 0.25])
        finally:
            dhd.dhdClose(ANY)


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_a_program_finds_every_device_at_rest_within_its_workspace(name: str) -> None:
    """In its own size, but for a motor, whose object moves by millimetres."""
    device = load(name, override=True)
    seen = describe_hardware(device)
    p = np.zeros(3) if device.kind.modes else device.rest_position
    at = Placement(seen.centre, seen.scale).place(p)
    least, greatest = np.array(seen.workspace[:3]), np.array(seen.workspace[3:])
    assert (least <= at).all()
    assert (at <= greatest).all()
    assert (greatest > least).all()
    assert seen.scale == (10.0 if device.kind.modes else 1.0)
