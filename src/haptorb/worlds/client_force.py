"""Force of a client, a program outside the loop: held briefly after its last command, then faded to zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from haptorb.arrays import Array, Records
from haptorb.compiled import kernel
from haptorb.devices.base import Device, State, find_object_limits
from haptorb.devices.gripper import find_gripper
from haptorb.worlds.base import World, parameter
from haptorb.worlds.dynamic import DynamicSum, DynamicWorld, MemoryField

__all__ = ["FADE_TIME_S", "HOLD_TIME_S", "Remote", "join_remote", "split_remote"]


HOLD_TIME_S = 0.05  #: hold time after the last command [s]
FADE_TIME_S = 0.02  #: fade time to zero after that [s]

_FIELDS = (
    MemoryField("force", "N", "force commanded by the client, stator frame", (3,)),
    MemoryField("session", "1", "number of the client's session; 0: no command yet"),
    MemoryField("age", "s", "age of the client's last command"),
    MemoryField("lost", "s", "time since the client's connection was lost; 0: connected"),
    MemoryField("fade", "1", "share of the force that is rendered: 1 before the fade, 0 after it"),
    MemoryField("mapping", "1", "number of the client's mapping: with another one the same command points elsewhere"),
    MemoryField("torque", "N·m", "torque commanded by the client, stator frame", (3,)),
    MemoryField("gripper", "N", "gripper force commanded by the client, positive to open"),
)


@kernel
def _take_command(memory: Records, client: Records) -> None:
    """Copy the command of `client` (1,) CLIENT_FORCE; a command that is not finite counts as none."""
    m, c = memory[0], client[0]
    finite = np.isfinite(c.session + c.age + c.lost) and np.isfinite(c.gripper)
    for i in range(3):
        finite &= np.isfinite(c.force[i]) and np.isfinite(c.torque[i])
    fade = 0.0
    if finite and c.session > 0.0:
        late = max(c.age - HOLD_TIME_S, c.lost)  # safety: client-silence-fades, client-loss-fades
        fade = min(max(1.0 - late / FADE_TIME_S, 0.0), 1.0)
    for i in range(3):
        m.force[i] = c.force[i] if finite else 0.0  # safety: client-force-finite
        m.torque[i] = c.torque[i] if finite else 0.0  # safety: client-torque-finite
    m.gripper = c.gripper if finite else 0.0  # safety: client-gripper-finite
    m.session = c.session if finite else 0.0
    m.age = c.age if finite else 0.0
    m.lost = c.lost if finite else 0.0
    m.fade = fade
    m.mapping = c.mapping if np.isfinite(c.mapping) else 0.0


@kernel
def _limit(vector: Array, fade: float, limit: float, out: Array) -> None:
    """`out` (3,) becomes `vector` (3,), faded and limited to the norm `limit`, both in its unit."""
    out[:] = 0.0
    largest = max(abs(vector[0]), abs(vector[1]), abs(vector[2]))
    if largest == 0.0 or fade == 0.0:
        return
    size = 0.0  # norm relative to the largest component: squares of the components themselves may overflow
    for i in range(3):
        size += (vector[i] / largest) ** 2
    share = fade * min(1.0, limit / largest / np.sqrt(size))  # safety: client-force-limit
    for i in range(3):
        out[i] = share * vector[i]


@kernel
def _render(memory: Records, force: float, torque: float, wrench: Array) -> None:
    m = memory[0]
    _limit(m.force[:], m.fade, force, wrench[:3])
    _limit(m.torque[:], m.fade, torque, wrench[3:])


@dataclass(frozen=True)
class Remote(DynamicWorld):
    """Force and torque of a program connected with `haptorb run --serve`.

    They follow the latest command, and fade if no other follows.

    A command lasts 50 ms. If none follows, its force fades to zero within 20 ms; when the connection is lost,
    the fade begins at once. The memory contains the client's command and the share that is rendered, so that the
    same memory gives the same force again. It may put energy into the hand, so it is not `passive`. The guard limits it
    to the device's limits; its own limits can only be lower.

    >>> Remote().wrench(State.at((0, 0, 0.05))).tolist()  # no client is connected
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """

    passive: ClassVar[bool] = False
    continuous: ClassVar[bool] = False
    takes_commands: ClassVar[bool] = True

    limit: float = parameter(100.0, "N", 0.0, 100.0, "maximum force of a client, if below the device's own")
    torque_limit: float = parameter(10.0, "N·m", 0.0, 10.0, "maximum torque of a client, if below the device's own")
    gripper_limit: float = parameter(100.0, "N", 0.0, 100.0, "maximum gripper force, if below the device's own")

    @property
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """Command of the client, and its rendered share."""
        return _FIELDS

    @property
    def bound(self) -> float:
        """[N] maximum force of a client."""
        return self.limit

    def for_device(self, device: Device) -> Remote:
        """With limits no higher than those of `device`: what is clamped later would fade later."""
        force, torque = find_object_limits(device)  # safety: client-fades-from-limit
        gripper = find_gripper(device)
        return self.replace(
            limit=min(self.limit, force), torque_limit=min(self.torque_limit, torque),
            gripper_limit=0.0 if gripper is None else min(self.gripper_limit, gripper.force),
        )  # fmt: skip

    def take_command(self, memory: Records, client: Records) -> None:
        """Copy the command of `client`, (1,) CLIENT_FORCE [N, s], into `memory` (1,)."""
        _take_command(memory, client)

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) force [N] and torque [N·m] in `memory`, independent of `state` and dt [s]."""
        wrench = np.empty(6)
        _render(memory, self.limit, self.torque_limit, wrench)
        return wrench

    def gripper_force(self, memory: Records) -> float:
        """[N] in `memory` (1,), faded and limited; positive opens."""
        force, fade = float(memory["gripper"].item()), float(memory["fade"].item())
        return fade * min(max(force, -self.gripper_limit), self.gripper_limit)  # safety: client-gripper-limit


# --------------------------------------------------------------------------------------------------
# World with the clients' force added to it: the world keeps its name and its parameters.


def split_remote(world: World) -> tuple[World, Remote | None]:
    """Split a sum that ends with the clients' force into (world, clients' force); else (world, None).

    >>> from haptorb.worlds.dome import Dome
    >>> split_remote(Dome(moment=1.0) + Remote(limit=3.0))[1].limit
    3.0
    """
    if not isinstance(world, DynamicSum) or len(world.parts) < 2:
        return world, None
    *others, last = world.parts
    if not isinstance(last, Remote):
        return world, None
    plain = others[0]
    for other in others[1:]:
        plain = plain + other
    return plain, last


def join_remote(world: World, remote: Remote | None) -> World:
    """Add the clients' force `remote` to `world`, if there is one and `world` is not the clients' force itself."""
    return world if remote is None or isinstance(world, Remote) else world + remote
