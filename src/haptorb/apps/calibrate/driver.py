"""From `--driver` to what calibration needs: a driver without a tool near the device, and a clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from haptorb.apps.calibrate.measure import Pace
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.driver import Driver
from haptorb.runtime.drivers.driver_registry import is_real, real_driver

__all__ = ["Hand", "hold_tool", "make_driver"]

Hand = Literal["away", "summit", "led"]  #: where a hand has the tool

_STEP = 2e-3  #: of the simulated device [s]
_COARSE = 1e-3  #: of its physics: nothing moves, and currents and heat are exact in steps of any length [s]
_PATIENCE = 0.05  #: for an answer: six minutes of heat should not end with a moment's hesitation of the device [s]


@dataclass(frozen=True)
class _ClampedHand:
    """A hand that holds the tool still, upright."""

    p: Array
    q: Array
    stamp: float = 0.0
    held: bool = False
    still: bool = False


def make_driver(
    name: str, device: SphericalElectromagnet, seed: int = 0, *, watchdog: bool = True
) -> tuple[Driver, Pace]:
    """The driver `name` of `device`, not open yet, and its pace; UnknownName or InputError if there is no such."""
    if is_real(name):
        return real_driver(name, device, patience=_PATIENCE, watchdog=watchdog), Pace()
    from haptorb.runtime.drivers.sim_driver import SimDriver
    from haptorb.runtime.tick.assembly import check_driver
    from haptorb.simulation.electromagnet.electromagnet import SimulatedElectromagnet

    check_driver(name)
    driver = SimDriver(SimulatedElectromagnet(device, seed, step=_COARSE), _STEP, seed=seed)
    hold_tool(driver, device, "away")
    return driver, Pace.for_simulation()


def hold_tool(driver: Driver, device: SphericalElectromagnet, hand: Hand) -> None:
    """Let a simulated hand hold the tool on the summit, half a metre above it, or lead it over the dome; with a real
    device a person does."""
    from haptorb.runtime.drivers.sim_driver import SimDriver
    from haptorb.simulation.led_tool import lead_tool

    if isinstance(driver, SimDriver):
        if hand == "led":
            driver.goal = lambda now: _ClampedHand(*lead_tool(device, now), now)
            return
        height = device.contact_distance if hand == "summit" else 0.5
        held = _ClampedHand(np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 0.0, 1.0]))
        driver.goal = lambda now: held
