"""Preparation of the servo's process before it opens the device: no code is loaded afterwards."""

import subprocess
import sys

import pytest

PROGRAM = """
import gc, sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from haptorb import worlds
from haptorb.control.trip_reasons import Trip
from haptorb.errors import HaptorbError
from haptorb.runtime import servo_process
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.servo import Servo
from haptorb.runtime.shared_memory import SharedMemory

servo = Servo(sys.argv[1], sys.argv[2], record=False)
shared = SharedMemory.create(servo.layout)
try:
    servo_process._warm_up(servo._make_plan(), shared)
    chain, row = servo._make_plan().assemble(PointerTracker(shared.pointer)), shared.layout.empty()
    kernels = lambda: sum(len(thing.overloads) for thing in gc.get_objects() if isinstance(thing, Dispatcher))
    before, rendered = (kernels(), set(sys.modules)), 0
    with chain.driver:
        for tick, kind in enumerate(worlds.CATALOGUE.values()):
            try:
                chain.change_world(kind())
            except HaptorbError:
                continue
            chain.step(row, tick * 1e-3)
            rendered += 1
        # Whatever people do while it runs: take the pointer, let it go, stop, engage, change mode, open the clutch.
        place = chain.estimator.update(chain.driver.read(0.1)).state.p
        for tick in range(100, 200):
            shared.pointer.write(tick < 130, place, np.array([0.0, 0.0, 0.0, 1.0]), tick * 1e-3)
            if tick == 150:
                chain.protection.trip(Trip.STOPPED)
            if tick == 160:
                chain.engage()
            if tick == 170 and servo.modes:
                chain.joining.set_mode("rotate")
            if tick == 180 and servo.modes:
                chain.joining.set_clutch(False)
            chain.step(row, tick * 1e-3)
    print(rendered, kernels() - before[0], sorted(set(sys.modules) - before[1]))
finally:
    shared.unlink()
"""


@pytest.mark.parametrize(
    ("device", "first", "least"), [("omni", "wall", 12), pytest.param("pmsm", "nothing", 8, marks=pytest.mark.slow)]
)
def test_no_world_of_the_catalogue_is_loaded_while_the_loop_runs(device: str, first: str, least: int) -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM, device, first], capture_output=True, text=True, check=True)
    rendered, loaded, modules = done.stdout.split(maxsplit=2)
    assert int(rendered) >= least
    assert loaded == "0"
    assert modules.strip() == "[]"
