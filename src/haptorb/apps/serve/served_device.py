"""The running device as a server's process sees it: its rows, who may command it, and its clients' news."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from time import monotonic
from typing import Any, final

from haptorb.devices.device import Device
from haptorb.numerics.arrays import Array
from haptorb.runtime.exchange.commands import BUTTONS
from haptorb.runtime.exchange.shared_memory import Phase, SharedMemory, Word
from haptorb.runtime.realtime.parent_death import is_parent_gone
from haptorb.worlds.dynamic.remote import HOLD

__all__ = ["LATE", "SILENCE", "ServedDevice"]

SILENCE = 2.0  #: a client that holds the device and commands nothing for so long has let it go [s]
LATE = 1.0  #: what a client asked longer ago, while its server did not read, is not done any more [s]
_SESSIONS = 10_000  #: numbers of sessions that one server has for itself
_LARGEST = 1e6  #: of a commanded force [N]; the world and the guard have their own limits, far below


@final
class ServedDevice:
    """For the server with the number `slot`, in the memory `shared` of a loop that the process `parent` started.

    device   the running device
    facts    of the run: driver, tracker, estimator, model, rate_hz, modes, versions
    dropped  rows that this server was too slow to read
    busy     how often a client was refused because another one holds the device
    stale    commands that were refused because they had waited for this server
    """

    def __init__(self, shared: SharedMemory, slot: int, parent: int, device: Device, facts: Mapping[str, Any]) -> None:
        self.device, self.facts, self.layout = device, dict(facts), shared.layout
        self.dropped = self.busy = self.stale = 0
        self.ending = False  #: set when this server is to end
        self._shared, self._slot, self._parent = shared, slot, parent
        self._block = shared.force_block(slot)
        self._cursor = shared.ring.count
        self._sessions = _SESSIONS * slot
        self._holder, self._held_since = 0, 0.0
        self._facts: dict[str, Any] = {}  # as reported last
        self._world_number, self._renders = -1, False

    @property
    def over(self) -> bool:
        """Whether the server is to end: the servo has ended, or no reader is left."""
        words = self._shared.words
        return bool(self.ending or words[Word.QUIT] or words[Word.PHASE] >= Phase.ENDED or is_parent_gone(self._parent))

    @property
    def origin(self) -> float:
        """The computer's monotonic clock when the loop's clock, `t` of the rows, was zero [s]."""
        return float(self._shared.words[Word.ORIGIN]) * 1e-9

    def latest(self) -> Array | None:
        """(width,) the newest row, in the units of `layout`; None before the first."""
        return self._shared.ring.latest()

    def read_rows(self) -> Array:
        """(n, width) what the loop published since the last call, oldest first; what was lost is counted in
        `dropped`. In the units [..] of `layout`; never waits."""
        before = self._cursor
        self._cursor, rows = self._shared.ring.read_since(before)
        self.dropped += self._cursor - before - len(rows)
        return rows

    @property
    def tick_count(self) -> int:
        """Rows published so far: another number is another newest row."""
        return int(self._shared.ring.count)

    @property
    def world(self) -> dict[str, Any]:
        """The world that is rendered: `name`, `values`, and the `memory` fields that its rows have; empty before the
        first."""
        changes = self._shared.worlds_since(self._shared.words[Word.WORLD] - 1)
        return dict(json.loads(changes[-1][1])) if changes else {}

    @property
    def renders_force(self) -> bool:
        """Whether the world that is felt now has the clients' force in it; a person may have chosen another."""
        number = int(self._shared.words[Word.WORLD])
        if number != self._world_number:
            names = [field["name"].rpartition("_")[2] for field in self.world.get("memory", [])]
            self._world_number, self._renders = number, {"force", "session", "fade"} <= set(names)
        return self._renders

    @property
    def buttons(self) -> dict[str, bool]:
        """Which of the buttons a, b, c a person holds down."""
        bits = self._shared.words[Word.BUTTONS]
        return {name: bool(bits >> i & 1) for i, name in enumerate(BUTTONS)}

    def open_session(self) -> int:
        """A number for a new client, which no other client of this run has."""
        self._sessions += 1
        return self._sessions

    @property
    def holder(self) -> int:
        """Session of the client that holds the device; 0: none."""
        if self._holder and monotonic() - self._held_since > SILENCE:
            self._holder = 0
        return self._holder

    def command(self, session: int, force: Sequence[float], *, arrival: float | None = None, mapping: int = 0) -> bool:
        """The client `session` wants `force` (3,) [N], in the stator's frame, since `arrival` of its message on the
        monotonic clock [s]; None: now. False, and nothing happens, if another client holds the device, if the numbers
        are not finite, or if the message has waited for longer than a command lasts.

        No force takes no device: many programs that only watch send zeros, because each message is answered.
        """
        if self.holder != session and not any(force):
            return True
        if self.holder not in (0, session):  # safety: watcher-commands-nothing
            self.busy += 1
            return False
        if not all(-_LARGEST <= number <= _LARGEST for number in force):  # safety: served-force-finite
            return False
        now = monotonic()
        since = now if arrival is None else min(arrival, now)
        if now - since > HOLD:  # safety: waited-is-stale
            self.stale += 1
            return False
        self._holder, self._held_since = session, since
        self._block.command(force, session, since, mapping)
        return True

    def lose(self, session: int) -> None:
        """The connection of the client `session` was lost: if it holds the device, its force ends and others may."""
        if self._holder == session:
            self._holder = 0
            self._block.lose(monotonic())  # safety: lost-client-told

    def request_world(self, name: str, values: Mapping[str, Any]) -> None:
        """Ask the program that runs the servo for the world `name` with `values`; the newest counts, others that
        were not read yet are dropped."""
        self._shared.server_requests[self._slot].write(json.dumps({"name": name, "values": dict(values)}, default=list))

    def report(self, server: str, address: str, clients: Sequence[Mapping[str, Any]], **more: Any) -> None:
        """Tell people who is connected: each of `clients` has `name`, `session`, `rate_hz` and `holds`. At most four
        times a second, please; of more than 50 clients the rest is only counted."""
        facts = {
            "server": server, "address": address, "count": len(clients), "clients": list(clients[:50]),
            "dropped": self.dropped, "stale": self.stale, **more,
        }  # fmt: skip
        self._facts = facts
        self._shared.server_facts[self._slot].write(json.dumps(facts))

    def conclude(self) -> None:
        """This server has ended: no client is connected any more; its counts stay for the run's report."""
        if self._facts:
            self._facts |= {"count": 0, "clients": [], "dropped": self.dropped}
            self._shared.server_facts[self._slot].write(json.dumps(self._facts))
