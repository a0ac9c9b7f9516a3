"""Snapshots of the chain every so many ticks: from there a recording, or a trip's black box, can be run again."""

from __future__ import annotations

from typing import Final, final

from haptorb.runtime.exchange.black_box import TICKS
from haptorb.runtime.memory.state_slots import SLOTS, StateSlots
from haptorb.runtime.tick.tick_state import TickState

__all__ = ["EVERY", "StateKeeper"]

EVERY: Final = 256  #: ticks from one snapshot to the next


@final
class StateKeeper:
    """Copies `state` every 256 ticks into the next of `slots`, where the recorder finds it: memory that is there.

    A snapshot that is too long for the slots is not taken: then recordings of a device with very many sensors replay
    from their beginning only.
    """

    def __init__(self, state: TickState, slots: StateSlots) -> None:
        self._state, self._slots = state, slots
        self._due, self._count = EVERY, 0
        self._fits = state.size <= slots.room and len(state.layout) <= slots.layout.room
        if self._fits:
            slots.layout.write(state.layout)
            self._places = [state.find_places(body) for body in slots.bodies]
            for places in self._places:  # what it loads, it loads now
                state.copy_to(places)

    def look(self, tick: int) -> None:
        """`tick` is over, and there is time before the next."""
        if tick >= self._due and self._fits:
            self._due = tick + EVERY
            self._count += 1
            self._slots.begin(self._count)
            self._state.copy_to(self._places[self._count % SLOTS])
            self._slots.end(self._count, tick)

    def tell(self, tick: int, t: float) -> None:
        """`tick` at `t` [s] has tripped: the newest snapshot from before its black box is the one to begin with."""
        self._slots.mark_trip(self._count, tick - TICKS, t)
