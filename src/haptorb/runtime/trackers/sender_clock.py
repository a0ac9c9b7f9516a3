"""Clock synchronisation: converts the timestamps of a sender to this computer's clock.

The difference between arrival and the sender's time is the clocks' offset plus the transport delay. Its minimum
over the last seconds is the offset plus the shortest delay, so a pose with the shortest delay has age zero, and a
delayed one is as old as its additional delay. The shortest delay itself cannot be measured from one end.
"""

from __future__ import annotations

from math import ulp
from typing import final

__all__ = ["RESTART_GAP_S", "SenderClock"]


RESTART_GAP_S = 0.25  #: silence after which the sender may have restarted, with another clock [s]

_MAX_RESOLUTION_S = 1e-4  #: coarsest valid resolution of a timestamp
_MAX_REPEATS = 2  #: successive different poses with the same timestamp that show that it is rounded
_WINDOW_S = 10.0  #: window of the minimum: clocks drift by 100 µs/s at most, a millisecond in this time


def _describe_time(seconds: float) -> str:
    """Format `seconds` in a suitable unit.

    >>> _describe_time(128.0), _describe_time(0.0078125)
    ('128 s', '7.8 ms')
    """
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{1e3 * seconds:.2g} ms"


@final
class SenderClock:
    """Estimates a sender's clock offset: the minimum over the current window and the one before it.

    remark   why the sender's times are not used, for the user; empty while they are

    >>> clock = SenderClock()
    >>> clock.stamp(5.000, 100.010), round(clock.stamp(5.010, 100.025), 9)       # the second was delayed by 5 ms
    (100.01, 100.02)
    """

    def __init__(self) -> None:
        self._since = self._last = float("-inf")
        self._least = self._before = float("inf")
        self._sent = float("nan")
        self._repeated = 0
        self.remark = ""

    def stamp(self, sent: float, arrival: float, resolution: float = 0.0, *, changed: bool = False) -> float:
        """Convert the sender's time `sent` [s] of a pose to the clock of `arrival` [s]; never later than it.

        resolution  of `sent` as it was transmitted [s]; that of a double is known
        changed     this pose differs from the one before

        Both times must be finite. A time that is coarser than 0.1 ms, or that several successive different poses have
        in common, is not used: the pose then has the time of its arrival.
        """
        if arrival - self._last > RESTART_GAP_S:
            self._least = self._before = float("inf")
            self._repeated, self.remark = 0, ""
        self._last = arrival
        self._repeated = self._repeated + 1 if changed and sent == self._sent else 0
        self._sent = sent
        if (coarse := max(resolution, ulp(sent))) > _MAX_RESOLUTION_S:
            self.remark = f"its times have a resolution of {_describe_time(coarse)}: the time of arrival is used"
        elif self._repeated >= _MAX_REPEATS:
            self.remark = "several poses have the same time: the time of arrival is used"
        if self.remark:  # safety: sender-time
            return arrival
        offset = arrival - sent
        if arrival - self._since > _WINDOW_S:
            self._before = self._least
            self._least, self._since = offset, arrival
        self._least = min(self._least, offset)
        # safety: stamp-before-arrival
        return min(sent + min(self._least, self._before), arrival)  # also not by rounding
