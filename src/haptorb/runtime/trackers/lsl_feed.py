"""Poses as a stream of the lab streaming layer: seven channels, x y z qx qy qz qw, and perhaps an eighth, valid.

The layer's clock is this computer's monotonic clock, and it measures the offset of others itself. It knows no token and
finds streams by calling into the network; so only streams of this computer are asked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite
from time import monotonic
from typing import Any, final

from haptorb.errors import DriverError
from haptorb.runtime.trackers.feed import Feed, RawPose, RejectedPose

__all__ = ["CHANNELS", "THIS_COMPUTER", "LslFeed", "lsl_stream"]

CHANNELS = (7, 8)  #: that a stream of poses may have

#: Nothing is asked of, or answered to, another computer.
THIS_COMPUTER = """
[multicast]
ResolveScope = machine
ListenAddress = 127.0.0.1
AddressesOverride = {127.0.0.1}
[ports]
IPv6 = disable
[lab]
KnownPeers = {127.0.0.1}
[log]
level = -2
"""

_SEARCH = 3.0  #: how long a stream is looked for [s]
_OFFSET = 5.0  #: between two looks at the clocks' offset [s]
_AT_ONCE = 64  #: samples taken before the pose is written again


def _library() -> Any:
    import pylsl

    pylsl.set_config_content(THIS_COMPUTER)
    return pylsl


def lsl_stream(name: str, search: float = _SEARCH) -> Any:
    """The stream's description; DriverError if there is none of this name, or if it holds no poses."""
    pylsl = _library()
    found = pylsl.resolve_byprop("name", name, timeout=search)
    if not found:
        raise DriverError(
            f"tracker lsl: no stream '{name}' on this computer within {search:g} s; start its program, or check its "
            "name (streams of other computers are not used: forward them with osc:HOST:PORT)"
        )
    if len(found) > 1:
        raise DriverError(f"tracker lsl: {len(found)} streams are called '{name}'; close all but one")
    stream = found[0]
    if stream.channel_count() not in CHANNELS or stream.channel_format() == pylsl.cf_string:
        raise DriverError(
            f"tracker lsl: stream '{name}' has {stream.channel_count()} channels; a stream of poses has 7 numbers, x y "
            "z [m] qx qy qz qw, or 8 with valid (0 or 1)"
        )
    return stream


@final
class LslFeed(Feed):
    """Reads the stream `name`; the layer reconnects by itself when its program comes back."""

    def __init__(self, name: str) -> None:
        pylsl = _library()
        self._inlet = pylsl.StreamInlet(lsl_stream(name), max_buflen=1, recover=True)
        self._offset, self._next = 0.0, float("-inf")

    def receive(self, patience: float) -> Iterator[RawPose | RejectedPose]:
        """Up to 64 samples; the first is waited for, at most `patience` [s]."""
        for _ in range(_AT_ONCE):
            try:
                values, sent = self._inlet.pull_sample(timeout=patience)
            except Exception:  # the stream is lost: silence, which is what the guard expires
                return
            if values is None:
                return
            arrival, patience = monotonic(), 0.0
            self._compare(arrival)
            numbers = [float(x) for x in values]
            stamp = min(sent + self._offset, arrival)
            if len(numbers) == 8 and not numbers[7] > 0.5:
                yield RawPose((), (), stamp, arrival, False) if isfinite(numbers[7]) else RejectedPose("not_finite")
            else:
                yield RawPose(tuple(numbers[:3]), tuple(numbers[3:7]), stamp, arrival)

    def _compare(self, now: float) -> None:
        if now >= self._next:
            self._next = now + _OFFSET
            try:
                self._offset = float(self._inlet.time_correction(timeout=0.05))
            except Exception:  # not known yet: ask again soon
                self._next = now + 0.5

    def close(self) -> None:
        """Leave the stream."""
        self._inlet.close_stream()
