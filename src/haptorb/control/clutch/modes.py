"""Two modes and a clutch: three turns of a rotor move a target in six degrees of freedom, and its wrench comes back.

Bai 2012, eqs. (5)–(6), rotor angles (ψ, λ, φ), R = Rx(ψ) Ry(λ) Rz(φ), primes for the target:

    rotate       λ' = ζ₁ λ,   ψ' = ζ₂ ψ,   φ' = ζ₃ φ          T_ψ = η₁ T_ψ',  T_λ = η₂ T_λ',  T_φ = η₃ T_φ'
    translate    X' = ζ̂₁ λ,   Y' = ζ̂₂ ψ,   Z' = ζ̂₃ φ          T_ψ = η̂₁ F_Y',  T_λ = η̂₂ F_X',  T_φ = η̂₃ F_Z'

(6b), not the text of phase 1, which swaps T_ψ and T_λ (erratum E6). Mind the printed order: ζ₁ is for λ, η₁ for ψ.

T_ψ, T_λ, T_φ are the components of the torque vector along the three Euler axes, and T_ψ', T_λ', T_φ' those at the
target; with that T·ω = F·v' + T'·w' holds at any tilt, not only for small ones.

The clutch moves the target by *increments*: dX' = share · ζ̂ dq, and the torque is share · η̂ F with the same share. Both
shares (one per mode) slide between 0 and 1, never jump; so switching, letting go and taking hold step neither pose nor
torque, and at every share the power that leaves the hand is the power that reaches the target. Letting go, turning
back and taking hold again reaches as far as one likes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from haptorb.control.clutch.gains import Gains, three
from haptorb.control.clutch.mode_kernels import (
    CLUTCH,
    STEEPEST,
    advance_clutch,
    fill_rotor_wrench,
    fill_target_pose,
)
from haptorb.devices.state import State
from haptorb.errors import InputError, UnknownName
from haptorb.numerics.arrays import Array, Records
from haptorb.numerics.record import record

__all__ = ["MODES", "Clutch", "Gains", "Mode", "TwoModes"]

Mode = Literal["translate", "rotate"]
MODES: tuple[Mode, ...] = ("translate", "rotate")


@record
class Clutch:
    """Where rotor and target are and how firmly they are joined; made by TwoModes, never changed."""

    t: float  #: of the rotor's last state [s]
    mode: Mode  #: the mode that is, or will be, joined
    engaged: bool  #: whether the hand wants to move the target
    share: Array  #: (2,) how firmly translation and rotation are joined now, 0 to 1
    angles: Array  #: (3,) rotor ψ, λ, φ [rad], φ unwrapped
    rates: Array  #: (3,) their rates [rad/s]
    position: Array  #: (3,) target X', Y', Z' [m]
    attitude: Array  #: (3,) target ψ', λ', φ' [rad]


class TwoModes:
    """The mapping of one device to one target: pure functions of Clutch and State, nothing kept inside.

    gains   motion and torque gains
    ramp    time in which the clutch engages, or releases [s]
    gap     longest time between two rotor states for which they count as one motion [s]; after a longer one the clutch
            releases at once and engages again from where the rotor then is

    Raises InputError for a time that is not above zero.

    >>> modes = TwoModes()
    >>> clutch = modes.start(State.from_rotation(np.eye(3)))
    >>> modes.torque(clutch, (1.0, 0, 0, 0, 0, 0)).tolist()       # it starts released, and engages within `ramp`
    [0.0, 0.0, 0.0]
    """

    def __init__(self, gains: Gains | None = None, *, ramp: float = 0.15, gap: float = 0.05) -> None:
        self.gains = gains or Gains()
        for name, value in (("ramp", ramp), ("gap", gap)):
            if not (isinstance(value, int | float) and math.isfinite(value) and value > 0):
                raise InputError(f"TwoModes: {name} must be a time greater than zero [s]; got {value!r}")
        self.ramp, self.gap = float(ramp), float(gap)
        self._settings = np.zeros(1, dtype=CLUTCH)
        for name in ("translate", "rotate", "translate_torque", "rotate_torque"):
            self._settings[name] = getattr(self.gains, name)
        self._settings["gap"], self._settings["ramp"] = self.gap, self.ramp

    def start(
        self,
        rotor: State,
        *,
        mode: Mode = "translate",
        engaged: bool = True,
        position: ArrayLike = (0.0, 0.0, 0.0),
        attitude: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Clutch:
        """A clutch, released, with the target at `position` (3,) [m], turned by `attitude` ψ', λ', φ' (3,) [rad].

        Raises InputError for an attitude beyond ±80° of λ'.
        """
        self.check_mode(mode)
        turned = np.array(three(attitude, "attitude"))
        if abs(turned[1]) >= STEEPEST:
            raise InputError(
                f"attitude: λ' must stay within ±{math.degrees(STEEPEST):.0f}°; got {math.degrees(turned[1]):.4g}°"
            )
        zero = np.zeros(3)
        place = np.array(three(position, "position"))
        clutch = Clutch(rotor.t, mode, engaged, np.zeros(2), zero, zero, place, turned)
        return self.advance(clutch, rotor)

    def advance(self, clutch: Clutch, rotor: State) -> Clutch:
        """The clutch after the rotor has come to `rotor`; the target has followed.

        Raises InputError for a rotor tilted so far (|λ| ≥ 80°) that its Euler angles lose their meaning.
        """
        memory = self.memory(clutch)
        R, w = np.ascontiguousarray(rotor.R_SR), np.ascontiguousarray(rotor.w)
        if not advance_clutch(memory, R, w, rotor.t - clutch.t):
            raise self.explain_loss(R)
        return self.clutch(memory, rotor.t, clutch.mode, clutch.engaged)

    def target(self, clutch: Clutch) -> State:
        """The target's pose and motion in the primed frame: what a world of the target is asked with."""
        pose = np.empty((6, 3))
        fill_target_pose(self.memory(clutch), pose)
        return State(clutch.t, pose[:3], pose[3], pose[4], pose[5])

    def torque(self, clutch: Clutch, wrench: ArrayLike) -> Array:
        """Torque (3,) [N·m] on the rotor, stator frame, for the `wrench` (6,) on the target about o', primed frame.

        Raises InputError for another shape.
        """
        asked = np.array(wrench, dtype=np.float64)  # a copy: a read-only array would be compiled for separately
        if asked.shape != (6,):
            raise InputError(f"wrench must have shape (6,); got {asked.shape}")
        out = np.empty(6)
        fill_rotor_wrench(self.memory(clutch), asked, 1.0, out)
        return out[3:]

    def memory(self, clutch: Clutch) -> Records:
        """(1,) CLUTCH: `clutch` and this mapping as `mode_kernels` take them; a new array."""
        memory = self._settings.copy()
        memory["moving"], memory["turning"] = clutch.share
        for name in ("angles", "rates", "position", "attitude"):
            memory[name] = getattr(clutch, name)
        self.aim(memory, clutch.mode, clutch.engaged)
        return memory

    def aim(self, memory: Records, mode: Mode, engaged: bool) -> None:
        """Let the shares in `memory`, (1,) CLUTCH, slide to what `mode` and the hand's wish ask for."""
        memory["moving_goal"] = engaged and mode == "translate"
        memory["turning_goal"] = engaged and mode == "rotate"

    def clutch(self, memory: Records, t: float, mode: Mode, engaged: bool) -> Clutch:
        """The clutch that `memory`, (1,) CLUTCH, holds at `t` [s]; it keeps a copy."""
        m = memory.copy()[0]
        share = np.array([m["moving"], m["turning"]])
        return Clutch(t, mode, engaged, share, m["angles"], m["rates"], m["position"], m["attitude"])

    def explain_loss(self, R: Array) -> InputError:
        """What is wrong with a rotor at R (3, 3) that no target can follow."""
        return InputError(
            f"the rotor is tilted beyond λ = ±{math.degrees(STEEPEST):.0f}°, or its orientation is unknown "
            f"(R_SR[0, 2] = {R[0, 2]:.4g}): the two-mode mapping is not defined there. Turn it back"
        )

    def switch(self, clutch: Clutch, mode: Mode) -> Clutch:
        """The same pose and torque, on the way to `mode`."""
        self.check_mode(mode)
        return replace(clutch, mode=mode)

    def release(self, clutch: Clutch) -> Clutch:
        """Letting go: the target stays, the rotor soon turns freely."""
        return replace(clutch, engaged=False)

    def engage(self, clutch: Clutch) -> Clutch:
        """Taking hold again, from wherever the rotor is."""
        return replace(clutch, engaged=True)

    @staticmethod
    def check_mode(mode: str) -> None:
        """UnknownName for what is not a mode."""
        if mode not in MODES:
            raise UnknownName("mode", str(mode), MODES)
