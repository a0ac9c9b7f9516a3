"""What the chain remembered some time ago, so that a trip's black box can be run again from there."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final, final

from haptorb.runtime.exchange.black_box import TICKS
from haptorb.runtime.exchange.kept_state import write_state
from haptorb.runtime.memory.text_slot import TextSlot

__all__ = ["EVERY", "REGULAR", "StateKeeper"]

EVERY: Final = 256  #: ticks from one state to the next
REGULAR: Final = 8  #: states from one that is recorded to the next


@final
class StateKeeper:
    """Asks `remember` for the state every 256 ticks, and writes the one that a trip's black box begins with to `slot`.

    Every 8th goes to `regular`, where the recorder finds it.

    It works behind the tick, when its row is published and its duties are applied.
    """

    def __init__(self, remember: Callable[[], bytes], slot: TextSlot, regular: TextSlot) -> None:
        self._remember, self._slot, self._regular = remember, slot, regular
        self._states: deque[tuple[int, bytes]] = deque(maxlen=3)
        self._due, self._count = EVERY, 0
        remember()  # what it loads, it loads now

    def look(self, tick: int) -> None:
        """`tick` is over, and there is time before the next."""
        if tick >= self._due:
            self._due = tick + EVERY
            self._states.append((tick, self._remember()))
            self._count += 1
            if self._count % REGULAR == 0:  # for the recorder
                write_state(self._regular, *self._states[-1], 0.0)

    def tell(self, tick: int, t: float) -> None:
        """`tick` at `t` [s] has tripped: the newest state from before its black box is the one to begin with."""
        early = [one for one in self._states if one[0] <= tick - TICKS]
        if early:
            write_state(self._slot, *early[-1], t)
