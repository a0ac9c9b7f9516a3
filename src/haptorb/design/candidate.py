"""One candidate of a design: the device that its values make, and what several objectives need of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar, final

from haptorb.devices.device import Device

__all__ = ["DesignCandidate"]

T = TypeVar("T")


@final
class DesignCandidate:
    """A device, and what was computed of it so far.

    device   what is judged
    base     the device of the design file: envelopes, copper and magnet volume are compared with it
    options  the design file's table `[evaluation]`, such as {"orientations": 400}
    """

    def __init__(self, device: Device, base: Device, options: Mapping[str, Any]) -> None:
        self.device = device
        self.base = base
        self.options = dict(options)
        self._shared: dict[str, Any] = {}

    def share(self, name: str, compute: Callable[[], T]) -> T:
        """What `compute` returns, computed once for all objectives that ask for `name`."""
        if name not in self._shared:
            self._shared[name] = compute()
        found: T = self._shared[name]
        return found
