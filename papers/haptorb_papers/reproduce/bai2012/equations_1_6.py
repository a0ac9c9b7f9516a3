"""Bai 2012, eqs. (1) to (6): torque linear in the currents, minimum power, and the two modes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from haptorb.arrays import Array
from haptorb.control.allocation import MinimumPowerAllocator
from haptorb.control.linkage import MODES, Gains, Mode, ModedLinkage
from haptorb.devices.api import motor, torque_characteristic
from haptorb.devices.base import State, WrenchMap
from haptorb.devices.motor import SphericalMotor
from haptorb.magnetics.magnets import ChargedRing
from haptorb.rotations import rotation_from_euler
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Report

__all__ = ["items"]

_AT = Citation("bai2012", "eq", "eqs. (1)–(6)")
_GAINS = Gains(  # all different, so that no two can be taken for each other
    translate=(0.02, 0.03, 0.05),
    rotate=(0.3, 0.5, 0.7),
    translate_torque=(0.011, 0.013, 0.017),
    rotate_torque=(0.19, 0.23, 0.29),
)
_TURN = 0.01  #: [rad]
_DIAGONAL = math.radians(22.5)  #: of ψ and λ, in the corner of the working space


def items(report: Report) -> tuple[tuple[Item, ...], None]:
    """Linearity against an independent sum over magnetic charges, the least-power inverse, and all twelve gains."""
    device = motor("pmsm")
    R = rotation_from_euler(*np.radians((10.0, 5.0, 5.0)))
    K = torque_characteristic(device, R)
    grouped = torque_characteristic(device, R, grouped=True)
    currents = np.random.default_rng(1).normal(size=device.channels)
    by_charges = _torque_on_charges(device, R, currents)
    report(0.6)
    wanted = np.array([0.05, -0.1, 0.08])
    by_equation = K.T @ np.linalg.solve(K @ K.T, wanted)  # Eq. (4)
    least = MinimumPowerAllocator(np.full(24, 1e3)).allocate(
        WrenchMap(np.vstack([np.zeros((3, 24)), K]), np.zeros(6)), np.concatenate([np.zeros(3), wanted])
    )
    u = least.currents
    found = [
        _AT.assume("1-cone", "motion of the rotor's axis while only φ changes", 0.0, _axis_spread(), "1", 1e-12,
                   "XYZ is read as intrinsic angles so that this is true, as the working space requires",
                   where="eq. (1)"),
        _AT.claim("2-linear", "torque by (2) against the force of all coils at once on the magnets' charges, relative",
                 0.0, np.linalg.norm(grouped @ currents - by_charges) / np.linalg.norm(by_charges), "1", 1e-4,
                 "the sum over charges is converged to that", where="eq. (2)"),
        _AT.claim("4-torque", "torque of the allocator's currents against the wanted one, relative", 0.0,
                 np.linalg.norm(K @ u - wanted) / np.linalg.norm(wanted), "1", 1e-12, where="eq. (4)"),
        _AT.claim("4-least", "power of the allocator's currents over that of (4), the minimum", 1.0,
                 (u**2).sum() / (by_equation**2).sum(), "1", 1e-9, where="eq. (4)"),
        *_motions(),
        *_torques(),
        _AT.claim("6-power", "(6b): power lost between handle and target with η̂₁ = ζ̂₂, η̂₂ = ζ̂₁, η̂₃ = ζ̂₃, relative", 0.0,
                 _find_imbalance(), "1", 1e-12, erratum="E6", where="eq. (6b)"),
        _AT.claim("6-text", "power at the handle over power at the target by the text's 'T_ψ (due to F_X') and T_λ "
                 "(due to F_Y')', F_X' = F_Y', λ alone moves, ζ̂₁ = 0.4, ζ̂₂ = 0.7", 1.0, _find_power_by_text(), "1",
                 1e-12, "λ moves X' by (6a), and the text has F_Y' act on it: η̂₁ = ζ̂₂ stands where ζ̂₁ must",
                 erratum="E6", corrected=0.7 / 0.4, where="§3.2"),
        *(
            _AT.claim(f"6-cartesian-{name}", f"power at the handle over power at the target if T_{sign} of (6b) is "
                      f"taken as the {axis} component of the torque of (2) and (9): ψ = λ = 22.5°, {sign} alone moves",
                      1.0, _take_as_cartesian(n), "1", 1e-6, "T_ψ, T_λ, T_φ do work on the Euler rates, whose axes "
                      "are not the stator's", erratum="E6", corrected=share, where="eqs. (2), (9), (6b)")
            for n, name, sign, axis, share in (
                (1, "lambda", "λ", "Y", math.cos(_DIAGONAL)), (2, "phi", "φ", "Z", math.cos(_DIAGONAL) ** 2))
        ),
        _AT.item("6-six", "independent motions of the target in the two modes", 6, _count_freedoms(), where="§2.1"),
    ]  # fmt: skip
    report(1.0)
    return tuple(found), None


def _axis_spread() -> float:
    axes = rotation_from_euler(0.3, 0.2, np.linspace(0, 6.0, 20))[:, :, 2]
    return float(np.ptp(axes, axis=0).max())


def _torque_on_charges(device: SphericalMotor, R: Array, currents: Array) -> Array:
    """(3,) [N·m] of the coils' field on the charges that the magnets' end faces are: another way than K takes."""
    magnet = device.magnet
    faces = ChargedRing(magnet.radius, 0.0, magnet.length, magnet.polarization, radial=10, azimuth=32)
    frames = R @ device.magnets.frames
    at = faces.points @ np.swapaxes(frames, 1, 2) + (device.magnets.positions @ R.T)[:, None]
    q = np.outer(device.polarity, faces.charges).ravel()
    at = at.reshape(-1, 3)
    torque: Array = np.cross(at, q[:, None] * device.coil_field(at, currents)).sum(axis=0)
    return torque


def _state(t: float, psi: float = 0.0, lam: float = 0.0, phi: float = 0.0) -> State:
    return State(t, rotation_from_euler(psi, lam, phi), np.zeros(3), np.zeros(3), np.zeros(3))


@dataclass(frozen=True)
class _ConstantWrench:
    value: Array  #: (6,) on the target [N, N·m]

    def wrench(self, state: State) -> Array:
        return self.value


_FREE = _ConstantWrench(np.zeros(6))


def _engage(gains: Gains, mode: Mode) -> ModedLinkage:
    """A linkage whose clutch has joined the upright rotor to the target in `mode`."""
    linkage = ModedLinkage(gains)
    linkage.set_mode(mode)
    for k in range(9):
        linkage.render(_FREE, _state(0.04 * k))
    return linkage


def _turn_handle(gains: Gains, mode: Mode, axis: int) -> Array:
    """(6,) motion of the target, X'Y'Z'ψ'λ'φ', per radian of ψ, λ or φ (axis 0, 1, 2)."""
    angles = [0.0, 0.0, 0.0]
    angles[axis] = _TURN
    target = _engage(gains, mode).render(_FREE, _state(0.33, *angles)).object
    R = target.R_SR
    attitude = math.atan2(-R[1, 2], R[2, 2]), math.asin(R[0, 2]), math.atan2(-R[0, 1], R[0, 0])
    return np.array([*target.p, *attitude]) / _TURN


def _find_torque(gains: Gains, mode: Mode, wrench: Array) -> Array:
    """(3,) torque on the upright rotor [N·m] for `wrench` (6,) on the target."""
    return _engage(gains, mode).render(_ConstantWrench(wrench), _state(0.33)).wrench[3:]


def _motions() -> list[Item]:
    psi, lam, phi = 0, 1, 2
    rows: tuple[tuple[str, Mode, int, int, str, float], ...] = (
        ("5a-lambda", "rotate", lam, 4, "ζ₁ of λ' = ζ₁ λ", 0.3), ("5a-psi", "rotate", psi, 3, "ζ₂ of ψ' = ζ₂ ψ", 0.5),
        ("5a-phi", "rotate", phi, 5, "ζ₃ of φ' = ζ₃ φ", 0.7),
        ("6a-x", "translate", lam, 0, "ζ̂₁ of X' = ζ̂₁ λ [m/rad]", 0.02),
        ("6a-y", "translate", psi, 1, "ζ̂₂ of Y' = ζ̂₂ ψ [m/rad]", 0.03),
        ("6a-z", "translate", phi, 2, "ζ̂₃ of Z' = ζ̂₃ φ [m/rad]", 0.05),
    )  # fmt: skip
    return [
        _AT.set_and_find(name, f"{what}, by turning the rotor", gain, _turn_handle(_GAINS, mode, axis)[row], "1",
                 1e-9, where=f"eq. ({name[:2]})")
        for name, mode, axis, row, what, gain in rows
    ]  # fmt: skip


def _torques() -> list[Item]:
    rows: tuple[tuple[str, Mode, int, int, str, float], ...] = (
        ("5b-psi", "rotate", 3, 0, "η₁ of T_ψ = η₁ T_ψ'", 0.19),
        ("5b-lambda", "rotate", 4, 1, "η₂ of T_λ = η₂ T_λ'", 0.23),
        ("5b-phi", "rotate", 5, 2, "η₃ of T_φ = η₃ T_φ'", 0.29),
        ("6b-psi", "translate", 1, 0, "η̂₁ of T_ψ = η̂₁ F_Y' [m]", 0.011),
        ("6b-lambda", "translate", 0, 1, "η̂₂ of T_λ = η̂₂ F_X' [m]", 0.013),
        ("6b-phi", "translate", 2, 2, "η̂₃ of T_φ = η̂₃ F_Z' [m]", 0.017),
    )  # fmt: skip
    return [
        _AT.set_and_find(name, what, gain, _find_torque(_GAINS, mode, np.eye(6)[component])[axis],
                 "1", 1e-9, where=f"eq. ({name[:2]})", erratum="E6" if name[:2] == "6b" and axis < 2 else "")
        for name, mode, component, axis, what, gain in rows
    ]  # fmt: skip


_UNLIKE = Gains(translate=(0.4, 0.7, 0.2))


def _find_power_by_text() -> float:
    """Power at the handle over power at the target: F_X' = F_Y', λ alone moves, and the torques in the text's order."""
    force = np.array([1.0, 1.0, 0.0])
    target = float(force @ (_turn_handle(_UNLIKE, "translate", 1)[:3]))
    torque = _find_torque(_UNLIKE, "translate", np.concatenate([force, np.zeros(3)]))[[1, 0, 2]]
    return float(torque[1]) / target


def _take_as_cartesian(axis: int) -> float:
    """Power at the handle over power at the target where ψ = λ = 22.5° and λ or φ (`axis` 1, 2) alone moves.

    The library's torque on the rotor gives the generalised force of that angle; the same number about Y or Z of the
    stator is what the print takes.
    """
    linkage = _engage(Gains(), "translate")
    wrench = np.zeros(6)
    wrench[0 if axis == 1 else 2] = 1.0
    angles = np.array([_DIAGONAL, _DIAGONAL, 0.2])
    torque = linkage.render(_ConstantWrench(wrench), _state(0.33, *angles)).wrench[3:]
    step = 1e-6 * np.eye(3)[axis]
    turn = (rotation_from_euler(*(angles + step)) - rotation_from_euler(*(angles - step))) / 2e-6
    spin = turn @ rotation_from_euler(*angles).T
    rate = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])  # angular velocity per unit of that Euler rate
    generalised = float(torque @ rate)
    return generalised * float(rate[axis]) / (Gains().translate[0 if axis == 1 else 2] * 1.0)


def _find_imbalance() -> float:
    """Greatest |T·q̇ − F·v'| over |F·v'| with gains that the library calls power-consistent, upright rotor."""
    rng, worst = np.random.default_rng(6), 0.0
    for force, rates in zip(rng.normal(size=(20, 3)), rng.normal(size=(20, 3)), strict=True):
        torque = _find_torque(_UNLIKE, "translate", np.concatenate([force, np.zeros(3)]))
        power = force @ (np.array([0.4, 0.7, 0.2]) * rates[[1, 0, 2]])  # X' from λ, Y' from ψ, Z' from φ
        worst = max(worst, abs(float(torque @ rates - power)) / abs(float(power)))
    return worst


def _count_freedoms() -> int:
    motions = [_turn_handle(_GAINS, mode, axis) for mode in MODES for axis in range(3)]
    return int(np.linalg.matrix_rank(motions))
