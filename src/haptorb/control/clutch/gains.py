"""The constants of the two modes: how far the target moves, and how strongly its wrench is felt."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, check_finite

__all__ = ["MOTOR_GAINS", "Gains", "three"]


def three(value: ArrayLike, what: str) -> tuple[float, float, float]:
    """`value` as three finite numbers, or InputError naming `what`. Shape (3,). In the unit of `value`: [any]."""
    numbers = check_finite(value, what)
    if numbers.shape != (3,):
        raise InputError(f"{what} must be three numbers; got shape {numbers.shape}")
    return float(numbers[0]), float(numbers[1]), float(numbers[2])


@dataclass(frozen=True)
class Gains:
    """The constants of eqs. (5) and (6), indexed as printed.

    translate          ζ̂ [m/rad] of X', Y', Z' (by λ, ψ, φ)
    rotate             ζ of λ', ψ', φ'
    translate_torque   η̂ [m] of F_Y', F_X', F_Z' (to T_ψ, T_λ, T_φ); None: as power demands, η̂ = (ζ̂₂, ζ̂₁, ζ̂₃)
    rotate_torque      η of T_ψ', T_λ', T_φ'; None: η = (ζ₂, ζ₁, ζ₃)

    The defaults render the outlet (a pull of 11.5 N; tilted by 2° 64 N sideways and 1 N·m about the plug's end) on a
    motor of about 1 N·m: 0.23, 0.26 and 0.25 N·m, and at most 0.6 wherever the handle may go, unless the plug's bevel
    is forced aside. ±22.5° of handle move the plug by ±8 mm out (its whole way), ±1.6 mm sideways; 8° of spin tilt it
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
        """translate_torque and rotate_torque, filled in."""
        assert self.translate_torque is not None  # filled in by the constructor
        assert self.rotate_torque is not None
        return self.translate_torque, self.rotate_torque

    @property
    def torque_per_motion(self) -> Array:
        """(6,) torque gain over motion gain for X', Y', Z', λ', ψ', φ'; one number six times if passive."""
        motion = np.array([*self.translate, *self.rotate])
        (psi, lam, phi), (turn_psi, turn_lam, turn_phi) = self.torques
        torque = np.array([lam, psi, phi, turn_lam, turn_psi, turn_phi])
        ratio = np.full(6, np.nan)
        np.divide(torque, motion, out=ratio, where=motion != 0)
        ratio[(motion == 0) & (torque != 0)] = np.inf
        return ratio

    @property
    def verdict(self) -> str:
        """ "power-consistent"; "scaled": all torques by one factor, still passive; or "active": can give energy.

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


#: 40° of handle, which a hand can sweep within the workspace, pull the plug all the way out; else the defaults
MOTOR_GAINS = Gains(translate=(0.024, 0.004, 0.01))
