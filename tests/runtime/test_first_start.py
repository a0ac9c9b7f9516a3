"""The second process of a first start compiles what the servo's process needs, and ends when not needed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from haptorb import worlds
from haptorb.runtime import plan
from haptorb.runtime.prestart import CATALOGUE, CONTROLLER, PLAN, WANTED, code_note, start_module
from haptorb.runtime.servo import Servo

PROGRAM = """
import gc, sys
from numba.core.dispatcher import Dispatcher
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.servo import Servo
from haptorb.runtime.warm_up import Compilation

servo = Servo(sys.argv[1], record=False)
compilation = Compilation(servo.config)
kernels = lambda: {(thing.py_func.__module__, thing.py_func.__qualname__, str(signature))
                   for thing in gc.get_objects() if isinstance(thing, Dispatcher) for signature in thing.overloads}
parts = sum(1 for _ in compilation.compile_controller())
compiled = kernels()
chain, row = servo._make_plan().practice(PointerTracker()), servo.layout.empty()
with chain.driver:
    for tick in range(5):
        chain.prepare(tick * 1e-3)
    before = kernels()
    for tick in range(5, 10):
        chain.step(row, tick * 1e-3)
left = [".".join(one[:2]) for one in kernels() - before]
print(parts, len(compiled), *(one for one in left if not one.startswith("haptorb.simulation.")))
"""


@pytest.mark.parametrize("device", ["omni", pytest.param("pmsm", marks=pytest.mark.slow)])
def test_the_controller_is_compiled_as_the_loop_uses_it(device: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, device], capture_output=True, text=True, check=True, timeout=300
    )
    parts, compiled, *left = done.stdout.split()
    assert int(parts) > 5
    assert int(compiled) > 10
    assert left == []


@pytest.mark.parametrize("what", [pytest.param(CONTROLLER, marks=pytest.mark.slow), CATALOGUE])
def test_it_is_a_program_that_ends(what: str, tmp_path: Path) -> None:
    plan.save(Servo("omni", record=False)._make_plan(), tmp_path / PLAN)
    (tmp_path / WANTED).write_text("button", encoding="utf-8")
    command = [sys.executable, "-m", "haptorb.runtime.first_start", what, str(tmp_path)]
    assert subprocess.run([*command, "0"], check=False, timeout=300).returncode == 1  # nobody's child
    notes = sorted(tmp_path.glob("code-*"))
    assert notes == ([code_note(tmp_path, "button")] if what == CATALOGUE else [])  # what is wanted comes first
    assert subprocess.run([*command, str(os.getpid())], check=False, timeout=300).returncode == 0
    assert {code_note(tmp_path, name).exists() for name in worlds.CATALOGUE} == {what == CATALOGUE}


@pytest.mark.realtime
def test_a_start_that_takes_long_is_helped_and_the_helper_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []

    def start(module: str, *words: str, **options: Any) -> subprocess.Popen[bytes]:
        started.append(start_module(module, *words, **options))
        return started[-1]

    monkeypatch.setattr("haptorb.runtime.process_group._USUAL_START_S", 0.0)
    monkeypatch.setattr("haptorb.runtime.process_group.start_module", start)
    with Servo("omni", record=False) as servo:
        helper, *worlds_code = started
        assert CONTROLLER in helper.args
        assert helper.poll() is not None
        assert all(CATALOGUE in other.args for other in worlds_code)  # where worlds are not compiled yet
        assert servo.alive
        compiler = servo._children.compiler  # type: ignore[union-attr]
        last, compiler.process = compiler.process, None
        compiler.help_start()  # from here on it would only be a device that takes its time
        assert compiler.process is None
        compiler.process = last
