"""A second process that switches the coils off when the first one ends or hangs: a Raspberry Pi has no firmware.

    python -m haptorb.runtime.drivers.i2c_guardian BUS ADDRESS

It reads heartbeats from its standard input, `1` while coils are engaged, `0` when they are not, and answers each on its
standard output. While engaged, 15 ms without one, or the end of the input, switch the PWM chip off: again and again,
until reading its registers back shows it. It cannot help when the computer's own kernel stops: for that a monostable
keeps the chip's OE pin (docs/reference/hardware.md).
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

__all__ = ["ANSWER", "PATIENCE", "Guardian", "serve", "switch_off", "watch"]

PATIENCE = 0.015  #: between two heartbeats while the coils are engaged [s]
ANSWER = 0.010  #: from the last answer to a heartbeat, after which the guardian counts as stopped [s]

_RETRY_INTERVAL_S = 2e-3  #: between two tries to switch off [s]
_PRIORITY = 41  #: before every loop: one that never sleeps must not keep its guardian from the processor


def watch(heartbeats: int, off: Callable[[], None], patience: float = PATIENCE, answers: int | None = None) -> bool:
    """Watch the file descriptor `heartbeats` until it ends (True) or falls silent while engaged (False); then `off`.

    Every heartbeat is answered on the file descriptor `answers`. After a silence no heartbeat counts any more: the
    descriptor is closed first, so that a program which comes back to life finds that out with its next heartbeat and
    cannot switch on by itself.
    """
    engaged = False
    while True:
        ready, _, _ = select.select((heartbeats,), (), (), patience if engaged else None)
        data = os.read(heartbeats, 4096) if ready else b""
        if not data:
            os.close(heartbeats)
            off()
            return bool(ready)
        if answers is not None:
            with suppress(OSError):  # a host that no longer reads it sees the end of its pipe
                os.write(answers, b".")  # safety: guardian-answers
        engaged = data.endswith(b"1")


def switch_off(pwm: Pca9685, wait: Callable[[float], None] = sleep) -> None:
    """Try until the chip confirms that every output is off, however long that takes."""
    while True:
        # However the bus responds or fails, there is only one thing to do.
        with suppress(Exception):
            if pwm.switch_off():
                return
        wait(_RETRY_INTERVAL_S)  # safety: guardian-tries


@final
class Guardian:
    """The other process, seen from the one with the loop; `command` starts it, with the descriptors `inherited`.

    It is there once `wait_until_ready` says so.
    """

    def __init__(
        self, command: Sequence[str], inherited: Sequence[int] = (), clock: Callable[[], float] = monotonic
    ) -> None:
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=inherited,
            start_new_session=True,  # what stops the program by the keyboard must not stop its guardian first
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._pipes = self._process.stdin, self._process.stdout
        self._beats, self._answers = (pipe.fileno() for pipe in self._pipes)  #: −1 once closed
        os.set_blocking(self._beats, False)
        os.set_blocking(self._answers, False)
        self._clock = clock
        self._last_answer = clock()
        self._engaged = self._ready = False

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def wait_until_ready(self, patience: float) -> bool:
        """Whether it watches; waits for its first word for at most `patience` [s]."""
        if not self._ready and self._answers >= 0:
            readable, _, _ = select.select((self._answers,), (), (), patience)
            self._ready = bool(readable) and os.read(self._answers, 1) == b"+"
        return self._ready and not self.ended

    def beat(self, engaged: bool) -> None:
        """Still here. DriverError if the guardian is not, or did not answer for 10 ms: without it no current may flow.
        Never waits."""
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
        if engaged and not self._engaged:  # at rest there are no heartbeats, so none was received
            self._last_answer = now
        self._engaged = engaged
        if engaged and now - self._last_answer > ANSWER:  # safety: guardian-silent
            raise DriverError(
                f"the guardian of the I²C bus did not answer for {1e3 * ANSWER:g} ms (stopped, or a busy computer)"
            )

    @property
    def ended(self) -> bool:
        """Whether its process has: its last deed succeeded, or it was killed."""
        return self._process.poll() is not None

    def leave(self) -> None:
        """Let it switch off until the chip confirms it, and end; the caller does not wait."""
        self._beats = -1
        with suppress(OSError):
            self._pipes[0].close()

    def end(self, patience: float) -> bool:
        """Once off is confirmed: let it end, within `patience` [s], or kill it; whether it has ended."""
        self.leave()
        for last in (False, True):
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(patience)
                self._answers = -1
                self._pipes[1].close()
                return True
            if not last:
                self._process.kill()
        return False


def serve(bus: I2cBus, address: int) -> None:
    """What the process does: switch the chip at `address` off, report it, watch, and switch it off again."""
    with suppress(OSError):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))  # the loop binds itself, and who it starts, to one core
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    pwm = Pca9685(bus, address)
    switch_off(pwm)
    os.set_blocking(1, False)
    os.write(1, b"+")
    watch(0, lambda: switch_off(pwm), answers=1)


def main(arguments: list[str]) -> int:
    """The guardian's own program."""
    serve(LinuxBus(int(arguments[0])), int(arguments[1]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
