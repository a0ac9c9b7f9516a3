"""The servo that made a recording, as far as the console's description asks for it: nothing of it runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

from haptorb.devices.device import Device
from haptorb.runtime.row import RowLayout

__all__ = ["RecordedServo"]


@final
class RecordedServo:
    """Device, driver, tracker and models of a run, by the recording's note of it."""

    part_remarks: tuple[str, ...] = ()  #: the numbers alone show how a part was rendered

    def __init__(self, device: Device, run: Mapping[str, str]) -> None:
        self.device = device
        self.layout = RowLayout.of(device)
        self.modes = device.kind.modes
        self.driver = run.get("driver", "") or "unknown"
        self.tracker = run.get("tracker", "") or "pointer"
        self.models: tuple[str, ...] = tuple(device.models)
        self.model = run.get("model", "") if run.get("model", "") in self.models else self.models[0]
        self.render = run.get("render", "") or None
