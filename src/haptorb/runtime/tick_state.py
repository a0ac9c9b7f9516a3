"""State of a chain between two ticks, as named arrays, so that a replay can begin in the middle of a run.

The parts of the chain list their state (`haptorb.arrays`); the layout of a snapshot is computed once. It does not
contain a world's own memory, which is in the row.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Final, final

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array, StateArray, Stateful
from haptorb.control.guard import HISTORY_TICKS
from haptorb.errors import RecordingError
from haptorb.runtime.shared_memory import split_snapshot

if TYPE_CHECKING:
    from haptorb.runtime.tick import Tick  # loads the compiler, which the host need not

__all__ = ["STATE_TYPES", "TickState", "load_state", "save_state"]

STATE_TYPES: Final = ("<f8", "<i8", "|b1")  #: types of the arrays of a state
_ALIGNMENT_BYTES: Final = 8  #: alignment of each array
_MAX_GAP_BYTES: Final = 512  #: largest gap between two arrays of a block that are copied in one piece: it is cheaper
_OLD_RING_LENGTH: Final = 512  #: wrenches in the passivity control's ring buffer in recordings of earlier versions


@final
class TickState:
    """Makes snapshots of the state of `tick`.

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
        sizes = [-(-len(piece) // _ALIGNMENT_BYTES) * _ALIGNMENT_BYTES for piece in self._pieces]
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
        """Offset of `array` in a snapshot [bytes]."""
        at = _address(array)
        for piece, start in zip(self._pieces, self._starts, strict=True):
            if 0 <= at - _address(piece) < len(piece):
                return start + at - _address(piece)
        return 0  # it is empty

    def find_places(self, memory: NDArray[np.uint8]) -> list[tuple[memoryview, memoryview]]:
        """List the sources and their destinations in `memory` (size,) [1], for `copy_to`."""
        return [
            (memory[start : start + len(piece)].data, piece.data)
            for start, piece in zip(self._starts, self._pieces, strict=True)
        ]

    def copy_to(self, places: list[tuple[memoryview, memoryview]]) -> None:
        """Copy the current state of the tick to the `places` that `find_places` returned."""
        for gather in self._gather:
            gather()
        for there, here in places:
            there[:] = here


def _join(arrays: list[StateArray]) -> list[NDArray[np.uint8]]:
    """Memory of all `arrays` in as few pieces as possible: one for neighbours in the same block."""
    pieces = list[NDArray[np.uint8]]()
    for array in sorted((one for one in arrays if one.nbytes), key=_address):
        bytes_ = array.reshape(-1).view(np.uint8)
        if not np.shares_memory(bytes_, array):
            raise TypeError("a state's arrays must be contiguous")
        first, last, block = _address(array), _address(array) + array.nbytes, _owner(array)
        if pieces and _owner(pieces[-1]) is block and block.flags.c_contiguous:
            before = _address(pieces[-1])
            if first - before - len(pieces[-1]) <= _MAX_GAP_BYTES:
                at = before - _address(block)
                pieces[-1] = block.reshape(-1).view(np.uint8)[at : at + max(last - before, len(pieces[-1]))]
                continue
        pieces.append(bytes_)
    return pieces


def _address(array: StateArray) -> int:
    return int(array.__array_interface__["data"][0])


def _owner(array: StateArray) -> StateArray:
    """The array that owns the memory of `array`, or it itself."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def save_state(tick: Tick) -> dict[str, StateArray]:
    """Copy the state of `tick` after a step: name → array."""
    state = TickState(tick)
    memory = np.zeros(state.size, dtype=np.uint8)
    state.copy_to(state.find_places(memory))
    return split_snapshot(state.layout, memory)


def load_state(tick: Tick, arrays: Mapping[str, StateArray], memory: Array) -> None:
    """Restore the state `arrays` in a new `tick`; memory (n,) is that of its world [SI].

    An estimator or linkage of another kind than the one in `arrays` stays in its initial state. Raises RecordingError
    for arrays that are not those of such a chain: names, types and shapes must be the same.
    """
    arrays = _complete_passivity(arrays)
    try:
        for prefix, owner in _walk("tick", tick):
            if not _is_replaced("/".join(prefix.split("/")[:2]), arrays):
                _fill(prefix, owner, arrays)
        tick.load_memory(memory)
    except (ValueError, OverflowError) as cause:  # the numbers are untrusted
        raise RecordingError(
            f"the state of the loop in the recording does not fit this device and these parts: {cause}"
        ) from cause


#: state of the passivity control that recordings of earlier versions do not have: zero, as at the start
_SOFTENING: Final[Mapping[str, int]] = {
    "softened": 0, "softer": 0, "since": 0, "made": 0, "spread": 0, "poses": 0, "taken": 0, "touched": 0, "spacing": 0,
    "moved": 3, "smooth": 6,
}  # fmt: skip


def _complete_passivity(arrays: Mapping[str, StateArray]) -> Mapping[str, StateArray]:
    """Convert the state of an older version: add the passivity control's new numbers, and copy its newest wrenches."""
    prefix = "tick/protection/state/passivity"
    times, wrenches, count = (arrays.get(f"{prefix}/{name}") for name in ("times", "wrenches", "count"))
    if times is None or wrenches is None or count is None or f"{prefix}/softened" in arrays:
        return arrays
    if times.shape[1:] != (_OLD_RING_LENGTH,) or wrenches.shape[1:] != (_OLD_RING_LENGTH, 6) or count.shape != (1,):
        return arrays
    known = dict(arrays)
    numbers = int(count[0]) - 1 - np.arange(HISTORY_TICKS)  # indices of the newest wrenches
    for name, ring in (("times", times), ("wrenches", wrenches)):
        newest = np.zeros((1, HISTORY_TICKS, *ring.shape[2:]))
        newest[:, numbers % HISTORY_TICKS] = ring[:, numbers % _OLD_RING_LENGTH]
        known[f"{prefix}/{name}"] = newest
    for name, size in _SOFTENING.items():
        known[f"{prefix}/{name}"] = np.zeros((1, size) if size else 1)
    return known


def _is_replaced(part: str, arrays: Mapping[str, StateArray]) -> bool:
    """Whether `arrays` belong to another kind of the chain's `part`, such as "tick/estimator:hall"."""
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
    """Visit all stateful parts, by their place in the chain, and their kind where there are several."""
    yield prefix, owner
    for name, part in owner.state_parts().items():
        yield from _walk(f"{prefix}/{name}" + (f":{part.state_kind}" if part.state_kind else ""), part)


def _overrides(owner: Stateful) -> bool:
    return type(owner).gather_state is not Stateful.gather_state


#: fields of the protection's records under the names that snapshots have had since the first version
_RECORDED_NAMES: Final[Mapping[str, str]] = {
    "wrench_commanded": "asked", "wrench_rendered": "wanted", "current_commanded": "held", "current_expected": "driven",
}  # fmt: skip


def _leaves(name: str, array: StateArray) -> Iterator[tuple[str, StateArray]]:
    """Split `array` of records into arrays of plain numbers."""
    if array.dtype.names is None:
        if array.dtype.str not in STATE_TYPES:
            raise TypeError(f"'{name}' is of {array.dtype.str}; a state has {', '.join(STATE_TYPES)}")
        yield name, array
        return
    for field in array.dtype.names:
        yield from _leaves(f"{name}/{_RECORDED_NAMES.get(field, field)}", array[field])
