"""The forces that programs command, in shared memory: each server's process writes its own block, the loop reads all.

A block says who commanded which force when. The loop judges by those times alone: when a server's process ends, its
force expires like that of a silent client.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, final

from haptorb.numerics.arrays import Records
from haptorb.worlds.client_force import CLIENT_FORCE
from haptorb.worlds.dynamic.remote import FADE, HOLD

__all__ = ["BLOCKS", "WORDS", "ClientForces", "ForceBlock"]

WORDS = 8  #: sequence, force (3), session, stamp, loss, mapping
BLOCKS = 8  #: servers that may command at once

_PLACES = [CLIENT_FORCE.fields[name][1] // 8 for name in ("force", "session", "age", "lost", "mapping")]  # type: ignore[index]
_OVER = HOLD + FADE


class _Command(NamedTuple):
    """What a block holds after its sequence number, as floats and in this order."""

    force_x: float  #: in the stator's frame [N]
    force_y: float
    force_z: float
    session: float  #: of the client
    stamp: float  #: on the monotonic clock [s]
    loss: float  #: when the client's connection was lost, on the same clock [s]; 0: it was not
    mapping: float  #: number of the client's mapping into the stator's frame


@final
class ForceBlock:
    """Eight words at `at`, seen both as integers and as floats; for the one server that writes them."""

    def __init__(self, words: memoryview, floats: memoryview[float], at: int) -> None:
        self._words, self._floats, self._at = words, floats, at

    def command(self, force: Sequence[float], session: int, stamp: float, mapping: int = 0) -> None:
        """The client of `session` wants `force` (3,) [N] in the stator's frame, since `stamp` [s] of the monotonic
        clock. Another number `mapping`: the same command would point elsewhere than before."""
        x, y, z = force
        self._write(_Command(x, y, z, float(session), stamp, loss=0.0, mapping=float(mapping)))

    def lose(self, stamp: float) -> None:
        """The connection of the client that commanded last was lost at `stamp` [s] of the monotonic clock."""
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
    """The loop's side: the one client whose force counts now, out of all blocks. Allocates no array in a tick.

    Who commands first keeps the device until its force has faded; then the newest command counts.
    """

    def __init__(self, words: memoryview, floats: memoryview[float], at: int) -> None:
        self._words, self._floats = words, floats
        self._starts = [at + WORDS * block for block in range(BLOCKS)]
        self._known = [0] * BLOCKS
        self._commands = [_Command(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)] * BLOCKS
        self._holder = -1

    def fill(self, client: Records, now: float) -> None:
        """`client` (1,) CLIENT_FORCE becomes what is commanded at `now` [s] of the monotonic clock; never waits."""
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
        force_x, force_y, force_z, session, stamp, loss, mapping = self._commands[self._holder]
        cells = client.data.cast("B").cast("d")  # single numbers go through it faster than into an array
        first, at_session, age, lost, at_mapping = _PLACES
        cells[first], cells[first + 1], cells[first + 2], cells[at_session] = force_x, force_y, force_z, session
        cells[at_mapping] = mapping
        cells[age] = max(now - stamp, 0.0)
        cells[lost] = max(now - loss, 0.0) if loss > 0.0 else 0.0

    def _is_over(self, block: int, now: float) -> bool:
        command = self._commands[block]
        return now - command.stamp >= _OVER or (command.loss > 0.0 and now - command.loss >= FADE)

    def _read(self, block: int, start: int) -> None:
        """Take what is written completely; what is being written just now, or never was to its end, is left."""
        sequence = self._words[start]
        if sequence & 1:
            return
        command = _read_command(self._floats, start)
        if self._words[start] == sequence:
            self._known[block], self._commands[block] = sequence, command


def _read_command(floats: memoryview[float], at: int) -> _Command:
    """The command of the block that begins at the word `at`."""
    return _Command(*floats[at + 1 : at + 1 + len(_Command._fields)].tolist())
