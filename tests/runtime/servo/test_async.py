"""Servo in an event loop: other tasks run during start and end; a cancelled task leaves nothing."""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from haptorb.errors import ServoError
from haptorb.runtime.process_group import ProcessGroup, SignalStop
from haptorb.runtime.shared_memory import Word

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
            assert not task.done(), "the start failed"
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


@pytest.mark.parametrize("executor", ["busy", "shut down"])
def test_leaving_the_block_needs_no_executor(fake_servo: Any, executor: str) -> None:
    """Its threads may all wait for something, or be gone."""
    made = fake_servo(record=False)
    free = threading.Event()

    async def use() -> bool:
        loop = asyncio.get_running_loop()
        async with made.servo as servo:
            if executor == "busy":
                loop.set_default_executor(ThreadPoolExecutor(1))
                job = loop.run_in_executor(None, free.wait, 5.0)
            else:
                await loop.shutdown_default_executor()
            await servo.wait(0.05)
        waited = executor == "busy" and job.done()
        free.set()
        return waited

    assert not asyncio.run(use())
    assert made.words() == ["open", "close"]


def test_the_coils_are_off_before_anything_else_ends(fake_servo: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    made = fake_servo(record=False)
    quits = list[int]()
    close = made.servo.close

    def note_and_close() -> None:
        quits.append(int(made.servo._shared.words[Word.QUIT]))
        close()

    monkeypatch.setattr(made.servo, "close", note_and_close)

    async def use() -> None:
        async with made.servo as servo:
            await servo.wait(0.05)

    asyncio.run(use())
    assert quits == [1]


def test_a_start_that_is_cancelled_is_stopped_at_once(fake_servo: Any, monkeypatch: Any) -> None:
    """Not when it has come to its end: the coils may be on long before."""
    made = fake_servo(record=False)
    wants, may = _delay(monkeypatch, "wait_until_running")

    async def use() -> None:
        async with made.servo:
            raise AssertionError("it was cancelled before")

    async def cancel() -> tuple[int, int]:
        task = asyncio.create_task(use())
        while not wants.is_set():
            await asyncio.sleep(0.001)
            assert not task.done(), "the start failed"
        task.cancel()
        await asyncio.sleep(0.01)
        words = made.servo._shared.words
        found = int(words[Word.QUIT]), int(words[Word.STOP])
        may.set()
        with pytest.raises(asyncio.CancelledError):
            await task
        return found

    assert asyncio.run(cancel()) == (1, 1)


def test_a_start_whose_signals_cannot_be_handled_ends_the_loop(fake_servo: Any, monkeypatch: Any) -> None:
    """The block is not entered, so nothing else ends it."""
    made = fake_servo(record=False)

    def fail(signals: SignalStop) -> None:
        if threading.current_thread() is threading.main_thread():
            raise OSError(24, "Too many open files")

    monkeypatch.setattr(SignalStop, "install", fail)

    async def use() -> None:
        async with made.servo:
            raise AssertionError("it was not entered")

    with pytest.raises(OSError, match="Too many open files"):
        asyncio.run(use())
    assert not made.servo.alive
    assert made.words() == ["open", "close"]


def test_signals_are_handled_as_before_when_it_has_ended(fake_servo: Any) -> None:
    """The next servo of the program finds the descriptor of its signals free."""
    made = fake_servo(record=False)

    async def use() -> int:
        async with made.servo as servo:
            await servo.wait(0.05)
            descriptor = signal.set_wakeup_fd(-1)
            signal.set_wakeup_fd(descriptor)
            return descriptor

    assert asyncio.run(use()) >= 0
    assert signal.set_wakeup_fd(-1) == -1


def test_a_servo_that_ends_by_itself_is_told_while_one_waits(fake_servo: Any) -> None:
    async def use() -> None:
        async with fake_servo({"raise_at": 100}, record=False).servo as servo:
            await servo.wait(PATIENCE)

    with pytest.raises(ServoError, match="a fault that nobody foresaw"):
        asyncio.run(use())
