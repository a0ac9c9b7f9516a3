"""`--serve lsl`: every row of the loop to programs of this computer that speak to the lab streaming layer."""

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
from haptorb.runtime.trackers.lsl import THIS_COMPUTER
from haptorb.serve.base import ServedDevice, ServerPreparation

__all__ = [
    "BACKLOG",
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
# How far another clock of this computer is ahead of its monotonic clock, and how well that is known.


@final
@dataclass(frozen=True)
class ClockOffset:
    """`seconds` to add to the monotonic clock [s]; the true offset is within ± `uncertainty` [s]."""

    seconds: float
    uncertainty: float


def measure_offset(clock: Callable[[], float], repetitions: int = 16) -> ClockOffset:
    """The offset of `clock` [s]: of several readings between two of the monotonic clock, the one in the least time.

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
# What the stream of rows says of itself: name, rate, label and unit of each channel, and the offsets of the clocks.
#
# The stream's XML follows the conventions of the layer's file format: `desc/channels/channel` with `label`, `unit` and
# `type` (https://github.com/sccn/xdf/wiki/Meta-Data) and `desc/synchronization`
# (https://github.com/sccn/xdf/wiki/Synchronization), where `offset_mean` is 0 for what this computer itself stamps.


NAME = "haptorb-rows"  #: by which programs find the stream
TYPE = "Haptics"  #: kind of content


@final
@dataclass(frozen=True)
class Channel:
    """One number of a row: its label, as in tables of recordings, its unit, and the field that it belongs to."""

    label: str
    unit: str
    field: str
    about: str


@final
@dataclass(frozen=True)
class Clocks:
    """Offsets from this computer's monotonic clock, in which rows state the start of their tick (`wall`)."""

    layer: ClockOffset  #: to the layer's clock, that of the samples' time stamps
    utc: ClockOffset  #: to seconds since 1970-01-01 UTC


def list_channels(layout: RowLayout) -> tuple[Channel, ...]:
    """The channels of a sample, in the order of the row: one for each number, `layout.width` in all.

    >>> list_channels(RowLayout(channels=1, sensors=0))[20]
    Channel(label='p[0]', unit='m', field='p', about='estimated position of the mover, stator frame')
    """
    return tuple(
        Channel(label, unit, field.name, field.about)
        for field in layout.fields
        for label, unit in zip(column_names(field), units_of(field), strict=True)
    )


def make_stream_info(layer: Any, layout: RowLayout, rate: float, facts: Mapping[str, str], clocks: Clocks) -> Any:
    """The description for an outlet of `layer`, the module pylsl: `rate` samples a second [Hz] of a row each.

    facts    what was served, as text: device, driver, version, ... ; the stream's source is the device and driver
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
# Sends rows to an outlet of the lab streaming layer, each stamped with the time at which its tick began.


BACKLOG = 10  #: seconds of samples that the layer keeps for a slow reader; then the oldest go [s]


@final
class RowOutlet:
    """The stream of the rows of `layout`, `rate` a second [Hz]; programs of this computer find it at once.

    facts    what is served, as text, for the stream's description
    """

    def __init__(self, layout: RowLayout, rate: float, facts: Mapping[str, str]) -> None:
        import pylsl  # here, so that only who serves by it needs it

        pylsl.set_config_content(THIS_COMPUTER)
        self._layer: Any = pylsl
        self._offset: ClockOffset = measure_offset(pylsl.local_clock)
        self._wall = layout["wall"].start
        clocks = Clocks(self._offset, measure_offset(time))
        info = make_stream_info(pylsl, layout, rate, facts, clocks)
        self._outlet: Any = pylsl.StreamOutlet(info, 0, BACKLOG)
        self.sent = 0  #: rows that were given to the layer

    @property
    def watched(self) -> bool:
        """Whether a program reads the stream."""
        return bool(self._outlet.have_consumers())

    def send(self, rows: Array) -> None:
        """Send `rows` (n, width), in the units of their layout; the layer copies them and never waits for a reader."""
        if not len(rows):
            return
        stamps = rows[:, self._wall] + self._offset.seconds
        self._outlet.push_chunk(np.ascontiguousarray(rows), stamps.tolist())
        self.sent += len(rows)

    def close(self) -> None:
        """End the stream: readers learn that it is gone."""
        self._outlet = None


_POLL_INTERVAL_S = 0.005  #: between two looks for rows [s]
_REPORT = 0.25  #: between two reports [s]


def prepare(where: str) -> ServerPreparation:
    """Nothing stands behind `lsl`; its ports are the layer's own. Raises InputError if something does."""
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
            if monotonic() - last >= _REPORT:
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
