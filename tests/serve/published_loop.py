"""Memory of a loop without its process: rows are published by the test, and servers' writes are read back."""

from __future__ import annotations

import os
from time import monotonic
from types import TracebackType
from typing import Any, Self

import numpy as np

from haptorb.devices.loader import load
from haptorb.recording.row import RowLayout
from haptorb.runtime.shared_memory import Phase, SharedMemory, Word
from haptorb.runtime.world_requests import description
from haptorb.serve.base import ServedDevice
from haptorb.worlds import World
from haptorb.worlds.dynamic import make_client_force

FACTS = {"driver": "sim", "tracker": "pointer", "estimator": "tracker", "rate_hz": 1000.0, "haptorb": "0"}


class PublishedLoop:
    """A loop of `device` that renders `world`; `served` is what the server with number 0 sees of it."""

    def __init__(self, world: World, device: str = "omni") -> None:
        self.device = load(device)
        self.layout = RowLayout.of(self.device)
        self.shared = SharedMemory.create(self.layout)
        self.shared.words[Word.PHASE] = Phase.RUNNING
        self.shared.announce_world(description(world))
        self.served = ServedDevice(self.shared, 0, os.getppid(), self.device, FACTS)
        self._client = make_client_force()
        self.count = 0

    def publish(self, count: int = 1, **fields: Any) -> np.ndarray:
        """`count` more rows, 1 ms apart, zero but for `fields`; returns the last."""
        row = np.zeros(self.layout.width)
        for name, value in {"q": (0, 0, 0, 1), "valid": 1, "guard": 2, **fields}.items():
            row[self.layout[name]] = value
        for _ in range(count):
            row[self.layout["tick"]], row[self.layout["t"]] = self.count, 1e-3 * self.count
            row[self.layout["wall"]] = monotonic()
            self.shared.ring.publish(row)
            self.count += 1
        return row

    def receive(self) -> tuple[list[float], float]:
        """The force [N] that the loop would take from its clients now, and the session that commands it."""
        self.shared.client_forces.fill(self._client, monotonic())
        return self._client["force"][0].tolist(), float(self._client["session"][0])

    def end(self) -> None:
        """The servo ends."""
        self.shared.words[Word.PHASE] = Phase.ENDED

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.shared.unlink()
