"""From names to a chain: which driver, which estimator, which allocator a device gets."""

from __future__ import annotations

from haptorb.control.allocator import Allocator
from haptorb.control.least_squares import LeastSquaresAllocator
from haptorb.control.linkage import Direct, Linkage, ModedLinkage
from haptorb.control.minimum_power import MinimumPowerAllocator
from haptorb.control.modes import MODES, Gains, Mode, TwoModes
from haptorb.devices.device import Device
from haptorb.devices.motor_doors import motor
from haptorb.devices.spherical_motor import SphericalMotor
from haptorb.errors import UnknownName
from haptorb.runtime.guided_handle import Handle
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.pointer_pose import PointerPose
from haptorb.runtime.real_driver import is_real, real_driver
from haptorb.runtime.tick import Tick
from haptorb.sensing.estimator import Estimator, TrackedPose
from haptorb.worlds.world import World

__all__ = [
    "DRIVERS",
    "MOTOR_GAINS",
    "TRACKERS",
    "allocator_of",
    "assemble",
    "default_world",
    "estimator_of",
    "estimators_of",
    "known_driver",
    "known_estimator",
    "known_tracker",
    "linkage_of",
    "modes_of",
]

DRIVERS = ("sim",)
TRACKERS = ("pointer",)
#: 40° of handle, which a hand can sweep within the workspace, pull the plug all the way out; else the defaults
MOTOR_GAINS = Gains(translate=(0.024, 0.004, 0.01))


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


def default_world(device: Device) -> str:
    """The world that shows `device` best.

    >>> from haptorb.devices.loader import load
    >>> default_world(load("omni"))
    'dome'
    """
    return "outlet" if isinstance(device, SphericalMotor) else "dome"


def modes_of(device: Device) -> tuple[Mode, ...]:
    """The modes in which `device` can move the world's object; none for a device that acts on it directly."""
    return MODES if isinstance(device, SphericalMotor) else ()


def estimators_of(device: Device) -> tuple[str, ...]:
    """Names of the estimators that `device` can have, the default first."""
    return ("least-squares", "tracker") if isinstance(device, SphericalMotor) else ("tracker",)


def known_estimator(device: Device, name: str | None) -> str:
    """`name` itself, or the default of `device` for None; UnknownName for what it cannot have."""
    known = estimators_of(device)
    if name is None:
        return known[0]
    if name not in known:
        raise UnknownName(f"estimator of device '{device.name}'", name, known)
    return name


def estimator_of(device: Device, name: str, level: str | None) -> Estimator:
    """The estimator `name` of `device`, its model at `level`."""
    if name == "least-squares":
        from haptorb.sensing.orientation import LeastSquaresOrientation

        return LeastSquaresOrientation(motor(device))
    return TrackedPose(device, level)


def allocator_of(device: Device) -> Allocator:
    """The one for `device`; what the model knows of the passive wrench is taken out (at level "dipole" nothing)."""
    limit = device.coils.current_limit
    if isinstance(device, SphericalMotor):
        return MinimumPowerAllocator(limit, resistance=device.coils.resistance, compensate_passive=True)
    return LeastSquaresAllocator.force(limit, compensate_passive=True)


def linkage_of(device: Device, gains: Gains | None = None) -> Linkage:
    """How `device` moves the world's object: a motor through two modes, a tool is the object itself."""
    if isinstance(device, SphericalMotor):
        return ModedLinkage(TwoModes(gains or MOTOR_GAINS))
    return Direct()


def assemble(
    device: Device,
    world: World,
    driver: str,
    rate: float,
    seed: int,
    level: str | None,
    tracker: PointerTracker,
    *,
    estimator: str | None = None,
    gains: Gains | None = None,
) -> Tick:
    """The chain that renders `world` on `device` at `rate` [Hz]; coils are off until its driver is opened."""
    from haptorb.runtime.sim_driver import SimDriver  # the simulation is loaded only where it runs

    known_driver(driver)
    dt = 1.0 / rate
    real = is_real(driver)
    if isinstance(device, SphericalMotor):
        tracker.guide = Handle()
    return Tick(
        device,
        world,
        real_driver(driver, device, PointerPose(tracker)) if real else SimDriver.of(device, dt, tracker.goal, seed),
        estimator_of(device, known_estimator(device, estimator), level),
        allocator_of(device),
        dt,
        linkage_of(device, gains),
    )
