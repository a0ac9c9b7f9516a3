"""From names to a chain: which driver, which estimator, which allocator a device gets."""

from __future__ import annotations

from haptorb.control.least_squares import LeastSquaresAllocator
from haptorb.devices.device import Device
from haptorb.errors import UnknownName
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.pointer_pose import PointerPose
from haptorb.runtime.real_driver import is_real, real_driver
from haptorb.runtime.tick import Tick
from haptorb.sensing.estimator import TrackedPose
from haptorb.worlds.world import World

__all__ = ["DRIVERS", "TRACKERS", "assemble", "known_driver", "known_tracker"]

DRIVERS = ("sim",)
TRACKERS = ("pointer",)


def known_driver(name: str) -> str:
    """`name` itself, or UnknownName; whether a port or bus is there shows when it is opened."""
    if name not in DRIVERS and not is_real(name):
        raise UnknownName("driver", name, (*DRIVERS, "serial:PORT", "i2c:BUS"))
    return name


def known_tracker(name: str) -> str:
    """`name` itself, or UnknownName."""
    if name not in TRACKERS:
        raise UnknownName("tracker", name, TRACKERS)
    return name


def assemble(
    device: Device, world: World, driver: str, rate: float, seed: int, level: str | None, tracker: PointerTracker
) -> Tick:
    """The chain that renders `world` on `device` at `rate` [Hz]; coils are off until its driver is opened."""
    from haptorb.runtime.sim_driver import SimDriver  # the simulation is loaded only where it runs

    known_driver(driver)
    dt = 1.0 / rate
    real = is_real(driver)
    return Tick(
        device,
        world,
        real_driver(driver, device, PointerPose(tracker)) if real else SimDriver.of(device, dt, tracker.goal, seed),
        TrackedPose(device, level),
        # What the model at `level` knows of the passive wrench is taken out; at level "dipole" that is nothing.
        LeastSquaresAllocator.force(device.coils.current_limit, compensate_passive=True),
        dt,
    )
