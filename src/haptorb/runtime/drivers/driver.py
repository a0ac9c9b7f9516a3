"""The interface to a device, simulated or real: read a sample, write duties, switch the coils off at the end."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

import numpy as np

from haptorb.control.protection.trip import CoilState
from haptorb.numerics.arrays import Array
from haptorb.sensing.sample import Sample

__all__ = ["Driver"]

_UNKNOWN = np.full(7, np.nan)

_NO_WRENCH = np.full(6, np.nan)


class Driver(ABC):
    """The interface of every driver. Coils are off before `open`, after `close`, and after leaving `with`."""

    name: str  #: as in `--driver`
    simulated: bool  #: whether a person can be touched by it
    lead: float = 0.0  #: how long before a tick it must be warned that the tick is near [s]

    @abstractmethod
    def open(self) -> None:
        """Connect; coils off. Raises DriverError that states what did not respond and what to do."""

    @abstractmethod
    def close(self) -> None:
        """Coils off, then disconnect. May be called twice."""

    def prepare(self, now: float) -> None:
        """The tick at `now` [s] is near: do work that need not wait for it. `read` must also work without it.
        Raises only what `read` will raise again."""
        return

    @abstractmethod
    def read(self, now: float) -> Sample:
        """The sample at `now` [s]. Raises DriverError if the device does not respond in time."""

    @abstractmethod
    def write(self, duties: Array) -> Array:
        """Apply `duties` (m,) in −1…1 of the supply voltage; returns (m,) the duties actually applied, after
        clipping and quantisation."""

    @property
    def coil_state(self) -> CoilState:
        """Whether current can flow, as confirmed by the device. OFF only if the device confirmed it: UNKNOWN
        between the command to switch off and the confirmation. A driver that does not know returns UNKNOWN."""
        return CoilState.UNKNOWN

    @property
    def field_axes(self) -> Array | None:
        """(k, 3) unit vectors, stator frame: the direction in which each one-axis field sensor measures; None:
        three-axis sensors."""
        return None

    @property
    def calibration(self) -> bytes | None:
        """Id of the calibration stored in the open device: 16 bytes, zeros for none; None: it has no memory."""
        return None

    def remember(self, calibration: bytes) -> bool:
        """Store the 16-byte id of the calibration in the open device; False if it has no memory. Raises DriverError
        if storing fails."""
        return False

    def engage(self) -> None:
        """A person engages after a trip. A driver whose hardware latches trips clears them here; no current flows
        before the next `write`. Raises DriverError if that is not possible."""
        return

    def cool(self) -> None:
        """Set simulated coils to the ambient temperature; no effect on a real device."""
        return

    def truth(self) -> Array:
        """(6,) the true wrench [N, N·m] of coils and core on the mover in the last tick, if the driver knows it (a
        simulated one does); else NaN."""
        return _NO_WRENCH

    def target(self) -> Array:
        """(7,) the pointer target of the hand, position [m] then quaternion (x, y, z, w), if the driver knows it
        (with a simulated hand); else NaN."""
        return _UNKNOWN

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
