"""Compile kernels for devices into numba's cache: `compile_kernels.py [DEVICE …]`; by default omni, planar, pmsm.

What is there already is loaded, which takes a second. The tests start hundreds of servos for a second or two. Without
this each of them would start to compile the worlds of the catalogue anew, and none of them would come to an end.
"""

from __future__ import annotations

import gc
import sys

import haptorb
from haptorb import worlds
from haptorb.estimation.registry import list_estimators
from haptorb.runtime.config import RunConfig
from haptorb.runtime.warm_up import Compilation


def compile_all(name: str) -> None:
    """A servo of the device, its other estimators, and every world of the catalogue on it."""
    with haptorb.Servo(name, record=False) as servo:
        servo.run(seconds=0.1)
    device = haptorb.load(name)
    for estimator in tuple(list_estimators(device)):
        made = Compilation(RunConfig(device=device, world=worlds.CATALOGUE[device.kind.world](), estimator=estimator))
        for _ in made.compile_controller():
            pass
    for _ in made.compile_catalogue(str):
        pass


def main(names: list[str]) -> None:
    """All of `names`, one after the other."""
    gc.disable()  # compiling makes a million lasting objects
    for name in names or ["omni", "planar", "pmsm"]:
        compile_all(name)


if __name__ == "__main__":
    main(sys.argv[1:])
