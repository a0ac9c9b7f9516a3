"""When a sender on another clock measured what it says: its own times, laid onto this computer's clock.

The difference between arrival and the sender's time is the clocks' offset plus the way's delay. The smallest of it over
the last seconds is the offset plus the shortest delay, so a pose that came the shortest way is as old as nothing, and
one that was held up is as old as it was held up. The shortest delay itself cannot be seen from one end.
"""

from __future__ import annotations

from math import ulp
from typing import final

__all__ = ["RESTART_SILENCE", "SenderClock"]

RESTART_SILENCE = 0.25  #: after such a silence the sender may have restarted, with another clock [s]

_COARSEST = 1e-4  #: a number whose resolution is coarser than this is no clock [s]
_WINDOW = 10.0  #: clocks drift by 100 µs in a second at the most: a millisecond in this time [s]


@final
class SenderClock:
    """The least offset over the present window and the one before it.

    >>> clock = SenderClock()
    >>> clock.stamp(5.000, 100.010), round(clock.stamp(5.010, 100.025), 9)       # the second was held up by 5 ms
    (100.01, 100.02)
    """

    def __init__(self) -> None:
        self._since = self._last = float("-inf")
        self._least = self._before = float("inf")

    def stamp(self, sent: float, arrival: float) -> float:
        """When a pose of the sender's time `sent` [s] was measured, on the clock of `arrival` [s]; never later than it.

        Both must be finite.
        """
        if ulp(sent) > _COARSEST:  # safety: sender-time
            return arrival
        offset = arrival - sent
        if arrival - self._last > RESTART_SILENCE:
            self._least = self._before = float("inf")
        self._last = arrival
        if arrival - self._since > _WINDOW:
            self._before = self._least
            self._least, self._since = offset, arrival
        self._least = min(self._least, offset)
        # safety: stamp-before-arrival
        return min(sent + min(self._least, self._before), arrival)  # not ahead of it by rounding, either
