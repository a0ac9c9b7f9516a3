"""Misbehaving worlds: the host reports why the servo ended, and no process outlives the host."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from haptorb.errors import ServoError
from haptorb.runtime.prestart import start_module
from haptorb.runtime.servo import Servo
from oracles.fork_server import get_fork_server

pytestmark = pytest.mark.realtime(retry=False)

AT = 400  #: the tick that misbehaves: late enough for a slow host to have opened it


def is_gone(pid: int) -> bool:
    """Whether a process ended; one that only waits to be collected counts."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


def eventually(condition: Callable[[], bool], patience: float = 20.0) -> bool:
    end = time.monotonic() + patience
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def deaf() -> None:
    """Nothing that this process can say no to ends it, and no code of Python's runs in it any more."""
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    while True:
        ctypes.PyDLL(None).sleep(60)  # with the interpreter's lock


def swallow() -> None:
    while True:
        try:
            while True:
                pass
        except BaseException:
            continue


@pytest.mark.parametrize("hang", [deaf, swallow])
def test_a_world_that_hangs_is_told_and_ended_by_force(fake_servo: Any, hang: Callable[[], None]) -> None:
    made = fake_servo({"act_at": AT, "act": hang}, record=False)
    with made.servo as servo:
        with pytest.raises(ServoError, match=r"world 'nothing' hangs: the last tick began .* and did not end"):
            servo.run(30)
        assert not servo.alive
        assert is_gone(servo.servo_pid)


@pytest.mark.usefixtures("quick_starts")
def test_a_world_that_does_not_return_from_its_first_call_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def endless(state: Any) -> None:
        swallow()

    monkeypatch.setattr("haptorb.runtime.process_group._FIRST_CALL_TIMEOUT_S", 0.3)
    servo = Servo("omni", endless, record=False)
    with pytest.raises(ServoError, match=r"world 'endless' has not returned from its first call for 0\.3 s"):
        servo.open()
    servo.close()


def test_a_world_that_only_loops_is_ended_in_order(fake_servo: Any) -> None:
    made = fake_servo({"hang_at": AT}, record=False)
    with pytest.raises(ServoError, match="world 'nothing' hangs: one tick took longer"), made.servo as servo:
        servo.run(30)
    assert made.words() == ["open", "close"]


def test_a_process_that_leaves_in_the_middle_is_explained(fake_servo: Any) -> None:
    with (
        pytest.raises(ServoError, match=r"ended with code 0.*os\._exit"),  # on a slow host while it is opened
        fake_servo({"act_at": AT, "act": lambda: os._exit(0)}, record=False).servo as servo,
    ):
        servo.run(30)


def test_a_forked_child_never_comes_back_into_the_loop(fake_servo: Any, tmp_path: Path) -> None:
    told = tmp_path / "told"

    def fork() -> None:
        if child := os.fork():
            told.write_text(str(os.waitpid(child, 0)[1]))
        else:
            told.write_text("the child goes on")

    with fake_servo({"act_at": AT, "act": fork}, record=False).servo as servo:
        assert eventually(told.exists)
        assert servo.alive
    assert told.read_text() == str(70 << 8)


def test_what_a_world_has_started_ends_with_the_servo(fake_servo: Any, tmp_path: Path) -> None:
    told = tmp_path / "told"

    def start() -> None:
        told.write_text(str(subprocess.Popen(["sleep", "100"]).pid))

    with fake_servo({"act_at": AT, "act": start}, record=False).servo as servo:
        assert eventually(lambda: told.exists() and told.read_text() != "")
        assert servo.alive
    assert eventually(lambda: is_gone(int(told.read_text())))


_HOST = """
import ctypes, os, signal
from dataclasses import dataclass
import numpy as np
import haptorb
from haptorb.worlds import World

@dataclass(frozen=True)
class Mine(World):
    def wrench(self, state):
        if os.path.exists(FLAG):
            signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
            while True:
                ctypes.PyDLL(None).sleep(60)
        return np.zeros(6)

with haptorb.Servo("omni", Mine(), record=False) as servo:
    print(servo.servo_pid, flush=True)
    servo.run(100)
"""


@pytest.fixture
def host(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], int, Path]]:
    """A program whose world hangs, deaf to everything, as soon as a file exists: (program, its servo, file)."""
    script, flag = tmp_path / "host.py", tmp_path / "hang"
    script.write_text(f"FLAG = {str(flag)!r}\n{_HOST}")
    with get_fork_server().start_program(str(script), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        servo = int(process.stdout.readline())
        try:
            yield process, servo, flag
        finally:
            process.kill()
            if not is_gone(servo):
                os.kill(servo, signal.SIGKILL)


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_servo_that_hangs_does_not_outlive_its_host(
    host: tuple[subprocess.Popen[str], int, Path], number: signal.Signals
) -> None:
    process, servo, flag = host
    flag.touch()
    process.send_signal(number)
    process.wait()
    assert eventually(lambda: is_gone(servo))


_ENDS = """
import ctypes, signal
from haptorb.runtime.linux import KillTimer
timer = KillTimer()
for _ in range(3):
    timer.set(0.3)
signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
ctypes.PyDLL(None).sleep(60)
"""


def test_the_timer_ends_a_process_that_hears_nothing() -> None:
    assert get_fork_server().run_program("-c", _ENDS).returncode == -signal.SIGKILL


_ASKS = """
import sys
from haptorb.runtime.linux import die_with_parent
die_with_parent()
print("asked", file=sys.stderr, flush=True)
input()
print("went on", file=sys.stderr, flush=True)
"""


def test_a_process_lives_on_when_the_thread_that_wanted_it_ends(tmp_path: Path) -> None:
    (tmp_path / "asks.py").write_text(_ASKS)
    errors, found = tmp_path / "errors", []
    code = f"import runpy; runpy.run_path({str(tmp_path / 'asks.py')!r})"
    (tmp_path / "runs_it.py").write_text(code)

    def want() -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
            found.append(start_module("runs_it", errors=errors, stdin=subprocess.PIPE))
        assert eventually(lambda: "asked" in errors.read_text())

    thread = threading.Thread(target=want)
    thread.start()
    thread.join()
    found[0].communicate(b"\n", timeout=20)
    assert errors.read_text().split("\n")[:2] == ["asked", "went on"]
    assert found[0].returncode == 0


_STARTS = """
import subprocess, sys
from dataclasses import dataclass
import numpy as np
import haptorb
from haptorb.worlds import World

started = []

@dataclass(frozen=True)
class Mine(World):
    def wrench(self, state):
        if not started and sys.modules["__main__"].__spec__.name == "haptorb.runtime.servo_process":
            started.append(subprocess.Popen(["sleep", "100"]))
            open(TOLD, "w").write(str(started[0].pid))
        return np.zeros(6)

with haptorb.Servo("omni", Mine(), record=False) as servo:
    print(servo.servo_pid, flush=True)
    servo.run(100)
"""


def test_what_a_world_has_started_does_not_outlive_the_host(tmp_path: Path) -> None:
    script, told = tmp_path / "host.py", tmp_path / "told"
    script.write_text(f"TOLD = {str(told)!r}\n{_STARTS}")
    with get_fork_server().start_program(str(script), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        process.kill()
    assert eventually(lambda: is_gone(int(told.read_text())))
