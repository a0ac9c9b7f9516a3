"""What a spherical motor can do over its workspace: torque about each axis, condition, heat, and who carries it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.control.allocation.bounded_power import solve_bounded_power
from haptorb.control.allocation.minimum_power import minimum_power_currents
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import DeviceError, InputError
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.numerics.rotations import rotation_from_euler

__all__ = ["MotorCapability", "motor_capability"]


@dataclass(frozen=True)
class MotorCapability:
    """Over a grid of tilts (ψ, λ), the worst spin φ each; axes are the stator's X, Y, Z.

    tilts        (t,) [rad] values of ψ and of λ
    spins        number of φ looked at per tilt
    peak         (t, t, 3) torque about each axis alone, currents at their limits [N·m]
    continuous   (t, t, 3) the same with continuous currents [N·m]
    condition    (t, t) greatest over smallest singular value of the channels' torque characteristic
    weakest      (t, t) smallest singular value [N·m/A]
    power        (t, t, 3) least heat for a torque about each axis, at the reference temperature [W/(N·m)²]
    shares       (3, m) share of every channel in that heat, mean over the workspace
    """

    tilts: Array
    spins: int
    peak: Array
    continuous: Array
    condition: Array
    weakest: Array
    power: Array
    shares: Array


def motor_capability(motor: SphericalMotor, tilts: int = 9, spins: int = 40, model: str = "table") -> MotorCapability:
    """The capability of `motor` over its workspace, at `model`. Raises DeviceError if it cannot turn everywhere."""
    if tilts < 2 or spins < 1:
        raise InputError(f"at least 2 tilts and 1 spin are needed; got {tilts} and {spins}")
    edge = np.linspace(-motor.workspace_tilt, motor.workspace_tilt, tilts)
    psi, lam, phi = np.meshgrid(edge, edge, 2 * np.pi * np.arange(spins) / spins, indexing="ij")
    R = rotation_from_euler(psi.ravel(), lam.ravel(), phi.ravel())
    single = motor.torque_characteristic(R, model)
    K = single @ motor.groups
    values = np.linalg.svd(K, compute_uv=False)
    if not (values[:, 2] > 1e-6 * np.abs(single).max()).all():
        raise DeviceError(f"device '{motor.name}': cannot produce torque about every axis everywhere in the workspace")
    grid = (tilts, tilts, spins)
    # what the supply cannot drive is no peak either
    most = np.minimum(motor.coils.current_limit, motor.supply.voltage / motor.coils.resistance)
    lasting = np.minimum(motor.sustained_current, most)
    heat = np.stack([_heat(K, motor.coils.resistance, axis) for axis in range(3)], axis=1)  # (n, 3, m)
    whole = heat.sum(axis=2)
    return MotorCapability(
        tilts=edge,
        spins=spins,
        peak=_torques(K, most).reshape(*grid, 3).min(axis=2),
        continuous=_torques(K, lasting).reshape(*grid, 3).min(axis=2),
        condition=(values[:, 0] / values[:, 2]).reshape(grid).max(axis=2),
        weakest=values[:, 2].reshape(grid).min(axis=2),
        power=whole.reshape(*grid, 3).max(axis=2),
        shares=(heat / whole[:, :, None]).mean(axis=0),
    )


def _heat(K: Array, resistance: Array, axis: int) -> Array:
    """(n, m) heat of every channel [W] for 1 N·m about `axis`, by Bai 2012 eq. (4)."""
    currents = minimum_power_currents(K / np.sqrt(resistance), np.eye(3)[axis])
    heat: Array = currents**2
    return heat


def _torques(K: Array, limit: Array) -> Array:
    out = np.empty((len(K), 3))
    _greatest(np.ascontiguousarray(K), np.ascontiguousarray(limit), out)
    return out


@kernel
def _greatest(K: Array, limit: Array, out: Array) -> None:
    """out (n, 3): greatest torque about each axis with the other two zero, from the scale of one that is too great."""
    m = K.shape[2]
    currents = np.empty(m)
    alike = np.ones(m)
    for n in range(K.shape[0]):
        for axis in range(3):
            asked = 1e-6
            for j in range(m):
                asked += 2.0 * abs(K[n, axis, j]) * limit[j]
            torque = np.zeros(3)
            torque[axis] = asked
            _, scale = solve_bounded_power(K[n], torque, limit, alike, False, currents)
            out[n, axis] = scale * asked
