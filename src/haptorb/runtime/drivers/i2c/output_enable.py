"""The monostable that enables the PWM chip's outputs for 20 ms after each trigger: is it there, and does it work?

It is what switches off when this computer stops with all its processes. The wiring is in docs/reference/hardware.md.
"""

from __future__ import annotations

from collections.abc import Callable

from haptorb.errors import DriverError
from haptorb.runtime.drivers.i2c.tca9534 import HallSelect

__all__ = ["LONGEST", "SHORTEST", "check_output_enable", "pulse"]

SHORTEST = 0.012  #: of a pulse, so that it lasts from tick to tick also when one is late [s]
LONGEST = 0.030  #: of a pulse: coils are off that long after the last trigger, whatever hangs [s]

_EVERY = 4e-3  #: between two triggers of the test [s]

_WIRE = (
    "wire a 74HC123 (P2 of the TCA9534 to its trigger, its inverted output to OE of the PCA9685, OE to P3, as the "
    "hardware reference shows), or accept the risk (--no-watchdog; in Python watchdog=False)"
)


def pulse(select: HallSelect, clock: Callable[[], float]) -> float:
    """How long OE stays low after the last trigger [s], between SHORTEST and LONGEST; takes 0.15 s.

    For outputs that are off. Raises DriverError, saying what to wire, if OE does not follow: high without triggers,
    low at once with one, low for as long as they come, high again after them. OSError if the TCA9534 does not answer.
    """
    if _measure_duration(select, clock) is None:
        raise DriverError(f"OE of the PCA9685 is low although nothing triggers a monostable: {_WIRE}")
    end = clock() + 2 * LONGEST
    while (now := clock()) < end:
        select.trigger()
        while clock() < now + _EVERY:
            if not select.is_enabled():
                raise DriverError(f"OE of the PCA9685 does not stay low while its monostable is triggered: {_WIRE}")
    select.trigger()
    lasted = _measure_duration(select, clock)
    if lasted is None:
        raise DriverError(f"OE of the PCA9685 is still low {1e3 * LONGEST:g} ms after the last trigger: {_WIRE}")
    if lasted < SHORTEST:
        raise DriverError(
            f"the monostable on OE of the PCA9685 holds for {1e3 * lasted:.1f} ms, not {1e3 * SHORTEST:g} to "
            f"{1e3 * LONGEST:g} ms: check its resistor (82 kΩ) and capacitor (470 nF)"
        )
    return lasted


def check_output_enable(select: HallSelect, clock: Callable[[], float]) -> None:
    """The same in a few messages, for outputs that are off: DriverError if OE stays low, or does not fall when it is
    triggered; takes at most LONGEST. OSError if the TCA9534 does not answer."""
    if _measure_duration(select, clock) is None:
        raise DriverError(f"OE of the PCA9685 is low although nothing triggers a monostable: {_WIRE}")
    select.trigger()
    if not select.is_enabled():
        raise DriverError(f"OE of the PCA9685 does not fall when its monostable is triggered: {_WIRE}")


def _measure_duration(select: HallSelect, clock: Callable[[], float]) -> float | None:
    """How long OE is still low [s]; None if longer than LONGEST."""
    start = clock()
    while select.is_enabled():
        if clock() - start > LONGEST:
            return None
    return clock() - start
