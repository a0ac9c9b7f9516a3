"""Servo in an event loop: other tasks run during start and end; a cancelled task leaves nothing."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any

import pytest

from haptorb.errors import ServoError
from haptorb.runtime.process_group import ProcessGroup

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("quick_starts")]

PATIENCE = 30.0  #: for what the event loop must do meanwhile [s]


def _delay(monkeypatch: pytest.MonkeyPatch, name: str) -> tuple[threading.Event, threading.Event]:
    """Let `ProcessGroup.name` begin only when the second event is set; the first one tells that it wants to."""
    wants, may = threading.Event(), threading.Event()
    method: Callable[..., None] = getattr(ProcessGroup, name)

    def delay(group: ProcessGroup, *arguments: object) -> None:
        wants.set()
        assert may.wait(PATIENCE), "the event loop stands still"
        method(group, *arguments)

    monkeypatch.setattr(ProcessGroup, name, delay)
    return wants, may


async def _count_then(wanted: threading.Event, may: threading.Event) -> int:
    """Ticks of the event loop while somebody waits for `may`, which it sets after 20."""
    ticks = 0
    while ticks < 20:
        await asyncio.sleep(0.001)
        ticks += wanted.is_set()
    may.set()
    return ticks


def test_the_event_loop_goes_on_while_a_servo_starts_and_ends(fake_servo: Any, monkeypatch: Any) -> None:
    made = fake_servo(record=False)
    start, end = _delay(monkeypatch, "wait_until_running"), _delay(monkeypatch, "end")

    async def use() -> tuple[int, int]:
        starting = asyncio.create_task(_count_then(*start))
        async with made.servo as servo:
            assert servo is made.servo
            await servo.wait(0.05)
            row = await anext(servo.watch())
            assert row.guard == 2
            ending = asyncio.create_task(_count_then(*end))
        return await starting, await ending

    assert asyncio.run(use()) == (20, 20)
    assert made.words() == ["open", "close"]
    assert not made.servo.alive


def test_a_task_that_is_cancelled_while_the_servo_starts_leaves_nothing_running(fake_servo: Any, monkeypatch: Any):
    made = fake_servo(record=False)
    wants, may = _delay(monkeypatch, "wait_until_running")

    async def use() -> None:
        async with made.servo:
            raise AssertionError("it was cancelled before")

    async def cancel() -> None:
        task = asyncio.create_task(use())
        while not wants.is_set():
            await asyncio.sleep(0.001)
        task.cancel()
        await asyncio.sleep(0.01)
        task.cancel()  # somebody is impatient
        await asyncio.sleep(0.01)
        assert not task.done(), "it ends when the servo has ended"
        may.set()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(cancel())
    assert not made.servo.alive
    assert made.words() == ["open", "close"]


def test_a_servo_that_ends_by_itself_is_told_while_one_waits(fake_servo: Any) -> None:
    async def use() -> None:
        async with fake_servo({"raise_at": 100}, record=False).servo as servo:
            await servo.wait(PATIENCE)

    with pytest.raises(ServoError, match="a fault that nobody foresaw"):
        asyncio.run(use())
