"""From names to a chain: which driver, which estimator, which allocator a device gets."""

from __future__ import annotations

from haptorb.control.allocation.allocator import Allocator
from haptorb.control.allocation.least_squares import LeastSquaresAllocator
from haptorb.control.allocation.minimum_power import MinimumPowerAllocator
from haptorb.control.clutch.linkage import Direct, Linkage, ModedLinkage
from haptorb.control.clutch.modes import MODES, Gains, Mode, TwoModes
from haptorb.devices.device import Device
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.motor.api import motor
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import InputError, UnknownName
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.driver_registry import is_real, real_driver
from haptorb.runtime.pointer.guided_handle import Handle
from haptorb.runtime.pointer.pointer import PointerTracker
from haptorb.runtime.tick.tick import Tick
from haptorb.runtime.trackers.tracker import Tracker
from haptorb.sensing.calibration.calibration import Calibration
from haptorb.sensing.estimator import Estimator, TrackedPose
from haptorb.worlds.world import World

__all__ = [
    "DRIVERS",
    "MOTOR_GAINS",
    "allocator_of",
    "assemble",
    "default_world",
    "electromagnet",
    "estimator_of",
    "estimators_of",
    "known_driver",
    "known_estimator",
    "linkage_of",
    "modes_of",
]

DRIVERS = ("sim",)
#: 40° of handle, which a hand can sweep within the workspace, pull the plug all the way out; else the defaults
MOTOR_GAINS = Gains(translate=(0.024, 0.004, 0.01))


def known_driver(name: str) -> str:
    """`name` itself, or UnknownName; whether a port or bus is there shows when it is opened."""
    if name not in DRIVERS and not is_real(name):
        raise UnknownName("driver", name, (*DRIVERS, "serial:PORT", "i2c:BUS"))
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
    if not isinstance(device, SphericalMotor):
        return ("tracker", "hall") if device.sensors > 1 else ("tracker",)
    from haptorb.sensing.registry import FIELD_ESTIMATORS

    return (*FIELD_ESTIMATORS, "tracker")


def known_estimator(device: Device, name: str | None) -> str:
    """`name` itself, or the default of `device` for None; UnknownName for what it cannot have, InputError for networks
    that nobody has trained yet."""
    known = estimators_of(device)
    if name is None:
        return known[0]
    if name not in known:
        raise UnknownName(f"estimator of device '{device.name}'", name, known)
    if name == "network":
        from haptorb.sensing.torque_maps.network_file import known_networks

        known_networks(motor(device))
    return name


def estimator_of(
    device: Device, name: str, level: str | None, offsets: Array | None = None, *, in_turns: bool = False
) -> Estimator:
    """The estimator `name` of `device`, its model at `level`; `offsets` (k, 3) [T] of its field sensors, if known.

    in_turns: the driver reads a part of the field sensors in each tick.
    """
    if name == "tracker":
        return TrackedPose(device, level)
    if name == "hall":
        from haptorb.sensing.tool.tool_position import IN_TURNS, HallTracker

        if in_turns:
            return HallTracker(electromagnet(device), level, offsets=offsets, bandwidth=IN_TURNS)
        return HallTracker(electromagnet(device), level, offsets=offsets)
    from haptorb.sensing.registry import field_estimator

    return field_estimator(name, motor(device))


def electromagnet(device: Device) -> SphericalElectromagnet:
    """`device`, if it is a spherical electromagnet; InputError if not."""
    if not isinstance(device, SphericalElectromagnet):
        raise InputError(
            f"device '{device.name}' is no spherical electromagnet: it has no Hall tracker, and no calibration"
        )
    return device


def allocator_of(device: Device) -> Allocator:
    """The one for `device`; what the model knows of the passive wrench is taken out (at level "dipole" nothing)."""
    limit = device.coils.current_limit
    if isinstance(device, SphericalMotor):
        return MinimumPowerAllocator(limit, resistance=device.coils.resistance, compensate_passive=True)
    return LeastSquaresAllocator.force(limit, compensate_passive=True)


def linkage_of(device: Device, gains: Gains | None = None) -> Linkage:
    """How `device` moves the world's object: a motor through two modes, a tool is the object itself."""
    if isinstance(device, SphericalMotor):
        return ModedLinkage(TwoModes(gains or MOTOR_GAINS), arm=device.rotor.handle_length)
    return Direct()


def assemble(
    device: Device,
    world: World,
    driver: str,
    rate: float,
    seed: int,
    level: str | None,
    tracker: Tracker,
    *,
    estimator: str | None = None,
    gains: Gains | None = None,
    calibration: Calibration | None = None,
    watchdog: bool = True,
) -> Tick:
    """The chain that renders `world` on `device` at `rate` [Hz]; coils are off until its driver is opened.

    What `calibration` measured is believed by everything but the simulated device, which stays what its file says. An
    I²C bus needs a monostable on its PWM chip's OE pin, unless `watchdog` is False.
    """
    from haptorb.runtime.drivers.simulated import SimDriver  # the simulation is loaded only where it runs

    known_driver(driver)
    dt = 1.0 / rate
    real = is_real(driver)
    if isinstance(device, SphericalMotor) and isinstance(tracker, PointerTracker):
        tracker.guide = Handle()
    believed = device if calibration is None else calibration.applied(electromagnet(device))
    offsets = None if calibration is None else calibration.offsets
    known = known_estimator(device, estimator)
    axes = 3 if known == "hall" else 1  # that its sensors must have; what a board has shows when it is opened
    return Tick(
        believed,
        world,
        real_driver(driver, device, tracker.pose, hall_axes=axes, watchdog=watchdog)
        if real
        else SimDriver.of(device, dt, tracker.goal, seed),
        estimator_of(believed, known, level, offsets, in_turns=real),
        allocator_of(device),
        dt,
        linkage_of(device, gains),
    )
