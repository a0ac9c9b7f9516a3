"""Shared memory of host, servo and recorder: one mapped file with counters, commands, status, texts and rows.

A mapped file and not `multiprocessing.SharedMemory`, which an unrelated process destroys when it attaches and exits.
Every word has one writer; all access is non-blocking.
"""

from __future__ import annotations

import contextlib
import errno
import json
import mmap
import os
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Sequence
from enum import IntEnum
from math import nan
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array, Records, StateArray
from haptorb.cache_folder import explain_shared
from haptorb.errors import InputError, ServoError
from haptorb.files import SHARED, FileLock, describe_size_limit, folders
from haptorb.recording.row import RowLayout
from haptorb.runtime.linux import END_SIGNALS
from haptorb.runtime.ring_buffer import RingBuffer
from haptorb.worlds.client_force import FADE_TIME_S, HOLD_TIME_S
from haptorb.worlds.dynamic import CLIENT_FORCE

__all__ = [
    "BINS",
    "BLOCKS",
    "BUTTONS",
    "CAPACITY",
    "COUNTS",
    "FORCE_BLOCK_WORDS",
    "HAND_GOAL_BLOCK_WORDS",
    "REGULAR",
    "SIZE",
    "SLOTS",
    "TRIPS",
    "WORDS",
    "WORLDS",
    "ClientForces",
    "Counts",
    "ForceBlock",
    "HandGoalBlock",
    "HandGoalSource",
    "HandSignals",
    "Histogram",
    "HostHandGoal",
    "Phase",
    "PoseBlock",
    "PoseRecord",
    "SeqlockWords",
    "SharedMemory",
    "StateSlots",
    "TextSlot",
    "Word",
    "engage_request",
    "engage_stops",
    "find_end_signal",
    "slots_size",
    "split_snapshot",
    "state_room",
]


# --------------------------------------------------------------------------------------------------
# A bounded, versioned text in shared memory, protected by a sequence lock: one writer, no torn reads.


SIZE = 16_384  #: size of a slot, including its two leading words [bytes]

_TEXT_SLOT_TRIES = 100


@final
class TextSlot:
    """Slot of two words (version, length) and UTF-8 text. The version is odd while the text is being written."""

    def __init__(self, memory: memoryview) -> None:
        self._words = memory[:16].cast("q")
        self._bytes = memory[16:]
        self.room = len(self._bytes)  #: maximum length of the text [bytes]

    @property
    def version(self) -> int:
        """Version of the text; changes with every `write`."""
        return int(self._words[0]) // 2

    def write(self, text: str) -> int:
        """Replace the text; return its version. Raises InputError if it is too long."""
        data = text.encode()
        if len(data) > self.room:
            raise InputError(f"a message of {len(data)} bytes is too long: at most {self.room}")
        version = self._words[0] | 1
        self._words[0] = version
        self._words[1] = len(data)
        self._bytes[: len(data)] = data
        self._words[0] = version + 1
        return (version + 1) // 2

    def read(self) -> tuple[int, str]:
        """Return (version, text); (0, "") before the first, and if a writer ended while writing."""
        for _ in range(_TEXT_SLOT_TRIES):
            before = self._words[0]
            length = self._words[1]
            if before & 1 or not 0 <= length <= self.room:
                continue
            data = bytes(self._bytes[:length])
            if self._words[0] == before:
                return before // 2, data.decode()
        return 0, ""


# --------------------------------------------------------------------------------------------------
# Histogram of durations in 1 µs bins: cheap enough to update in every tick, and sufficient for percentiles.


Counts: TypeAlias = NDArray[np.int64]

BINS = 20_001  #: 1 µs each, the last one for everything from 20 ms on


@final
class Histogram:
    """Histogram of durations, in an array that another object may own (shared memory).

    >>> histogram = Histogram()
    >>> for duration in (1_500, 2_500, 90_000_000):
    ...     histogram.add(duration)
    >>> histogram.count, histogram.percentile(50.0)
    (3, 3.0)
    """

    def __init__(self, counts: Counts | None = None) -> None:
        self.counts = np.zeros(BINS, dtype=np.int64) if counts is None else counts  #: (20001,)
        self._cells = self.counts.data  # scalar access through a memoryview is faster than through the array

    def add(self, duration: int) -> None:
        """Count one duration [ns]."""
        self._cells[min(max(duration, 0) // 1000, BINS - 1)] += 1

    @property
    def count(self) -> int:
        """Durations counted."""
        return int(self.counts.sum())

    def percentile(self, percent: float) -> float:
        """Percentile of the durations [µs]: the upper edge of its bin. NaN when empty.

        Durations from 20 ms on are not resolved; 20001 stands for "20 ms or more".
        """
        below = np.cumsum(self.counts)
        if below[-1] == 0:
            return float("nan")
        return float(np.searchsorted(below, percent / 100 * below[-1], side="left") + 1)


# --------------------------------------------------------------------------------------------------
# A flag and numbers in shared memory, protected by a sequence lock: its number is odd while they are being written.


_SEQLOCK_TRIES = 8  #: limit, so that a slow writer cannot delay the loop


@final
class SeqlockWords:
    """Sequence lock: `count` words at `at`, as integers and as floats: the sequence number, the flag, the numbers.

    One writer; reads are non-blocking and never torn.
    """

    def __init__(self, words: memoryview, floats: memoryview[float], at: int, count: int) -> None:
        self._words, self._floats = words, floats
        self._at, self._flag, self._first, self._end = at, at + 1, at + 2, at + count
        self._known = 0

    def write(self, flag: bool, numbers: tuple[float, ...]) -> None:
        """Replace flag and numbers; for the single writer."""
        words, floats, at = self._words, self._floats, self._at
        sequence = words[at] | 1
        words[at] = sequence
        words[self._flag] = flag
        for i, value in enumerate(numbers, start=self._first):
            floats[i] = value
        words[at] = sequence + 1

    def read_new(self) -> tuple[bool, list[float]] | None:
        """Return what was written since the last call; None if nothing was, or if a write is in progress."""
        words, at = self._words, self._at
        for _ in range(_SEQLOCK_TRIES):
            sequence = words[at]
            if sequence == self._known:
                return None
            if sequence & 1:
                continue
            flag = words[self._flag] != 0
            numbers: list[float] = self._floats[self._first : self._end].tolist()  # type: ignore[assignment]
            if words[at] == sequence:
                self._known = sequence
                return flag, numbers
        return None


# --------------------------------------------------------------------------------------------------
# A tracker's last pose in shared memory, protected by a sequence lock.


WORDS = 16  #: sequence, valid, p (3), q (4), v (3), w (3), stamp


class PoseRecord(NamedTuple):
    """Last pose of a tracker, converted to a common form by its own process."""

    valid: bool  #: False: the tracker has lost the tool, or has not found it yet
    p: Array  #: (3,) [m], frame S
    q: Array  #: (4,) quaternion (x, y, z, w) of R_SR, length 1
    v: Array  #: (3,) [m/s]
    w: Array  #: (3,) [rad/s], frame S
    stamp: float  #: time of the measurement on the computer's monotonic clock [s]


@final
class PoseBlock:
    """Sixteen words at `at`, seen both as integers and as floats."""

    def __init__(self, words: memoryview, floats: memoryview[float], at: int) -> None:
        self._words = SeqlockWords(words, floats, at, WORDS)
        unturned = np.array([0.0, 0.0, 0.0, 1.0])
        self._tracked = PoseRecord(False, np.zeros(3), unturned, np.zeros(3), np.zeros(3), float("-inf"))

    def write(self, pose: PoseRecord) -> None:
        """Write the tool's pose; for the single writer."""
        numbers = (*pose.p.tolist(), *pose.q.tolist(), *pose.v.tolist(), *pose.w.tolist(), pose.stamp)
        self._words.write(pose.valid, numbers)

    def read_pose(self) -> PoseRecord:
        """Return the last pose; if a write is in progress, the one before. Non-blocking."""
        latest = self._words.read_new()
        if latest is not None:
            n = np.array(latest[1])
            self._tracked = PoseRecord(latest[0], n[:3], n[3:7], n[7:10], n[10:13], latest[1][13])
        return self._tracked


# --------------------------------------------------------------------------------------------------
# Forces commanded by client programs, in shared memory: each server's process writes its own block, the loop reads all.
#
# A block states which client commanded which force when. The loop uses only those times: when a server's process ends,
# its force expires like that of a silent client.


FORCE_BLOCK_WORDS = 12  #: sequence, force (3), session, stamp, loss, mapping, torque (3), gripper
BLOCKS = 8  #: servers that may command at once

_PLACES = [
    CLIENT_FORCE.fields[name][1] // 8  # type: ignore[index]
    for name in ("force", "session", "age", "lost", "mapping", "torque", "gripper")
]
_OVER = HOLD_TIME_S + FADE_TIME_S


class _Command(NamedTuple):
    """Content of a block after its sequence number, as floats and in this order."""

    force_x: float  #: in the stator's frame [N]
    force_y: float
    force_z: float
    session: float  #: of the client
    stamp: float  #: on the monotonic clock [s]
    loss: float  #: when the client's connection was lost, on the same clock [s]; 0: it was not
    mapping: float  #: number of the client's mapping into the stator's frame
    torque_x: float  #: in the stator's frame [N·m]
    torque_y: float
    torque_z: float
    gripper: float  #: between thumb and finger, positive to open [N]


@final
class ForceBlock:
    """Twelve words at `at`, as integers and as floats; for the single server that writes them."""

    def __init__(self, words: memoryview, floats: memoryview[float], at: int) -> None:
        self._words, self._floats, self._at = words, floats, at

    def command(
        self, force: Sequence[float], session: int, stamp: float, mapping: int = 0,
        torque: Sequence[float] = (0.0, 0.0, 0.0), gripper: float = 0.0,
    ) -> None:  # fmt: skip
        """Write the `force` (3,) [N] and `torque` (3,) [N·m], stator frame, and the `gripper` force [N], that the
        client of `session` commanded at `stamp` [s] of the monotonic clock. A new number `mapping`: the client's frame
        has changed."""
        (x, y, z), (a, b, c) = force, torque
        self._write(_Command(x, y, z, float(session), stamp, 0.0, float(mapping), a, b, c, gripper))

    def lose(self, stamp: float) -> None:
        """Record that the last client's connection was lost at `stamp` [s] of the monotonic clock."""
        last = _read_command(self._floats, self._at)
        if last.loss == 0.0:
            self._write(last._replace(loss=stamp))

    def _write(self, command: _Command) -> None:
        words, floats, at = self._words, self._floats, self._at
        sequence = words[at] | 1
        words[at] = sequence
        for i, value in enumerate(command, start=at + 1):
            floats[i] = value
        words[at] = sequence + 1


@final
class ClientForces:
    """The loop's reader of all blocks: selects the one client that controls the device. Allocates no array in a tick.

    The first client controls the device until its force has faded; then the newest command takes over.
    """

    def __init__(self, words: memoryview, floats: memoryview[float], at: int) -> None:
        self._words, self._floats = words, floats
        self._starts = [at + FORCE_BLOCK_WORDS * block for block in range(BLOCKS)]
        self._known = [0] * BLOCKS
        self._commands = [_Command(*(0.0,) * len(_Command._fields))] * BLOCKS
        self._holder = -1

    def fill(self, client: Records, now: float) -> None:
        """Fill `client` (1,) CLIENT_FORCE with the command in force at `now` [s], monotonic clock; non-blocking."""
        newest, best = -1, 0.0
        for block, start in enumerate(self._starts):
            if self._words[start] != self._known[block]:
                self._read(block, start)
            if self._known[block] and (stamp := self._commands[block].stamp) > best:
                newest, best = block, stamp
        if newest < 0:
            return
        if self._holder < 0 or self._is_over(self._holder, now):  # safety: one-client-holds
            self._holder = newest
        command = self._commands[self._holder]
        force_x, force_y, force_z, session, stamp, loss, mapping, torque_x, torque_y, torque_z, gripper = command
        cells = client.data.cast("B").cast("d")  # scalar access through it is faster than through an array
        first, at_session, age, lost, at_mapping, at_torque, at_gripper = _PLACES
        cells[first], cells[first + 1], cells[first + 2], cells[at_session] = force_x, force_y, force_z, session
        cells[at_torque], cells[at_torque + 1], cells[at_torque + 2] = torque_x, torque_y, torque_z
        cells[at_mapping], cells[at_gripper] = mapping, gripper
        cells[age] = max(now - stamp, 0.0)
        cells[lost] = max(now - loss, 0.0) if loss > 0.0 else 0.0

    def _is_over(self, block: int, now: float) -> bool:
        command = self._commands[block]
        return now - command.stamp >= _OVER or (command.loss > 0.0 and now - command.loss >= FADE_TIME_S)

    def _read(self, block: int, start: int) -> None:
        """Read the block's command unless a write is in progress, or was never completed."""
        sequence = self._words[start]
        if sequence & 1:
            return
        command = _read_command(self._floats, start)
        if self._words[start] == sequence:
            self._known[block], self._commands[block] = sequence, command


def _read_command(floats: memoryview[float], at: int) -> _Command:
    """The command of the block that begins at the word `at`."""
    return _Command(*floats[at + 1 : at + 1 + len(_Command._fields)].tolist())


# --------------------------------------------------------------------------------------------------
# The host's hand goal in shared memory, protected by a sequence lock.


HAND_GOAL_BLOCK_WORDS = 11  #: sequence, held, p (3), q (4), stamp, keep_alive


class HostHandGoal(NamedTuple):
    """Last hand goal of the host."""

    held: bool
    p: Array  #: (3,) [m], frame S
    q: Array  #: (4,) quaternion (x, y, z, w) of R_SR
    stamp: float  #: time of the message on the computer's monotonic clock [s]
    keep_alive: float = 0.0  #: keep-alive: a simulated hand stays there for so long without a new message [s]


class HandGoalSource(ABC):
    """Source of the host's hand goal: shared memory in a running servo."""

    @abstractmethod
    def read_hand_goal(self) -> HostHandGoal:
        """Return the last hand goal; non-blocking."""


@final
class HandGoalBlock(HandGoalSource):
    """Hand goal in shared memory: `HAND_GOAL_BLOCK_WORDS` words from the word `at` on."""

    def __init__(self, words: memoryview, floats: memoryview[float], at: int) -> None:
        self._words = SeqlockWords(words, floats, at, HAND_GOAL_BLOCK_WORDS)
        self._latest = HostHandGoal(False, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 0.0)

    def write(self, held: bool, p: Array, q: Array, stamp: float, keep_alive: float = 0.0) -> None:
        """Write the hand goal, `p` (3,) [m] and `q` (4,) (x, y, z, w), at `stamp` [s]; for the single writer.

        A simulated hand stays there for `keep_alive` [s] without a new message.
        """
        self._words.write(held, (*p.tolist(), *q.tolist(), stamp, keep_alive))

    def read_hand_goal(self) -> HostHandGoal:
        """Return the last hand goal; if a write is in progress, the one before."""
        latest = self._words.read_new()
        if latest is not None:
            held, n = latest
            self._latest = HostHandGoal(held, np.array(n[:3]), np.array(n[3:7]), n[7], n[8])
        return self._latest


# --------------------------------------------------------------------------------------------------
# Signals of a scripted hand: the loop writes buttons, gripper and time; servers and the row read them.


@final
class HandSignals:
    """Words at `at`: the pressed buttons of a scripted hand, the opening of its thumb and finger, and the time in its
    motion; the word at `begin` states when it may begin."""

    def __init__(self, words: memoryview, floats: memoryview[float], at: int, begin: int) -> None:
        self._words, self._floats, self._at, self._begin = words, floats, at, begin

    def write(self, buttons: int, grip: float, t: float = nan) -> None:
        """Write the buttons, a sum of 1, 2 and 4, `grip` [m], NaN without a gripper, and the time `t` in the motion
        [s], NaN before its start; for the single writer."""
        self._words[self._at] = buttons
        self._floats[self._at + 1] = grip
        self._floats[self._at + 2] = t

    def begin(self) -> None:
        """Let a motion begin that waits for a program; for the single server that serves such programs."""
        self._words[self._begin] = 1

    @property
    def begun(self) -> bool:
        """Whether the program for which a motion waits has connected."""
        return bool(self._words[self._begin])

    @property
    def buttons(self) -> int:
        """Pressed buttons of the scripted hand, a sum of 1, 2 and 4."""
        return int(self._words[self._at])

    @property
    def grip(self) -> float:
        """Opening of its gripper [m]; NaN without one."""
        return float(self._floats[self._at + 1])


# --------------------------------------------------------------------------------------------------
# Snapshots of the chain's state in shared memory: the last ones, and that from before the last trip. One writer.


SLOTS: Final = 12  #: of the last snapshots
REGULAR: Final = 8  #: every so many snapshots one is recorded
_STATE_SLOTS_LAYOUT: Final = 48 * 1024  #: bytes of the layout of a snapshot, which is text
_HEAD: Final = 4  #: words of a slot: version, number, tick; in nanoseconds: time of the trip
_STATE_SLOTS_TRIES: Final = 100


def state_room(channels: int, sensors: int) -> int:
    """Size of a snapshot of a device with so many coils and sensors [bytes]."""
    return 36 * 1024 + 1024 * channels + 1024 * sensors


def slots_size(channels: int, sensors: int) -> int:
    """Size of all slots, layout included [bytes]."""
    return _STATE_SLOTS_LAYOUT + (SLOTS + 1) * (8 * _HEAD + state_room(channels, sensors))


@final
class StateSlots:
    """Slots of snapshots in zeroed `memory`. A slot's version is odd while it is being written.

    layout  of the snapshots, as in `TickState`; empty: no snapshots are made
    """

    def __init__(self, memory: memoryview, channels: int, sensors: int) -> None:
        self.room = state_room(channels, sensors)
        self.layout = TextSlot(memory[:_STATE_SLOTS_LAYOUT])
        slots = np.frombuffer(memory[_STATE_SLOTS_LAYOUT:], np.uint8).reshape(SLOTS + 1, 8 * _HEAD + self.room)
        self._heads = slots[:, : 8 * _HEAD].view(np.int64)
        #: (SLOTS, room) [1]
        self.bodies: NDArray[np.uint8] = slots[:SLOTS, 8 * _HEAD :]
        self._trip: NDArray[np.uint8] = slots[SLOTS, 8 * _HEAD :]
        self._cells = [head.data for head in self._heads]

    def begin(self, number: int) -> None:
        """Begin writing snapshot `number`, from 1 on, to `bodies[number % SLOTS]`."""
        cells = self._cells[number % SLOTS]
        cells[0] |= 1
        cells[1] = number

    def end(self, number: int, tick: int) -> None:
        """Publish snapshot `number`, the state of the chain after `tick`."""
        cells = self._cells[number % SLOTS]
        cells[2] = tick
        cells[0] += 1

    def mark_trip(self, last: int, tick: int, t: float) -> None:
        """Record a trip at `t` [s], when `last` is the newest snapshot: retain the newest one up to `tick`."""
        for number in range(last, max(last - SLOTS, 0), -1):
            cells = self._cells[number % SLOTS]
            if cells[1] == number and cells[2] <= tick:
                trip = self._cells[SLOTS]
                trip[0] |= 1
                trip[1], trip[2], trip[3] = number, cells[2], round(1e9 * t)
                self._trip[:] = self.bodies[number % SLOTS]
                trip[0] += 1
                return

    def read_since(self, number: int, every: int) -> list[tuple[int, int, NDArray[np.uint8]]]:
        """Return (number, tick, copy of the snapshot (room,)) of those after snapshot `number` whose numbers are
        multiples of `every` [1], oldest first."""
        found = []
        for slot in range(SLOTS):
            there = int(self._cells[slot][1])
            if there > number and there % every == 0:
                copy = self._read(slot, self.bodies[slot])
                if copy is not None and copy[0] == there:
                    found.append((there, copy[1], copy[3]))
        return sorted(found, key=lambda one: one[0])

    def read_trip(self, t: float) -> tuple[int, NDArray[np.uint8]] | None:
        """Return (tick, snapshot) from before the trip at `t` [s]; None if there is none."""
        copy = self._read(SLOTS, self._trip)
        return None if copy is None or copy[2] != round(1e9 * t) else (copy[1], copy[3])

    def _read(self, slot: int, body: NDArray[np.uint8]) -> tuple[int, int, int, NDArray[np.uint8]] | None:
        cells = self._cells[slot]
        for _ in range(_STATE_SLOTS_TRIES):
            before = cells[0]
            if not before or before & 1:
                continue
            number, tick, time, copy = int(cells[1]), int(cells[2]), int(cells[3]), body.copy()
            if cells[0] == before:
                return number, tick, time, copy
        return None


def split_snapshot(layout: str, snapshot: NDArray[np.uint8]) -> dict[str, StateArray]:
    """Split a `snapshot` (size,) [1] by its `layout`: name → copy of the array."""
    found: dict[str, StateArray] = {}
    for name, kind, shape, first, stride in json.loads(layout):
        dtype = np.dtype(kind)
        inner = [dtype.itemsize]
        for length in reversed(shape[2:]):
            inner.insert(0, inner[0] * length)
        strides = ([stride, *inner] if len(shape) > 1 else [stride]) if shape else []
        found[name] = np.ndarray(shape, dtype, snapshot, first, strides).copy()
    return found


_MAGIC = int.from_bytes(b"haptorb\0", "little")
_VERSION = 11
_PAGE = 4096
_SIGNALS = 1024  #: signals that can be received between two polls of the host, 20 ms apart
_HAS_FLAGS = hasattr(mmap, "MAP_SHARED")
_END_NUMBERS = frozenset(map(int, END_SIGNALS))
_TEXTS = 9
CAPACITY = 8192  #: rows of the ring buffer: 2 s at the fastest rate
WORLDS = 32  #: last changes of the world that are stored for the recorder
TRIPS = 64  #: first trips that are stored for the report


class Phase(IntEnum):
    """Life-cycle phase of a child process."""

    STARTING = 0
    RUNNING = 1
    ENDED = 2  #: as requested
    FAILED = 3  #: the status text states why


BUTTONS = ("a", "b", "c")  #: of the tool, as connected programs see them; bits in this order


class Word(IntEnum):
    """Indices of the 8-byte words in the first page; all are integers unless stated otherwise."""

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
    ENGAGE = 18  #: `engage_request`: count, and the stop count at the request
    QUIT = 19  #: 1: end
    MODE = 20  #: 0: unchanged, else number of the mode from 1 on
    CLUTCH = 21  #: 0: unchanged, 1: engaged, 2: released
    MODEL = 22  #: 0: unchanged, else number of the device's model from 1 on
    COOL = 23  #: count: simulated coils at the ambient temperature
    POINTER = 24  #: and the next ten
    SCALE = 35  #: 0: unchanged, else the scale of a motor's torques, in millionths
    BUTTONS = 36  #: bits of the buttons a, b, c that the user presses: for servers, not for the loop
    RECORDING_PAUSED = 37  #: 1: rows are not recorded until it is 0 again
    # servo → servers, row
    HAND_BUTTONS = 38  #: bits of the buttons a, b, c that a scripted hand presses
    HAND_GRIP = 39  #: float: opening of a scripted hand's thumb and finger [m]; NaN: none
    HAND_TIME = 40  #: float: time in a scripted hand's motion [s]; NaN: none, or not begun
    # servo → host
    PID = 54
    PHASE = 41
    ORIGIN = 42  #: monotonic time at zero of the loop's clock [ns]
    ROWS = 43  #: published
    TICKS = 44
    MISSED = 45  #: deadlines missed
    ON_TIME = 46  #: ticks that began and ended within their period
    TRIPS = 47  #: count
    PEAK = 48  #: float: peak force on the mover [N]
    WORLD = 49  #: changes of the world
    PEAK_TORQUE = 50  #: float: peak torque on the mover [N·m]
    FIRST_CALL = 51  #: monotonic time at which the first call of a user's world began [ns]; 0: none runs
    COMPILED = 52  #: 1: the servo's process had to compile a kernel
    UNCOMPILED = 53  #: count of the catalogue's worlds whose code is not in the cache
    # recorder → host
    RECORDER = 56  #: a Phase
    WRITTEN = 57  #: rows in the file, which are safe even if the recorder fails
    LOST = 58  #: rows overwritten before they could be recorded
    TAKEN = 59  #: rows that it has read, and those that it lost
    # the server of other makers' libraries → servo
    HAND_BEGIN = 62  #: 1: a program has opened the device
    # a tracker's process → servo, host
    TRACKER = 60  #: a Phase
    # recorder → host
    RECORDER_LOOKS = 61  #: count of the recorder's polls
    TRACKED = 64  #: and the next fifteen
    # each server's process → servo, host
    FORCES = 128  #: twelve for each of eight servers
    SERVERS = 224  #: a Phase for each of eight servers


_SHARED_MEMORY_LAYOUT = [Word.CHANNELS, Word.SENSORS, Word.CONTACTS, Word.MEMORY]  #: arguments of RowLayout
_SERVER_TEXTS = 2 * BLOCKS
_LATENESS = _PAGE + (_TEXTS + WORLDS + _SERVER_TEXTS) * SIZE + 16 * TRIPS  #: offset of the histograms [bytes]
_ROWS = _LATENESS + 2 * 8 * BINS

#: Counters of the loop, by their offsets in the memory before the rows: words of the first page, histograms.
COUNTS = np.dtype(
    {
        "names": [
            "ticks",
            "missed",
            "on_time",
            "peak",
            "peak_torque",
            "buttons",
            "hand_buttons",
            "grip",
            "hand_t",
            "lateness",
            "compute",
        ],
        "formats": ["i8", "i8", "i8", "f8", "f8", "i8", "i8", "f8", "f8", ("i8", (BINS,)), ("i8", (BINS,))],
        "offsets": [
            *(
                8 * word
                for word in (
                    Word.TICKS,
                    Word.MISSED,
                    Word.ON_TIME,
                    Word.PEAK,
                    Word.PEAK_TORQUE,
                    Word.BUTTONS,
                    Word.HAND_BUTTONS,
                    Word.HAND_GRIP,
                    Word.HAND_TIME,
                )
            ),
            _LATENESS,
            _LATENESS + 8 * BINS,
        ],
        "itemsize": _ROWS,
    },
    align=True,
)


def engage_request(last: int, stops: int) -> int:
    """Next value of the word ENGAGE after `last`: a new count, and the stop count at the user's request.

    One word, so that two threads that engage at once cannot combine one's count with the other's stop count.

    >>> engage_stops(engage_request(0, 7))
    7
    """
    count = ((last >> 32) + 1) & 0x7FFF_FFFF
    return count << 32 | stops & 0xFFFF_FFFF


def engage_stops(word: int) -> int:
    """Stop count at the time of the engage request `word`, modulo 2³²."""
    return word & 0xFFFF_FFFF


def find_end_signal(signals: memoryview) -> int:
    """Number of a termination signal in `signals`, one byte for each signal that came; 0: none."""
    received = signals.tobytes()
    return next((number for number in _END_NUMBERS if number in received), 0)


@final
class SharedMemory:
    """The mapped file. `create` makes it, `attach` opens that of another process.

    Raises ServoError if the file is not a servo's shared memory of this version and layout.
    """

    def __init__(self, path: Path, *, populate: bool = False) -> None:
        # Only Linux loads the pages at once; Windows has no flags.
        flags = {"flags": mmap.MAP_SHARED | (getattr(mmap, "MAP_POPULATE", 0) if populate else 0)} if _HAS_FLAGS else {}
        with path.open("r+b") as file:
            size = os.fstat(file.fileno()).st_size
            if size < _ROWS:
                raise ServoError(f"{path} is not a servo's shared memory: too small; end the program that created it")
            self._map = mmap.mmap(file.fileno(), size, **flags)
        self._claim: FileLock | None = None  # of the process that created it
        memory = memoryview(self._map)
        self.path = path
        self.words = memory[:_PAGE].cast("q")
        self.floats = memory[:_PAGE].cast("d")
        self.counts: Records = np.frombuffer(memory[:_ROWS], dtype=COUNTS)  #: (1,) words and histograms, for kernels
        if self.words[Word.MAGIC] != _MAGIC or self.words[Word.VERSION] != _VERSION:
            raise ServoError(f"{path} is not a servo's shared memory of this version; end the program that created it")
        self.layout = RowLayout(*(self.words[word] for word in _SHARED_MEMORY_LAYOUT))
        end = _size(self.layout)
        if self.layout.width != self.words[Word.WIDTH] or size < end + _PAGE:  # many signals make it longer
            raise ServoError(f"{path} holds rows of another layout; end the program that created it")

        self.pointer = HandGoalBlock(self.words, self.floats, Word.POINTER)
        self.hand = HandSignals(self.words, self.floats, Word.HAND_BUTTONS, Word.HAND_BEGIN)
        self.tracked = PoseBlock(self.words, self.floats, Word.TRACKED)
        self.client_forces = ClientForces(self.words, self.floats, Word.FORCES)
        at = _PAGE
        slots = []
        for _ in range(_TEXTS + WORLDS + _SERVER_TEXTS):
            slots.append(TextSlot(memory[at : at + SIZE]))
            at += SIZE
        self.request, self.answer, self.reason, self.error, self.facts, self.recorder_reason = slots[:6]
        self.tracker_reason, self.tracker_facts, self.warning = slots[6:_TEXTS]
        self._worlds = slots[_TEXTS : _TEXTS + WORLDS]
        texts = slots[_TEXTS + WORLDS :]
        #: of each server's process: state of its clients, and their requests
        self.server_facts, self.server_requests = texts[:BLOCKS], texts[BLOCKS:]
        self.trips: Array = np.frombuffer(memory[at : at + 16 * TRIPS], dtype=np.float64).reshape(TRIPS, 2)
        self.lateness = Histogram(self.counts["lateness"][0])
        self.compute = Histogram(self.counts["compute"][0])
        rows_end = _ROWS + 8 * CAPACITY * self.layout.width
        #: snapshots of the chain
        self.states = StateSlots(memory[rows_end:end], self.layout.channels, self.layout.sensors)
        #: signal numbers of the host, written to one of the two by turns, and where they begin: see `SignalStop`
        self.signals_at = end, end + _PAGE // 2
        self.signals = tuple(memory[at : at + _SIGNALS] for at in self.signals_at)
        rows = np.frombuffer(memory[_ROWS:rows_end], dtype=np.float64).reshape(CAPACITY, self.layout.width)
        self.ring = RingBuffer(self.words, Word.ROWS, rows)

    @classmethod
    def create(cls, layout: RowLayout) -> SharedMemory:
        """Create a new one, all zeros, in a memory file system where possible; ServoError if there is no space."""
        size, advice = _size(layout) + _PAGE, "free some"
        for folder in folders():
            try:
                descriptor, name, claim = _create_file(folder)
            except OSError:
                continue
            if folder == Path(tempfile.gettempdir()) and (shared := explain_shared(Path(name))):
                os.close(descriptor)
                Path(name).unlink()
                advice = f"that one is not used, as its file {shared}"
                continue
            try:
                # Allocate it now: a full memory file system would otherwise kill the loop in the middle of a tick.
                _allocate(descriptor, size)
                head = np.zeros(16, dtype=np.int64)
                head[[Word.MAGIC, Word.VERSION, Word.WIDTH, Word.CAPACITY]] = _MAGIC, _VERSION, layout.width, CAPACITY
                head[_SHARED_MEMORY_LAYOUT] = layout.channels, layout.sensors, layout.contacts, layout.memory
                os.lseek(descriptor, 0, os.SEEK_SET)
                os.write(descriptor, head.tobytes())
                made = cls(Path(name))
                made.hand.write(0, float("nan"))
                made._claim = claim
                return made
            except OSError as cause:
                Path(name).unlink()
                if cause.errno == errno.EFBIG:
                    advice = describe_size_limit()
            finally:
                os.close(descriptor)
        raise ServoError(f"no room for {size / 1e6:.0f} MB in /dev/shm or {tempfile.gettempdir()}; {advice}")

    @classmethod
    def attach(cls, path: str | Path) -> SharedMemory:
        """Open that of another process, with all pages loaded before the loop begins."""
        return cls(Path(path), populate=True)

    def unlink(self) -> None:
        """Remove its name; existing mappings stay valid. Windows keeps a mapped file: a later `sweep` removes it."""
        with contextlib.suppress(FileNotFoundError, PermissionError):
            self.path.unlink()
        if self._claim is not None:
            self._claim.close()

    def force_block(self, server: int) -> ForceBlock:
        """Force block of the server with this number, 0 to 7."""
        return ForceBlock(self.words, self.floats, Word.FORCES + FORCE_BLOCK_WORDS * server)

    @property
    def phase(self) -> Phase:
        """Life-cycle phase of the servo."""
        return Phase(self.words[Word.PHASE])

    def announce_world(self, text: str) -> int:
        """Publish `text` as the description of the current world; return the number of this change."""
        number = self.words[Word.WORLD]
        self._worlds[number % WORLDS].write(text)
        self.words[Word.WORLD] = number + 1
        return int(number)

    def worlds_since(self, known: int) -> list[tuple[int, str]]:
        """Return (number, description) of the world's changes from number `known` on; the oldest may be overwritten."""
        count = self.words[Word.WORLD]
        return [(i, self._worlds[i % WORLDS].read()[1]) for i in range(max(known, count - WORLDS + 1, 0), count)]

    def world_now(self) -> str:
        """Name of the rendered world; empty before the first."""
        changes = self.worlds_since(self.words[Word.WORLD] - 1)
        return str(json.loads(changes[-1][1])["name"]) if changes else ""

    def announce_trip(self, t: float, code: float) -> None:
        """Publish a trip; those after the first 64 are only counted."""
        number = self.words[Word.TRIPS]
        if number < TRIPS:
            self.trips[number] = t, code
        self.words[Word.TRIPS] = number + 1


def _allocate(descriptor: int, size: int) -> None:
    """Give the file `descriptor` `size` bytes, all zero, that exist; OSError if there is no room for them."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(descriptor, 0, size)
        return
    block = bytes(1 << 20)
    for start in range(0, size, len(block)):
        os.write(descriptor, block[: size - start])


def _create_file(folder: Path) -> tuple[int, str, FileLock]:
    """Create a new file in `folder`; return (descriptor, path, lock). Raises OSError if that fails."""
    while True:
        descriptor, name = tempfile.mkstemp(prefix="haptorb-", suffix=SHARED, dir=folder)
        claim = FileLock(name)
        if claim.there:
            return descriptor, name, claim
        os.close(descriptor)  # another process removed it first


def _size(layout: RowLayout) -> int:
    return _ROWS + 8 * CAPACITY * layout.width + slots_size(layout.channels, layout.sensors)


assert Word.POINTER + HAND_GOAL_BLOCK_WORDS <= Word.SCALE
assert (Word.HAND_BUTTONS + 1, Word.HAND_BUTTONS + 2) == (Word.HAND_GRIP, Word.HAND_TIME)
assert Word.TRACKED + WORDS <= Word.FORCES
assert Word.FORCES + FORCE_BLOCK_WORDS * BLOCKS <= Word.SERVERS
assert 8 * (Word.SERVERS + BLOCKS) <= _PAGE
