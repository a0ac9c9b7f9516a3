"""DS18B20 thermometers through Linux' 1-wire driver: a conversion takes 0.75 s, so a thread of its own reads them."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Protocol, final

import numpy as np

from haptorb.errors import DriverError
from haptorb.numerics.arrays import Array

__all__ = ["Thermometers", "W1Thermometers"]

_FOLDER = Path("/sys/bus/w1/devices")


class Thermometers(Protocol):
    """A source of the temperatures at the coils' boundaries."""

    def wait_until_ready(self, patience: float) -> bool:
        """Wait for the first reading [s]."""

    def read(self) -> Array:
        """(m,) [K]."""

    def close(self) -> None:
        """May be called twice."""


@final
class W1Thermometers:
    """The sensors 28-… in `folder`, in the order of their numbers: coils x, y, z.

    Raises DriverError if there are not just `count` of them.
    """

    def __init__(self, count: int = 3, folder: Path = _FOLDER) -> None:
        self._files = [path / "temperature" for path in sorted(folder.glob("28-*"))]
        if len(self._files) != count:
            found = ", ".join(file.parent.name for file in self._files) or "none"
            raise DriverError(
                f"{count} DS18B20 thermometers are needed on the 1-wire bus, found: {found} "
                "(switch 1-wire on with `raspi-config`, check the 4.7 kΩ pull-up)"
            )
        self._kelvin = np.full(count, np.nan)
        self._end = threading.Event()
        self._first = threading.Event()
        self._thread = threading.Thread(target=self._run, name="thermometers", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._end.is_set():
            for i, file in enumerate(self._files):
                try:
                    self._kelvin[i] = int(file.read_text()) / 1000 + 273.15
                except (OSError, ValueError):
                    self._kelvin[i] = np.nan
            self._first.set()
            self._end.wait(0.05)

    def wait_until_ready(self, patience: float) -> bool:
        """Wait until each has been read once, at most `patience` [s]."""
        return self._first.wait(patience)

    def read(self) -> Array:
        """(count,) the last readings [K]; NaN where a sensor does not answer."""
        return self._kelvin.copy()

    def close(self) -> None:
        """May be called twice."""
        self._end.set()
