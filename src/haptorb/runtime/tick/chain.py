"""What the loop drives, as far as the loop must know: the tick's chain, its stop, its driver's close."""

from __future__ import annotations

from typing import Protocol

from haptorb.control.clutch.modes import Mode
from haptorb.numerics.arrays import Array, Records
from haptorb.runtime.drivers.driver import Driver
from haptorb.worlds.world import World

__all__ = ["Chain", "Joining"]


class Joining(Protocol):
    """The part of a linkage that the loop needs; its commands are noted."""

    def set_mode(self, mode: Mode) -> None:
        """Go over to `mode` without a step."""

    def set_clutch(self, engaged: bool) -> None:
        """Take hold of the world's object, or let it go, without a step."""

    def set_torque_scale(self, scale: float) -> None:
        """Let the wrench come back `scale` times as strong, without a step."""


class Chain(Protocol):
    """Driver, estimator, world, allocator and guard in one hand; `Tick` is the real one."""

    @property
    def error(self) -> str:
        """What a failed world or driver said, and where in a user's code; empty for other trips."""

    @property
    def remark(self) -> str:
        """What a person should know of the estimator before it is relied on; empty for nothing."""

    @property
    def client(self) -> Records:
        """(1,) CLIENT_FORCE [N, s]: what a program outside the loop commands; the loop fills it before every step."""

    @property
    def driver(self) -> Driver:
        """The door to the device."""

    @property
    def joining(self) -> Joining:
        """What joins the mover to the world's object."""

    def excuse_lateness(self) -> None:
        """The next step is late because the computer woke the loop too late, not because a step took too long."""

    def prepare(self, now: float) -> None:
        """The tick at `now` [s] is near: do what need not wait for it."""

    def step(self, row: Array, now: float) -> None:
        """One tick at `now` [s] on the loop's clock; fills all of `row` (width,) except what the clock knows, each
        number in the unit of its field."""

    def stop(self) -> None:
        """A person stopped: coils off in the next step, and off until `engage`."""

    def engage(self) -> bool:
        """After a stop or a trip: begin again, from zero; False while the reason is still there."""

    def cool(self) -> None:
        """Simulated coils at the ambient temperature, in the next step; nothing happens with a real device."""

    def change_model(self, number: int) -> None:
        """Invert another of the device's models, counted from 0, from the next step on; the force goes over smoothly.
        Raises InputError if the estimator cannot."""

    def replace_world(self, world: World) -> None:
        """Render another version of the world from the next step on, as `change_world`, without a step of the force."""

    def change_world(self, world: World) -> None:
        """Render `world` from the next step on. Raises InputError if the device cannot."""
