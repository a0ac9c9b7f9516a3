"""Linkage between the mover and the object that a world acts on: direct, or through two modes and a clutch.

A world renders a wrench for a state. For a stylus over a dome both are those of the mover. A motor's rotor only
rotates, while its plug moves in six degrees of freedom: they are connected by a linkage with a clutch
(`ModedLinkage`). Besides guard and drive it is the only part of the chain with a state from tick to tick.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Literal, Protocol, final

import numpy as np
from numpy import ascontiguousarray
from numpy.typing import ArrayLike

from haptorb.arrays import (
    Array,
    Records,
    StateArray,
    Stateful,
    check_finite,
    choose,
    fields,
    make_numbers,
    record,
    state_zeros,
)
from haptorb.compiled import kernel, tick_kernel
from haptorb.devices.arm import Arm
from haptorb.devices.base import Device, State, device_function, find_object_limits
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import InputError, UnknownName, quote

__all__ = [
    "CLUTCH",
    "MODES",
    "MOTOR_GAINS",
    "NO_CONTACTS",
    "STEEPEST",
    "Direct",
    "Gains",
    "Linkage",
    "Mode",
    "ModedLinkage",
    "RenderedWrench",
    "WrenchSource",
    "advance_clutch",
    "fill_rotor_wrench",
    "follow_rotor",
    "make_linkage",
    "three",
]


# --------------------------------------------------------------------------------------------------
# Gains of the two modes: motion of the object, and scale of its wrench.


def three(value: ArrayLike, what: str) -> tuple[float, float, float]:
    """Convert `value` to three finite numbers (3,) in its own unit, or raise InputError naming `what`. [any]"""
    numbers = check_finite(value, what)
    if numbers.shape != (3,):
        raise InputError(f"{what} must be three numbers; got shape {numbers.shape}")
    return float(numbers[0]), float(numbers[1]), float(numbers[2])


@dataclass(frozen=True)
class Gains:
    """Gains of eqs. (5) and (6), indexed as printed.

    translate          ζ̂ [m/rad] of X', Y', Z' (by λ, ψ, φ)
    rotate             ζ of λ', ψ', φ'
    translate_torque   η̂ [m] of F_Y', F_X', F_Z' (to T_ψ, T_λ, T_φ); None: power-consistent, η̂ = (ζ̂₂, ζ̂₁, ζ̂₃)
    rotate_torque      η of T_ψ', T_λ', T_φ'; None: η = (ζ₂, ζ₁, ζ₃)

    The defaults render the outlet (a pull of 11.5 N; tilted by 2° 64 N sideways and 1 N·m about the plug's end) on a
    motor of about 1 N·m: 0.23, 0.26 and 0.25 N·m, and at most 0.6 over the handle's workspace, unless the plug's bevel
    is forced aside. ±22.5° of handle move the plug by ±8 mm out (its full travel), ±1.6 mm sideways; 8° of spin tilt it
    by 2°. For the paper's beam, 4.3 times stiffer, use `Gains().scale(0.25)`.

    >>> Gains().verdict, Gains().scale(0.2).verdict, Gains(rotate_torque=(1, 1, 1)).verdict
    ('power-consistent', 'scaled', 'active')
    """

    translate: tuple[float, float, float] = (0.02, 0.004, 0.01)
    rotate: tuple[float, float, float] = (0.25, 0.25, 0.25)
    translate_torque: tuple[float, float, float] | None = None
    rotate_torque: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("translate", "rotate", "translate_torque", "rotate_torque"):
            value = getattr(self, name)
            if value is None and name.endswith("torque"):
                first, second, third = getattr(self, name.removesuffix("_torque"))
                value = (second, first, third)
            object.__setattr__(self, name, three(value, f"gains.{name}"))

    def scale(self, factor: float) -> Gains:
        """The same motion with all torques multiplied by `factor`: a stronger or weaker world, still passive.

        Raises InputError for a negative factor.
        """
        factor = float(check_finite(factor, "factor"))
        if factor < 0:
            raise InputError(
                f"factor must not be negative: the torques would act in the wrong direction; got {factor:g}"
            )
        move, turn = (three(factor * check_finite(part, "gains"), "gains") for part in self.torques)
        return replace(self, translate_torque=move, rotate_torque=turn)

    @property
    def torques(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """translate_torque and rotate_torque, with their defaults resolved."""
        assert self.translate_torque is not None  # set by the constructor
        assert self.rotate_torque is not None
        return self.translate_torque, self.rotate_torque

    @property
    def torque_per_motion(self) -> Array:
        """(6,) ratio of torque gain to motion gain for X', Y', Z', λ', ψ', φ'; six equal values if passive."""
        motion = np.array([*self.translate, *self.rotate])
        (psi, lam, phi), (turn_psi, turn_lam, turn_phi) = self.torques
        torque = np.array([lam, psi, phi, turn_lam, turn_psi, turn_phi])
        ratio = np.full(6, np.nan)
        np.divide(torque, motion, out=ratio, where=motion != 0)
        ratio[(motion == 0) & (torque != 0)] = np.inf
        return ratio

    @property
    def verdict(self) -> str:
        """ "power-consistent"; "scaled": all torques by one factor, still passive; or "active": can generate energy.

        One factor for all six: with another factor in the other mode, energy put in through one could be taken out
        through the other.
        """
        ratio = self.torque_per_motion
        ratio = ratio[~np.isnan(ratio)]
        if ratio.size == 0 or np.abs(ratio - 1.0).max() < 1e-9:
            return "power-consistent"
        if np.isfinite(ratio).all() and ratio.min() >= 0 and np.ptp(ratio) <= 1e-9 * ratio.max():
            return "scaled"
        return "active"


#: 40° of handle, within a hand's range in the workspace, pull the plug out completely; else the defaults
MOTOR_GAINS = Gains(translate=(0.024, 0.004, 0.01))


# --------------------------------------------------------------------------------------------------
# Names of the two modes: the handle translates the object, or rotates it.


Mode = Literal["translate", "rotate"]
MODES: tuple[Mode, ...] = ("translate", "rotate")


NO_CONTACTS = np.zeros((0, 8))  #: contacts of a world without any; one row of 8 numbers each
_CLOSED = np.ones(2)


class WrenchSource(Protocol):
    """Part of a world's interface that a linkage uses."""

    def wrench(self, state: State) -> Array:
        """(6,) on the object at `state` [N, N·m]."""


@record
class RenderedWrench:
    """Result of one tick of a linkage.

    Parameters
    ----------
    wrench : ndarray, shape (6,)
        Wrench on the mover, in the stator frame [N, N·m].
    object : State
        Pose and motion of the body that the world acts on: the mover, or a motor's object in its own primed frame.
    object_wrench : ndarray, shape (6,)
        Wrench on that body [N, N·m].
    contacts : ndarray, shape (n, 8)
        Contacts in the format and the units [any] of `ContactWorld`; empty for other worlds, or a linkage without
        contacts.
    mode : int
        Zero for a direct linkage, 1 for "translate", 2 for "rotate".
    share : ndarray, shape (2,)
        Engagement of translation and of rotation, 0 to 1 [1].
    engaged : bool
        Whether the clutch is commanded to engage.
    """

    wrench: Array
    object: State
    object_wrench: Array
    contacts: Array
    mode: int
    share: Array
    engaged: bool


class Linkage(Stateful, ABC):
    """Connection of mover and object: maps the mover's state to the wrench of a world on the hand.

    What it remembers from tick to tick is in `state_arrays`.

    Attributes
    ----------
    modes : tuple of str
        Available modes; empty for a direct linkage.
    passive : bool
        Whether it adds no energy to that of the world.
    arm : float
        Lever arm of the hand on a mover that turns [m]; 0 where the mover is a tool.
    """

    modes: tuple[Mode, ...]  #: available modes; empty for a direct linkage
    passive: bool  #: whether it adds no energy to that of the world
    arm: float  #: lever arm of the hand on a mover that turns [m]; 0 where the mover is a tool

    @abstractmethod
    def render(self, world: WrenchSource, mover: State) -> RenderedWrench:
        """Wrench of `world` on the hand with the mover at `mover`; one call per tick."""

    @abstractmethod
    def fill_mover_wrench(self, object_wrench: Array, wrench: Array) -> None:
        """Fill `wrench` (6,) on the mover [N, N·m] for `object_wrench` (6,), a part of the last `render`'s wrench on
        the object."""

    @abstractmethod
    def set_mode(self, mode: Mode) -> None:
        """Change to `mode`, without a step of pose or wrench. Raises UnknownName for an unknown mode."""

    @abstractmethod
    def set_clutch(self, engaged: bool) -> None:
        """Engage the clutch to the object, or release it, without a step of pose or wrench."""

    @abstractmethod
    def set_torque_scale(self, scale: float) -> None:
        """Scale the wrench by `scale`, with a smooth transition."""

    @abstractmethod
    def restart(self) -> None:
        """Reset the object to its initial pose, and engage the clutch again."""


@final
class Direct(Linkage):
    """Linkage in which the world acts on the mover itself; `arm`: lever arm of the hand if torque is rendered [m]."""

    modes = ()
    passive = True

    def __init__(self, arm: float = 0.0) -> None:
        self.arm = arm

    def render(self, world: WrenchSource, mover: State) -> RenderedWrench:
        """Wrench of the world at the mover."""
        wrench = world.wrench(mover)
        return RenderedWrench(wrench, mover, wrench, NO_CONTACTS, 0, _CLOSED, True)

    def fill_mover_wrench(self, object_wrench: Array, wrench: Array) -> None:
        """`wrench` (6,) becomes `object_wrench` (6,) itself [N, N·m]: object and mover are the same body."""
        wrench[:] = object_wrench

    def set_mode(self, mode: Mode) -> None:
        """Not available without modes. Raises InputError."""
        raise InputError(f"mode '{mode}': this device has no modes; its mover acts directly")

    def set_clutch(self, engaged: bool) -> None:
        """Not available without a clutch. Raises InputError."""
        raise InputError("this device has no clutch; its mover acts directly")

    def set_torque_scale(self, scale: float) -> None:
        """Not available without a torque scale. Raises InputError."""
        raise InputError("this device has no torque scale; its mover acts directly")

    def restart(self) -> None:
        """Do nothing: a direct linkage is stateless."""


@device_function
@singledispatch
def make_linkage(device: Device, gains: Gains | None = None) -> Linkage:
    """Create the linkage between a device's mover and the object that the world acts on, by its kind.

    Parameters
    ----------
    device : Device
        The device.
    gains : Gains, optional
        Gains of a linkage with modes.

    Returns
    -------
    Linkage
        By default object and mover are the same body.

    Raises
    ------
    InputError
        For `gains` without modes.
    """
    if gains is not None:
        raise InputError(f"gains are for two-mode devices; a {device.kind.title} such as '{device.name}' has no modes")
    return Direct()


@make_linkage.register(Arm)
def _(device: Arm, gains: Gains | None = None) -> Linkage:
    """Direct linkage of an end effector; for an actuated orientation the lever arm is the one at which the hand's
    rotational damping corresponds to its translational damping."""
    if gains is not None:
        return make_linkage.dispatch(object)(device, gains)  # refuses
    return Direct(device.turning_arm)


# --------------------------------------------------------------------------------------------------
# Mapping of eqs. (5) and (6) in compiled code: rotor to object in one pass, and the object's wrench back.
#
# State and gains of the mapping are one record of `CLUTCH`, in an array of one.


STEEPEST = math.radians(80.0)  #: tilt λ at which Euler angles come too close to their singularity, for rotor and object
_HIGHEST = math.sin(STEEPEST)
_TURN = 2.0 * math.pi

CLUTCH = fields(
    # settings: the gains of `Gains`, as printed, and the time constants of `ModedLinkage`
    ("translate", "f8", (3,)),  # ζ̂ [m/rad] of X', Y', Z' (by λ, ψ, φ)
    ("rotate", "f8", (3,)),  # ζ of λ', ψ', φ'
    ("translate_torque", "f8", (3,)),  # η̂ [m] of F_Y', F_X', F_Z' (to T_ψ, T_λ, T_φ)
    ("rotate_torque", "f8", (3,)),  # η of T_ψ', T_λ', T_φ'
    ("gap", "f8"),  # [s]
    ("ramp", "f8"),  # [s]
    # state
    ("moving", "f8"),  # engagement of translation, 0 to 1
    ("turning", "f8"),  # engagement of rotation, 0 to 1
    ("moving_goal", "f8"),  # setpoint of the first
    ("turning_goal", "f8"),  # setpoint of the second
    ("angles", "f8", (3,)),  # of the rotor: ψ, λ, φ [rad], φ unwrapped
    ("rates", "f8", (3,)),  # their rates [rad/s]
    ("position", "f8", (3,)),  # of the object: X', Y', Z' [m]
    ("attitude", "f8", (3,)),  # of the object: ψ', λ', φ' [rad]
)


@kernel
def _free(attitude: float, rate: float, gain: float) -> float:
    """0 while the object is driven against the singularity of its Euler angles (λ', λ's rate, ζ₁), else 1."""
    return 0.0 if abs(attitude) >= STEEPEST and attitude * rate * gain > 0.0 else 1.0


@kernel
def _nearest(angle: float, near: float) -> float:
    """Return `angle` plus the multiple of a full turn [rad] that brings it nearest to `near`."""
    return angle + _TURN * round((near - angle) / _TURN)


@kernel
def _slide(share: float, goal: float, step: float) -> float:
    return min(share + step, goal) if share < goal else max(share - step, goal)


@kernel
def advance_clutch(clutch: Records, R: Array, w: Array, dt: float) -> bool:
    """Bring `clutch`, (1,) CLUTCH, to the rotor at R (3, 3), turning with w (3,) [rad/s], `dt` [s] later, and update
    the object.

    False, without any change, if the rotor is tilted beyond STEEPEST or its orientation is not finite.
    """
    if not abs(R[0, 2]) < _HIGHEST:  # also catches NaN
        return False
    m = clutch[0]
    angles, rates, position, attitude = m.angles, m.rates, m.position, m.attitude
    psi = _nearest(math.atan2(-R[1, 2], R[2, 2]), angles[0])
    lam = math.asin(min(1.0, max(-1.0, R[0, 2])))
    phi = _nearest(math.atan2(-R[0, 1], R[0, 0]), angles[2])
    lost = not dt <= m.gap
    move, turn = (0.0, 0.0) if lost else (m.moving, m.turning)
    free = _free(attitude[1], rates[1], m.rotate[0])
    dpsi, dlam, dphi = psi - angles[0], lam - angles[1], phi - angles[2]
    position[0] += move * m.translate[0] * dlam  # Eq. (6a)
    position[1] += move * m.translate[1] * dpsi
    position[2] += move * m.translate[2] * dphi
    attitude[0] += turn * m.rotate[1] * dpsi  # Eq. (5a)
    attitude[1] += turn * m.rotate[0] * dlam * free
    attitude[2] += turn * m.rotate[2] * dphi
    angles[0], angles[1], angles[2] = psi, lam, phi
    c, s = math.cos(psi), math.sin(psi)
    rates[1] = c * w[1] + s * w[2]
    rates[2] = (c * w[2] - s * w[1]) / math.cos(lam)
    rates[0] = w[0] - math.sin(lam) * rates[2]
    step = max(dt, 0.0) / m.ramp
    m.moving = 0.0 if lost else _slide(m.moving, m.moving_goal, step)
    m.turning = 0.0 if lost else _slide(m.turning, m.turning_goal, step)
    return True


@kernel
def _fill_target_pose(clutch: Records, pose: Array) -> None:
    """Fill pose (6, 3): R' (3, 3), position [m], w' [rad/s] and v' [m/s] of the object, primed frame."""
    m = clutch[0]
    rates, attitude = m.rates, m.attitude
    cp, sp = math.cos(attitude[0]), math.sin(attitude[0])
    cl, sl = math.cos(attitude[1]), math.sin(attitude[1])
    cf, sf = math.cos(attitude[2]), math.sin(attitude[2])
    pose[0, 0], pose[0, 1], pose[0, 2] = cl * cf, -cl * sf, sl
    pose[1, 0], pose[1, 1], pose[1, 2] = cp * sf + sp * sl * cf, cp * cf - sp * sl * sf, -sp * cl
    pose[2, 0], pose[2, 1], pose[2, 2] = sp * sf - cp * sl * cf, sp * cf + cp * sl * sf, cp * cl
    for i in range(3):
        pose[3, i] = m.position[i]
    dp = m.turning * m.rotate[1] * rates[0]
    dl = m.turning * m.rotate[0] * rates[1] * _free(attitude[1], rates[1], m.rotate[0])
    df = m.turning * m.rotate[2] * rates[2]
    pose[4, 0] = dp + sl * df
    pose[4, 1] = cp * dl - sp * cl * df
    pose[4, 2] = sp * dl + cp * cl * df
    pose[5, 0] = m.moving * m.translate[0] * rates[1]
    pose[5, 1] = m.moving * m.translate[1] * rates[0]
    pose[5, 2] = m.moving * m.translate[2] * rates[2]


@tick_kernel
def follow_rotor(clutch: Records, R: Array, w: Array, dt: float, pose: Array, share: Array) -> bool:
    """`advance_clutch` and `_fill_target_pose` in one call; share (2,): engagement of translation and rotation."""
    if not advance_clutch(clutch, R, w, dt):
        return False
    _fill_target_pose(clutch, pose)
    share[0], share[1] = clutch[0].moving, clutch[0].turning
    return True


@tick_kernel
def fill_rotor_wrench(clutch: Records, wrench: Array, scale: float, out: Array) -> None:
    """out (6,): no force, and the torque [N·m] on the rotor, stator frame, for the object's wrench (6,) [N, N·m].

    scale: factor on the torque in addition to the clutch's gains.
    """
    m = clutch[0]
    q, rates, attitude, move, turn = m.angles, m.rates, m.attitude, m.translate_torque, m.rotate_torque
    c, s = math.cos(attitude[0]), math.sin(attitude[0])
    cl, sl = math.cos(attitude[1]), math.sin(attitude[1])
    # the object's torque along its Euler axes: Jᵀ T'
    T_psi = wrench[3]
    T_lam = (c * wrench[4] + s * wrench[5]) * _free(attitude[1], rates[1], m.rotate[0])
    T_phi = sl * wrench[3] - s * cl * wrench[4] + c * cl * wrench[5]
    Q_psi = m.moving * move[0] * wrench[1] + m.turning * turn[0] * T_psi  # Eqs. (6b), (5b)
    Q_lam = m.moving * move[1] * wrench[0] + m.turning * turn[1] * T_lam
    Q_phi = m.moving * move[2] * wrench[2] + m.turning * turn[2] * T_phi
    # torque vector with these components along the rotor's Euler axes: J⁻ᵀ Q
    c, s = math.cos(q[0]), math.sin(q[0])
    u = (Q_phi - math.sin(q[1]) * Q_psi) / math.cos(q[1])
    out[0], out[1], out[2] = 0.0, 0.0, 0.0
    out[3] = scale * Q_psi
    out[4] = scale * (c * Q_lam - s * u)
    out[5] = scale * (s * Q_lam + c * u)


# --------------------------------------------------------------------------------------------------
# Two modes and a clutch: three rotor angles move an object in six degrees of freedom, with its wrench fed back.
#
# Bai 2012, eqs. (5)–(6), rotor angles (ψ, λ, φ), R = Rx(ψ) Ry(λ) Rz(φ), primes for the object:
#
#     rotate       λ' = ζ₁ λ,   ψ' = ζ₂ ψ,   φ' = ζ₃ φ          T_ψ = η₁ T_ψ',  T_λ = η₂ T_λ',  T_φ = η₃ T_φ'
#     translate    X' = ζ̂₁ λ,   Y' = ζ̂₂ ψ,   Z' = ζ̂₃ φ          T_ψ = η̂₁ F_Y',  T_λ = η̂₂ F_X',  T_φ = η̂₃ F_Z'
#
# (6b) as printed; the paper's text swaps T_ψ and T_λ (erratum E6). Note the printed order: ζ₁ is for λ, η₁ for ψ.
#
# T_ψ, T_λ, T_φ are the projections of the torque vector on the three Euler axes, and T_ψ', T_λ', T_φ' likewise for the
# object; with that T·ω = F·v' + T'·w' is satisfied at any tilt, not only for small ones.
#
# The clutch moves the object by *increments*: dX' = share · ζ̂ dq, and the torque is share · η̂ F with the same share.
# Both shares (one per mode) ramp between 0 and 1; so switching, releasing and engaging step neither pose nor torque,
# and at every share the power delivered by the hand equals the power received by the object. Release, turn back and
# engage again (indexing) extends the range without limit.


_FLOAT = NO_CONTACTS.dtype
#: time in which the torque scale changes by a factor e [s]: slow compared with a hand's own motion
_SCALE_TIME_CONSTANT_S = 0.5
_NUMBERS = {mode: number for number, mode in enumerate(MODES, start=1)}  #: number of each mode in a row


@final
class ModedLinkage(Linkage):
    """A rotor moves an object through two modes; the wrench on the object is fed back as torque.

    gains                motion and torque gains
    position, attitude   initial pose of the object: X', Y', Z' [m] and ψ', λ', φ' [rad]; zero: the plug fully inserted
    arm                  distance from the motor's centre to the hand on its handle [m]
    ramp                 time in which the clutch engages, or releases [s]
    gap                  maximum time between two rotor states that count as one motion [s]; after a longer one the
                         clutch releases at once and engages again at the rotor's new orientation

    It starts released, and engages within `ramp`. Commands of mode and clutch take effect in the next tick; the
    object's pose remains continuous at any time and in any state.

    Raises InputError for a time that is not above zero, and for an attitude beyond ±80° of λ'.

    >>> from haptorb.worlds.snap_fit import Outlet
    >>> linkage, rotor = ModedLinkage(), State.from_rotation(np.eye(3))
    >>> linkage.render(Outlet(), rotor).object.p.tolist(), linkage.render(Outlet(), rotor).mode
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
        self._memory: Records = state_zeros(1, CLUTCH)  # updated in place in every tick
        self._object_wrench = np.zeros(6)
        self._scale = self._scale_goal = 1.0
        self._numbers = make_numbers("mode", "engaged", "t", "scale", "scale_goal")
        self.restart()

    def state_arrays(self) -> Mapping[str, StateArray]:
        """Clutch; mode, from 0; whether it is commanded to engage; time [s] of the rotor's last state; torque
        scales."""
        return {"clutch": self._memory, "choices": self._numbers[0]}

    def gather_state(self) -> None:
        """Copy mode, clutch command and scales into the state arrays."""
        cells = self._numbers[1]
        cells[0], cells[1], cells[2] = MODES.index(self._mode), self._engaged, self._t
        cells[3], cells[4] = self._scale, self._scale_goal

    def apply_state(self) -> None:
        """Restore mode, clutch command and scales from the state arrays."""
        mode, engaged, self._t, scale, goal = self._numbers[1]
        if not (0.0 < scale < math.inf and 0.0 < goal < math.inf):
            raise ValueError(f"{scale!r} and {goal!r} are no torque scales")
        self._mode, self._engaged = MODES[choose(mode, len(MODES))], bool(engaged)
        self._scale, self._scale_goal = scale, goal

    def restart(self) -> None:
        """Reset the object to its initial pose with the clutch released; mode and clutch command are preserved."""
        memory = self._memory
        memory[:] = np.zeros(1, dtype=CLUTCH)
        for name in ("translate", "rotate", "translate_torque", "rotate_torque"):
            memory[name] = getattr(self.gains, name)
        memory["ramp"], memory["gap"] = self.ramp, self.gap
        memory["position"], memory["attitude"] = self._begin
        self._t = -math.inf  # of the rotor's last state [s]: after such a gap the clutch begins released
        self._aim()

    def render(self, world: WrenchSource, mover: State) -> RenderedWrench:
        """Advance the clutch to `mover`, evaluate `world` at the object, and return its wrench as torque.

        Raises InputError for a rotor tilted beyond ±80°, and for an invalid wrench of the world.
        """
        memory, t = self._memory, mover.t
        R, pose, share = ascontiguousarray(mover.R_SR), np.empty((6, 3)), np.empty(2)
        if not follow_rotor(memory, R, ascontiguousarray(mover.w), t - self._t, pose, share):
            raise _explain_loss(R)
        if self._scale != self._scale_goal and self._t > -math.inf:
            self._slide_scale(t - self._t)
        self._t = t
        body = State(t, pose[:3], pose[3], pose[4], pose[5])
        # Not `isinstance(world, ContactWorld)`: of an abstract class that costs 0.4 µs in every tick.
        render_contacts = getattr(world, "render_contacts", None)
        if render_contacts is None:
            object_wrench, contacts = world.wrench(body), NO_CONTACTS
        else:
            object_wrench, contacts = render_contacts(body)
            contacts = ascontiguousarray(contacts, _FLOAT)  # for the kernel that fills the row
            if contacts.ndim != 2 or contacts.shape[1] != 8:
                raise InputError(f"a world must give contacts of shape (n, 8); got shape {contacts.shape}")
        if (object_wrench.shape if isinstance(object_wrench, np.ndarray) else np.shape(object_wrench)) != (6,):
            raise InputError(f"a world must give force and torque, shape (6,); got {quote(object_wrench)}")
        known, wrench = self._object_wrench, np.empty(6)
        known[:] = object_wrench  # a user's array of another memory layout would compile the kernel once more
        fill_rotor_wrench(memory, known, self._scale, wrench)
        return RenderedWrench(wrench, body, object_wrench, contacts, _NUMBERS[self._mode], share, self._engaged)

    def fill_mover_wrench(self, object_wrench: Array, wrench: Array) -> None:
        """Fill `wrench` (6,) with the torque for `object_wrench` (6,), a part of the object's wrench [N, N·m]."""
        fill_rotor_wrench(self._memory, object_wrench, self._scale, wrench)

    def set_mode(self, mode: Mode) -> None:
        """Change to `mode` from the next tick on, with a smooth transition."""
        if mode not in MODES:
            raise UnknownName("mode", str(mode), MODES)
        self._mode = mode
        self._aim()

    def set_clutch(self, engaged: bool) -> None:
        """Engage or release the clutch from the next tick on."""
        self._engaged = bool(engaged)
        self._aim()

    def set_torque_scale(self, scale: float) -> None:
        """From the next tick on, ramp all torques to `scale` times those of the gains.

        Raises InputError for a scale that is not above 0.
        """
        if not (math.isfinite(scale) and scale > 0.0):
            raise InputError(f"torque scale must be above 0; got {scale!r}")
        self._scale_goal = float(scale)

    def _aim(self) -> None:
        """Set the aimed engagement of each mode."""
        self._memory["moving_goal"] = self._engaged and self._mode == "translate"
        self._memory["turning_goal"] = self._engaged and self._mode == "rotate"

    def _slide_scale(self, elapsed: float) -> None:
        step = min(max(elapsed, 0.0), self.gap) / _SCALE_TIME_CONSTANT_S
        way = math.log(self._scale_goal / self._scale)
        self._scale = self._scale_goal if abs(way) <= step else self._scale * math.exp(math.copysign(step, way))


def _explain_loss(R: Array) -> InputError:
    """InputError for a rotor orientation R (3, 3) that no object can follow."""
    return InputError(
        f"the rotor is tilted beyond λ = ±{math.degrees(STEEPEST):.0f}°, or its orientation is unknown "
        f"(R_SR[0, 2] = {R[0, 2]:.4g}): the two-mode mapping is not defined there. Turn it back"
    )


@make_linkage.register(SphericalMotor)
def _(device: SphericalMotor, gains: Gains | None = None) -> ModedLinkage:
    """Linkage of a motor, whose handle moves an object through two modes; MOTOR_GAINS by default."""
    return ModedLinkage(gains or MOTOR_GAINS, arm=device.rotor.handle_length)


@find_object_limits.register
def _(device: SphericalMotor) -> tuple[float, float]:
    """Limits of the wrench on the object, in modes translate and rotate, that stay within the rotor's torque."""
    moving, turning = MOTOR_GAINS.torques
    return device.limits.torque / max(moving), device.limits.torque / max(turning)
