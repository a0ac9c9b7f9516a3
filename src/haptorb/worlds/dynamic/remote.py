"""The force of a program outside the loop: held briefly after its last command, then faded to zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from haptorb.devices.state import State
from haptorb.numerics.arrays import Array, Record, Records
from haptorb.numerics.compiled import kernel
from haptorb.worlds.dynamic_world import DynamicWorld
from haptorb.worlds.memory import MemoryField
from haptorb.worlds.parameter import parameter

__all__ = ["FADE", "HOLD", "Remote"]

HOLD = 0.05  #: after the last command the force stands for so long [s]
FADE = 0.02  #: and is nothing so much later [s]

_FIELDS = (
    MemoryField("force", "N", "force commanded by the client, stator frame", (3,)),
    MemoryField("session", "1", "number of the client's session; 0: no command yet"),
    MemoryField("age", "s", "age of the client's last command"),
    MemoryField("lost", "s", "time since the client's connection was lost; 0: connected"),
    MemoryField("fade", "1", "share of the force that is rendered: 1 before the fade, 0 after it"),
    MemoryField("mapping", "1", "number of the client's mapping: with another one the same command points elsewhere"),
)


@kernel
def _take_command(memory: Records, client: Records) -> None:
    """Take over what the `client` (1,) CLIENT_FORCE commands; a command that is no number is none."""
    m, c = memory[0], client[0]
    finite = np.isfinite(c.session + c.age + c.lost)
    for i in range(3):
        finite &= np.isfinite(c.force[i])
    fade = 0.0
    if finite and c.session > 0.0:
        late = max(c.age - HOLD, c.lost)  # safety: client-silence-fades, client-loss-fades
        fade = min(max(1.0 - late / FADE, 0.0), 1.0)
    for i in range(3):
        m.force[i] = c.force[i] if finite else 0.0  # safety: client-force-finite
    m.session = c.session if finite else 0.0
    m.age = c.age if finite else 0.0
    m.lost = c.lost if finite else 0.0
    m.fade = fade
    m.mapping = c.mapping if np.isfinite(c.mapping) else 0.0


@kernel
def _push(m: Record, limit: float, wrench: Array) -> None:
    """`wrench` (6,) becomes the client's force [N], faded and no greater than `limit` [N]."""
    wrench[:] = 0.0
    largest = max(abs(m.force[0]), abs(m.force[1]), abs(m.force[2]))
    if largest == 0.0 or m.fade == 0.0:
        return
    size = 0.0  # of the force over its largest part: squares of the numbers themselves may overflow
    for i in range(3):
        size += (m.force[i] / largest) ** 2
    share = m.fade * min(1.0, limit / largest / np.sqrt(size))  # safety: client-force-limit
    for i in range(3):
        wrench[i] = share * m.force[i]


@kernel
def _render(memory: Records, limit: float, wrench: Array) -> None:
    _push(memory[0], limit, wrench)


@dataclass(frozen=True)
class Remote(DynamicWorld):
    """The force of a program connected with `haptorb run --serve`: the latest command, faded if no other follows.

    A command lasts 50 ms. If none follows, its force fades to zero within 20 ms; when the connection is lost,
    the fade begins at once. The memory contains the client's command and the share that is rendered, so that the
    same memory gives the same force again. It may put energy into the hand, so it is not `passive`.

    >>> Remote().wrench(State.at((0, 0, 0.05))).tolist()  # no client is connected
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """

    passive: ClassVar[bool] = False
    continuous: ClassVar[bool] = False
    takes_commands: ClassVar[bool] = True
    asks = "force"

    limit: float = parameter(10.0, "N", 0.0, 100.0, "maximum force accepted from a client")

    @property
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """The client's command, and the share that is rendered."""
        return _FIELDS

    @property
    def bound(self) -> float:
        """[N] the maximum force accepted from a client."""
        return self.limit

    def take_command(self, memory: Records, client: Records) -> None:
        """Copy the command of `client`, (1,) CLIENT_FORCE [N, s], into `memory` (1,)."""
        _take_command(memory, client)

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) the force in `memory` [N], independent of `state` and dt [s]."""
        wrench = np.empty(6)
        _render(memory, self.limit, wrench)
        return wrench
