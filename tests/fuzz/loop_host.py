"""A servo without processes: its commands go into memory that a loop in this thread reads."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from haptorb.runtime.servo import Servo
from haptorb.runtime.shared_memory import SharedMemory


def make_host(shared: SharedMemory, world: str = "nothing") -> Servo:
    """A Servo of the Omni that exchanges everything with a loop through `shared`; there is nothing to close."""
    servo = Servo("omni", world, record=False)
    servo._attach(shared)
    compiler = SimpleNamespace(check=lambda: None, compile_world=lambda name: None)
    processes: Any = SimpleNamespace(check=lambda: None, alive=True, compiler=compiler)
    servo._children = processes
    return servo
