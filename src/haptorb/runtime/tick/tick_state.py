"""All that a chain remembers from tick to tick, as bytes: so that a replay can begin in the middle of a run.

A world's own memory is not in them: the row has it. The bytes are a pickle of plain values, and are read by a reader
that makes nothing but these: a recording may come from anybody.
"""

from __future__ import annotations

import io
import pickle
import zlib
from base64 import b64decode, b64encode
from typing import Any, Final, final

import numpy as np

from haptorb.errors import RecordingError
from haptorb.numerics.arrays import Array
from haptorb.runtime.tick.tick import Tick

__all__ = ["load_state", "pack_state", "save_state", "unpack_state"]

_LONGEST: Final = 4_000_000  #: bytes of a state

#: class → its attributes that change; "name[]": an array that others look into, and that is filled in place
_REMEMBERED: Final[dict[str, tuple[str, ...]]] = {
    "Tick": ("_applied", "world_changes", "_last_rendered", "_model", "_rendered[]", "_on_thing[]"),
    "TickLog": ("scale",),
    "RenderedPart": ("number", "is_open", "_part", "_has_pushed"),
    "WorldBudget": ("_mean", "_calm", "_patience"),
    "Protection": ("coils[]", "state[]", "duties[]"),
    "ModedLinkage": ("_memory", "_mode", "_engaged", "_t", "_scale", "_scale_goal"),
    "Direct": (),
    "BoundWorld": ("paused", "failed"),
    "TrackedPose": ("_last",),
    "ControllerModel": ("_asked", "_name", "_before", "_share", "_t"),
    "HallTracker": ("_tracker[]", "_sensors[]", "_lagged[]", "verdict", "_found", "_t", "_searched", "_last"),
    "CurrentHistory": ("_times[]", "_values[]", "_waiting", "_waiting_since", "field", "taken", "currents", "doubt"),
    "LeastSquaresOrientation": (
        "_track[]", "_slopes[]", "field[]", "usable[]", "trusted[]", "_found", "_t", "_near", "_last",
    ),
    "ColdStart": ("_slopes[]", "_fit[]"),
    "FieldToTorque": ("_field[]", "_usable[]", "_single[]", "_known[]", "_t"),
}  # fmt: skip
#: name → what versions before called it
_EARLIER: Final = {"_last_rendered": "_felt_last"}
#: class → its parts that remember
_PARTS: Final[dict[str, tuple[str, ...]]] = {
    "Tick": ("_log", "part", "budget", "protection", "linkage", "_bound", "estimator"),
    "TrackedPose": ("_model",),
    "HallTracker": ("_history", "_controller_model"),
    "LeastSquaresOrientation": ("_cold",),
    "FieldToTorque": ("_orientation",),
}
_PLAIN: Final = frozenset(
    {
        ("numpy", "ndarray"), ("numpy", "dtype"), ("numpy.core.multiarray", "_reconstruct"),
        ("numpy._core.multiarray", "_reconstruct"), ("numpy.core.multiarray", "scalar"),
        ("numpy._core.multiarray", "scalar"), ("numpy._core.numeric", "_frombuffer"),
        ("numpy.core.numeric", "_frombuffer"),
        ("haptorb.devices.state", "State"), ("haptorb.devices.wrench_map", "WrenchMap"),
        ("haptorb.sensing.sample", "Estimate"), ("haptorb.control.clutch.linkage", "RenderedWrench"),
    }
)  # fmt: skip


def save_state(tick: Tick) -> bytes:
    """What `tick` remembers after a step."""
    return pickle.dumps(_gather(tick), protocol=4)


def pack_state(state: bytes) -> str:
    """`state` as text, for notes."""
    return b64encode(zlib.compress(state)).decode()


def unpack_state(text: str) -> bytes:
    """What was given to `pack_state`. Raises RecordingError for what is nothing like it."""
    try:
        return zlib.decompressobj().decompress(b64decode(text, validate=True), _LONGEST)
    except (ValueError, zlib.error) as cause:
        raise RecordingError(f"a state in the recording was not written by haptorb: {cause}") from cause


def load_state(tick: Tick, state: bytes, memory: Array) -> None:
    """Let `tick`, which has just been made, remember what another one did; memory (n,) is that of its world [SI].

    Raises RecordingError for bytes that `save_state` of this version has not made for such a chain.
    """
    try:
        found = _PlainReader(io.BytesIO(state)).load()
        _restore(tick, found)
        if tick._bound is not None:
            tick._bound.numbers[:] = memory[: tick._bound.numbers.size]
        choice = tick.part._choice
        if choice is not None:
            tick.part.allocator = choice.allocators[tick.part._part]
    except Exception as cause:  # anybody's bytes
        raise RecordingError(
            "the state at the beginning of the recording does not fit this device and these parts "
            f"({type(cause).__name__}: {cause})"
        ) from cause


def _gather(part: Any) -> dict[str, Any]:
    kind = type(part).__name__
    found: dict[str, Any] = {"kind": kind}
    for name in _REMEMBERED.get(kind, ()):
        value = getattr(part, name.removesuffix("[]"))
        # Without its type: that of a record is longer than what it holds.
        found[name] = value.tobytes() if name.endswith("[]") or _is_record(value) else value
    for name in _PARTS.get(kind, ()):
        below = getattr(part, name)
        if below is not None:
            found[f"{name}."] = _gather(below)
    return found


def _is_record(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.names is not None


def _restore(part: Any, state: dict[str, Any]) -> None:
    kind = type(part).__name__
    if kind != state["kind"]:
        return  # another estimator or world replaces it: it starts from its initial state
    for name in _REMEMBERED.get(kind, ()):
        value, there = state[name if name in state else _EARLIER[name]], getattr(part, name.removesuffix("[]"))
        if isinstance(value, bytes):
            there[...] = np.frombuffer(value, dtype=there.dtype).reshape(there.shape)
        elif not _is_record(there):  # None for a record: an earlier version, before the first tick
            setattr(part, name, value)
    for name in _PARTS.get(kind, ()):
        below = getattr(part, name)
        if below is not None:
            _restore(below, state[f"{name}."])


@final
class _PlainReader(pickle.Unpickler):
    """Makes arrays, numbers and the records of a tick, and nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        """The class `name`, if it is one of those. Raises UnpicklingError otherwise."""
        if (module, name) not in _PLAIN:  # safety: plain-state
            raise pickle.UnpicklingError(f"{module}.{name} is not part of a state")
        return super().find_class(module, name)
