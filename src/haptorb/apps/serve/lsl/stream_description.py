"""What the stream of rows says of itself: name, rate, label and unit of each channel, and the offsets of the clocks.

The stream's XML follows the conventions of the layer's file format: `desc/channels/channel` with `label`, `unit` and
`type` (https://github.com/sccn/xdf/wiki/Meta-Data) and `desc/synchronization`
(https://github.com/sccn/xdf/wiki/Synchronization), where `offset_mean` is 0 for what this computer itself stamps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

from haptorb.apps.serve.lsl.clock_offset import ClockOffset
from haptorb.runtime.recording.data_frames import column_names, units_of
from haptorb.runtime.row import RowLayout

__all__ = ["NAME", "TYPE", "Channel", "Clocks", "list_channels", "make_stream_info"]

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
