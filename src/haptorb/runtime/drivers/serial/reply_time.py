"""When a board answered, by the clock of the loop that asked it."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

__all__ = ["BoardTime"]

#: From a question's sending to its answer's making [s]: 13 bytes at 1 Mbaud, and their check. What a USB bridge adds is
#: the same for all values in one reply; between its parts the board's own clock counts.
_LINE_DELAY = 0.25e-3


@final
class BoardTime:
    """The last two ticks, by the loop's clock and by the `clock` that gives the time of a request [s].

    An answer is as old as its question, and not as the tick in which it is found: a tick may come late, and the answer
    has then been lying there.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._before = self._here = (0.0, 0.0)

    def tick(self, now: float) -> None:
        """The tick at `now` [s] has begun."""
        self._before, self._here = self._here, (now, self._clock())

    def time_of_answer(self, asked: float) -> float:
        """When the board answered what it was asked at `asked` [s by `clock`], by the loop's clock [s].

        >>> time = iter([10.0, 11.5])
        >>> board = BoardTime(lambda: next(time))
        >>> board.tick(0.0)
        >>> board.tick(1.0)                         # half a second late
        >>> round(board.time_of_answer(10.25), 5)         # asked a quarter of a second after the first began
        0.25025
        """
        at, start = self._here if asked >= self._here[1] else self._before
        return at + (asked - start) + _LINE_DELAY
