"""Programs that misuse the interfaces, block, or find no device: each gets an error, and no force remains."""

from __future__ import annotations

import fcntl
import json
import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np
import pytest

from haptorb.serve.native import device_folder, prepare
from haptorb.testing import haptic_device
from serve.native.conftest import ServedFile
from serve.native.test_haptic_device_api import PREFACE, program  # noqa: F401  (a fixture)

# --------------------------------------------------------------------------------------------------
# Every function of DHD and DRD, with nothing but zeros, before, while and after a device is open.


CALLS = """
import ctypes, json, sys
library, kinds = ctypes.CDLL(sys.argv[1]), json.loads(sys.argv[2])
library.dhdErrorGetLastStr.restype = ctypes.c_char_p
library.dhdOpen.restype = ctypes.c_int
zeros = {"pointer": None, "double": ctypes.c_double(0.0), "id": ctypes.c_char(b"\\xff"), "whole": 0}
results = {"int": ctypes.c_int, "bool": ctypes.c_bool, "double": ctypes.c_double}
def call_all():
    found = {}
    for name, (result, arguments) in kinds.items():
        function = getattr(library, name)
        function.restype = results.get(result, ctypes.c_void_p)
        answer = function(*(zeros[one] for one in arguments))
        found[name] = [answer, library.dhdErrorGetLastStr().decode()]
    return found
before = call_all()
library.dhdEnableExpertMode()
opened = library.dhdOpen()
while_open = call_all()
library.dhdClose(zeros["id"])
print(json.dumps([before, opened, while_open, call_all()]))
"""

#: waits for a key, ends this process, opens a device, closes it, or has no error to state
NOT_CALLED = re.compile(
    r"dhdKb|dhdSleep|drdSleep|d[rh]dOpen|d[rh]dClose|dhdErrorGet|dhdStartThread|dhdStop|dhd(Enable|Disable)ExpertMode"
)


def read_declarations(headers: Path) -> dict[str, tuple[str, list[str]]]:
    """Result and arguments of every function of the two headers."""
    text = "".join(re.sub(r"/\*.*?\*/", "", (headers / name).read_text(), flags=re.S) for name in ("dhdc.h", "drdc.h"))
    found = {}
    for result, name, arguments in re.findall(r"DHD_API ([\w \*]+?)\s*\b(d[rh]d[A-Z]\w+)\((.*?)\);", text, re.S):
        kinds = []
        for one in re.sub(r"DHD_DEFAULT\([^()]*\)", "", arguments).split(","):
            if one.strip() == "DHD_ID":
                kinds.append("id")
            elif "*" in one or "[" in one:
                kinds.append("pointer")
            elif one.strip() != "void":
                kinds.append("double" if "double" in one else "whole")
        found[name] = (result.strip(), kinds)
    return found


def test_every_function_with_zeros_at_every_time(served: ServedFile, libraries: Path) -> None:
    """None crashes; without an open device each that acts on one says so; expert functions say what is missing."""
    declared = read_declarations(libraries.parent / "include")
    assert len(declared) == 234
    called = {name: one for name, one in declared.items() if not NOT_CALLED.match(name)}
    done = subprocess.run(
        [sys.executable, "-c", CALLS, str(libraries / "libdrd.so.3"), json.dumps(called)],
        env={**os.environ, **served.run}, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    before, opened, while_open, after = json.loads(done.stdout)
    assert opened == 0
    of_a_device = {name for name, (result, kinds) in called.items() if result == "int" and kinds[-1:] == ["id"]}
    assert len(of_a_device) > 150
    for when in (before, after):
        wrong = {name: when[name] for name in of_a_device if when[name][0] != -1}
        assert wrong == {}
        assert all(text for _, text in when.values())
    reasons = {name: while_open[name][1] for name in of_a_device if while_open[name][0] == -1}
    assert all(": " in text or "null argument" in text for text in reasons.values()), reasons
    motors = [name for name in of_a_device if re.match(r"dhd.*(Motor|Encoder|Mot$|JointTorques|Jacobian)", name)]
    assert len(motors) > 30
    for name in motors:
        assert re.match(r"not available: the device has no such (motors or encoders|joints)$", reasons[name]), name


# --------------------------------------------------------------------------------------------------
# A callback that blocks for a while.


BLOCKS = """
h = hd.hdInitDevice(None)
hd.hdEnable(0x4000); hd.hdDisable(0x4002)
count, times = [0], []
def push(_):
    count[0] += 1
    if count[0] == 300:
        times.append(time.monotonic()); time.sleep(1.0); times.append(time.monotonic())
    hd.hdBeginFrame(h); force(0, 0.5, 0); hd.hdEndFrame(h)
    return 1
keep = CALL(push)
schedule(keep); hd.hdStartScheduler()
while len(times) < 2: time.sleep(0.01)
time.sleep(0.5)
say(*times, *errors())
hd.hdStopScheduler(); hd.hdDisableDevice(h)
"""


@pytest.mark.realtime
def test_a_callback_that_blocks(libraries: Path) -> None:
    """Its force fades within 70 ms, the loop goes on, and when it returns the force rises again from zero."""
    text = PREFACE.replace("LIBRARY", repr(str(libraries / "libHD.so"))) + BLOCKS
    with haptic_device("omni", real_time=True, serve=["native"]) as run:
        end = monotonic() + 10.0
        while not (served := run.servo.connections):
            assert monotonic() < end
            sleep(0.01)
        environment = {**os.environ, "HAPTORB_RUN": served[0]["address"]}
        done = subprocess.run(
            [sys.executable, "-c", text], env=environment, capture_output=True, text=True, timeout=60, check=False
        )
        report = run.servo.report()
    assert done.returncode == 0, done.stderr
    words = done.stdout.split()
    assert words[2:] == [], "no error: the program does not know that it was late"
    blocked, returned = map(float, words[:2])
    assert report["trips"] == []
    rows = run.recording
    wall, push = np.asarray(rows["wall"]), np.asarray(rows["wrench_commanded"])[:, 2]
    before = push[(wall > blocked - 0.02) & (wall < blocked)]
    assert before == pytest.approx(0.5, abs=1e-6)
    silent = (wall > blocked + 0.075) & (wall < returned - 0.001)  # 50 ms + 20 ms, a tick and a call's delay
    assert silent.sum() > 0.7 * 1e3 * (returned - blocked - 0.076), "the loop goes on"
    assert (push[silent] == 0.0).all()
    after = push[wall > returned][:200]
    rate = np.diff(np.concatenate([[0.0], after]))
    most = max(run.device.limits.force_rate, 150.0)
    # A row that was late or missing may have risen for as many ticks.
    steps = np.maximum(np.diff(np.concatenate([[wall[wall <= returned][-1]], wall[wall > returned][:200]])), 1e-3)
    assert (rate <= 1.2 * most * steps + 1e-9).all(), "it rises as fast as the guard lets it, and no faster"
    assert after[-1] == pytest.approx(0.5, abs=1e-6)


# --------------------------------------------------------------------------------------------------
# OpenHaptics: no device, two programs, a fork, threads, calls at the wrong time.


def read_lines(process: Any) -> list[str]:
    out, errors = process.communicate(timeout=30)
    assert process.returncode == 0, errors
    return list(out.splitlines())


@pytest.mark.realtime(retry=False)
def test_openhaptics_without_a_device(libraries: Path, tmp_path: Path) -> None:
    """At once: a fault on the stack, an invalid handle, one line that says how to start a device."""
    source = textwrap.dedent("""
        t = time.monotonic()
        say(hd.hdInitDevice(None) == 0xFFFFFFFF, *errors())
        say(hd.hdInitDevice(None) == 0xFFFFFFFF, *errors(), time.monotonic() - t < 0.2)
        hd.hdBeginFrame(0); force(0, 1, 0); hd.hdEndFrame(0); hd.hdEnable(0x4000); say(*errors())
    """)
    text = PREFACE.replace("LIBRARY", repr(str(libraries / "libHD.so"))) + source
    done = subprocess.run(
        [sys.executable, "-c", text], env={**os.environ, "HAPTORB_RUN": str(tmp_path / "none.device")},
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    assert done.stdout.splitlines() == ["True 0x300", "True 0x300 True", "0x104 0x104 0x104 0x104"]
    assert done.stderr.count("\n") == 1
    assert "haptorb exec" in done.stderr


def test_two_openhaptics_programs(served: ServedFile, program: Any) -> None:  # noqa: F811
    """The second one reads; its forces are errors, and it goes on."""
    first = program("""
        h = hd.hdInitDevice(None); hd.hdEnable(0x4000); hd.hdDisable(0x4002)
        hd.hdBeginFrame(h); force(0, 0.5, 0); hd.hdEndFrame(h); say(*errors()); sys.stdin.readline()
    """)
    assert first.stdout.readline() == "\n"
    served.await_force((0.0, 0.0, 0.5), 10.0)
    said = read_lines(
        program("""
        h = hd.hdInitDevice(None); hd.hdEnable(0x4000); hd.hdDisable(0x4002)
        for _ in range(2):
            hd.hdBeginFrame(h); force(0, 0.1, 0); place = doubles(0x2050, 3); hd.hdEndFrame(h); say(*errors())
        hd.hdBeginFrame(h); hd.hdEndFrame(h); say(len(place), *errors())
        """)
    )
    assert said == ["0x204", "0x204", "3"]
    assert served.receive()[0] == [0.0, 0.0, 0.5]


def test_openhaptics_fork_and_threads(served: ServedFile, program: Any) -> None:  # noqa: F811
    """A child has neither device nor scheduler; a frame is the thread's that began it; after the end there is none."""
    said = read_lines(
        program("""
        h = hd.hdInitDevice(None); hd.hdEnable(0x4000); hd.hdDisable(0x4002)
        hd.hdStartScheduler()
        if os.fork() == 0:
            hd.hdBeginFrame(h); say("child", *errors())
            hd.hdStopScheduler(); say("child", hd.hdInitDevice(None), *errors())
            os._exit(0)
        os.wait()
        hd.hdBeginFrame(h)
        def other(): hd.hdBeginFrame(h); force(0, 0.4, 0); hd.hdEndFrame(h)
        thread = threading.Thread(target=other); thread.start(); thread.join()
        say(*errors()); hd.hdEndFrame(h); say(*errors())
        seen = set()
        def frames():
            for _ in range(300):
                hd.hdBeginFrame(h); force(0, 0.1, 0); doubles(0x2050, 3); hd.hdEndFrame(h)
        threads = [threading.Thread(target=frames) for _ in range(3)]
        for one in threads: one.start()
        for one in threads: one.join()
        seen = set(errors())
        say(seen <= {"0x400", "0x401", "0x402"})
        hd.hdStopScheduler(); hd.hdDisableDevice(h)
        hd.hdBeginFrame(h); force(0, 1, 0); hd.hdEndFrame(h); say(*errors())
        """)
    )
    assert said == ["child 0x104", "child 0", "0x401 0x402 0x400", "", "True", "0x104 0x104 0x104"]


def test_a_frame_that_a_callback_leaves_open(served: ServedFile, program: Any) -> None:  # noqa: F811
    """As drivers do that return at an error of hdBeginFrame: the next frames begin, and their forces go out."""
    process = program("""
        h = hd.hdInitDevice(None); hd.hdEnable(0x4000); hd.hdDisable(0x4002)
        count, found = [0], []
        def call(_):
            count[0] += 1
            hd.hdBeginFrame(h)
            found.extend(errors())
            if count[0] % 2: return 1
            force(0, 0.5, 0); hd.hdEndFrame(h)
            return 1
        keep = CALL(call); schedule(keep); hd.hdStartScheduler()
        sys.stdin.readline()
        while count[0] <= 4: time.sleep(0.01)
        hd.hdStopScheduler(); say("ended", *found, *errors())
    """)
    served.await_force((0.0, 0.0, 0.5), 10.0)
    assert process.communicate("\n", timeout=30)[0] == "ended\n"


def test_joint_angles_of_a_device_without_joints(served: ServedFile, program: Any) -> None:  # noqa: F811
    """Drivers of ROS read them in every frame: zeros, and one error, not a thousand a second."""
    said = read_lines(
        program("""
        h = hd.hdInitDevice(None)
        for _ in range(3): hd.hdBeginFrame(h); found = doubles(0x2100, 3); hd.hdEndFrame(h); say(found, *errors())
        """)
    )
    assert said == ["[0.0, 0.0, 0.0] 0x103", "[0.0, 0.0, 0.0]", "[0.0, 0.0, 0.0]"]


# --------------------------------------------------------------------------------------------------
# What a run that was killed left behind.


def test_a_file_that_a_run_left_is_removed_by_the_next() -> None:
    """One that is in use stays."""
    stale = device_folder() / f"{os.getpid()}0000001.device"
    used = device_folder() / f"{os.getpid()}0000002.device"
    try:
        for path in (stale, used):
            path.write_bytes(bytes(3 * 4096))
        with used.open("rb+") as held:
            fcntl.flock(held, fcntl.LOCK_EX)
            prepare("").close()
            assert not stale.exists()
            assert used.exists()
    finally:
        for path in (stale, used):
            path.unlink(missing_ok=True)
        (device_folder() / f"{os.getpid()}.device").unlink(missing_ok=True)


def test_a_program_waits_for_no_one(served: ServedFile, libraries: Path) -> None:
    """A DHD loop that blocks between two forces: the device stays its own, and its force has ended meanwhile."""
    source = """
import ctypes, sys, time
dhd, ANY, D = ctypes.CDLL(sys.argv[1]), ctypes.c_char(b"\\xff"), ctypes.c_double
assert dhd.dhdOpen() == 0
print(dhd.dhdSetForce(D(0), D(0), D(0.5), ANY), flush=True)
time.sleep(0.5)
print(dhd.dhdSetForce(D(0), D(0), D(0.25), ANY), flush=True)
sys.stdin.readline()
"""
    with subprocess.Popen(
        [sys.executable, "-c", source, str(libraries / "libdrd.so.3")], env={**os.environ, **served.run},
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "0\n"
            session = served.await_force((0.0, 0.0, 0.5))
            client = served.loop._client
            end = monotonic() + 2.0
            while client["age"][0] < 0.07:
                served.receive()
                assert monotonic() < end
                sleep(0.001)
            assert process.stdout.readline() == "0\n"
            assert served.await_force((0.0, 0.0, 0.25)) == session
        finally:
            process.kill()
