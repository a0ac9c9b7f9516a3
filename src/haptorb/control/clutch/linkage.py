"""What connects the mover to the body that the world acts on: directly, or through two modes and a clutch.

A world renders a wrench for a state. For a stylus over a dome the two are the mover's own. A motor's rotor only turns,
while its plug moves in six degrees of freedom: between them is a linkage with a clutch (`moded_linkage.py`). Besides
guard and drive it is the one part of the chain that remembers something from tick to tick.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol, final

import numpy as np

from haptorb.control.clutch.gains import Gains
from haptorb.control.clutch.modes import Mode
from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.numerics.record import record
from haptorb.numerics.state_arrays import Stateful

__all__ = ["NO_CONTACTS", "Direct", "Linkage", "RenderedWrench", "WrenchSource", "make_direct_linkage"]

NO_CONTACTS = np.zeros((0, 8))
_CLOSED = np.ones(2)


class WrenchSource(Protocol):
    """The part of a world that a linkage needs."""

    def wrench(self, state: State) -> Array:
        """(6,) on the body at `state` [N, N·m]."""


@record
class RenderedWrench:
    """What one tick of a linkage gives.

    wrench        (6,) on the mover, stator frame [N, N·m]
    thing         pose and motion of the body that the world acts on: the mover, or a motor's target (primed frame)
    on_thing      (6,) wrench on it [N, N·m]
    contacts      (n, 8) as `ContactWorld` gives them; none of another world, or of a linkage without contacts
    mode          0 direct, 1 translate, 2 rotate
    share         (2,) how firmly translation and rotation are joined, 0 to 1
    engaged       whether the hand's clutch is engaged
    """

    wrench: Array
    thing: State
    on_thing: Array
    contacts: Array
    mode: int
    share: Array
    engaged: bool


class Linkage(Stateful, ABC):
    """From the mover's state to what the hand feels of a world. What it remembers, `state_arrays` names."""

    modes: tuple[Mode, ...]  #: that can be chosen; empty for a direct linkage
    passive: bool  #: whether it gives no energy that the world did not give
    arm: float  #: at which a hand holds a mover that turns [m]; 0 where the mover is a tool

    @abstractmethod
    def render(self, world: WrenchSource, mover: State) -> RenderedWrench:
        """What `world` makes the hand feel with the mover at `mover`; one call per tick."""

    @abstractmethod
    def bring_back(self, on_thing: Array, wrench: Array) -> None:
        """`wrench` (6,) becomes what the part `on_thing` (6,) of the last `render`'s wrench on the body makes on the
        mover [N, N·m]."""

    @abstractmethod
    def set_mode(self, mode: Mode) -> None:
        """Go over to `mode`, without a step of pose or wrench. Raises UnknownName for a mode that there is not."""

    @abstractmethod
    def set_clutch(self, engaged: bool) -> None:
        """Couple to the target, or release it, without a step of pose or wrench."""

    @abstractmethod
    def set_torque_scale(self, scale: float) -> None:
        """Let the wrench come back `scale` times as strong, sliding there."""

    @abstractmethod
    def restart(self) -> None:
        """Reset the object to its initial pose, and engage the clutch again."""


@final
class Direct(Linkage):
    """The world acts on the mover itself."""

    modes = ()
    passive = True
    arm = 0.0

    def render(self, world: WrenchSource, mover: State) -> RenderedWrench:
        """The world's wrench at the mover."""
        wrench = world.wrench(mover)
        return RenderedWrench(wrench, mover, wrench, NO_CONTACTS, 0, _CLOSED, True)

    def bring_back(self, on_thing: Array, wrench: Array) -> None:
        """`wrench` (6,) becomes `on_thing` (6,) itself [N, N·m]: body and mover are one."""
        wrench[:] = on_thing

    def set_mode(self, mode: Mode) -> None:
        """There is nothing to choose. Raises InputError."""
        raise InputError(f"mode '{mode}': this device has no modes; its mover acts directly")

    def set_clutch(self, engaged: bool) -> None:
        """There is no clutch. Raises InputError."""
        raise InputError("this device has no clutch; its mover acts directly")

    def set_torque_scale(self, scale: float) -> None:
        """There is nothing to scale. Raises InputError."""
        raise InputError("this device has no torque scale; its mover acts directly")

    def restart(self) -> None:
        """Nothing is remembered."""


def make_direct_linkage(device: Device, gains: Gains | None) -> Direct:
    """The linkage of a device whose mover is the body that the world acts on. Raises InputError for gains: it has no
    modes."""
    if gains is not None:
        raise InputError(f"gains are for two-mode devices; a {device.kind.title} such as '{device.name}' has no modes")
    return Direct()
