"""A state of the chain in shared memory: its tick, the time of a trip, and the bytes of `tick_state`."""

from __future__ import annotations

import zlib
from base64 import b64decode, b64encode
from contextlib import suppress

from haptorb.errors import InputError
from haptorb.runtime.memory.text_slot import TextSlot

__all__ = ["read_state", "write_state"]


def write_state(slot: TextSlot, tick: int, state: bytes, t: float) -> None:
    """Write the `state` after `tick`, for the trip at `t` [s]; nothing where it is too long for the slot: then
    recordings of a device with very many sensors replay from their beginning only."""
    with suppress(InputError):
        slot.write(f"{tick} {t!r} {b64encode(state).decode()}")


def read_state(slot: TextSlot) -> tuple[int, float, str]:
    """(tick, time of the trip [s], state as `pack_state` writes it); (−1, 0, "") before the first."""
    tick, _, rest = slot.read()[1].partition(" ")
    t, _, text = rest.partition(" ")
    if not text:
        return -1, 0.0, ""
    return int(tick), float(t), b64encode(zlib.compress(b64decode(text))).decode()
