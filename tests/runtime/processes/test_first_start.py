"""What a first start's second process compiles is what the servo's process needs, and it goes when it is not needed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from haptorb.runtime.exchange import plan as plans
from haptorb.runtime.servo.servo import Servo

PROGRAM = """
import gc, sys
from numba.core.dispatcher import Dispatcher
from haptorb.runtime.pointer.pointer import PointerTracker
from haptorb.runtime.servo.servo import Servo

servo = Servo(sys.argv[1], record=False)
kernels = lambda: {(thing.py_func.__module__, thing.py_func.__qualname__, str(signature))
                   for thing in gc.get_objects() if isinstance(thing, Dispatcher) for signature in thing.overloads}
parts = sum(1 for _ in servo._plan.compiling())
compiled = kernels()
chain, row = servo._plan.practice(PointerTracker()), servo.layout.empty()
with chain.driver:
    for tick in range(5):
        chain.prepare(tick * 1e-3)
    before = kernels()
    for tick in range(5, 10):
        chain.step(row, tick * 1e-3)
left = [".".join(one[:2]) for one in kernels() - before]
print(parts, len(compiled), *(one for one in left if not one.startswith("haptorb.simulation.")))
"""


@pytest.mark.parametrize("device", ["omni", "pmsm"])
def test_the_controller_is_compiled_as_the_loop_uses_it(device: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, device], capture_output=True, text=True, check=True, timeout=300
    )
    parts, compiled, *left = done.stdout.split()
    assert int(parts) > 10
    assert int(compiled) > 10
    assert left == []


def test_it_is_a_program_that_ends(tmp_path: Path) -> None:
    plans.save(Servo("omni", record=False)._plan, tmp_path / "plan")
    command = [sys.executable, "-m", "haptorb.runtime.processes.first_start", str(tmp_path / "plan")]
    assert subprocess.run([*command, str(os.getpid())], check=False, timeout=300).returncode == 0
    assert subprocess.run([*command, "0"], check=False, timeout=300).returncode == 1  # nobody's child


def test_a_start_that_takes_long_is_helped_and_the_helper_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("haptorb.runtime.servo.process_group._USUAL", 0.0)
    with Servo("omni", record=False) as servo:
        helper = servo._children._compiler  # type: ignore[union-attr]
        assert helper is not None
        assert helper.poll() is not None
        assert servo.alive
        # From here on it would only be a device that takes its time.
        assert not servo._children._compiling_since(0.0)  # type: ignore[union-attr]
