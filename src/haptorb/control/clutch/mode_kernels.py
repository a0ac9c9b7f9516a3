"""The mapping of eqs. (5) and (6) in compiled code: rotor to target in one pass, and the target's wrench back.

What is remembered, and the constants that the mapping goes by, are one record of `CLUTCH`, in an array of one.
"""

from __future__ import annotations

import math

from haptorb.numerics.arrays import Array, Records, fields
from haptorb.numerics.compiled import kernel, tick_kernel

__all__ = ["CLUTCH", "STEEPEST", "advance_clutch", "fill_rotor_wrench", "follow_rotor"]

STEEPEST = math.radians(80.0)  #: tilt λ at which Euler angles come too close to their pole, for rotor and target
_HIGHEST = math.sin(STEEPEST)
_TURN = 2.0 * math.pi

CLUTCH = fields(
    # settings: the gains of `Gains`, as printed, and the times of `ModedLinkage`
    ("translate", "f8", (3,)),  # ζ̂ [m/rad] of X', Y', Z' (by λ, ψ, φ)
    ("rotate", "f8", (3,)),  # ζ of λ', ψ', φ'
    ("translate_torque", "f8", (3,)),  # η̂ [m] of F_Y', F_X', F_Z' (to T_ψ, T_λ, T_φ)
    ("rotate_torque", "f8", (3,)),  # η of T_ψ', T_λ', T_φ'
    ("gap", "f8"),  # [s]
    ("ramp", "f8"),  # [s]
    # remembered
    ("moving", "f8"),  # how firmly translation is joined now, 0 to 1
    ("turning", "f8"),  # how firmly rotation is joined now, 0 to 1
    ("moving_goal", "f8"),  # to which the first slides
    ("turning_goal", "f8"),  # to which the second slides
    ("angles", "f8", (3,)),  # of the rotor: ψ, λ, φ [rad], φ unwrapped
    ("rates", "f8", (3,)),  # their rates [rad/s]
    ("position", "f8", (3,)),  # of the target: X', Y', Z' [m]
    ("attitude", "f8", (3,)),  # of the target: ψ', λ', φ' [rad]
)


@kernel
def _free(attitude: float, rate: float, gain: float) -> float:
    """0 while the target leans against the pole of its Euler angles (λ', λ's rate, ζ₁), else 1."""
    return 0.0 if abs(attitude) >= STEEPEST and attitude * rate * gain > 0.0 else 1.0


@kernel
def _nearest(angle: float, near: float) -> float:
    """`angle` and some whole turns [rad], so that it is nearest to `near`."""
    return angle + _TURN * round((near - angle) / _TURN)


@kernel
def _slide(share: float, goal: float, step: float) -> float:
    return min(share + step, goal) if share < goal else max(share - step, goal)


@kernel
def advance_clutch(clutch: Records, R: Array, w: Array, dt: float) -> bool:
    """Bring `clutch`, (1,) CLUTCH, to the rotor at R (3, 3), turning with w (3,) [rad/s], `dt` [s] later; the target
    follows.

    False, and nothing changed, where the rotor is tilted beyond STEEPEST or nowhere.
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
    """Fill pose (6, 3): R' (3, 3), position [m], w' [rad/s] and v' [m/s] of the target, primed frame."""
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
    """`advance_clutch` and `_fill_target_pose` at once; share (2,): how firmly translation and rotation are joined."""
    if not advance_clutch(clutch, R, w, dt):
        return False
    _fill_target_pose(clutch, pose)
    share[0], share[1] = clutch[0].moving, clutch[0].turning
    return True


@tick_kernel
def fill_rotor_wrench(clutch: Records, wrench: Array, scale: float, out: Array) -> None:
    """out (6,): no force, and the torque [N·m] on the rotor, stator frame, for the target's wrench (6,) [N, N·m].

    scale: by how much stronger it comes back than the clutch's gains say.
    """
    m = clutch[0]
    q, rates, attitude, move, turn = m.angles, m.rates, m.attitude, m.translate_torque, m.rotate_torque
    c, s = math.cos(attitude[0]), math.sin(attitude[0])
    cl, sl = math.cos(attitude[1]), math.sin(attitude[1])
    # the target's torque along its Euler axes: Jᵀ T'
    T_psi = wrench[3]
    T_lam = (c * wrench[4] + s * wrench[5]) * _free(attitude[1], rates[1], m.rotate[0])
    T_phi = sl * wrench[3] - s * cl * wrench[4] + c * cl * wrench[5]
    Q_psi = m.moving * move[0] * wrench[1] + m.turning * turn[0] * T_psi  # Eqs. (6b), (5b)
    Q_lam = m.moving * move[1] * wrench[0] + m.turning * turn[1] * T_lam
    Q_phi = m.moving * move[2] * wrench[2] + m.turning * turn[2] * T_phi
    # the vector that has these components along the rotor's Euler axes: J⁻ᵀ Q
    c, s = math.cos(q[0]), math.sin(q[0])
    u = (Q_phi - math.sin(q[1]) * Q_psi) / math.cos(q[1])
    out[0], out[1], out[2] = 0.0, 0.0, 0.0
    out[3] = scale * Q_psi
    out[4] = scale * (c * Q_lam - s * u)
    out[5] = scale * (s * Q_lam + c * u)
