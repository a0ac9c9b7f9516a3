"""Stop switch: Stop goes directly to the servo, and earlier requests cannot switch the coils on afterwards.

No queue, no lock, no database: a Stop is a count and one write into the servo's memory. Any thread may call it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, final

from haptorb.errors import InputError
from haptorb_study.json_values import utc_now

if TYPE_CHECKING:
    from haptorb.runtime.servo import Servo

__all__ = ["StopCount", "StopEvent", "StopSwitch"]

_MAX_UNRECORDED_STOPS = 100  #: unrecorded Stops at most


@dataclass(frozen=True)
class StopCount:
    """Number of Stops at the time of a request, read when the request arrives."""

    number: int  #: of the last Stop
    servo: Servo | None  #: servo attached at that time
    stops: int  #: the servo's own stop count


@dataclass(frozen=True)
class StopEvent:
    """A Stop that is to be recorded."""

    number: int
    why: str
    at: str  #: time of day, ISO 8601


@final
class StopSwitch:
    """Stop switch of a session: reaches its servo at any moment, also while it starts."""

    def __init__(self) -> None:
        self.why = ""  #: cause of the Stop in force
        self._servo: Servo | None = None
        self._numbers = count(1)
        self._last_stop = 0  # number of the last Stop
        self._last_cleared = 0  # number of the last Stop before the coils were switched on again
        self._unrecorded: deque[StopEvent] = deque(maxlen=_MAX_UNRECORDED_STOPS)

    @property
    def active(self) -> bool:
        """Whether a Stop is in force: none resumed since."""
        return self._last_stop != self._last_cleared

    def stop(self, why: str | None = "") -> None:
        """Switch the coils off now. `why` is recorded; None: not recorded, because the session ends anyway."""
        # Without a servo, a Stop that still stands is the previous session's: the next one needs the new cause.
        stood = self.active and self._servo is not None
        # Number before servo: `attach` sets the servo before it reads the number, so one of the two stops it.
        self._last_stop = number = next(self._numbers)
        servo = self._servo
        if servo is not None:
            servo.stop()
        if not stood:
            self.why = why or ""
            if why is not None:
                self._unrecorded.append(StopEvent(number, why, utc_now()))

    def read_count(self) -> StopCount:
        """Stop count to pass on with a request, read when it arrives."""
        servo = self._servo
        return StopCount(self._last_stop, servo, 0 if servo is None else servo.stops)

    def attach(self, servo: Servo, asked: StopCount) -> None:
        """Attach `servo`, open or not; a Stop since `asked` already applies to it."""
        self._last_cleared = asked.number
        self._servo = servo
        if self.active:  # safety: study-stop-starting
            servo.stop()
        while self._unrecorded and self._unrecorded[0].number <= asked.number:
            self._unrecorded.popleft()
        while len(self._unrecorded) > 1:  # a Stop that still stood when others came is the one that counts
            self._unrecorded.pop()
        self.why = self._unrecorded[0].why if self._unrecorded else ""

    def detach(self) -> None:
        """Detach the servo: the session is over."""
        self._servo = None

    def engage(self, asked: StopCount) -> None:
        """Switch the coils on from zero, as requested at `asked`; InputError if Stop was given since.

        The servo checks the count again, so that a Stop during this call also has priority.
        """
        servo = self._servo
        if servo is None or asked.servo is not servo:
            raise InputError("no device is running")
        if asked.number != self._last_stop:  # safety: study-asked-before
            raise InputError(
                "Stop was pressed in the meantime: the coils stay off. Press Resume again when all are ready"
            )
        servo.engage(asked.stops)  # safety: study-stop-engaging
        self._last_cleared = asked.number

    def pop_unrecorded(self) -> list[StopEvent]:
        """Remove and return the Stops that are to be recorded, oldest first."""
        return [self._unrecorded.popleft() for _ in range(len(self._unrecorded))]
