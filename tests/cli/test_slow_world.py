"""A world file that does not return: the command names what it waits for; Ctrl-C ends it."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from haptorb.cli.world_option import choose_world_option
from haptorb.devices.loader import load
from haptorb.runtime.world_loading import WorldWatcher
from haptorb.worlds.user_world import WorldFile
from oracles.fork_server import get_fork_server

pytestmark = pytest.mark.realtime

HANG = """
import time
from pathlib import Path
import numpy as np
from haptorb.worlds import World

GATE = Path(__file__).with_name("gate")


def wait():
    while not GATE.exists():
        time.sleep(0.01)

{load}

class Slow(World):
    '''Nothing is felt, as soon as there is a gate.'''

    def wrench(self, state):
        {call}
        return np.zeros(6)
"""
PATIENCE = 60.0


@pytest.fixture(params=["load", "call"])
def file(request: Any, tmp_path: Path) -> Path:
    """A world file that waits for `gate` beside it, when it is loaded or when it is called."""
    path = tmp_path / "slow.py"
    waits = {"load": "", "call": "pass"} | {request.param: "wait()"}
    path.write_text(HANG.format(**waits))
    return path


def _until(condition: Any) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "it did not come to pass"
        time.sleep(0.01)


def test_it_is_told_and_goes_on_when_the_world_returns(file: Path, capfd: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    found: list[Any] = []
    told = ""

    def is_told() -> bool:
        nonlocal told
        told += capfd.readouterr().err
        return "Ctrl-C" in told

    thread = threading.Thread(
        target=lambda: found.append(choose_world_option(str(file), [], load("omni"))), daemon=True
    )
    thread.start()
    _until(is_told)
    assert str(file) in told
    assert not found
    file.with_name("gate").touch()
    thread.join(PATIENCE)
    assert found == [WorldFile(file)]
    assert "Ctrl-C" not in capfd.readouterr().err, "it is told once"


@pytest.mark.parametrize("file", ["call"], indirect=True)
def test_ctrl_c_ends_a_run_that_waits(file: Path) -> None:
    words = ["run", "--headless", "--world", f"{file}:Slow"]
    with get_fork_server().start_haptorb(*words, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        try:
            told = ""
            while "Ctrl-C" not in told:
                line = process.stderr.readline()
                assert line, f"it ended before: {told}"
                told += line
            assert "World 'slow' of" in told
            assert str(file) in told
            process.send_signal(signal.SIGINT)
            told += process.stderr.read()
            assert process.wait(PATIENCE) == 128 + signal.SIGINT
        finally:
            process.kill()
    assert "Traceback" not in told


def test_a_saved_file_that_does_not_return_is_told(file: Path, capfd: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    waiting, gate = file.read_text(), file.with_name("gate")
    gate.touch()
    source = WorldFile(file)
    world, replaced = source.load(), threading.Event()
    watcher = WorldWatcher(source, world, load("omni"), lambda new, values: replaced.set(), lambda: (world.name, {}))
    try:
        gate.unlink()
        file.write_text(waiting + "\n")
        _until(lambda: watcher.trouble)
        assert "slow.py was saved, but has not returned" in watcher.trouble
        assert not replaced.is_set()
        gate.touch()
        assert replaced.wait(PATIENCE)
        _until(lambda: not watcher.trouble)
    finally:
        watcher.end()
    told = capfd.readouterr().err
    assert "the previous world continues" in told
    assert "reloaded" in told
