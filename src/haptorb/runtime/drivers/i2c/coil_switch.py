"""The way from "on" back to "off, as the chip itself says": the PWM chip, and the guardian that watches over it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import final

from haptorb.control.protection.trip import CoilState
from haptorb.errors import DriverError
from haptorb.runtime.drivers.i2c.i2c_chips import Port, Watchdog
from haptorb.runtime.drivers.i2c.pca9685 import Pca9685

__all__ = ["CoilSwitch"]

_CLOSING = 0.25  #: that `close` tries for, at most [s]
_TRIES = 2000  #: the same, for a clock that does not advance
_STARTING = 5.0  #: that a guardian's interpreter takes to start, at most [s]
_LEAVING = 0.05  #: for one that was killed to be gone, when a person engages [s]
_ENDING = 0.5  #: for a guardian to read the chip once more and end [s]
_RESTART = 1.0  #: between two guardians [s]


@final
class CoilSwitch:
    """Whether current can flow through `pwm`'s outputs, as far as the chip confirmed it: `state`.

    A write that failed may have been carried out in part, so the state is UNKNOWN until reading the registers back
    shows every output off. A loop that calls `recover` in every tick tries in every tick; a guardian tries in parallel.
    """

    def __init__(self, pwm: Pca9685, port: Port, clock: Callable[[], float]) -> None:
        self.state = CoilState.OFF  # the chip was set up, and read back
        self._pwm = pwm
        self._port = port
        self._clock = clock
        self._watcher: Watchdog | None = None
        self._leaving = False
        self._started = float("-inf")

    def start(self) -> None:
        """A guardian, and wait for it. DriverError if it does not start."""
        if self._watcher is None:
            self._started = self._clock()
            try:
                self._watcher, self._leaving = self._port.watcher(), False
            except OSError as cause:
                raise DriverError(f"the guardian process of the I²C bus did not start: {cause}") from cause
        if self._watcher is not None and not self._watcher.wait_until_ready(_STARTING):
            self._release_watcher()
            raise DriverError(
                f"the guardian process of the I²C bus did not start within {_STARTING:g} s; close other programs, and "
                "try again"
            )

    def beat(self, engaged: bool) -> None:
        """Tell the guardian. DriverError if it is gone or does not answer."""
        if self._watcher is not None:
            try:
                self._watcher.beat(engaged)
            except DriverError:
                self._release_watcher()
                raise

    def write(self, steps: list[int]) -> None:
        """New duties, in signed steps of 1/4096. OSError if the chip does not answer."""
        self.state = CoilState.ON  # before it is: half a message may move an output
        self._pwm.write(steps)

    def switch_off(self) -> bool:
        """Try once; True if the chip confirms that every output is off."""
        self.state = CoilState.UNKNOWN  # safety: i2c-off-unsaid
        with suppress(OSError):
            if self._pwm.switch_off():
                self.state = CoilState.OFF
        return self.state is CoilState.OFF

    def fail(self) -> None:
        """Try once, and let the guardian try too if that was in vain."""
        if not self.switch_off():
            self._release_watcher()
        elif not self._leaving:
            with suppress(DriverError):
                self.beat(False)

    def _release_watcher(self) -> None:
        if self._watcher is not None:
            self._watcher.leave()
            self._leaving = True

    def recover(self) -> None:
        """What one tick does for a device that has failed: switch off until that is confirmed; then have a guardian
        again, so that a person who engages need not wait for it. Never waits."""
        if self.state is not CoilState.OFF:  # safety: i2c-reading-off
            self.switch_off()
        elif self._is_guardian_gone() and self._clock() - self._started > _RESTART:
            self._started = self._clock()
            with suppress(OSError):
                self._watcher, self._leaving = self._port.watcher(), False

    def _is_guardian_gone(self, patience: float = 0.0) -> bool:
        """Whether there is no guardian any more. One that still tries need not, for off is confirmed."""
        if self._watcher is not None and (self._leaving or self._watcher.ended) and self._watcher.end(patience):
            self._watcher = None
        return self._watcher is None

    def require(self) -> None:
        """DriverError unless the chip confirms that it is off and a guardian watches; until then, engaging is not
        allowed."""
        if self.state is not CoilState.OFF and not self.switch_off():  # safety: i2c-engage-off
            raise DriverError(
                "coil state unknown: the PWM chip has not confirmed that the coils are off. Check the bus and the "
                "supply, then engage again"
            )
        if (self._leaving or (self._watcher is not None and self._watcher.ended)) and not self._is_guardian_gone(
            _LEAVING
        ):
            raise DriverError("the guardian of the I²C bus is still trying to switch off. Engage again in a moment")
        self.start()

    def close(self) -> None:
        """Off, confirmed; then the guardian ends. DriverError if it was not confirmed within a quarter of a second: a
        guardian then keeps trying."""
        end = self._clock() + _CLOSING
        for _ in range(_TRIES):
            if self.switch_off() or self._clock() > end:
                break
        watcher, self._watcher = self._watcher, None
        if self.state is CoilState.OFF:  # safety: i2c-closing
            if watcher is not None:
                watcher.end(_ENDING)
            return
        if watcher is not None:
            watcher.leave()
        raise DriverError(
            f"COIL STATE UNKNOWN: the PWM chip on {self._port.name} did not confirm that the coils are off. Switch the "
            "supply off" + ("; a guardian process keeps trying" if watcher is not None else "")
        )
