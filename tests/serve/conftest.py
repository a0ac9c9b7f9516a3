"""A device whose rows a test writes, as seen by a server's process: no loop, no process."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from haptorb.control.trip_reasons import GuardState
from haptorb.devices.loader import load
from haptorb.recording.row import RowLayout
from haptorb.runtime.shared_memory import Phase, SharedMemory, Word
from haptorb.serve.base import ServedDevice
from haptorb.serve.haply import prepare, serve
from haptorb.worlds.dynamic import make_client_force


class Bench:
    """`served` before the memory `shared`; `publish` writes a row, `read_client` reads what the loop would render."""

    def __init__(self) -> None:
        self.device = load("omni")
        self.shared = SharedMemory.create(RowLayout.of(self.device))
        self.shared.words[Word.PHASE] = Phase.RUNNING
        facts = {"driver": "sim", "modes": [], "rate_hz": 1000.0}
        self.served = ServedDevice(self.shared, 0, os.getppid(), self.device, facts)
        self.publish()

    def publish(self, **fields: Any) -> None:
        row = self.shared.layout.empty()
        first = {
            "t": 1.0,
            "p": (0.0, 0.0, 0.05),
            "q": (0.0, 0.0, 0.0, 1.0),
            "v": 0.0,
            "wrench_commanded": 0.0,
            "valid": 1.0,
        }
        for name, value in {**first, "guard": GuardState.RUNNING, "trip": 0.0, **fields}.items():
            row[self.shared.layout[name]] = value
        self.shared.ring.publish(row)

    def read_client(self, later: float = 0.0) -> Any:
        client = make_client_force()
        self.shared.client_forces.fill(client, time.monotonic() + later)
        return client[0]


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.shared.unlink()


@pytest.fixture
def port(bench: Bench) -> Iterator[int]:
    """Of a haply server that runs in a thread, before `bench`; its events are on the next of `bench.ports`."""
    preparation = prepare("0:0")
    numbers = [int(one.rpartition(":")[2]) for one in preparation.address.split(",")]
    bench.ports = numbers  # type: ignore[attr-defined]
    thread = threading.Thread(target=serve, args=(preparation.spec, list(preparation.descriptors), bench.served))
    thread.start()
    yield numbers[0]
    bench.served.ending = True
    thread.join(10.0)
    assert not thread.is_alive()
