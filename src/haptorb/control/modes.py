"""Two modes and a clutch: three turns of a rotor move a target in six degrees of freedom, and its wrench comes back.

Bai 2012, eqs. (5)–(6), rotor angles (ψ, λ, φ), R = Rx(ψ) Ry(λ) Rz(φ), primes for the target:

    rotate       λ' = ζ₁ λ,   ψ' = ζ₂ ψ,   φ' = ζ₃ φ          T_ψ = η₁ T_ψ',  T_λ = η₂ T_λ',  T_φ = η₃ T_φ'
    translate    X' = ζ̂₁ λ,   Y' = ζ̂₂ ψ,   Z' = ζ̂₃ φ          T_ψ = η̂₁ F_Y',  T_λ = η̂₂ F_X',  T_φ = η̂₃ F_Z'

(6b), not the text of phase 1, which swaps T_ψ and T_λ (erratum E6). Mind the printed order: ζ₁ is for λ, η₁ for ψ.

T_ψ, T_λ, T_φ are what the torque vector does along the three Euler axes, and T_ψ', T_λ', T_φ' likewise at the target;
with that T·ω = F·v' + T'·w' holds at any tilt, not only for small ones.

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

from haptorb.control.gains import Gains, three
from haptorb.devices.state import State
from haptorb.errors import InputError, UnknownName
from haptorb.physics.arrays import Array
from haptorb.physics.compiled import kernel
from haptorb.physics.record import record

__all__ = ["MODES", "Clutch", "Gains", "Mode", "TwoModes"]

Mode = Literal["translate", "rotate"]
MODES: tuple[Mode, ...] = ("translate", "rotate")
STEEPEST = math.radians(80.0)  #: tilt λ at which Euler angles come too close to their pole, for rotor and target


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


@kernel
def _angles(R: Array, near: Array, out: Array) -> None:
    """ψ, λ, φ of R, each the one nearest to `near`."""
    out[0] = math.atan2(-R[1, 2], R[2, 2])
    out[1] = math.asin(min(1.0, max(-1.0, R[0, 2])))
    out[2] = math.atan2(-R[0, 1], R[0, 0])
    for i in (0, 2):
        out[i] += 2.0 * math.pi * round((near[i] - out[i]) / (2.0 * math.pi))


@kernel
def _rates(q: Array, w: Array, out: Array) -> None:
    c, s = math.cos(q[0]), math.sin(q[0])
    out[1] = c * w[1] + s * w[2]
    out[2] = (c * w[2] - s * w[1]) / math.cos(q[1])
    out[0] = w[0] - math.sin(q[1]) * out[2]


@kernel
def _free(attitude: Array, rates: Array, rotate: Array) -> float:
    """0 while the target leans against the pole of its Euler angles, else 1."""
    return 0.0 if abs(attitude[1]) >= STEEPEST and attitude[1] * rates[1] * rotate[0] > 0.0 else 1.0


@kernel
def _advance(
    R: Array, w: Array, dt: float, gap: float, ramp: float, goal: Array, gains: Array,
    share: Array, angles: Array, rates: Array, position: Array, attitude: Array, out: Array,
) -> None:  # fmt: skip
    """Fill out (5, 3): share, angles, rates, position, attitude."""
    _angles(R, angles, out[1])
    _rates(out[1], w, out[2])
    lost = not dt <= gap
    move, turn = (0.0, 0.0) if lost else (share[0], share[1])
    dpsi, dlam, dphi = out[1, 0] - angles[0], out[1, 1] - angles[1], out[1, 2] - angles[2]
    out[3, 0] = position[0] + move * gains[0, 0] * dlam  # Eq. (6a)
    out[3, 1] = position[1] + move * gains[0, 1] * dpsi
    out[3, 2] = position[2] + move * gains[0, 2] * dphi
    free = _free(attitude, rates, gains[1])
    out[4, 0] = attitude[0] + turn * gains[1, 1] * dpsi  # Eq. (5a)
    out[4, 1] = attitude[1] + turn * gains[1, 0] * dlam * free
    out[4, 2] = attitude[2] + turn * gains[1, 2] * dphi
    step = max(dt, 0.0) / ramp
    for i in range(2):
        if lost:
            out[0, i] = 0.0
        elif share[i] < goal[i]:
            out[0, i] = min(share[i] + step, goal[i])
        else:
            out[0, i] = max(share[i] - step, goal[i])
    out[0, 2] = 0.0


@kernel
def _torque(share: Array, q: Array, rates: Array, attitude: Array, wrench: Array, gains: Array, out: Array) -> None:
    """T (3,) [N·m] on the rotor, stator frame."""
    c, s = math.cos(attitude[0]), math.sin(attitude[0])
    cl, sl = math.cos(attitude[1]), math.sin(attitude[1])
    # the target's torque along its Euler axes: Jᵀ T'
    T_psi = wrench[3]
    T_lam = (c * wrench[4] + s * wrench[5]) * _free(attitude, rates, gains[1])
    T_phi = sl * wrench[3] - s * cl * wrench[4] + c * cl * wrench[5]
    Q_psi = share[0] * gains[2, 0] * wrench[1] + share[1] * gains[3, 0] * T_psi  # Eqs. (6b), (5b)
    Q_lam = share[0] * gains[2, 1] * wrench[0] + share[1] * gains[3, 1] * T_lam
    Q_phi = share[0] * gains[2, 2] * wrench[2] + share[1] * gains[3, 2] * T_phi
    # the vector that has these components along the rotor's Euler axes: J⁻ᵀ Q
    c, s = math.cos(q[0]), math.sin(q[0])
    u = (Q_phi - math.sin(q[1]) * Q_psi) / math.cos(q[1])
    out[0] = Q_psi
    out[1] = c * Q_lam - s * u
    out[2] = s * Q_lam + c * u


@kernel
def _target(share: Array, rates: Array, a: Array, gains: Array, R: Array, w: Array, v: Array) -> None:
    cp, sp = math.cos(a[0]), math.sin(a[0])
    cl, sl = math.cos(a[1]), math.sin(a[1])
    cf, sf = math.cos(a[2]), math.sin(a[2])
    R[0, 0], R[0, 1], R[0, 2] = cl * cf, -cl * sf, sl
    R[1, 0], R[1, 1], R[1, 2] = cp * sf + sp * sl * cf, cp * cf - sp * sl * sf, -sp * cl
    R[2, 0], R[2, 1], R[2, 2] = sp * sf - cp * sl * cf, sp * cf + cp * sl * sf, cp * cl
    v[0] = share[0] * gains[0, 0] * rates[1]
    v[1] = share[0] * gains[0, 1] * rates[0]
    v[2] = share[0] * gains[0, 2] * rates[2]
    dp = share[1] * gains[1, 1] * rates[0]
    dl = share[1] * gains[1, 0] * rates[1] * _free(a, rates, gains[1])
    df = share[1] * gains[1, 2] * rates[2]
    w[0] = dp + sl * df
    w[1] = cp * dl - sp * cl * df
    w[2] = sp * dl + cp * cl * df


class TwoModes:
    """The mapping of one device to one target: pure functions of Clutch and State, nothing kept inside.

    gains   motion and torque gains
    ramp    time in which the clutch takes hold, or lets go [s]
    gap     longest time between two rotor states for which they count as one motion [s]; after a longer one the clutch
            lets go at once and takes hold again from where the rotor then is

    Raises InputError for a time that is not above zero.

    >>> modes = TwoModes()
    >>> clutch = modes.start(State.turned(np.eye(3)))
    >>> modes.torque(clutch, (1.0, 0, 0, 0, 0, 0)).tolist()       # it starts let go, and takes hold within `ramp`
    [0.0, 0.0, 0.0]
    """

    def __init__(self, gains: Gains | None = None, *, ramp: float = 0.15, gap: float = 0.05) -> None:
        self.gains = gains or Gains()
        for name, value in (("ramp", ramp), ("gap", gap)):
            if not (isinstance(value, int | float) and math.isfinite(value) and value > 0):
                raise InputError(f"TwoModes: {name} must be a time greater than zero [s]; got {value!r}")
        self.ramp, self.gap = float(ramp), float(gap)
        g = self.gains
        self._gains = np.array([g.translate, g.rotate, *g.torques])
        self._goals = {
            (mode, engaged): np.array([float(engaged and mode == name) for name in MODES])
            for mode in MODES
            for engaged in (False, True)
        }

    def start(
        self,
        rotor: State,
        *,
        mode: Mode = "translate",
        engaged: bool = True,
        position: ArrayLike = (0.0, 0.0, 0.0),
        attitude: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Clutch:
        """A clutch, let go, with the target at `position` (3,) [m], turned by `attitude` ψ', λ', φ' (3,) [rad].

        Raises InputError for an attitude beyond ±80° of λ'.
        """
        self.known(mode)
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
        R = np.ascontiguousarray(rotor.R_SR)
        if not abs(R[0, 2]) < math.sin(STEEPEST):  # also catches NaN
            raise InputError(
                f"the rotor is tilted beyond λ = ±{math.degrees(STEEPEST):.0f}°, or its orientation is unknown "
                f"(R_SR[0, 2] = {R[0, 2]:.4g}): the two-mode mapping has no meaning there. Turn it back"
            )
        out = np.empty((5, 3))
        _advance(
            R, np.ascontiguousarray(rotor.w), rotor.t - clutch.t, self.gap, self.ramp,
            self._goals[clutch.mode, clutch.engaged], self._gains,
            clutch.share, clutch.angles, clutch.rates, clutch.position, clutch.attitude, out,
        )  # fmt: skip
        return Clutch(rotor.t, clutch.mode, clutch.engaged, out[0, :2], out[1], out[2], out[3], out[4])

    def target(self, clutch: Clutch) -> State:
        """The target's pose and motion in the primed frame: what a world of the target is asked with."""
        R, w, v = np.empty((3, 3)), np.empty(3), np.empty(3)
        _target(clutch.share, clutch.rates, clutch.attitude, self._gains, R, w, v)
        return State(clutch.t, R, clutch.position, w, v)

    def torque(self, clutch: Clutch, wrench: ArrayLike) -> Array:
        """Torque (3,) [N·m] on the rotor, stator frame, for the `wrench` (6,) on the target about o', primed frame.

        Raises InputError for another shape.
        """
        asked = np.array(wrench, dtype=np.float64)  # a copy: a read-only array would be compiled for anew
        if asked.shape != (6,):
            raise InputError(f"wrench must have shape (6,); got {asked.shape}")
        out = np.empty(3)
        _torque(clutch.share, clutch.angles, clutch.rates, clutch.attitude, asked, self._gains, out)
        return out

    def switched(self, clutch: Clutch, mode: Mode) -> Clutch:
        """The same pose and torque, on the way to `mode`."""
        self.known(mode)
        return replace(clutch, mode=mode)

    def released(self, clutch: Clutch) -> Clutch:
        """Letting go: the target stays, the rotor soon turns freely."""
        return replace(clutch, engaged=False)

    def engaged(self, clutch: Clutch) -> Clutch:
        """Taking hold again, from wherever the rotor is."""
        return replace(clutch, engaged=True)

    @staticmethod
    def known(mode: str) -> None:
        """UnknownName for what is not a mode."""
        if mode not in MODES:
            raise UnknownName("mode", str(mode), MODES)
