"""An emulated device for everybody: the real firmware, its chips and a simulated electromagnet on a serial port."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from time import monotonic, sleep

import numpy as np

from haptorb.devices.device import Device
from haptorb.devices.electromagnet.api import electromagnet
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.serial.emulator import EmulatedDevice, Emulator
from haptorb.simulation.electromagnet.electromagnet import SimulatedElectromagnet
from haptorb.simulation.led_tool import lead_tool

__all__ = ["emulate"]


def emulate(
    device: Device,
    build: Path,
    port: Path,
    board: str = "m328p",
    duration: float = float("inf"),
    ready: Callable[[], None] = lambda: None,
    height: float | None = None,
    *,
    led: bool = False,
    dead: int | None = None,
) -> None:
    """Emulate `device` behind the pseudo-terminal `port` for `duration` [s]; `ready` is called when it answers.

    The simulated tool stands upright on the axis, its magnet `height` [m] above the centre (None: above the summit, as
    the simulation begins): where a pointer is, the emulated device cannot know. With `led` a hand leads it over the
    whole dome, as the calibration's step 'sensors' wants it. Field sensor number `dead`, from 1, has failed.

    Raises InputError for a height inside the dome or above 2 m, for a height of a tool that is led, and for a sensor
    that is not there.
    """
    known = electromagnet(device, "the emulated firmware")
    if height is not None and not known.contact_distance <= height <= 2.0:
        raise InputError(
            f"height of the tool's magnet must be from {1e3 * known.contact_distance:g} mm, the dome, to 2000 mm; got "
            f"{1e3 * height:g} mm"
        )
    if led and height is not None:
        raise InputError("a tool moved by --led has no fixed height: use --led or --height")
    if dead is not None and not 1 <= dead <= known.sensors:
        raise InputError(f"the failed field sensor must be 1 to {known.sensors}; got {dead}")
    with tempfile.TemporaryDirectory() as folder:
        goal = (lambda t: lead_tool(known, t)) if led else None if height is None else _rest_pose(height)
        physics = EmulatedDevice(known, Path(folder, "physics"), goal)
        if dead is not None:
            assert isinstance(physics.simulation, SimulatedElectromagnet)
            physics.simulation.fail([dead - 1])
        if goal is not None:
            physics.place(*goal(0.0))
        try:
            with Emulator(build, port, board, physics) as emulator:
                ready()
                end = monotonic() + duration
                while monotonic() < end and emulator.alive:
                    sleep(0.05)
        finally:
            physics.close()


def _rest_pose(height: float) -> Callable[[float], tuple[Array, Array]]:
    p, q = np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 0.0, 1.0])
    return lambda t: (p, q)
