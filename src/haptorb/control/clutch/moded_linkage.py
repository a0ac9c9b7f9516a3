"""Two modes and a clutch: three turns of a rotor move a target in six degrees of freedom, and its wrench comes back.

Bai 2012, eqs. (5)–(6), rotor angles (ψ, λ, φ), R = Rx(ψ) Ry(λ) Rz(φ), primes for the target:

    rotate       λ' = ζ₁ λ,   ψ' = ζ₂ ψ,   φ' = ζ₃ φ          T_ψ = η₁ T_ψ',  T_λ = η₂ T_λ',  T_φ = η₃ T_φ'
    translate    X' = ζ̂₁ λ,   Y' = ζ̂₂ ψ,   Z' = ζ̂₃ φ          T_ψ = η̂₁ F_Y',  T_λ = η̂₂ F_X',  T_φ = η̂₃ F_Z'

(6b), not the text of phase 1, which swaps T_ψ and T_λ (erratum E6). Mind the printed order: ζ₁ is for λ, η₁ for ψ.

T_ψ, T_λ, T_φ are what the torque vector does along the three Euler axes, and T_ψ', T_λ', T_φ' likewise at the target;
with that T·ω = F·v' + T'·w' holds at any tilt, not only for small ones.

The clutch moves the target by *increments*: dX' = share · ζ̂ dq, and the torque is share · η̂ F with the same share. Both
shares (one per mode) slide between 0 and 1, never jump; so switching, releasing and engaging step neither pose nor
torque, and at every share the power that leaves the hand is the power that reaches the target. To release, turn back
and engage again reaches as far as one likes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, final

import numpy as np
from numpy import ascontiguousarray
from numpy.typing import ArrayLike

from haptorb.control.clutch.gains import MOTOR_GAINS, Gains, three
from haptorb.control.clutch.linkage import NO_CONTACTS, Linkage, RenderedWrench, WrenchSource
from haptorb.control.clutch.mode_kernels import CLUTCH, STEEPEST, fill_rotor_wrench, follow_rotor
from haptorb.control.clutch.modes import MODES, Mode
from haptorb.devices.state import State
from haptorb.errors import InputError, UnknownName, quote
from haptorb.numerics.arrays import Array, Records
from haptorb.numerics.state_arrays import StateArray, choose, make_numbers

if TYPE_CHECKING:
    from haptorb.devices.motor.spherical_motor import SphericalMotor

__all__ = ["ModedLinkage", "make_moded_linkage"]

_FLOAT = NO_CONTACTS.dtype
_SLIDE = 0.5  #: time in which the torque scale changes by a factor e [s]: slow against a hand's own motion
_NUMBERS = {mode: number for number, mode in enumerate(MODES, start=1)}  #: of modes in a row


@final
class ModedLinkage(Linkage):
    """A rotor moves a target through two modes; the wrench on the target comes back as torque.

    gains                motion and torque gains
    position, attitude   where the target begins: X', Y', Z' [m] and ψ', λ', φ' [rad]; the plug fully home is at zero
    arm                  from the motor's centre to the hand on its handle [m]
    ramp                 time in which the clutch engages, or releases [s]
    gap                  longest time between two rotor states for which they count as one motion [s]; after a longer
                         one the clutch releases at once and engages again from where the rotor then is

    It starts released, and engages within `ramp`. Commands of mode and clutch act in the next tick; the target's pose
    goes on from where it is, at any moment and in any state.

    Raises InputError for a time that is not above zero, and for an attitude beyond ±80° of λ'.

    >>> from haptorb.worlds.snap_fit.outlet import Outlet
    >>> linkage, rotor = ModedLinkage(), State.from_rotation(np.eye(3))
    >>> linkage.render(Outlet(), rotor).thing.p.tolist(), linkage.render(Outlet(), rotor).mode
    ([0.0, 0.0, 0.0], 1)
    """

    modes = MODES
    state_kind = "modes"

    def __init__(
        self,
        gains: Gains | None = None,
        *,
        position: ArrayLike = (0.0, 0.0, 0.0),
        attitude: ArrayLike = (0.0, 0.0, 0.0),
        arm: float = 0.1,
        ramp: float = 0.15,
        gap: float = 0.05,
    ) -> None:
        self.gains, self.arm = gains or Gains(), arm
        self.passive = self.gains.verdict != "active"
        for name, value in (("ramp", ramp), ("gap", gap)):
            if not (isinstance(value, int | float) and math.isfinite(value) and value > 0):
                raise InputError(f"{name} must be a time greater than zero [s]; got {value!r}")
        self.ramp, self.gap = float(ramp), float(gap)
        self._begin = three(position, "position"), three(attitude, "attitude")
        if not abs(turn := self._begin[1][1]) < STEEPEST:
            limit = math.degrees(STEEPEST)
            raise InputError(f"attitude: λ' must stay within ±{limit:.0f}°; got {math.degrees(turn):.4g}°")
        self._mode: Mode = "translate"
        self._engaged = True
        self._memory: Records = np.zeros(1, dtype=CLUTCH)  # changed in place by every tick
        self._asked = np.zeros(6)
        self._scale = self._scale_goal = 1.0
        self._numbers = make_numbers("mode", "engaged", "t", "scale", "scale_goal")
        self.restart()

    def state_arrays(self) -> Mapping[str, StateArray]:
        """The clutch; mode from 0 on, whether the hand has it engaged, time [s] of the rotor's last state, torque
        scales."""
        return {"clutch": self._memory, "choices": self._numbers[0]}

    def gather_state(self) -> None:
        """Note the choices."""
        cells = self._numbers[1]
        cells[0], cells[1], cells[2] = MODES.index(self._mode), self._engaged, self._t
        cells[3], cells[4] = self._scale, self._scale_goal

    def apply_state(self) -> None:
        """Take them over."""
        mode, engaged, self._t, scale, goal = self._numbers[1]
        if not (0.0 < scale < math.inf and 0.0 < goal < math.inf):
            raise ValueError(f"{scale!r} and {goal!r} are no torque scales")
        self._mode, self._engaged = MODES[choose(mode, len(MODES))], bool(engaged)
        self._scale, self._scale_goal = scale, goal

    def restart(self) -> None:
        """The target is back at its beginning and the clutch released; mode and the hand's wish stay."""
        memory = self._memory
        memory[:] = np.zeros(1, dtype=CLUTCH)
        for name in ("translate", "rotate", "translate_torque", "rotate_torque"):
            memory[name] = getattr(self.gains, name)
        memory["ramp"], memory["gap"] = self.ramp, self.gap
        memory["position"], memory["attitude"] = self._begin
        self._t = -math.inf  # of the rotor's last state [s]: after such a gap the clutch begins released
        self._aim()

    def render(self, world: WrenchSource, mover: State) -> RenderedWrench:
        """Advance the clutch to `mover`, ask `world` at the target, and bring its wrench back as torque.

        Raises InputError for a rotor tilted beyond ±80°, and for a world that gives no wrench.
        """
        memory, t = self._memory, mover.t
        R, pose, share = ascontiguousarray(mover.R_SR), np.empty((6, 3)), np.empty(2)
        if not follow_rotor(memory, R, ascontiguousarray(mover.w), t - self._t, pose, share):
            raise _explain_loss(R)
        if self._scale != self._scale_goal and self._t > -math.inf:
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
                raise InputError(f"a world must give contacts of shape (n, 8); got shape {contacts.shape}")
        if (on_target.shape if isinstance(on_target, np.ndarray) else np.shape(on_target)) != (6,):
            raise InputError(f"a world must give force and torque, shape (6,); got {quote(on_target)}")
        asked, wrench = self._asked, np.empty(6)
        asked[:] = on_target  # in another memory layout a user's array would have the kernel compiled again
        fill_rotor_wrench(memory, asked, self._scale, wrench)
        return RenderedWrench(wrench, target, on_target, contacts, _NUMBERS[self._mode], share, self._engaged)

    def bring_back(self, on_thing: Array, wrench: Array) -> None:
        """`wrench` (6,) becomes the torque that the part `on_thing` (6,) of the target's wrench makes [N, N·m]."""
        fill_rotor_wrench(self._memory, on_thing, self._scale, wrench)

    def set_mode(self, mode: Mode) -> None:
        """From the next tick on, the clutch slides over to `mode`."""
        if mode not in MODES:
            raise UnknownName("mode", str(mode), MODES)
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

    def _aim(self) -> None:
        """Let the shares slide to what the mode and the hand's wish ask for."""
        self._memory["moving_goal"] = self._engaged and self._mode == "translate"
        self._memory["turning_goal"] = self._engaged and self._mode == "rotate"

    def _slide_scale(self, elapsed: float) -> None:
        step = min(max(elapsed, 0.0), self.gap) / _SLIDE
        way = math.log(self._scale_goal / self._scale)
        self._scale = self._scale_goal if abs(way) <= step else self._scale * math.exp(math.copysign(step, way))


def _explain_loss(R: Array) -> InputError:
    """What is wrong with a rotor at R (3, 3) that no target can follow."""
    return InputError(
        f"the rotor is tilted beyond λ = ±{math.degrees(STEEPEST):.0f}°, or its orientation is unknown "
        f"(R_SR[0, 2] = {R[0, 2]:.4g}): the two-mode mapping is not defined there. Turn it back"
    )


def make_moded_linkage(device: SphericalMotor, gains: Gains | None) -> ModedLinkage:
    """The linkage of a motor, whose handle moves a target through two modes; MOTOR_GAINS unless others are given."""
    return ModedLinkage(gains or MOTOR_GAINS, arm=device.rotor.handle_length)
