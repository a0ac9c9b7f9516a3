"""Assembles the control chain from the description of a run: driver, estimator, world, allocator and linkage."""

from __future__ import annotations

from haptorb.arrays import one_block
from haptorb.control.linkage import make_linkage
from haptorb.control.registry import make_allocator, make_choice
from haptorb.devices.api import electromagnet
from haptorb.estimation.registry import check_estimator, list_estimators, make_estimator
from haptorb.runtime.config import RunConfig
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.registry import check_driver, real_driver
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.tick import Tick
from haptorb.runtime.trackers.base import Tracker
from haptorb.simulation.hand_motion import guide_hand

__all__ = ["assemble", "make_tick"]


def assemble(config: RunConfig, tracker: Tracker) -> Tick:
    """Build the control chain of the run `config`, with poses from `tracker`; coils are off until its driver is opened.

    The calibrated values are used by everything but the simulated device, which uses the values of its file.
    """
    from haptorb.runtime.drivers.sim import SimDriver  # the simulation is loaded only where it runs

    device = config.device
    check_driver(config.driver)
    if isinstance(tracker, PointerTracker):
        tracker.guide = config.hand or guide_hand(device)
        tracker.waits = config.hand is not None and config.hand_start == "program"
    # The number of axes of a board's sensors is checked when the driver opens it.
    axes = list_estimators(device)[check_estimator(device, config.estimator)].axes
    driver = (
        real_driver(config.driver, device, tracker.pose, hall_axes=axes, watchdog=config.watchdog)
        if config.is_real
        else SimDriver.of(device, 1.0 / config.rate, tracker.goal, config.seed)
    )
    return make_tick(config, driver)


def make_tick(config: RunConfig, driver: Driver) -> Tick:
    """Build the control chain of the run `config` on `driver`."""
    device, calibration, name = config.device, config.calibration, config.estimator
    believed = device if calibration is None else calibration.apply(electromagnet(device, "a calibration"))
    offsets = None if calibration is None else calibration.offsets
    # A recording contains its estimator's trained data, which this computer need not have.
    known = name if config.learned and name else check_estimator(device, name)
    with one_block():
        return Tick(
            believed, config.world, driver,
            make_estimator(
                believed, known, config.model, offsets, in_turns=config.is_real, learned=config.learned
            ),
            make_allocator(device), 1.0 / config.rate, make_linkage(device, config.gains),
            choice=make_choice(device, config.render, config.torque_arm),
        )  # fmt: skip
