"""Stop, from any source straight to the servo; a request before a Stop cannot switch on after it.

No queue, no lock, no database: a Stop is a count and one write into the servo's memory. Any thread may call it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, final

from haptorb.errors import InputError
from haptorb_study.database import utc_now

if TYPE_CHECKING:
    from haptorb.runtime.servo import Servo

__all__ = ["StopCount", "StopEvent", "StopSwitch"]

_MOST = 100  #: Stops that are not recorded yet, at most


@dataclass(frozen=True)
class StopCount:
    """How often Stop had been given when a person asked for something: taken when the request arrives."""

    number: int  #: of the last Stop
    servo: Servo | None  #: that was attached
    stops: int  #: its own count


@dataclass(frozen=True)
class StopEvent:
    """A Stop that is to be recorded."""

    number: int
    why: str
    at: str  #: time of day, ISO 8601


@final
class StopSwitch:
    """Holds the servo of a session, if there is one, so that Stop reaches it at any moment, also while it starts."""

    def __init__(self) -> None:
        self.why = ""  #: of the Stop that stands
        self._servo: Servo | None = None
        self._numbers = count(1)
        self._last = 0  # number of the last Stop
        self._cleared = 0  # number of the last Stop after which the coils were switched on again
        self._unrecorded: deque[StopEvent] = deque(maxlen=_MOST)

    @property
    def active(self) -> bool:
        """Whether a Stop was given, without a resume since."""
        return self._last != self._cleared

    def stop(self, why: str | None = "") -> None:
        """Coils off now. `why` is for the record; None: it need not be recorded, the session ends anyway."""
        stood = self.active
        # The number first: `attach` sets the servo first and then looks at the number, so one of the two stops it.
        self._last = number = next(self._numbers)
        servo = self._servo
        if servo is not None:
            servo.stop()
        if not stood:
            self.why = why or ""
            if why is not None:
                self._unrecorded.append(StopEvent(number, why, utc_now()))

    def ask(self) -> StopCount:
        """What is to travel with a request from the moment at which it arrives."""
        servo = self._servo
        return StopCount(self._last, servo, 0 if servo is None else servo.stops)

    def attach(self, servo: Servo, asked: StopCount) -> None:
        """From now on Stop reaches `servo`, which need not be open yet. A Stop after `asked` holds for it already."""
        self._cleared = asked.number
        self._servo = servo
        if self.active:  # safety: study-stop-starting
            servo.stop()
        while self._unrecorded and self._unrecorded[0].number <= asked.number:
            self._unrecorded.popleft()

    def detach(self) -> None:
        """The session is over: there is nothing to stop any more."""
        self._servo = None

    def engage(self, asked: StopCount) -> None:
        """Coils on again, from zero, as was asked for at `asked`; InputError if Stop was given since.

        The servo looks once more, so that a Stop which comes while this runs holds as well.
        """
        servo = self._servo
        if servo is None or asked.servo is not servo:
            raise InputError("no device is running")
        if asked.number != self._last:  # safety: study-asked-before
            raise InputError(
                "Stop was pressed in the meantime: the coils stay off. Press Resume again when everybody is ready"
            )
        servo.engage(asked.stops)  # safety: study-stop-engaging
        self._cleared = asked.number

    def take(self) -> list[StopEvent]:
        """The Stops that are to be recorded, oldest first; each is given once."""
        return [self._unrecorded.popleft() for _ in range(len(self._unrecorded))]
