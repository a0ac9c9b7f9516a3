"""An emulated device for everybody: the real firmware, its chips and a simulated electromagnet on a serial port."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from time import monotonic, sleep

from haptorb.devices.device import Device
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import DeviceError
from haptorb.runtime.emulator import EmulatedDevice, Emulator

__all__ = ["emulate"]


def emulate(
    device: Device,
    build: Path,
    port: Path,
    board: str = "m328p",
    duration: float = float("inf"),
    ready: Callable[[], None] = lambda: None,
) -> None:
    """Emulate `device` behind the pseudo-terminal `port` for `duration` [s]; `ready` is called when it answers.

    The simulated tool rests above the dome's summit: where a pointer is, the emulated device cannot know.
    """
    if not isinstance(device, SphericalElectromagnet):
        raise DeviceError(f"the firmware serves a spherical electromagnet; '{device.name}' is another kind of device")
    with tempfile.TemporaryDirectory() as folder:
        physics = EmulatedDevice(device, Path(folder, "physics"))
        try:
            with Emulator(build, port, board, physics) as emulator:
                ready()
                end = monotonic() + duration
                while monotonic() < end and emulator.alive:
                    sleep(0.05)
        finally:
            physics.close()
