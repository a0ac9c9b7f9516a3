"""From names to a chain: which driver, which estimator, which allocator a device gets."""

from __future__ import annotations

from contextlib import suppress

from haptorb.arrays import Array, one_block
from haptorb.control.allocation import Allocator, WrenchChoice
from haptorb.control.linkage import Gains, Linkage
from haptorb.devices.base import Device
from haptorb.devices.electromagnet import electromagnet
from haptorb.errors import InputError, UnknownName
from haptorb.estimation.calibration import Calibration
from haptorb.estimation.types import Estimator, EstimatorChoice, EstimatorSettings
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.registry import is_real, real_driver
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.tick import Tick
from haptorb.runtime.trackers.base import Tracker
from haptorb.simulation.hand import GuidedMotion
from haptorb.worlds.base import World, check_part

__all__ = [
    "DRIVERS",
    "allocator_of",
    "assemble",
    "check_driver",
    "check_estimator",
    "choice_of",
    "default_world",
    "estimator_of",
    "estimators_of",
    "linkage_of",
    "make_tick",
    "modes_of",
    "read_learned",
]

DRIVERS = ("sim",)


def check_driver(name: str) -> str:
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
    return device.kind.world


def modes_of(device: Device) -> tuple[str, ...]:
    """The modes in which `device` can move the world's object; none for a device that acts on it directly."""
    return device.kind.modes


def estimators_of(device: Device) -> tuple[str, ...]:
    """Names of the estimators that `device` can have, the default first."""
    return tuple(_choices(device))


def _choices(device: Device) -> dict[str, EstimatorChoice]:
    choices: dict[str, EstimatorChoice] = device.kind.part("estimators")(device)
    return choices


def check_estimator(device: Device, name: str | None) -> str:
    """`name` itself, or the default of `device` for None; UnknownName for what it cannot have, InputError for what it
    cannot have yet, such as networks before their training."""
    known = _choices(device)
    if name is None:
        return next(iter(known))
    if name not in known:
        raise UnknownName(f"estimator of device '{device.name}'", name, known)
    check = known[name].check
    if check is not None:
        check(device)
    return name


def estimator_of(
    device: Device,
    name: str,
    model: str | None,
    offsets: Array | None = None,
    *,
    in_turns: bool = False,
    learned: bytes = b"",
) -> Estimator:
    """The estimator `name` of `device`, by its `model`; `offsets` (k, 3) [T] of its field sensors, if known.

    in_turns: the driver reads a part of the field sensors in each tick. learned: as `read_learned` has it, in place of
    what this computer has. Raises UnknownName for an estimator that it cannot have.
    """
    known = _choices(device)
    if name not in known:
        raise UnknownName(f"estimator of device '{device.name}'", name, known)
    return known[name].make(device, EstimatorSettings(model, offsets, in_turns, learned))


def read_learned(device: Device, name: str) -> bytes:
    """The file with what the estimator `name` of `device` learned, such as networks; empty for one that learns nothing,
    or if there is none."""
    read = _choices(device)[name].read_learned
    with suppress(OSError):
        return b"" if read is None else read(device)
    return b""


def allocator_of(device: Device) -> Allocator:
    """The one that `device` has by its kind."""
    allocator: Allocator = device.kind.part("allocator")(device)
    return allocator


def choice_of(device: Device, render: str | None = None, torque_arm: float | None = None) -> WrenchChoice | None:
    """Which part of a world's wrench `device` renders: `render`, or the part that the world defines for None.

    torque_arm: where force and torque are both asked, 1 N weighs as much as this length [m] × 1 N of torque. None for a
    kind of device that has no choice. Raises UnknownName for a part that there is not, InputError for a choice that the
    device has not, and for an arm that is no length.
    """
    part = None if render is None else check_part(render)
    if device.kind.wrench_choice is None:
        if render is None and torque_arm is None:
            return None
        raise InputError(
            f"device '{device.name}' ({device.kind.title}) has no choice of force or torque: it always renders every "
            "component; leave out render and torque arm"
        )
    choice: WrenchChoice = device.kind.part("wrench_choice")(device, part, torque_arm)
    return choice


def linkage_of(device: Device, gains: Gains | None = None) -> Linkage:
    """How `device` moves the world's object: a motor through two modes, a tool is the object itself."""
    linkage: Linkage = device.kind.part("linkage")(device, gains)
    return linkage


def assemble(
    device: Device,
    world: World,
    driver: str,
    rate: float,
    seed: int,
    model: str | None,
    tracker: Tracker,
    *,
    estimator: str | None = None,
    gains: Gains | None = None,
    calibration: Calibration | None = None,
    watchdog: bool = True,
    render: str | None = None,
    torque_arm: float | None = None,
    hand: GuidedMotion | None = None,
) -> Tick:
    """The chain that renders `world` on `device` at `rate` [Hz]; coils are off until its driver is opened.

    hand: motion of the simulated hand; None: that of the kind of device. What `calibration` measured is used by
    everything but the simulated device, which keeps its file's values. An I²C bus needs a monostable on its PWM chip's
    OE pin, unless `watchdog` is False.
    """
    from haptorb.runtime.drivers.sim import SimDriver  # the simulation is loaded only where it runs

    check_driver(driver)
    real = is_real(driver)
    if isinstance(tracker, PointerTracker):
        tracker.guide = hand or device.kind.part("guide")(device)
    axes = _choices(device)[check_estimator(device, estimator)].axes  # what a board has shows when it is opened
    return make_tick(
        device, world,
        real_driver(driver, device, tracker.pose, hall_axes=axes, watchdog=watchdog)
        if real
        else SimDriver.of(device, 1.0 / rate, tracker.goal, seed),
        rate, model,
        estimator=estimator, gains=gains, calibration=calibration, render=render, torque_arm=torque_arm, in_turns=real,
    )  # fmt: skip


def make_tick(
    device: Device,
    world: World,
    driver: Driver,
    rate: float,
    model: str | None,
    *,
    estimator: str | None = None,
    gains: Gains | None = None,
    calibration: Calibration | None = None,
    render: str | None = None,
    torque_arm: float | None = None,
    in_turns: bool = False,
    learned: bytes = b"",
) -> Tick:
    """The chain behind `driver`, as `assemble` makes it; at `rate` [Hz].

    in_turns: the driver reads a part of the field sensors in each tick. learned: as `read_learned` has it, in place of
    what this computer has.
    """
    believed = device if calibration is None else calibration.apply(electromagnet(device, "a calibration"))
    offsets = None if calibration is None else calibration.offsets
    known = estimator if learned and estimator else check_estimator(device, estimator)
    with one_block():
        return Tick(
            believed, world, driver,
            estimator_of(believed, known, model, offsets, in_turns=in_turns, learned=learned),
            allocator_of(device), 1.0 / rate, linkage_of(device, gains), choice=choice_of(device, render, torque_arm),
        )  # fmt: skip
