"""Server of `--serve lsl`: publishes every row of the loop as a stream of the lab streaming layer (LSL)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import monotonic, sleep, time
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import InputError
from haptorb.recording.export import column_names, units_of
from haptorb.recording.row import RowLayout
from haptorb.runtime.trackers.lsl_feed import THIS_COMPUTER
from haptorb.serve.base import ServedDevice, ServerPreparation

__all__ = [
    "BUFFER_TIME_S",
    "NAME",
    "TYPE",
    "Channel",
    "ClockOffset",
    "Clocks",
    "RowOutlet",
    "list_channels",
    "make_stream_info",
    "measure_offset",
    "prepare",
    "serve",
]


# --------------------------------------------------------------------------------------------------
# Offset of another clock of this computer from its monotonic clock, with its uncertainty.


@final
@dataclass(frozen=True)
class ClockOffset:
    """Clock offset: `seconds` to add to the monotonic clock [s]; the true offset is within ± `uncertainty` [s]."""

    seconds: float
    uncertainty: float


def measure_offset(clock: Callable[[], float], repetitions: int = 16) -> ClockOffset:
    """Measure the offset of `clock` [s], each reading enclosed by two of the monotonic clock; the closest pair counts.

    >>> from time import monotonic
    >>> measure_offset(lambda: monotonic() + 5.0).seconds > 4.9
    True
    """
    best = ClockOffset(0.0, float("inf"))
    for _ in range(repetitions):
        before = monotonic()
        there = clock()
        after = monotonic()
        if (after - before) / 2 < best.uncertainty:
            best = ClockOffset(there - (before + after) / 2, (after - before) / 2)
    return best


# --------------------------------------------------------------------------------------------------
# Metadata of the stream: name, rate, label and unit of each channel, and the clock offsets.
#
# The stream's XML follows the conventions of the layer's file format: `desc/channels/channel` with `label`, `unit` and
# `type` (https://github.com/sccn/xdf/wiki/Meta-Data) and `desc/synchronization`
# (https://github.com/sccn/xdf/wiki/Synchronization), where `offset_mean` is 0 for samples stamped by this computer.


NAME = "haptorb-rows"  #: name of the stream
TYPE = "Haptics"  #: content type of the stream


@final
@dataclass(frozen=True)
class Channel:
    """Channel of the stream, one number of a row: label as in tables of recordings, unit, and field of the row."""

    label: str
    unit: str
    field: str
    about: str


@final
@dataclass(frozen=True)
class Clocks:
    """Clock offsets from the monotonic clock, in which `wall` of a row is the start of its tick."""

    layer: ClockOffset  #: to LSL's clock, that of the samples' time stamps
    utc: ClockOffset  #: to seconds since 1970-01-01 UTC


def list_channels(layout: RowLayout) -> tuple[Channel, ...]:
    """Channels of a sample in the order of the row: one for each number, `layout.width` in all.

    >>> list_channels(RowLayout(channels=1, sensors=0))[20]
    Channel(label='p[0]', unit='m', field='p', about='estimated position of the mover, stator frame')
    """
    return tuple(
        Channel(label, unit, field.name, field.about)
        for field in layout.fields
        for label, unit in zip(column_names(field), units_of(field), strict=True)
    )


def make_stream_info(layer: Any, layout: RowLayout, rate: float, facts: Mapping[str, str], clocks: Clocks) -> Any:
    """Build the stream info for an outlet: one row per sample, at `rate` [Hz]; `layer` is the module pylsl.

    facts    facts of the run as text: device, driver, version, ...; the source id of the stream is device and driver
    """
    channels = list_channels(layout)
    source = "-".join(["haptorb", *(facts[key] for key in ("device", "driver") if key in facts)])
    info = layer.StreamInfo(NAME, TYPE, len(channels), rate, layer.cf_double64, source)
    description = info.desc()
    run = description.append_child("run")
    for key, value in facts.items():
        run.append_child_value(key, value)
    listed = description.append_child("channels")
    for channel in channels:
        node = listed.append_child("channel")
        for key, value in (("label", channel.label), ("unit", channel.unit), ("type", channel.field)):
            node.append_child_value(key, value)
        node.append_child_value("about", channel.about)
    _describe_clocks(description, clocks)
    return info


def _describe_clocks(description: Any, clocks: Clocks) -> None:
    standard = description.append_child("synchronization")
    for key, value in (
        ("time_source", "start of the tick, monotonic clock"),
        ("offset_mean", "0"),
        ("can_drop_samples", "true"),
    ):
        standard.append_child_value(key, value)
    node = description.append_child("clocks")
    for name, about, offset in (
        ("monotonic_to_lsl", "add to channel wall: time stamp of the sample", clocks.layer),
        ("monotonic_to_utc", "add to channel wall: seconds since 1970-01-01 UTC", clocks.utc),
    ):
        clock = node.append_child(name)
        clock.append_child_value("offset", f"{offset.seconds:.9f}")
        clock.append_child_value("uncertainty", f"{offset.uncertainty:.3g}")
        clock.append_child_value("unit", "s")
        clock.append_child_value("about", about)


# --------------------------------------------------------------------------------------------------
# The outlet: rows, each stamped with the start time of its tick.


BUFFER_TIME_S = 10  #: LSL's buffer for a slow reader; then the oldest samples are dropped [s]


@final
class RowOutlet:
    """LSL outlet of the rows of `layout`, `rate` a second [Hz]; programs of this computer discover it at once.

    facts    facts of the run as text, for the stream's description
    """

    def __init__(self, layout: RowLayout, rate: float, facts: Mapping[str, str]) -> None:
        import pylsl  # here: an optional dependency, needed by this server only

        pylsl.set_config_content(THIS_COMPUTER)
        self._layer: Any = pylsl
        self._offset: ClockOffset = measure_offset(pylsl.local_clock)
        self._wall = layout["wall"].start
        clocks = Clocks(self._offset, measure_offset(time))
        info = make_stream_info(pylsl, layout, rate, facts, clocks)
        self._outlet: Any = pylsl.StreamOutlet(info, 0, BUFFER_TIME_S)
        self.sent = 0  #: rows sent

    @property
    def watched(self) -> bool:
        """Whether the stream has a reader."""
        return bool(self._outlet.have_consumers())

    def send(self, rows: Array) -> None:
        """Send `rows` (n, width), in the units of their layout; LSL copies them and does not block on readers."""
        if not len(rows):
            return
        stamps = rows[:, self._wall] + self._offset.seconds
        self._outlet.push_chunk(np.ascontiguousarray(rows), stamps.tolist())
        self.sent += len(rows)

    def close(self) -> None:
        """Close the outlet; readers are notified."""
        self._outlet = None


_POLL_INTERVAL_S = 0.005  #: polling interval of the rows [s]
_REPORT_INTERVAL_S = 0.25  #: between two reports [s]


def prepare(where: str) -> ServerPreparation:
    """Check that `lsl` has no address, because LSL chooses its ports. Raises InputError if it has one."""
    if where:
        raise InputError(f"--serve lsl takes no address, because LSL discovers streams; got '{where}'")
    remark = (
        "lsl: the layer cannot know its readers: every account of this computer, and who reaches its ports from the "
        "network, can read the rows while this server runs"
    )
    return ServerPreparation({}, f"stream '{NAME}' of the lab streaming layer", remarks=(remark,))


def serve(spec: dict[str, Any], descriptors: list[int], served: ServedDevice) -> None:
    """Serve until `served.over`."""
    facts = {"device": served.device.name, **{key: str(value) for key, value in served.facts.items()}}
    outlet = RowOutlet(served.layout, float(served.facts["rate_hz"]), facts)
    try:
        last = float("-inf")
        while not served.over:
            outlet.send(served.read_rows())
            if monotonic() - last >= _REPORT_INTERVAL_S:
                last = monotonic()
                _report(served, outlet)
            sleep(_POLL_INTERVAL_S)
        outlet.send(served.read_rows())
        _report(served, outlet)
    finally:
        outlet.close()


def _report(served: ServedDevice, outlet: RowOutlet) -> None:
    clients = [{"name": "reader", "session": 0, "rate_hz": served.facts["rate_hz"], "holds": False}]
    served.report("lsl", NAME, clients if outlet.watched else [], sent=outlet.sent)
