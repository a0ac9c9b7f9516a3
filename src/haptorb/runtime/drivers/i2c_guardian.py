"""Guardian process: switches the coils off when the driver's process ends or hangs, as there is no firmware.

    python -m haptorb.runtime.drivers.i2c_guardian BUS ADDRESS

It reads heartbeats from its standard input, `1` while coils are engaged, `0` when they are not, and answers each on its
standard output. While engaged, 15 ms without one, or the end of the input, switch the PWM chip off: again and again,
until reading its registers back confirms it. It cannot help when the computer's own kernel stops: for that a monostable
controls the chip's OE pin (docs/reference/hardware.md).
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from time import monotonic, sleep
from typing import final

from haptorb.errors import DriverError
from haptorb.runtime.drivers.i2c_chips import I2cBus, LinuxBus, Pca9685

__all__ = ["HEARTBEAT_TIMEOUT_S", "RESPONSE_TIMEOUT_S", "Guardian", "serve", "switch_off", "watch"]

HEARTBEAT_TIMEOUT_S = 0.015  #: heartbeat timeout while the coils are engaged [s]
RESPONSE_TIMEOUT_S = 0.010  #: time since the last answer to a heartbeat after which the guardian counts as stopped [s]

_RETRY_INTERVAL_S = 2e-3  #: between two tries to switch off
_PRIORITY = 41  #: above every loop: one that never sleeps must not starve its guardian


def watch(
    heartbeats: int, off: Callable[[], None], timeout: float = HEARTBEAT_TIMEOUT_S, answers: int | None = None
) -> bool:
    """Monitor the file descriptor `heartbeats` until it ends (True) or times out while engaged (False); then `off`.

    Every heartbeat is answered on the file descriptor `answers`. After a timeout no heartbeat is accepted any more: the
    descriptor is closed first, so that the next heartbeat of a program that resumes fails and it cannot switch on by
    itself.
    """
    engaged = False
    while True:
        ready, _, _ = select.select((heartbeats,), (), (), timeout if engaged else None)
        data = os.read(heartbeats, 4096) if ready else b""
        if not data:
            os.close(heartbeats)
            off()
            return bool(ready)
        if answers is not None:
            with suppress(OSError):  # a host that does not read it detects the end of its pipe
                os.write(answers, b".")  # safety: guardian-answers
        engaged = data.endswith(b"1")


def switch_off(pwm: Pca9685, wait: Callable[[float], None] = sleep) -> None:
    """Try without limit until the chip confirms that every output is off."""
    while True:
        # Any failure of the bus is handled the same way: try again.
        with suppress(Exception):
            if pwm.switch_off():
                return
        wait(_RETRY_INTERVAL_S)  # safety: guardian-tries


@final
class Guardian:
    """The guardian process as used by the driver; `command` starts it, with the descriptors `inherited`.

    It is active once `wait_until_ready` returns True.
    """

    def __init__(
        self, command: Sequence[str], inherited: Sequence[int] = (), clock: Callable[[], float] = monotonic
    ) -> None:
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=inherited,
            start_new_session=True,  # Ctrl-C in the terminal must not end the guardian before the program
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._pipes = self._process.stdin, self._process.stdout
        self._beats, self._answers = (pipe.fileno() for pipe in self._pipes)  #: −1 when closed
        os.set_blocking(self._beats, False)
        os.set_blocking(self._answers, False)
        self._clock = clock
        self._last_answer = clock()
        self._engaged = self._ready = False

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def wait_until_ready(self, timeout: float) -> bool:
        """Wait for its ready message, for at most `timeout` [s]; return whether it is active."""
        if not self._ready and self._answers >= 0:
            readable, _, _ = select.select((self._answers,), (), (), timeout)
            self._ready = bool(readable) and os.read(self._answers, 1) == b"+"
        return self._ready and not self.ended

    def beat(self, engaged: bool) -> None:
        """Send a heartbeat. DriverError if the guardian has ended, or did not respond for 10 ms: no current may flow
        without it. Non-blocking."""
        now = self._clock()
        try:
            os.write(self._beats, b"1" if engaged else b"0")
        except OSError as cause:
            raise DriverError(
                "the guardian of the I²C bus has switched off: the host was silent for 15 ms (a busy computer)"
            ) from cause
        with suppress(BlockingIOError):
            if not os.read(self._answers, 4096):
                raise DriverError("the guardian of the I²C bus has ended; start this program again")
            self._last_answer = now
        if engaged and not self._engaged:  # there were no heartbeats before, so no answers either
            self._last_answer = now
        self._engaged = engaged
        if engaged and now - self._last_answer > RESPONSE_TIMEOUT_S:  # safety: guardian-silent
            raise DriverError(
                f"the guardian of the I²C bus did not respond for {1e3 * RESPONSE_TIMEOUT_S:g} ms (stopped, or a busy "
                "computer)"
            )

    @property
    def ended(self) -> bool:
        """Whether its process has ended: it has switched off, confirmed, or was killed."""
        return self._process.poll() is not None

    def leave(self) -> None:
        """Let it switch off until the chip confirms it, and end; non-blocking."""
        self._beats = -1
        with suppress(OSError):
            self._pipes[0].close()

    def end(self, timeout: float) -> bool:
        """End it once off is confirmed, within `timeout` [s], or kill it; return whether it has ended."""
        self.leave()
        for last in (False, True):
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout)
                self._answers = -1
                self._pipes[1].close()
                return True
            if not last:
                self._process.kill()
        return False


def serve(bus: I2cBus, address: int) -> None:
    """Run the guardian: switch the chip at `address` off, report that, monitor heartbeats, and switch off again."""
    with suppress(OSError):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))  # the loop binds itself and its children to one core
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    pwm = Pca9685(bus, address)
    switch_off(pwm)
    os.set_blocking(1, False)
    os.write(1, b"+")
    watch(0, lambda: switch_off(pwm), answers=1)


def main(arguments: list[str]) -> int:
    """Entry point of the guardian process."""
    serve(LinuxBus(int(arguments[0])), int(arguments[1]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
