"""What pages want to feel, and what runs: written by the server's thread and by the one that has the servo."""

from __future__ import annotations

import threading
from typing import Any, Protocol, final

from haptorb.errors import InputError

__all__ = ["BASE", "Selection", "StoppableServo"]

BASE = -1  #: the row that stands for the base device
_NONE = -2  #: no row


class StoppableServo(Protocol):
    """A servo as far as a page of the chooser may command it."""

    def stop(self) -> None:
        """Coils off within a tick, and off until they are engaged."""
        ...


@final
class Selection:
    """The design that is wanted, and the one that runs. Its methods may be called in any thread.

    count   of the rows that can be chosen
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._lock = threading.Lock()
        self._asked = threading.Event()
        self._wanted = self._row = _NONE
        self._state, self._url, self._text = "none", "", ""
        self._servo: StoppableServo | None = None

    def choose(self, row: Any) -> None:
        """A page wants the design in `row`, or the base device.

        InputError if there is none such, or while another starts. The coils of the device that runs go off at once.
        """
        if type(row) is not int or not BASE <= row < self._count:
            raise InputError(f"a row must be a whole number from {BASE} (base device) to {self._count - 1}")
        with self._lock:
            if self._state == "starting":
                raise InputError("another design is starting; wait until it has")
            if self._servo is not None:
                self._servo.stop()
            self._wanted, self._servo = row, None
            self._row, self._state, self._url, self._text = row, "starting", "", ""
        self._asked.set()

    def stop(self) -> None:
        """Coils off, and off until they are engaged in the console."""
        with self._lock:
            if self._servo is not None:
                self._servo.stop()

    @property
    def pending(self) -> bool:
        """Whether a page wants another design than what runs."""
        return self._asked.is_set()

    def wait(self, seconds: float) -> int | None:
        """The row that is wanted, once; None if nothing was within `seconds`."""
        if not self._asked.wait(seconds):
            return None
        with self._lock:
            self._asked.clear()
            return self._wanted

    def report(self, text: str) -> None:
        """What takes long in starting the device."""
        with self._lock:
            self._text = text

    def set_running(self, servo: StoppableServo, url: str) -> None:
        """The wanted device runs, and `url` is its console."""
        with self._lock:
            self._servo, self._state, self._url, self._text = servo, "running", url, ""

    def set_refused(self, text: str) -> None:
        """The wanted device cannot run, or runs no more, because of `text`."""
        with self._lock:
            self._servo, self._state, self._url, self._text = None, "refused", "", text

    def set_ended(self) -> None:
        """The device ends: there is nothing left to stop."""
        with self._lock:
            self._servo = None

    def describe(self) -> dict[str, Any]:
        """What a page shows, as plain JSON types."""
        with self._lock:
            return {
                "state": self._state, "row": max(self._row, BASE), "base": self._row == BASE, "url": self._url,
                "text": self._text,
            }  # fmt: skip
