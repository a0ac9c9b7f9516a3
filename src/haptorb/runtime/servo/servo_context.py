"""A servo in a `with` block, and in an `async with` block, whose event loop keeps running."""

from __future__ import annotations

import asyncio
from abc import abstractmethod
from collections.abc import AsyncIterator, Callable
from time import monotonic, sleep
from types import TracebackType
from typing import Self

from haptorb.errors import InputError
from haptorb.numerics.arrays import check_finite
from haptorb.runtime.servo.latest_row import LatestRow
from haptorb.runtime.servo.observer import ServoObserver

__all__ = ["ServoContext"]

_LOOK = 0.02  #: between two looks whether all is well [s]


class ServoContext(ServoObserver):
    """Base of `Servo`: it is open in the block and closed after it, however the block ends."""

    @abstractmethod
    def open(self) -> None:
        """Start; returns when the loop runs."""

    @abstractmethod
    def close(self) -> None:
        """Coils off, processes ended."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    async def __aenter__(self) -> Self:
        try:
            await _complete(self.open)
        except asyncio.CancelledError:
            await _complete(self.close)
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        await _complete(self.close)

    def run(self, seconds: float) -> None:
        """Let the loop run for `seconds`. Raises ServoError as soon as it ends by itself, RecordingError if the
        recorder does, WorldError if the world's code fails or takes too long; InputError if the path of the hand fails,
        or `seconds` is negative or not finite.

        Ctrl-C closes the servo first, then raises KeyboardInterrupt; so does what else ends a program.
        """
        end = monotonic() + _check_seconds(seconds)
        try:
            while (left := self._check_all(end)) > 0:
                sleep(min(left, _LOOK))
        except BaseException as cause:
            if not isinstance(cause, Exception):
                self.close()
            raise

    async def wait(self, seconds: float) -> None:
        """Like `run`, for an event loop: other tasks keep running. Raises what `run` raises."""
        end = monotonic() + _check_seconds(seconds)
        while (left := self._check_all(end)) > 0:
            await asyncio.sleep(min(left, _LOOK))

    async def watch(self, every: float = _LOOK) -> AsyncIterator[LatestRow]:
        """The newest tick, once `every` [s]: `async for row in servo.watch()`.

        Raises what `run` raises.
        """
        pause = _check_seconds(every)
        while True:
            self._check_all(0.0)
            yield self.latest()
            await asyncio.sleep(pause)

    def _check_all(self, end: float) -> float:
        """Time until `end` [s]; raises if something is wrong."""
        self.check()
        self.check_world()
        self.check_hand()
        return end - monotonic()


def _check_seconds(seconds: float) -> float:
    duration = float(check_finite(seconds, "seconds"))
    if duration < 0:
        raise InputError(f"seconds must not be negative; got {seconds!r}")
    return duration


async def _complete(work: Callable[[], None]) -> None:
    """`work` in a thread, to its end: a task that is cancelled waits until it is done, because a servo
    that has half started must be closed."""
    task = asyncio.ensure_future(asyncio.to_thread(work))
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.wait({task})
        except asyncio.CancelledError as cause:
            cancelled = cause
    if cancelled is not None:
        task.exception()  # otherwise it is reported nowhere
        raise cancelled
    task.result()
