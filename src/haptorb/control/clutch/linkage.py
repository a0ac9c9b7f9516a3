"""What connects the mover to the body that the world acts on: directly, or through two modes and a clutch.

A world renders a wrench for a state. For a stylus over a dome the two are the mover's own. A motor's rotor only turns,
while its plug moves in six degrees of freedom: between them stands a linkage with the clutch in its hands, the one part
of the chain, besides guard and drive, that remembers something from tick to tick.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Protocol, final

import numpy as np
from numpy import ascontiguousarray
from numpy.typing import ArrayLike

from haptorb.control.clutch.mode_kernels import fill_rotor_wrench, follow_rotor
from haptorb.control.clutch.modes import MODES, Clutch, Gains, Mode, TwoModes
from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.errors import InputError, quote
from haptorb.numerics.arrays import Array, Records
from haptorb.numerics.record import record

if TYPE_CHECKING:
    from haptorb.devices.motor.spherical_motor import SphericalMotor

__all__ = [
    "MOTOR_GAINS",
    "NO_CONTACTS",
    "Direct",
    "Linkage",
    "ModedLinkage",
    "RenderedWrench",
    "WrenchSource",
    "make_direct_linkage",
    "make_moded_linkage",
]  # fmt: skip

#: 40° of handle, which a hand can sweep within the workspace, pull the plug all the way out; else the defaults
MOTOR_GAINS = Gains(translate=(0.024, 0.004, 0.01))

NO_CONTACTS = np.zeros((0, 8))
_FLOAT = NO_CONTACTS.dtype
_CLOSED = np.ones(2)
_SLIDE = 0.5  #: time in which the torque scale changes by a factor e [s]: slow against a hand's own motion
_NUMBERS = {mode: number for number, mode in enumerate(MODES, start=1)}  #: of modes in a row


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


class Linkage(ABC):
    """From the mover's state to what the hand feels of a world."""

    modes: tuple[Mode, ...]  #: that can be chosen; empty for a direct linkage
    passive: bool  #: whether it gives no energy that the world did not give
    arm: float  #: at which a hand holds a mover that turns [m]; 0 where the mover is a tool

    @abstractmethod
    def render(self, world: WrenchSource, mover: State) -> RenderedWrench:
        """What `world` makes the hand feel with the mover at `mover`; one call per tick."""

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


@final
class ModedLinkage(Linkage):
    """A rotor moves a target through `modes`; the wrench on the target comes back as torque.

    position, attitude   where the target begins: X', Y', Z' [m] and ψ', λ', φ' [rad]; the plug fully home is at zero
    arm                  from the motor's centre to the hand on its handle [m]

    Mode and clutch are set between two ticks and act in the next; the target's pose continues from where it is, at any
    moment and in any state (`Clutch`: the mapping is by increments, and the shares slide).

    >>> from haptorb.worlds.snap_fit.outlet import Outlet
    >>> linkage, rotor = ModedLinkage(), State.from_rotation(np.eye(3))
    >>> linkage.render(Outlet(), rotor).thing.p.tolist(), linkage.render(Outlet(), rotor).mode
    ([0.0, 0.0, 0.0], 1)
    """

    modes = MODES

    def __init__(
        self,
        modes: TwoModes | None = None,
        *,
        position: ArrayLike = (0.0, 0.0, 0.0),
        attitude: ArrayLike = (0.0, 0.0, 0.0),
        arm: float = 0.1,
    ) -> None:
        self.mapping = modes or TwoModes()
        self.arm = arm
        self.passive = self.mapping.gains.verdict != "active"
        self._begin = (np.asarray(position, dtype=np.float64), np.asarray(attitude, dtype=np.float64))
        self.mapping.start(
            State.from_rotation(np.eye(3)), position=position, attitude=attitude
        )  # refuses what cannot be
        self._mode: Mode = "translate"
        self._engaged = True
        self._memory: Records | None = None  # of the clutch, changed in place by every tick
        self._t = 0.0
        self._asked = np.zeros(6)
        self._scale = self._scale_goal = 1.0

    @property
    def clutch(self) -> Clutch | None:
        """Where rotor and target are and how firmly they are joined, after the last tick; None before the first."""
        if self._memory is None:
            return None
        return self.mapping.clutch(self._memory, self._t, self._mode, self._engaged)

    def render(self, world: WrenchSource, mover: State) -> RenderedWrench:
        """Advance the clutch to `mover`, ask `world` at the target, and bring its wrench back as torque.

        Raises InputError for a rotor tilted beyond ±80°, and for a world that gives no wrench.
        """
        mapping, memory, t = self.mapping, self._memory, mover.t
        if memory is None:
            memory = self._take_hold(mover)
        R, pose, share = ascontiguousarray(mover.R_SR), np.empty((6, 3)), np.empty(2)
        if not follow_rotor(memory, R, ascontiguousarray(mover.w), t - self._t, pose, share):
            raise mapping.explain_loss(R)
        if self._scale != self._scale_goal:
            self._slide_scale(t - self._t)
        self._t = t
        target = State(t, pose[:3], pose[3], pose[4], pose[5])
        # Not `isinstance(world, ContactWorld)`: of an abstract class that costs 0.4 µs in every tick.
        render_contacts = getattr(world, "render_contacts", None)
        if render_contacts is None:
            on_target, contacts = world.wrench(target), NO_CONTACTS
        else:
            on_target, contacts = render_contacts(target)
            contacts = ascontiguousarray(contacts, _FLOAT)  # for the kernel that fills the row
            if contacts.ndim != 2 or contacts.shape[1] != 8:
                raise InputError(f"a world must return contacts of shape (n, 8); got shape {contacts.shape}")
        if (on_target.shape if isinstance(on_target, np.ndarray) else np.shape(on_target)) != (6,):
            raise InputError(f"a world must return force and torque, shape (6,); got {quote(on_target)}")
        asked, wrench = self._asked, np.empty(6)
        asked[:] = on_target  # a user's array in another memory layout would compile the kernel again
        fill_rotor_wrench(memory, asked, self._scale, wrench)
        return RenderedWrench(wrench, target, on_target, contacts, _NUMBERS[self._mode], share, self._engaged)

    def _take_hold(self, mover: State) -> Records:
        """(1,) CLUTCH of a clutch that has just been put between `mover` and the target at its beginning."""
        position, attitude = self._begin
        mode, engaged = self._mode, self._engaged
        clutch = self.mapping.start(mover, mode=mode, engaged=engaged, position=position, attitude=attitude)
        self._memory, self._t = self.mapping.memory(clutch), mover.t
        return self._memory

    def _aim(self) -> None:
        if self._memory is not None:
            self.mapping.aim(self._memory, self._mode, self._engaged)

    def set_mode(self, mode: Mode) -> None:
        """From the next tick on, the clutch slides over to `mode`."""
        self.mapping.check_mode(mode)
        self._mode = mode
        self._aim()

    def set_clutch(self, engaged: bool) -> None:
        """From the next tick on, the clutch engages or releases."""
        self._engaged = bool(engaged)
        self._aim()

    def set_torque_scale(self, scale: float) -> None:
        """From the next tick on, all torques slide to `scale` times what the gains say.

        Raises InputError for a scale that is not above 0.
        """
        if not (math.isfinite(scale) and scale > 0.0):
            raise InputError(f"torque scale must be above 0; got {scale!r}")
        self._scale_goal = float(scale)

    def _slide_scale(self, elapsed: float) -> None:
        step = min(max(elapsed, 0.0), self.mapping.gap) / _SLIDE
        way = math.log(self._scale_goal / self._scale)
        self._scale = self._scale_goal if abs(way) <= step else self._scale * math.exp(math.copysign(step, way))

    def restart(self) -> None:
        """The target is back at its beginning; mode and the hand's wish stay."""
        self._memory = None


def make_direct_linkage(device: Device, gains: Gains | None) -> Direct:
    """The linkage of a device whose mover is the body that the world acts on. Raises InputError for gains: it has no
    modes."""
    if gains is not None:
        raise InputError(f"gains are for two-mode devices; a {device.kind.title} such as '{device.name}' has no modes")
    return Direct()


def make_moded_linkage(device: SphericalMotor, gains: Gains | None) -> ModedLinkage:
    """The linkage of a motor, whose handle moves a target through two modes; with MOTOR_GAINS by default."""
    return ModedLinkage(TwoModes(gains or MOTOR_GAINS), arm=device.rotor.handle_length)
