"""Torque of a spherical motor, and the heat that it takes, in the worst direction and orientation in the workspace.

All are of the exact level: the torque of one magnet and one coil comes from zonal harmonics (`series_table`) or, where
those do not hold, from the exact table. Of a zonotope {K i, |i| ≤ I} the greatest ball has the radius
min over the facets' normals n of Σ |n·K_k| I_k, and every normal is a product of two columns of K.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from haptorb.design.candidate import DesignCandidate
from haptorb.design.objectives.orientations import find_worst, spread_angles
from haptorb.design.objectives.registry import describe, option
from haptorb.devices.device import require
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.devices.tables import table_kernels
from haptorb.devices.tables.pair_table import PairTable
from haptorb.devices.tables.series_table import series_torque_table
from haptorb.devices.tables.table_cache import load_torque_table
from haptorb.errors import GeometryError
from haptorb.numerics.arrays import Array
from haptorb.numerics.rotations import rotation_from_euler
from haptorb.physics.sources.coil import Coil
from haptorb.physics.sources.cylinder import CylinderMagnet

__all__ = ["QUANTITIES", "find_heaviest", "motor_of", "torque_per_ampere"]

_ORIENTATIONS = 400
_MOTOR = "spherical-motor"


def motor_of(candidate: DesignCandidate) -> SphericalMotor:
    """The candidate's device; InputError if it is no spherical motor."""
    return require(candidate.device, SphericalMotor, "this quantity")


def torque_per_ampere(candidate: DesignCandidate) -> Callable[[Array], Array]:
    """(n, 3, 3) orientations → (n, 3, m) [N·m/A] torque on the rotor per ampere in every channel."""
    motor = motor_of(candidate)
    magnet, coil = motor.magnet, motor.electromagnet
    table = _pair_table(
        (magnet.radius, magnet.length, magnet.polarization), motor.magnets.distance,
        (coil.turns, coil.inner_radius, coil.outer_radius, coil.length), motor.electromagnets.distance,
    )  # fmt: skip
    coils = motor.electromagnets.directions

    def compute(R: Array) -> Array:
        single = np.empty((len(R), 3, len(coils)))
        table_kernels.torque_characteristic(
            table.cells, table.scale, motor.magnets.directions, motor.polarity, coils, R, single
        )
        grouped: Array = single @ motor.groups
        return grouped

    return compute


@lru_cache(maxsize=32)
def _pair_table(
    magnet_sizes: tuple[float, float, float], magnet_distance: float,
    coil_sizes: tuple[float, float, float, float], coil_distance: float,
) -> PairTable:  # fmt: skip
    magnet, coil = CylinderMagnet(*magnet_sizes), Coil(*coil_sizes)
    try:
        return series_torque_table(magnet, magnet_distance, coil, coil_distance)
    except GeometryError:  # a rotor inside its stator
        return load_torque_table(magnet, magnet_distance, coil, coil_distance)


def find_heaviest(candidate: DesignCandidate) -> tuple[float, Array]:
    """Greatest heat for a torque [W/(N·m)²] at the reference temperature, and the squares (m,) of the currents
    [A²/(N·m)²] that make it: in the worst direction and orientation, by Bai 2012 eq. (4)."""

    def compute() -> tuple[float, Array]:
        motor, torque = motor_of(candidate), torque_per_ampere(candidate)
        root = np.sqrt(motor.coils.resistance)

        def ease(R: Array) -> Array:
            K = torque(R) / root
            least: Array = np.linalg.eigvalsh(K @ K.transpose(0, 2, 1))[:, 0].astype(np.float64)
            return least

        least, angles = find_worst(ease, motor.workspace_tilt, _count(candidate))
        K = torque(np.ascontiguousarray(rotation_from_euler(*angles)[None]))[0] / root
        values, axes = np.linalg.eigh(K @ K.T)
        currents = K.T @ axes[:, 0] / max(values[0], 1e-300) / root
        return (1.0 / least if least > 0 else np.inf), currents**2

    return candidate.share("motor: worst heat", compute)


def _heat(candidate: DesignCandidate) -> float:
    return find_heaviest(candidate)[0]


def _peak(candidate: DesignCandidate) -> float:
    return _ball(candidate, motor_of(candidate).driven_current)


def _continuous(candidate: DesignCandidate) -> float:
    motor = motor_of(candidate)
    return _ball(candidate, np.minimum(motor.sustained_current_together, motor.driven_current))


def _ball(candidate: DesignCandidate, limit: Array) -> float:
    torque = torque_per_ampere(candidate)
    first, second = np.triu_indices(len(limit), 1)

    def radius(R: Array) -> Array:
        K = torque(R) * limit
        normals: Array = np.cross(K[:, :, first], K[:, :, second], axis=1)
        reach = np.abs(normals.transpose(0, 2, 1) @ K).sum(axis=2)
        size = np.linalg.norm(normals, axis=1)
        ratio = np.divide(reach, size, out=np.full_like(reach, np.inf), where=size > 1e-12 * size.max())
        least: Array = ratio.min(axis=1)
        return least

    return find_worst(radius, motor_of(candidate).workspace_tilt, _count(candidate))[0]


def _isotropy(candidate: DesignCandidate) -> float:
    torque = torque_per_ampere(candidate)

    def ratio(R: Array) -> Array:
        values = np.linalg.svd(torque(R), compute_uv=False)
        least: Array = values[:, 2] / values[:, 0]
        return least

    return find_worst(ratio, motor_of(candidate).workspace_tilt, _count(candidate))[0]


def _cogging(candidate: DesignCandidate) -> float:
    motor = motor_of(candidate)
    tilts = np.arccos(np.cos(np.linspace(0, motor.workspace_tilt, 24)) ** 2)  # tilts of ψ and λ add up
    turns = rotation_from_euler(tilts, np.zeros_like(tilts), np.zeros_like(tilts))
    return max(float(np.linalg.norm(motor.passive(R)[3:])) for R in turns)


def _model_error(candidate: DesignCandidate) -> float:
    motor, torque = motor_of(candidate), torque_per_ampere(candidate)
    angles = spread_angles(motor.workspace_tilt, _count(candidate))
    R = np.ascontiguousarray(rotation_from_euler(angles[:, 0], angles[:, 1], angles[:, 2]))
    exact = torque(R)
    other = motor.torque_characteristic(R, "dipole") @ motor.groups
    return float(np.linalg.norm(other - exact, axis=1).max() / np.linalg.norm(exact, axis=1).max())


def _count(candidate: DesignCandidate) -> int:
    return int(option(candidate, "orientations", _ORIENTATIONS))


_OVER = "in the worst direction and orientation in the workspace"
QUANTITIES = (
    describe("heat_per_torque_squared", "W/(N·m)²", "minimise",
             f"Smallest heat for a torque, divided by its square, {_OVER}; coils at their reference temperature.",
             {_MOTOR: _heat}),
    describe("peak_torque", "N·m", "maximise", f"Torque at full current available in every direction, {_OVER}.",
             {_MOTOR: _peak}),
    describe("continuous_torque", "N·m", "maximise",
             f"Continuous torque in all channels, {_OVER}.", {_MOTOR: _continuous}),
    describe("torque_isotropy", "", "maximise",
             "Ratio of smallest to largest torque per ampere over all directions, in the worst orientation.",
             {_MOTOR: _isotropy}),
    describe("cogging", "N·m", "minimise",
             "Largest torque on the rotor without current over the workspace: the remainder of weight and "
             "regulator.", {_MOTOR: _cogging}),
    describe("torque_model_error", "", "minimise",
             "Largest error of a channel's torque by the dipole model over the workspace, relative to the largest "
             "torque per ampere.", {_MOTOR: _model_error}),
)  # fmt: skip
