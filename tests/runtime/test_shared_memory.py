"""Shared memory: rows, texts and pointer goals written at full speed are never read half written."""

from __future__ import annotations

import mmap
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb.control.trip_reasons import CoilState
from haptorb.errors import InputError, ServoError
from haptorb.recording.row import RowLayout
from haptorb.runtime.report import loop_report
from haptorb.runtime.ring_buffer import RingBuffer
from haptorb.runtime.shared_memory import (
    CAPACITY,
    SIZE,
    TRIPS,
    WORLDS,
    HandGoalBlock,
    Phase,
    SharedMemory,
    TextSlot,
    Word,
)

LAYOUT = RowLayout(channels=3, sensors=9)


@pytest.fixture
def shared() -> Iterator[SharedMemory]:
    memory = SharedMemory.create(LAYOUT)
    yield memory
    memory.unlink()


@contextmanager
def _writing(shared: SharedMemory, write: Callable[[SharedMemory, int], None]) -> Iterator[None]:
    """Another process that calls `write(shared, 1)`, `write(shared, 2)` … as fast as it can."""
    child = os.fork()
    if child == 0:
        other, i = SharedMemory.attach(shared.path), 0
        while True:
            i += 1
            write(other, i)
    try:
        yield
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def _ring(capacity: int, width: int = 3) -> RingBuffer:
    words = memoryview(bytearray(8)).cast("q")
    return RingBuffer(words, 0, np.zeros((capacity, width)))


@given(capacity=st.integers(2, 9), bursts=st.lists(st.integers(0, 25), max_size=20))
def test_ring_against_a_list(capacity: int, bursts: list[int]) -> None:
    ring, written, cursor = _ring(capacity), 0, 0
    assert ring.latest() is None
    for burst in bursts:
        for _ in range(burst):
            ring.publish(np.full(3, float(written)))
            written += 1
        before = cursor
        cursor, rows = ring.read_since(cursor)
        assert cursor == written
        kept = min(written - before, capacity - 1)  # the slot after the newest may be written just now
        assert rows[:, 0].tolist() == list(range(written - kept, written))
        assert rows.shape[1] == 3
    newest = ring.latest()
    assert (newest is None) == (written == 0)
    assert newest is None or newest[0] == written - 1


@given(cursor=st.integers(-5, 100), most=st.none() | st.integers(0, 9))
def test_ring_with_any_cursor(cursor: int, most: int | None) -> None:
    ring = _ring(8)
    for i in range(20):
        ring.publish(np.full(3, float(i)))
    end, rows = ring.read_since(cursor, most)
    assert end == 20
    wanted = min(max(20 - cursor, 0), 7, 7 if most is None else most)
    assert rows[:, 0].tolist() == list(range(20 - wanted, 20))


def test_rows_are_copies() -> None:
    ring = _ring(4)
    ring.publish(np.zeros(3))
    _, rows = ring.read_since(0)
    ring.publish(np.ones(3))
    rows[:] = 7.0
    assert ring.read_since(0)[1].tolist() == [[0, 0, 0], [1, 1, 1]]


def test_rows_that_were_overtaken_while_they_were_copied() -> None:
    class Rising:
        """A count that the writer raises between the reader's two looks."""

        def __init__(self) -> None:
            self.counts = [20, 23]

        def __getitem__(self, at: int) -> int:
            return self.counts.pop(0)

    ring = _ring(8)
    for i in range(20):
        ring.publish(np.full(3, float(i)))
    ring._words = Rising()  # type: ignore[assignment]
    end, rows = ring.read_since(0)
    assert end == 20
    assert rows[:, 0].tolist() == [16, 17, 18, 19]  # 13 to 15 may have been overwritten


@pytest.mark.parametrize("capacity", [5, 16, CAPACITY])
def test_no_torn_rows(shared: SharedMemory, capacity: int) -> None:
    def small(memory: SharedMemory) -> RingBuffer:
        return RingBuffer(memory.words, Word.ROWS, memory.ring._rows[:capacity])

    def write(other: SharedMemory, i: int) -> None:
        small(other).publish(np.full(LAYOUT.width, float(i)))

    ring = small(shared)
    with _writing(shared, write):
        cursor, lost, seen, last = 0, 0, 0, 0.0
        while seen < (20_000 if capacity > 5 else 4_000):  # most rows of five are lost
            before = cursor
            cursor, rows = ring.read_since(cursor)
            lost += cursor - before - len(rows)
            if not len(rows):
                continue
            assert (rows == rows[:, :1]).all()  # torn rows would mix two numbers
            assert (np.diff(rows[:, 0]) == 1).all()
            assert rows[0, 0] > last
            last = rows[-1, 0]
            seen += len(rows)
            newest = ring.latest()
            assert newest is not None
            assert (newest == newest[0]).all()
        assert last == seen + lost


def test_torn_rows_would_be_noticed(shared: SharedMemory) -> None:
    """The same reader without the second look at the count does return torn rows: the test above can fail."""
    rows = shared.ring._rows
    torn = 0

    def write(other: SharedMemory, i: int) -> None:
        other.ring.publish(np.full(LAYOUT.width, float(i)))

    with _writing(shared, write):
        for _ in range(20_000_000):
            slot = rows[shared.ring.count % CAPACITY].copy()  # the one that is being written
            torn += bool((slot != slot[0]).any())
            if torn:
                break
    assert torn


def test_pointer_never_torn(shared: SharedMemory) -> None:
    def write(other: SharedMemory, i: int) -> None:
        other.pointer.write(bool(i % 2), np.full(3, float(i)), np.full(4, float(i)), float(i), float(i))

    with _writing(shared, write):
        seen, last = 0, 0.0
        while seen < 50_000:
            held, p, q, stamp, keep_alive = shared.pointer.read_hand_goal()
            if stamp == 0.0:  # nothing was written yet
                continue
            seen += 1
            assert (p == stamp).all()
            assert (q == stamp).all()
            assert keep_alive == stamp
            assert held == bool(stamp % 2)
            assert stamp >= last
            last = stamp


def test_pointer_of_a_writer_that_died_in_the_middle() -> None:
    memory = memoryview(bytearray(88))
    words = memory.cast("q")
    block = HandGoalBlock(words, memory.cast("d"), 0)
    block.write(True, np.ones(3), np.ones(4), 5.0)
    assert block.read_hand_goal().stamp == 5.0
    words[0] += 1  # it began to write, and died
    memory.cast("d")[9] = 77.0
    assert block.read_hand_goal().stamp == 5.0
    HandGoalBlock(words, memory.cast("d"), 0).write(True, np.ones(3), np.ones(4), 6.0)  # its successor
    assert block.read_hand_goal().stamp == 6.0


def test_texts_never_torn(shared: SharedMemory) -> None:
    def write(other: SharedMemory, i: int) -> None:
        other.answer.write(f"{i} " * (i % 400 + 1))

    with _writing(shared, write):
        seen = set()
        while len(seen) < 500:
            version, text = shared.answer.read()
            numbers = set(text.split())
            assert len(numbers) <= 1
            seen.add(version)


@given(st.lists(st.text(max_size=50), min_size=1, max_size=5))
def test_text_there_and_back(texts: list[str]) -> None:
    slot = TextSlot(memoryview(bytearray(512)))
    assert slot.read() == (0, "")
    for i, text in enumerate(texts, start=1):
        assert slot.write(text) == i == slot.version
        assert slot.read() == (i, text)


def test_text_too_long_leaves_the_old_one() -> None:
    slot = TextSlot(memoryview(bytearray(64)))
    slot.write("short")
    with pytest.raises(InputError, match="too long"):
        slot.write("ü" * 30)
    assert slot.read() == (1, "short")


def test_text_of_a_writer_that_died_in_the_middle() -> None:
    memory = memoryview(bytearray(64))
    slot = TextSlot(memory)
    slot.write("short")
    memory.cast("q")[0] += 1
    assert slot.read() == (0, "")
    slot.write("again")
    assert slot.read()[1] == "again"


def test_attached_sees_the_same(shared: SharedMemory) -> None:
    other = SharedMemory.attach(shared.path)
    assert other.layout == LAYOUT
    shared.words[Word.STOP] += 3
    shared.floats[Word.PEAK] = 0.25
    other.lateness.add(5000)
    assert other.words[Word.STOP] == 3
    assert other.floats[Word.PEAK] == 0.25
    assert shared.lateness.count == 1
    assert shared.phase is Phase.STARTING


def test_it_outlives_those_who_attach(shared: SharedMemory) -> None:
    """What `multiprocessing.SharedMemory` does not: a process that attaches and ends takes nothing away."""
    child = os.fork()
    if child == 0:
        SharedMemory.attach(shared.path).words[Word.TICKS] = 9
        os._exit(0)
    os.waitpid(child, 0)
    assert shared.path.exists()
    assert SharedMemory.attach(shared.path).words[Word.TICKS] == 9


def test_worlds_are_kept_in_order(shared: SharedMemory) -> None:
    known, seen = 0, []
    for i in range(3 * WORLDS):
        assert shared.announce_world(f"world {i}") == i
        if i % 5 == 0:
            for number, text in shared.worlds_since(known):
                assert text == f"world {number}"
                seen.append(number)
                known = number + 1
    assert seen == list(range(seen[-1] + 1))
    assert [number for number, _ in shared.worlds_since(0)] == list(range(2 * WORLDS + 1, 3 * WORLDS))


def test_trips_beyond_the_room_are_counted(shared: SharedMemory) -> None:
    for i in range(TRIPS + 10):
        shared.announce_trip(float(i), 1.0)
    assert shared.words[Word.TRIPS] == TRIPS + 10
    assert shared.trips[-1].tolist() == [TRIPS - 1, 1.0]


@pytest.mark.parametrize("damage", ["empty", "short", "magic", "version", "width", "size"])
def test_foreign_memory_is_refused(shared: SharedMemory, tmp_path: Path, damage: str) -> None:
    data: Any = bytearray(shared.path.read_bytes())
    if damage == "empty":
        data = b""
    elif damage == "short":
        data = data[:5000]
    elif damage == "size":
        data = data[: -2 * mmap.PAGESIZE]  # longer ones are ours: signals are written behind the end
    else:
        data[8 * Word[damage.upper()]] ^= 1
    path = tmp_path / "memory"
    path.write_bytes(data)
    with pytest.raises(ServoError):
        SharedMemory.attach(path)


def test_slots_do_not_touch(shared: SharedMemory) -> None:
    slots = [shared.request, shared.answer, shared.reason, shared.error, shared.facts, shared.recorder_reason]
    for i, slot in enumerate(slots):
        slot.write(chr(97 + i) * (SIZE - 16))
    shared.announce_world("w" * (SIZE - 16))
    shared.ring.publish(np.ones(LAYOUT.width))
    shared.announce_trip(1.0, 2.0)
    shared.lateness.add(10**12)
    shared.compute.add(0)
    assert [slot.read()[1][0] for slot in slots] == list("abcdef")
    assert shared.worlds_since(0) == [(0, "w" * (SIZE - 16))]
    assert shared.lateness.count == shared.compute.count == 1
    assert shared.ring.count == 1


@settings(max_examples=20)
@given(channels=st.integers(1, 24), sensors=st.integers(0, 48), contacts=st.integers(0, 4))
def test_any_layout(channels: int, sensors: int, contacts: int) -> None:
    memory = SharedMemory.create(RowLayout(channels, sensors, contacts))
    try:
        assert SharedMemory.attach(memory.path).layout == RowLayout(channels, sensors, contacts)
    finally:
        memory.unlink()
    memory.unlink()  # twice does no harm


@pytest.mark.parametrize("state", list(CoilState))
def test_the_report_says_what_the_last_row_says_of_the_coils(shared: SharedMemory, state: CoilState) -> None:
    assert loop_report(shared)["coil_state"] is None
    row = LAYOUT.empty()
    for one in (CoilState.ON, state):
        row[LAYOUT["coil_state"]] = one
        shared.ring.publish(row)
    assert loop_report(shared)["coil_state"] == state.name.lower()
