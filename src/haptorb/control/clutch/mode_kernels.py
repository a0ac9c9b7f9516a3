"""The mapping of eqs. (5) and (6) in compiled code: rotor to target in one pass, and the target's wrench back.

What is remembered is one array, memory (6, 3): shares of translation and rotation, rotor angles ψ, λ, φ [rad], their
rates [rad/s], the target's position [m] and its attitude ψ', λ', φ' [rad], and the shares to which the clutch slides.
settings (5, 3): ζ̂, ζ, η̂, η as `Gains` has them, then gap [s] and ramp [s] of `TwoModes`.
"""

from __future__ import annotations

import math

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = [
    "ANGLES",
    "ATTITUDE",
    "GOAL",
    "POSITION",
    "RATES",
    "SHARE",
    "STEEPEST",
    "advance_clutch",
    "fill_rotor_wrench",
    "fill_target_pose",
    "follow_rotor",
]

SHARE, ANGLES, RATES, POSITION, ATTITUDE, GOAL = range(6)
STEEPEST = math.radians(80.0)  #: tilt λ at which Euler angles come too close to their pole, for rotor and target
_HIGHEST = math.sin(STEEPEST)
_TURN = 2.0 * math.pi


@kernel
def _free(attitude: float, rate: float, gain: float) -> float:
    """0 while the target leans against the pole of its Euler angles (λ', λ's rate, ζ₁), else 1."""
    return 0.0 if abs(attitude) >= STEEPEST and attitude * rate * gain > 0.0 else 1.0


@kernel
def _nearest(angle: float, near: float) -> float:
    """`angle` and some whole turns [rad], so that it is nearest to `near`."""
    return angle + _TURN * round((near - angle) / _TURN)


@kernel
def advance_clutch(R: Array, w: Array, dt: float, settings: Array, memory: Array) -> bool:
    """Bring `memory` to the rotor at R (3, 3), turning with w (3,) [rad/s], `dt` [s] later; the target follows.

    False, and nothing changed, where the rotor is tilted beyond STEEPEST or nowhere.
    """
    if not abs(R[0, 2]) < _HIGHEST:  # also catches NaN
        return False
    share, angles, rates = memory[SHARE], memory[ANGLES], memory[RATES]
    position, attitude, goal = memory[POSITION], memory[ATTITUDE], memory[GOAL]
    psi = _nearest(math.atan2(-R[1, 2], R[2, 2]), angles[0])
    lam = math.asin(min(1.0, max(-1.0, R[0, 2])))
    phi = _nearest(math.atan2(-R[0, 1], R[0, 0]), angles[2])
    lost = not dt <= settings[4, 0]
    move, turn = (0.0, 0.0) if lost else (share[0], share[1])
    free = _free(attitude[1], rates[1], settings[1, 0])
    dpsi, dlam, dphi = psi - angles[0], lam - angles[1], phi - angles[2]
    position[0] += move * settings[0, 0] * dlam  # Eq. (6a)
    position[1] += move * settings[0, 1] * dpsi
    position[2] += move * settings[0, 2] * dphi
    attitude[0] += turn * settings[1, 1] * dpsi  # Eq. (5a)
    attitude[1] += turn * settings[1, 0] * dlam * free
    attitude[2] += turn * settings[1, 2] * dphi
    angles[0], angles[1], angles[2] = psi, lam, phi
    c, s = math.cos(psi), math.sin(psi)
    rates[1] = c * w[1] + s * w[2]
    rates[2] = (c * w[2] - s * w[1]) / math.cos(lam)
    rates[0] = w[0] - math.sin(lam) * rates[2]
    step = max(dt, 0.0) / settings[4, 1]
    for i in range(2):
        if lost:
            share[i] = 0.0
        elif share[i] < goal[i]:
            share[i] = min(share[i] + step, goal[i])
        else:
            share[i] = max(share[i] - step, goal[i])
    return True


@kernel
def fill_target_pose(settings: Array, memory: Array, pose: Array) -> None:
    """Fill pose (6, 3): R' (3, 3), position [m], w' [rad/s] and v' [m/s] of the target, primed frame."""
    share, rates, attitude = memory[SHARE], memory[RATES], memory[ATTITUDE]
    cp, sp = math.cos(attitude[0]), math.sin(attitude[0])
    cl, sl = math.cos(attitude[1]), math.sin(attitude[1])
    cf, sf = math.cos(attitude[2]), math.sin(attitude[2])
    pose[0, 0], pose[0, 1], pose[0, 2] = cl * cf, -cl * sf, sl
    pose[1, 0], pose[1, 1], pose[1, 2] = cp * sf + sp * sl * cf, cp * cf - sp * sl * sf, -sp * cl
    pose[2, 0], pose[2, 1], pose[2, 2] = sp * sf - cp * sl * cf, sp * cf + cp * sl * sf, cp * cl
    for i in range(3):
        pose[3, i] = memory[POSITION, i]
    dp = share[1] * settings[1, 1] * rates[0]
    dl = share[1] * settings[1, 0] * rates[1] * _free(attitude[1], rates[1], settings[1, 0])
    df = share[1] * settings[1, 2] * rates[2]
    pose[4, 0] = dp + sl * df
    pose[4, 1] = cp * dl - sp * cl * df
    pose[4, 2] = sp * dl + cp * cl * df
    pose[5, 0] = share[0] * settings[0, 0] * rates[1]
    pose[5, 1] = share[0] * settings[0, 1] * rates[0]
    pose[5, 2] = share[0] * settings[0, 2] * rates[2]


@kernel
def follow_rotor(R: Array, w: Array, dt: float, settings: Array, memory: Array, pose: Array) -> bool:
    """`advance_clutch` and `fill_target_pose` at once; pose (7, 3) ends with the shares."""
    if not advance_clutch(R, w, dt, settings, memory):
        return False
    fill_target_pose(settings, memory, pose)
    for i in range(3):
        pose[6, i] = memory[SHARE, i]
    return True


@kernel
def fill_rotor_wrench(settings: Array, memory: Array, wrench: Array, out: Array) -> None:
    """out (6,): no force, and the torque [N·m] on the rotor, stator frame, for the target's wrench (6,) [N, N·m]."""
    share, q, rates, attitude = memory[SHARE], memory[ANGLES], memory[RATES], memory[ATTITUDE]
    c, s = math.cos(attitude[0]), math.sin(attitude[0])
    cl, sl = math.cos(attitude[1]), math.sin(attitude[1])
    # the target's torque along its Euler axes: Jᵀ T'
    T_psi = wrench[3]
    T_lam = (c * wrench[4] + s * wrench[5]) * _free(attitude[1], rates[1], settings[1, 0])
    T_phi = sl * wrench[3] - s * cl * wrench[4] + c * cl * wrench[5]
    Q_psi = share[0] * settings[2, 0] * wrench[1] + share[1] * settings[3, 0] * T_psi  # Eqs. (6b), (5b)
    Q_lam = share[0] * settings[2, 1] * wrench[0] + share[1] * settings[3, 1] * T_lam
    Q_phi = share[0] * settings[2, 2] * wrench[2] + share[1] * settings[3, 2] * T_phi
    # the vector that has these components along the rotor's Euler axes: J⁻ᵀ Q
    c, s = math.cos(q[0]), math.sin(q[0])
    u = (Q_phi - math.sin(q[1]) * Q_psi) / math.cos(q[1])
    out[0], out[1], out[2] = 0.0, 0.0, 0.0
    out[3] = Q_psi
    out[4] = c * Q_lam - s * u
    out[5] = s * Q_lam + c * u
