"""The one door to a device, simulated or real: read a sample, write duties, and coils off on the way out."""

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
    """What every driver answers. Coils are off before `open`, after `close`, and after leaving `with` in any way."""

    name: str  #: as in `--driver`
    simulated: bool  #: whether a person can be touched by it
    lead: float = 0.0  #: how long before a tick it wants to be told that the tick is near [s]

    @abstractmethod
    def open(self) -> None:
        """Connect; coils off. Raises DriverError saying what did not answer and what to do."""

    @abstractmethod
    def close(self) -> None:
        """Coils off, then disconnect. May be called twice."""

    def prepare(self, now: float) -> None:
        """The tick at `now` [s] is near: do what need not wait for it. `read` need not be told first. Raises only what
        `read` will raise again."""
        return

    @abstractmethod
    def read(self, now: float) -> Sample:
        """The sample at `now` [s]. Raises DriverError if the device does not answer in time."""

    @abstractmethod
    def write(self, duties: Array) -> Array:
        """Apply `duties` (m,) in −1…1 of the supply voltage; returns (m,) what was really applied, after clipping
        and quantisation."""

    @property
    def coil_state(self) -> CoilState:
        """Whether current can flow, as far as the device confirmed it. OFF only when the device said so: UNKNOWN from
        the moment at which off is asked for until then. A driver that cannot tell says UNKNOWN."""
        return CoilState.UNKNOWN

    @property
    def field_axes(self) -> Array | None:
        """(k, 3) unit vectors, stator frame: the one direction in which each field sensor measures; None: they measure
        all three."""
        return None

    @property
    def calibration(self) -> bytes | None:
        """Which calibration the open device says is its own: 16 bytes, zeros for none; None: it has no memory."""
        return None

    def remember(self, calibration: bytes) -> bool:
        """Let the open device keep the 16-byte id of its calibration; False if it has no memory for it. Raises
        DriverError if it has one and does not."""
        return False

    def engage(self) -> None:
        """A person wants the coils on again after a trip. A driver whose hardware latches trips by itself forgets them
        here; nothing flows before the next `write`. Raises DriverError if that cannot be."""
        return

    def cool(self) -> None:
        """Simulated coils are at the ambient temperature at once; those of a real device are not."""
        return

    def truth(self) -> Array:
        """(6,) the wrench [N, N·m] that the coils and the core really put on the mover in the last tick, if the driver
        can know it (a simulated one can); NaN where it cannot."""
        return _NO_WRENCH

    def target(self) -> Array:
        """(7,) where the hand wants the mover, position [m] then quaternion (x, y, z, w), if the driver can know it (a
        simulated hand says so); NaN where it cannot."""
        return _UNKNOWN

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
