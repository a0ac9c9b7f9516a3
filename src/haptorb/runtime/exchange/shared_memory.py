"""The memory that host, servo and recorder share: one mapped file with counters, commands, status, texts and rows.

A mapped file and not `multiprocessing.SharedMemory`: there an unrelated process that attaches and exits destroys it.
Every word has one writer; nothing in here ever waits.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import tempfile
from enum import IntEnum
from pathlib import Path
from typing import final

import numpy as np

from haptorb.errors import ServoError
from haptorb.numerics.arrays import Array, Records
from haptorb.runtime.memory import force_block, pose_block, text_slot
from haptorb.runtime.memory.force_block import BLOCKS, ClientForces, ForceBlock
from haptorb.runtime.memory.histogram import BINS, Histogram
from haptorb.runtime.memory.pose_block import PoseBlock
from haptorb.runtime.memory.ring import RingBuffer
from haptorb.runtime.memory.state_slots import StateSlots, slots_size
from haptorb.runtime.memory.text_slot import TextSlot
from haptorb.runtime.pointer import pointer_block
from haptorb.runtime.pointer.pointer_block import PointerBlock
from haptorb.runtime.realtime.end_signals import END_SIGNALS
from haptorb.runtime.realtime.stale_files import SHARED, FileLock, folders
from haptorb.runtime.row import RowLayout

__all__ = [
    "CAPACITY", "COUNTS", "TRIPS", "WORLDS", "Phase", "SharedMemory", "Word", "engage_request", "engage_stops",
    "has_end_signal",
]  # fmt: skip

_MAGIC = int.from_bytes(b"haptorb\0", "little")
_VERSION = 9
_PAGE = 4096
_END_NUMBERS = frozenset(map(int, END_SIGNALS))
_TEXTS = 9
CAPACITY = 8192  #: rows: 2 s at the fastest rate
WORLDS = 32  #: the last changes of the world, kept for the recorder
TRIPS = 64  #: the first trips, kept for the report


class Phase(IntEnum):
    """Where a child process is in its life."""

    STARTING = 0
    RUNNING = 1
    ENDED = 2  #: as requested
    FAILED = 3  #: the status text says why


class Word(IntEnum):
    """Which 8-byte word of the first page is what; all are integers unless said otherwise."""

    MAGIC = 0
    VERSION = 1
    WIDTH = 2
    CAPACITY = 3
    CHANNELS = 4
    SENSORS = 5
    CONTACTS = 6
    MEMORY = 7
    # host → servo
    HEARTBEAT = 16  #: monotonic clock [ns]
    STOP = 17  #: count
    ENGAGE = 18  #: `engage_request`: count, and the stop count under which it was given
    QUIT = 19  #: 1: end
    MODE = 20  #: 0: as it is, else number of the mode from 1 on
    CLUTCH = 21  #: 0: unchanged, 1: engaged, 2: released
    MODEL = 22  #: 0: as it is, else number of the device's model from 1 on
    COOL = 23  #: count: simulated coils at the ambient temperature
    POINTER = 24  #: and the ten after it
    SCALE = 35  #: 0: as it is, else the scale of a motor's torques, in millionths
    BUTTONS = 36  #: bits of the buttons a, b, c that a person holds down: for servers, not for the loop
    RECORDING_PAUSED = 37  #: 1: rows are not recorded until it is 0 again
    # servo → host
    PID = 40
    PHASE = 41
    ORIGIN = 42  #: monotonic clock at which the loop's clock shows zero [ns]
    ROWS = 43  #: published
    TICKS = 44
    MISSED = 45  #: deadlines missed
    ON_TIME = 46  #: ticks that began and ended within their period
    TRIPS = 47  #: count
    PEAK = 48  #: float: greatest force on the mover [N]
    WORLD = 49  #: changes of the world
    PEAK_TORQUE = 50  #: float: greatest torque on the mover [N·m]
    FIRST_CALL = 51  #: monotonic clock at which the first call of a user's world began [ns]; 0: none runs
    COMPILED = 52  #: 1: its process has had to compile a kernel
    UNCOMPILED = 53  #: worlds of the catalogue whose code lies in no cache
    # recorder → host
    RECORDER = 56  #: a Phase
    WRITTEN = 57  #: rows that are in the file, even if the recorder fails
    LOST = 58  #: rows overwritten before they could be recorded
    TAKEN = 59  #: rows that it has fetched, and those that it lost
    # a tracker's process → servo, host
    TRACKER = 60  #: a Phase
    # recorder → host
    RECORDER_LOOKS = 61  #: how often it has looked for rows
    TRACKED = 64  #: and the fifteen after it
    # each server's process → servo, host
    FORCES = 128  #: eight for each of eight servers
    SERVERS = 192  #: a Phase for each of eight servers


_LAYOUT = [Word.CHANNELS, Word.SENSORS, Word.CONTACTS, Word.MEMORY]  #: arguments of RowLayout
_SERVER_TEXTS = 2 * BLOCKS
_LATENESS = _PAGE + (_TEXTS + WORLDS + _SERVER_TEXTS) * text_slot.SIZE + 16 * TRIPS  #: where the histograms begin
_ROWS = _LATENESS + 2 * 8 * BINS

#: What the loop counts in every tick, where it lies in the memory before the rows: words of the first page, histograms.
COUNTS = np.dtype(
    {
        "names": ["ticks", "missed", "on_time", "peak", "peak_torque", "lateness", "compute"],
        "formats": ["i8", "i8", "i8", "f8", "f8", ("i8", (BINS,)), ("i8", (BINS,))],
        "offsets": [
            *(8 * word for word in (Word.TICKS, Word.MISSED, Word.ON_TIME, Word.PEAK, Word.PEAK_TORQUE)),
            _LATENESS,
            _LATENESS + 8 * BINS,
        ],
        "itemsize": _ROWS,
    },
    align=True,
)


def engage_request(last: int, stops: int) -> int:
    """The word ENGAGE after `last`: a new count, and the stop count under which the person asked.

    One word, so that two threads that engage at once cannot mix one's count with the other's stop count.

    >>> engage_stops(engage_request(0, 7))
    7
    """
    count = ((last >> 32) + 1) & 0x7FFF_FFFF
    return count << 32 | stops & 0xFFFF_FFFF


def engage_stops(word: int) -> int:
    """The stop count under which the engage request `word` was given, modulo 2³²."""
    return word & 0xFFFF_FFFF


def has_end_signal(signals: memoryview) -> bool:
    """Whether one of the numbers in `signals`, a word of eight bytes, is of a signal that ends programs."""
    return any(number in _END_NUMBERS for number in signals.tobytes())


@final
class SharedMemory:
    """The mapped file. `create` makes it, `attach` opens one that another process made.

    Raises ServoError if the file is not a servo's shared memory of this version and layout.
    """

    def __init__(self, path: Path, *, populate: bool = False) -> None:
        flags = mmap.MAP_SHARED | (mmap.MAP_POPULATE if populate else 0)
        with path.open("r+b") as file:
            size = os.fstat(file.fileno()).st_size
            if size < _ROWS:
                raise ServoError(f"{path} is not a servo's shared memory: too small; end the program that created it")
            self._map = mmap.mmap(file.fileno(), size, flags=flags)
        self._claim: FileLock | None = None  # of the process that made it
        memory = memoryview(self._map)
        self.path = path
        self.words = memory[:_PAGE].cast("q")
        self.floats = memory[:_PAGE].cast("d")
        self.counts: Records = np.frombuffer(memory[:_ROWS], dtype=COUNTS)  #: (1,) words and histograms, for kernels
        if self.words[Word.MAGIC] != _MAGIC or self.words[Word.VERSION] != _VERSION:
            raise ServoError(f"{path} is not a servo's shared memory of this version; end the program that created it")
        self.layout = RowLayout(*(self.words[word] for word in _LAYOUT))
        end = _size(self.layout)
        if self.layout.width != self.words[Word.WIDTH] or size < end + _PAGE:  # many signals make it longer
            raise ServoError(f"{path} holds rows of another layout; end the program that created it")

        self.pointer = PointerBlock(self.words, self.floats, Word.POINTER)
        self.tracked = PoseBlock(self.words, self.floats, Word.TRACKED)
        self.client_forces = ClientForces(self.words, self.floats, Word.FORCES)
        at = _PAGE
        slots = []
        for _ in range(_TEXTS + WORLDS + _SERVER_TEXTS):
            slots.append(TextSlot(memory[at : at + text_slot.SIZE]))
            at += text_slot.SIZE
        self.request, self.answer, self.reason, self.error, self.facts, self.recorder_reason = slots[:6]
        self.tracker_reason, self.tracker_facts, self.warning = slots[6:_TEXTS]
        self._worlds = slots[_TEXTS : _TEXTS + WORLDS]
        texts = slots[_TEXTS + WORLDS :]
        #: of each server's process: what it says of its clients, and what they request
        self.server_facts, self.server_requests = texts[:BLOCKS], texts[BLOCKS:]
        self.trips: Array = np.frombuffer(memory[at : at + 16 * TRIPS], dtype=np.float64).reshape(TRIPS, 2)
        self.lateness = Histogram(self.counts["lateness"][0])
        self.compute = Histogram(self.counts["compute"][0])
        rows_end = _ROWS + 8 * CAPACITY * self.layout.width
        #: snapshots of the chain
        self.states = StateSlots(memory[rows_end:end], self.layout.channels, self.layout.sensors)
        #: where the numbers of the host's signals are written: see `SignalStop`
        self.signals_at, self.signals = end, memory[end : end + 8].cast("q")
        rows = np.frombuffer(memory[_ROWS:rows_end], dtype=np.float64).reshape(CAPACITY, self.layout.width)
        self.ring = RingBuffer(self.words, Word.ROWS, rows)

    @classmethod
    def create(cls, layout: RowLayout) -> SharedMemory:
        """A new one, all zeros, in memory where the system has a place for that; ServoError if nowhere is room."""
        size = _size(layout) + _PAGE
        for folder in folders():
            try:
                descriptor, name, claim = _create_file(folder)
            except OSError:
                continue
            try:
                # Reserve it now: a full memory file system would otherwise kill the loop in the middle of a tick.
                os.posix_fallocate(descriptor, 0, size)
                head = np.zeros(16, dtype=np.int64)
                head[[Word.MAGIC, Word.VERSION, Word.WIDTH, Word.CAPACITY]] = _MAGIC, _VERSION, layout.width, CAPACITY
                head[_LAYOUT] = layout.channels, layout.sensors, layout.contacts, layout.memory
                os.pwrite(descriptor, head.tobytes(), 0)
                made = cls(Path(name))
                made._claim = claim
                return made
            except OSError:
                Path(name).unlink()
            finally:
                os.close(descriptor)
        raise ServoError(f"no room for {size / 1e6:.0f} MB in /dev/shm or {tempfile.gettempdir()}; free some")

    @classmethod
    def attach(cls, path: str | Path) -> SharedMemory:
        """The one that another process made, all of its pages present before the loop begins."""
        return cls(Path(path), populate=True)

    def unlink(self) -> None:
        """Remove its name; who has it mapped keeps it."""
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        if self._claim is not None:
            self._claim.close()

    def force_block(self, server: int) -> ForceBlock:
        """Where the process of the server with this number, 0 to 7, says what its clients command."""
        return ForceBlock(self.words, self.floats, Word.FORCES + force_block.WORDS * server)

    @property
    def phase(self) -> Phase:
        """Where the servo is in its life."""
        return Phase(self.words[Word.PHASE])

    def announce_world(self, text: str) -> int:
        """Keep `text` as the description of the world from now on; returns the number of this change."""
        number = self.words[Word.WORLD]
        self._worlds[number % WORLDS].write(text)
        self.words[Word.WORLD] = number + 1
        return int(number)

    def worlds_since(self, known: int) -> list[tuple[int, str]]:
        """(number, description) of the world's changes from number `known` on; the oldest may be gone."""
        count = self.words[Word.WORLD]
        return [(i, self._worlds[i % WORLDS].read()[1]) for i in range(max(known, count - WORLDS + 1, 0), count)]

    def world_now(self) -> str:
        """Name of the world that is rendered; empty before the first."""
        changes = self.worlds_since(self.words[Word.WORLD] - 1)
        return str(json.loads(changes[-1][1])["name"]) if changes else ""

    def announce_trip(self, t: float, code: float) -> None:
        """Note a trip; those after the first 64 are only counted."""
        number = self.words[Word.TRIPS]
        if number < TRIPS:
            self.trips[number] = t, code
        self.words[Word.TRIPS] = number + 1


def _create_file(folder: Path) -> tuple[int, str, FileLock]:
    """(descriptor, path, claim) of a new file in `folder`. Raises OSError if none can be made there."""
    while True:
        descriptor, name = tempfile.mkstemp(prefix="haptorb-", suffix=SHARED, dir=folder)
        claim = FileLock(name)
        if claim.there:
            return descriptor, name, claim
        os.close(descriptor)  # another process removed it first


def _size(layout: RowLayout) -> int:
    return _ROWS + 8 * CAPACITY * layout.width + slots_size(layout.channels, layout.sensors)


assert Word.POINTER + pointer_block.WORDS <= Word.PID
assert Word.TRACKED + pose_block.WORDS <= Word.FORCES
assert Word.FORCES + force_block.WORDS * BLOCKS <= Word.SERVERS
assert 8 * (Word.SERVERS + BLOCKS) <= _PAGE
