"""The libraries, built once, and a server with a loop whose rows a test writes."""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from time import monotonic, sleep
from types import TracebackType
from typing import Any, Self

import pytest

from haptorb.errors import DriverError
from haptorb.serve.native import prepare, serve
from haptorb.serve.native_libraries import find_libraries
from haptorb.worlds import Remote
from serve.published_loop import PublishedLoop


@pytest.fixture(scope="session")
def libraries() -> Path:
    """The folder of the libraries; skipped where there is no compiler."""
    try:
        return find_libraries()[0]
    except DriverError as cause:
        if "not installed" in str(cause):
            pytest.skip(str(cause))
        raise


class ServedFile:
    """A server in a thread of this process, before `loop`; `path` is its file, `run` the environment for programs."""

    def __init__(self, device: str = "omni", where: str = "", limit: float = 10.0) -> None:
        self.loop = PublishedLoop(Remote(limit=limit), device)
        self.loop.served.facts["modes"] = list(self.loop.device.kind.modes)
        self.preparation = prepare(where)
        self.path = Path(self.preparation.address)
        self.run = {"HAPTORB_RUN": str(self.path)}
        self._fields: dict[str, Any] = {"p": (0.0, 0.0, 0.05)}
        self._over = threading.Event()
        self._publisher = threading.Thread(target=self._publish, daemon=True)
        self._descriptors = [os.dup(one) for one in self.preparation.descriptors]
        self._thread = threading.Thread(
            target=serve, args=(self.preparation.spec, self._descriptors, self.loop.served), daemon=True
        )

    def publish(self, **fields: Any) -> None:
        """These fields are in all rows from now on, one every 5 ms."""
        self._fields = fields
        count = self.loop.count
        while self.loop.count < count + 2:
            assert self._publisher.is_alive(), "these are no fields of a row"
            sleep(0.001)

    def _publish(self) -> None:
        while not self._over.wait(0.005):
            self.loop.publish(**self._fields)

    def receive(self) -> tuple[list[float], float]:
        return self.loop.receive()

    def await_force(self, wanted: tuple[float, ...], patience: float = 2.0) -> float:
        """Wait until the loop would take this force [N], stator frame; returns the session."""
        end = monotonic() + patience
        while True:
            force, session = self.receive()
            if force == pytest.approx(wanted, abs=1e-12):
                return session
            assert monotonic() < end, f"the loop has {force} N, not {wanted}"
            sleep(0.001)

    def await_rest(self, force: tuple[float, ...]) -> tuple[list[float], float]:
        """Torque [N·m] and gripper force [N] that come with this force [N], for which it waits."""
        self.await_force(force)
        return self.torque, float(self.loop._client["gripper"][0])

    @property
    def torque(self) -> list[float]:
        """Torque that the loop received last [N·m], stator frame."""
        return self.loop._client["torque"][0].tolist()

    def __enter__(self) -> Self:
        self.loop.__enter__()
        self._publisher.start()
        self._thread.start()
        end = monotonic() + 5.0
        while not any(self.path.read_bytes()[4096:4104]):
            assert monotonic() < end
            sleep(0.001)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.loop.served.ending = True
        self._thread.join(5.0)
        self._over.set()
        self._publisher.join(5.0)
        self.preparation.close()
        for one in self._descriptors:
            os.close(one)
        self.loop.__exit__(kind, error, at)
        assert not self._thread.is_alive()


@pytest.fixture
def served() -> Iterator[ServedFile]:
    with ServedFile() as one:
        yield one


@pytest.fixture
def dhd(libraries: Path, served: ServedFile, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Force Dimension's library in this process, without its time guard, and `served` open."""
    monkeypatch.setenv("HAPTORB_RUN", str(served.path))
    library = ctypes.CDLL(str(libraries / "libdrd.so.3"))
    library.dhdErrorGetLastStr.restype = ctypes.c_char_p
    assert library.dhdOpen() == 0, library.dhdErrorGetLastStr()
    assert library.dhdSetTimeGuard(0, ctypes.c_char(b"\xff")) == 0
    yield library
    library.dhdClose(ctypes.c_char(b"\xff"))
