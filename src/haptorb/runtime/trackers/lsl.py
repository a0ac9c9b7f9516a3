"""Poses as a stream of the lab streaming layer: seven channels, x y z qx qy qz qw, and perhaps an eighth, valid.

The layer's clock is this computer's monotonic clock in every program that runs on it. The layer knows no token and
finds streams by calling into the network; so only streams of this computer are asked for, and only those of this
account are used.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from ipaddress import ip_address
from math import isfinite
from time import monotonic
from typing import Any, final
from xml.etree import ElementTree

from haptorb.errors import DriverError
from haptorb.runtime.sockets import is_own_account, listener_owner
from haptorb.runtime.trackers.base import Feed, RawPose, RejectedPose, SenderClock

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
_AGAIN = 0.2  #: and, in one attempt, one that was lost [s]
_CONNECT = 2.0  #: longest wait for its data [s]
_OLDEST = 1.0  #: a sample whose time is farther from its arrival is stamped on another clock [s]
_AT_ONCE = 64  #: samples taken before the pose is written again


def _library() -> Any:
    import pylsl

    pylsl.set_config_content(THIS_COMPUTER)
    return pylsl


def _is_own(stream: Any) -> bool:
    """Whether a program of this account on this computer publishes `stream`."""
    about = ElementTree.fromstring(stream.as_xml())
    address, port = about.findtext("v4address") or "127.0.0.1", about.findtext("v4data_port") or "0"
    try:
        near = ip_address(address).is_loopback
    except ValueError:
        return False
    return near and port.isdecimal() and is_own_account(listener_owner(int(port)))


def lsl_stream(name: str, search: float = _SEARCH) -> Any:
    """The stream's description; DriverError if there is none of this name, or if it holds no poses."""
    pylsl = _library()
    known = pylsl.resolve_byprop("name", name, timeout=search)
    found = [one for one in known if _is_own(one)]  # safety: stream-account
    if known and not found:
        raise DriverError(
            f"tracker lsl: stream '{name}' is published by another account of this computer: publish it as the account "
            "that runs the servo"
        )
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


def _open_inlet(stream: Any) -> Any:
    """A connection to `stream`. Raises DriverError if it ended, or passed to another account, meanwhile."""
    pylsl = _library()
    inlet = pylsl.StreamInlet(stream, max_buflen=1, recover=False)
    try:
        inlet.open_stream(timeout=_CONNECT)
    except Exception as cause:
        raise DriverError(f"tracker lsl: stream '{stream.name()}' has ended; start its program again") from cause
    if not _is_own(stream):
        inlet.close_stream()
        raise DriverError(f"tracker lsl: stream '{stream.name()}' is another account's")
    return inlet


@final
class LslFeed(Feed):
    """Reads the stream `name`, and looks for it again when its program has ended: the layer's own search would take
    another account's."""

    def __init__(self, name: str) -> None:
        self._name, self._inlet = name, _open_inlet(lsl_stream(name))
        self._clock, self._other_clock, self._numbers = SenderClock(), SenderClock(), [0.0]
        self._foreign = ""

    def receive(self, patience: float) -> Iterator[RawPose | RejectedPose]:
        """Up to 64 samples; the first is waited for, at most `patience` [s]."""
        if self._inlet is None:
            with suppress(DriverError):
                self._inlet = _open_inlet(lsl_stream(self._name, _AGAIN))
                self._clock, self._other_clock, self._foreign = SenderClock(), SenderClock(), ""
            return
        for _ in range(_AT_ONCE):
            try:
                values, sent = self._inlet.pull_sample(timeout=patience)
            except Exception:  # the stream is lost: silence, which is what the guard expires
                self.close()
                return
            if values is None:
                return
            arrival, patience = monotonic(), 0.0
            numbers = [float(x) for x in values]
            stamp = self._stamp(float(sent), arrival, numbers)
            if len(numbers) == 8 and not numbers[7] > 0.5:
                yield RawPose((), (), stamp, arrival, False) if isfinite(numbers[7]) else RejectedPose("not_finite")
            else:
                yield RawPose(tuple(numbers[:3]), tuple(numbers[3:7]), stamp, arrival)

    @property
    def remark(self) -> str:
        """Why the sender's times are not used, or not as they are; empty while they are."""
        return self._clock.remark or self._foreign

    def _stamp(self, sent: float, arrival: float, numbers: list[float]) -> float:
        """When a sample was measured [s], on the monotonic clock."""
        if not isfinite(sent):
            return sent
        changed, self._numbers = numbers != self._numbers, numbers
        self._clock.stamp(sent, arrival, changed=changed)
        if self._clock.remark:
            return arrival
        if abs(arrival - sent) <= _OLDEST:
            self._foreign = ""
            return min(sent, arrival)
        self._foreign = (
            f"its times differ from this computer's clock by {abs(arrival - sent):.3g} s: they are compared with the "
            "fastest arrivals"
        )
        return self._other_clock.stamp(sent, arrival)

    def close(self) -> None:
        """Leave the stream."""
        if self._inlet is not None:
            self._inlet.close_stream()
            self._inlet = None
