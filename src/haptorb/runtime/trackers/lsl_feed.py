"""Poses as a stream of the lab streaming layer (LSL): seven channels, x y z qx qy qz qw, and optionally valid.

The layer's clock is this computer's monotonic clock in every program that runs on it. It does not tell when a sample
arrived: what was queued while this program did not read is dated by the sender's time on that clock, or else as early
as possible, by the last time that this program read. The layer has no tokens and
finds streams by multicast; so only streams of this computer are resolved, and only those of this
account are used. Several streams may have one name: lsl:NAME/SOURCE, with the source id or uid of one, selects it;
without it, none of them is used.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from ipaddress import ip_address
from math import isfinite
from time import monotonic, sleep
from typing import Any, final
from xml.etree import ElementTree

from haptorb.errors import DriverError
from haptorb.runtime.sockets import STALL, is_own_account, listener_owner
from haptorb.runtime.trackers.base import Feed, RawPose, RejectedPose
from haptorb.runtime.trackers.sender_clock import SenderClock

__all__ = ["CHANNELS", "THIS_COMPUTER", "LslFeed", "StreamWatch", "lsl_stream", "name_source"]

CHANNELS = (7, 8)  #: valid channel counts of a stream of poses

#: Restricts the layer to this computer: no queries to, or answers for, another one.
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

_SEARCH_TIMEOUT_S = 3.0  #: longest search for a stream
_OTHERS_TIMEOUT_S = 1.6  #: longest search for others of the same name after the first: two of the layer's queries
_RESOLVE_INTERVAL_S = 0.5  #: between two reads of the resolver's results
_FORGET_AFTER_S = 2.0  #: time after which the resolver drops a stream that no longer answers
_MAX_STREAMS = 64  #: streams of one name that are considered
_CONNECT_TIMEOUT_S = 2.0  #: longest wait for its data
_MAX_AGE_S = 1.0  #: largest difference of timestamp and arrival of a sample that is stamped on this computer's clock
_MAX_BATCH = 64  #: most samples read in one batch
_MAX_READ_S = 0.5 * STALL  #: longest wait of one read, so that a longer one shows that this program was stopped [s]


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


def _compose_query(where: str) -> str:
    """Compose the layer's predicate for streams that match `where`, NAME or NAME/SOURCE."""
    name, _, source = where.rpartition("/")
    quote = '"' if "'" in where else "'"
    if quote in where:
        raise DriverError(f"tracker lsl: a stream's name cannot have both kinds of quotation marks; got {where}")
    either = f"name={quote}{where}{quote}"
    if not name:
        return either
    one = f"source_id={quote}{source}{quote} or uid={quote}{source}{quote}"
    return f"{either} or (name={quote}{name}{quote} and ({one}))"


def _select_streams(found: list[Any], where: str) -> list[Any]:
    """Select those of this account that match `where`: by their whole name or, if none has it, by name and source."""
    own = [one for one in found if _is_own(one)]  # safety: stream-account
    return [one for one in own if one.name() == where] or own


def _describe_streams(found: list[Any]) -> str:
    """List source and port of each, for the user to choose."""
    return ", ".join(
        f"'{name_source(one, found)}' (host {one.hostname()}, "
        f"port {ElementTree.fromstring(one.as_xml()).findtext('v4data_port')})"
        for one in found
    )


def name_source(stream: Any, found: list[Any]) -> str:
    """Identifier of `stream` for NAME/SOURCE: its source id, or its uid if others of `found` have the same."""
    source = str(stream.source_id())
    alike = sum(one.source_id() == source for one in found)
    return source if source and alike == 1 else str(stream.uid())


def lsl_stream(where: str, search: float = _SEARCH_TIMEOUT_S) -> Any:
    """Find the stream `where`, NAME or NAME/SOURCE; DriverError if there is none, if there are several, or if it does
    not contain poses."""
    pylsl = _library()
    query = _compose_query(where)
    known = pylsl.resolve_bypred(query, 1, search)
    if known:  # others may answer later
        known = pylsl.resolve_bypred(query, _MAX_STREAMS, _OTHERS_TIMEOUT_S)
    found = _select_streams(known, where)
    if known and not found:
        raise DriverError(
            f"tracker lsl: stream '{where}' is published by another account of this computer: publish it as the "
            "account that runs the servo"
        )
    if not found:
        raise DriverError(
            f"tracker lsl: no stream '{where}' on this computer within {search:g} s; start its program, or check its "
            "name (streams of other computers are not used: forward them with osc:HOST:PORT)"
        )
    if len(found) > 1:  # safety: one-stream
        raise DriverError(
            f"tracker lsl: {len(found)} streams are called '{where}': {_describe_streams(found)}. Choose one, such as "
            f"--tracker 'lsl:{found[0].name()}/{name_source(found[0], found)}', or end the others"
        )
    stream = found[0]
    if stream.channel_count() not in CHANNELS or stream.channel_format() == pylsl.cf_string:
        raise DriverError(
            f"tracker lsl: stream '{where}' has {stream.channel_count()} channels; a stream of poses has 7 numbers, x "
            "y z [m] qx qy qz qw, or 8 with valid (0 or 1)"
        )
    return stream


@final
class StreamWatch:
    """Resolves `where` continuously, in the layer's own thread."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._resolver = _library().ContinuousResolver(pred=_compose_query(where), forget_after=_FORGET_AFTER_S)
        self._own: dict[str, bool] = {}  # uid → whether it is this account's
        self._polled = float("-inf")
        self.found: list[Any] = []  #: streams of this account at the last poll

    def poll(self) -> list[Any]:
        """Return the available streams, updated at most twice a second."""
        if (now := monotonic()) - self._polled > _RESOLVE_INTERVAL_S:
            self._polled = now
            known = {str(one.uid()): one for one in self._resolver.results()}
            self._own = {uid: self._own[uid] if uid in self._own else _is_own(one) for uid, one in known.items()}
            own = [one for uid, one in known.items() if self._own[uid]]
            self.found = [one for one in own if one.name() == self._where] or own
        return self.found


def _open_inlet(stream: Any) -> Any:
    """Connect to `stream`. Raises DriverError if it ended, or passed to another account, meanwhile."""
    pylsl = _library()
    inlet = pylsl.StreamInlet(stream, max_buflen=1, recover=False)
    try:
        inlet.open_stream(timeout=_CONNECT_TIMEOUT_S)
    except Exception as cause:
        raise DriverError(f"tracker lsl: stream '{stream.name()}' has ended; start its program again") from cause
    if not _is_own(stream):
        inlet.close_stream()
        raise DriverError(f"tracker lsl: stream '{stream.name()}' is another account's")
    return inlet


@final
class LslFeed(Feed):
    """Receives poses from the stream `where`, NAME or NAME/SOURCE; searches for it again when its program has ended.

    The layer's own recovery would accept another account's stream. It must be the only one of its name.
    """

    def __init__(self, where: str) -> None:
        stream = lsl_stream(where)
        self._watch, self._inlet = StreamWatch(where), _open_inlet(stream)
        self._where, self._uid = where, "" if stream is None else str(stream.uid())
        self._clock, self._other_clock, self._numbers = SenderClock(), SenderClock(), [0.0]
        self._foreign = self._several = ""
        self._read_at = monotonic()  # end of the last read
        self._waiting_since: float | None = None  # samples that are read may have waited since then
        self._resumed_at = self._read_at

    def _find_others(self) -> None:
        """Find the stream again if it is lost, and set the remark if there are several."""
        found = self._watch.poll()
        if self._inlet is None:  # a lost stream stays in the results for a while
            found = [one for one in found if str(one.uid()) != self._uid] or found
        self._several = ""
        if len(found) > 1:
            used = "none of them is used" if self._inlet is None else "the one from the start is used"
            self._several = (
                f"{len(found)} streams are called '{self._where}': {_describe_streams(found)}; {used}: choose one, "
                f"lsl:{found[0].name()}/SOURCE, or end the others"
            )
        if self._inlet is None and len(found) == 1:
            with suppress(DriverError):
                self._inlet, self._uid = _open_inlet(found[0]), str(found[0].uid())
                self._clock, self._other_clock, self._foreign = SenderClock(), SenderClock(), ""
                self._read_at, self._waiting_since = monotonic(), None

    def receive(self, timeout: float) -> Iterator[RawPose | RejectedPose]:
        """Receive up to 64 samples; wait for the first for at most `timeout` [s]."""
        self._find_others()
        if self._inlet is None:
            sleep(timeout)
            return
        for _ in range(_MAX_BATCH):
            try:
                values, sent = self._read(timeout)
            except Exception:  # the stream is lost: the last pose expires
                self.close()
                return
            if values is None:
                return
            timeout = 0.0
            numbers = [float(x) for x in values]
            stamp, arrival = self._date(float(sent), self._read_at, numbers)
            if len(numbers) == 8 and not numbers[7] > 0.5:
                yield RawPose((), (), stamp, arrival, False) if isfinite(numbers[7]) else RejectedPose("not_finite")
            else:
                yield RawPose(tuple(numbers[:3]), tuple(numbers[3:7]), stamp, arrival)

    def _read(self, timeout: float) -> tuple[Any, float]:
        """Read a sample and its sender's time; None if there is none within `timeout` [s].

        A gap between two reads, or in one, shows that this program was stopped: samples may have waited since then,
        until the queue is empty. The layer's own thread, stopped as well, takes a moment to fill it."""
        end = monotonic() + timeout
        while True:
            wait = min(max(end - monotonic(), 0.0), _MAX_READ_S)
            values, sent = self._inlet.pull_sample(timeout=wait)
            before, self._read_at = self._read_at, monotonic()
            if self._read_at - before > wait + STALL:
                self._resumed_at = self._read_at
                self._waiting_since = before if self._waiting_since is None else self._waiting_since
            elif values is None and self._read_at - self._resumed_at > STALL:
                self._waiting_since = None
            if values is not None or self._read_at >= end:
                return values, sent

    @property
    def remark(self) -> str:
        """Remark that there are several streams, or why the sender's times are not used; empty else."""
        return self._several or self._clock.remark or self._foreign

    def _date(self, sent: float, now: float, numbers: list[float]) -> tuple[float, float]:
        """Times of measurement and arrival of a sample that was read `now`, on the monotonic clock [s]."""
        if not isfinite(sent):
            return sent, now
        changed, self._numbers = numbers != self._numbers, numbers
        since = self._waiting_since
        if since is not None:  # safety: lsl-waited
            known = not (self._clock.remark or self._foreign) and since - _MAX_AGE_S <= sent <= now
            stamp = sent if known else since
            return stamp, max(stamp, since)
        return self._stamp(sent, now, changed=changed), now

    def _stamp(self, sent: float, arrival: float, *, changed: bool) -> float:
        """Time of the measurement of a sample that did not wait [s]."""
        self._clock.stamp(sent, arrival, changed=changed)
        if self._clock.remark:
            return arrival
        if abs(arrival - sent) <= _MAX_AGE_S:
            self._foreign = ""
            return min(sent, arrival)
        self._foreign = (
            f"its times differ from this computer's clock by {abs(arrival - sent):.1f} s: they are compared with the "
            "fastest arrivals"
        )
        return self._other_clock.stamp(sent, arrival)

    def close(self) -> None:
        """Disconnect from the stream."""
        if self._inlet is not None:
            self._inlet.close_stream()
            self._inlet = None
