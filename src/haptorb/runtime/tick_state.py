"""All that a chain remembers between two ticks, as named arrays: so that a replay can begin in the middle of a run.

The parts of the chain say what they remember (`haptorb.arrays`); where each number lies in a snapshot is
found once. A world's own memory is not in it: the row has it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array, StateArray, Stateful
from haptorb.control.guard import TICKS
from haptorb.errors import RecordingError
from haptorb.runtime.shared_memory import split_snapshot
from haptorb.runtime.tick import Tick

__all__ = ["STATE_TYPES", "TickState", "load_state", "save_state"]

STATE_TYPES: Final = ("<f8", "<i8", "|b1")  #: of the arrays of a state
_ALIGNED: Final = 8  #: bytes
_APART: Final = 512  #: bytes between two arrays of a block that are copied along: cheaper than to copy them apart
_REMEMBERED: Final = 512  #: wrenches in the passivity control's ring of recordings of before it softened worlds


@final
class TickState:
    """Takes snapshots of `tick`.

    size    of a snapshot [bytes]
    layout  JSON for `split_snapshot`: of each array its name, type, shape, first byte, and bytes from one row to the
            next
    """

    def __init__(self, tick: Tick) -> None:
        owners = dict(_walk("tick", tick))
        self._gather = [one.gather_state for one in owners.values() if _overrides(one)]
        named = [
            (f"{prefix}/{name}", array)
            for prefix, owner in owners.items()
            for name, array in owner.state_arrays().items()
        ]
        self._pieces = _join([array for _, array in named])
        sizes = [-(-len(piece) // _ALIGNED) * _ALIGNED for piece in self._pieces]
        self._starts = [sum(sizes[:n]) for n in range(len(sizes))]
        self.size = sum(sizes)
        self.layout = json.dumps(
            [
                [
                    leaf,
                    view.dtype.str,
                    list(view.shape),
                    self._find(view),
                    view.strides[0] if view.ndim and view.size else 0,
                ]
                for name, array in named
                for leaf, view in _leaves(name, array)
            ]
        )

    def _find(self, array: StateArray) -> int:
        """The byte of a snapshot at which `array` begins."""
        at = _address(array)
        for piece, start in zip(self._pieces, self._starts, strict=True):
            if 0 <= at - _address(piece) < len(piece):
                return start + at - _address(piece)
        return 0  # it is empty

    def find_places(self, memory: NDArray[np.uint8]) -> list[tuple[memoryview, memoryview]]:
        """For `copy_to`: where in `memory` (size,) [1] each piece goes."""
        return [
            (memory[start : start + len(piece)].data, piece.data)
            for start, piece in zip(self._starts, self._pieces, strict=True)
        ]

    def copy_to(self, places: list[tuple[memoryview, memoryview]]) -> None:
        """A snapshot of what the tick remembers now, to the `places` in some memory."""
        for gather in self._gather:
            gather()
        for there, here in places:
            there[:] = here


def _join(arrays: list[StateArray]) -> list[NDArray[np.uint8]]:
    """The bytes of all `arrays` in as few pieces as possible: one for all that lie in the same block, side by side."""
    pieces = list[NDArray[np.uint8]]()
    for array in sorted((one for one in arrays if one.nbytes), key=_address):
        bytes_ = array.reshape(-1).view(np.uint8)
        if not np.shares_memory(bytes_, array):
            raise TypeError("a state's arrays must be contiguous")
        first, last, block = _address(array), _address(array) + array.nbytes, _owner(array)
        if pieces and _owner(pieces[-1]) is block and block.flags.c_contiguous:
            before = _address(pieces[-1])
            if first - before - len(pieces[-1]) <= _APART:
                at = before - _address(block)
                pieces[-1] = block.reshape(-1).view(np.uint8)[at : at + max(last - before, len(pieces[-1]))]
                continue
        pieces.append(bytes_)
    return pieces


def _address(array: StateArray) -> int:
    return int(array.__array_interface__["data"][0])


def _owner(array: StateArray) -> StateArray:
    """The array whose memory `array` is a part of, or it itself."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def save_state(tick: Tick) -> dict[str, StateArray]:
    """Name → a copy of each array that `tick` remembers after a step."""
    state = TickState(tick)
    memory = np.zeros(state.size, dtype=np.uint8)
    state.copy_to(state.find_places(memory))
    return split_snapshot(state.layout, memory)


def load_state(tick: Tick, arrays: Mapping[str, StateArray], memory: Array) -> None:
    """Let `tick`, which has just been made, remember what another one did; memory (n,) is that of its world [SI].

    An estimator or linkage of another kind than the one in `arrays` begins anew. Raises RecordingError for arrays that
    are not those of such a chain: names, types and shapes must be the same.
    """
    arrays = _complete_passivity(arrays)
    try:
        for prefix, owner in _walk("tick", tick):
            if not _is_replaced("/".join(prefix.split("/")[:2]), arrays):
                _fill(prefix, owner, arrays)
        tick.take_memory(memory)
    except (ValueError, OverflowError) as cause:  # anybody's numbers
        raise RecordingError(
            f"the state of the loop in the recording does not fit this device and these parts: {cause}"
        ) from cause


#: numbers that the passivity control did not remember before it softened worlds: zero, as at the start
_SOFTENING: Final[Mapping[str, int]] = {
    "softened": 0, "softer": 0, "since": 0, "made": 0, "spread": 0, "poses": 0, "taken": 0, "touched": 0, "spacing": 0,
    "moved": 3, "smooth": 6,
}  # fmt: skip


def _complete_passivity(arrays: Mapping[str, StateArray]) -> Mapping[str, StateArray]:
    """The same; of an older version, with all that the passivity control remembers today, and its newest wrenches."""
    prefix = "tick/protection/state/passivity"
    times, wrenches, count = (arrays.get(f"{prefix}/{name}") for name in ("times", "wrenches", "count"))
    if times is None or wrenches is None or count is None or f"{prefix}/softened" in arrays:
        return arrays
    if times.shape[1:] != (_REMEMBERED,) or wrenches.shape[1:] != (_REMEMBERED, 6) or count.shape != (1,):
        return arrays
    known = dict(arrays)
    numbers = int(count[0]) - 1 - np.arange(TICKS)  # of the newest wrenches
    for name, ring in (("times", times), ("wrenches", wrenches)):
        newest = np.zeros((1, TICKS, *ring.shape[2:]))
        newest[:, numbers % TICKS] = ring[:, numbers % _REMEMBERED]
        known[f"{prefix}/{name}"] = newest
    for name, size in _SOFTENING.items():
        known[f"{prefix}/{name}"] = np.zeros((1, size) if size else 1)
    return known


def _is_replaced(part: str, arrays: Mapping[str, StateArray]) -> bool:
    """Whether `arrays` are of another kind of the chain's `part`, such as "tick/estimator:hall"."""
    role, _, kind = part.partition(":")
    known = {name.split("/")[1] for name in arrays if name.startswith(f"{role}:") and name.count("/") > 1}
    return bool(kind) and bool(known) and part.partition("/")[2] not in known


def _fill(prefix: str, owner: Stateful, arrays: Mapping[str, StateArray]) -> None:
    for name, array in owner.state_arrays().items():
        for leaf, view in _leaves(f"{prefix}/{name}", array):
            given = arrays.get(leaf)
            if given is None:
                raise ValueError(f"it has no '{leaf}'")
            if given.dtype.str != view.dtype.str or given.shape != view.shape:  # safety: state-shapes
                raise ValueError(f"'{leaf}' must be {view.dtype.str} {view.shape}; got {given.dtype.str} {given.shape}")
            view[...] = given
    owner.apply_state()


def _walk(prefix: str, owner: Stateful) -> Iterator[tuple[str, Stateful]]:
    """All that remembers something: by its place in the chain, and its kind where there are several."""
    yield prefix, owner
    for name, part in owner.state_parts().items():
        yield from _walk(f"{prefix}/{name}" + (f":{part.state_kind}" if part.state_kind else ""), part)


def _overrides(owner: Stateful) -> bool:
    return type(owner).gather_state is not Stateful.gather_state


def _leaves(name: str, array: StateArray) -> Iterator[tuple[str, StateArray]]:
    """The arrays of plain numbers that `array` of records consists of."""
    if array.dtype.names is None:
        if array.dtype.str not in STATE_TYPES:
            raise TypeError(f"'{name}' is of {array.dtype.str}; a state has {', '.join(STATE_TYPES)}")
        yield name, array
        return
    for field in array.dtype.names:
        yield from _leaves(f"{name}/{field}", array[field])
