"""The same motor in other libraries, each by its fastest known method.

All peers get the winding as the same Gauss filaments and the same rotor; what differs is how the magnets' field comes
about. Each function gives torque on the rotor per coil (3, m) [N·m/A] or field at the sensors (k, 3) [T].
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.motor import SphericalMotor
from haptorb.magnetics.dipole import MU0

__all__ = ["Winding", "cfsem_field", "core_field", "getb_field", "getft_torque"]

Field = Callable[[Array], Array]  #: points (p, 3) → field (p, 3), stator frame


class Winding:
    """Every coil of a motor as `across` × `along` Gauss filaments of `around` elements I dl at one ampere."""

    def __init__(self, motor: SphericalMotor, across: int, along: int, around: int) -> None:
        radii, heights, turns = motor.electromagnet.filaments(across, along)
        angle = 2 * np.pi * (np.arange(around) + 0.5) / around
        rim = np.stack(
            [np.outer(radii, np.cos(angle)), np.outer(radii, np.sin(angle)), np.repeat(heights[:, None], around, 1)], -1
        ).reshape(-1, 3)
        step = (2 * np.pi / around * radii * turns)[:, None]
        element = np.stack([-step * np.sin(angle), step * np.cos(angle), 0 * step * angle], -1).reshape(-1, 3)
        frames = motor.electromagnets.frames
        self.points = (rim @ np.swapaxes(frames, 1, 2) + motor.electromagnets.positions[:, None]).reshape(-1, 3)
        self.elements = (element @ np.swapaxes(frames, 1, 2)).reshape(-1, 3)
        self.coils = len(frames)

    def torque(self, field: Field) -> Array:
        """(3, m) torque on the rotor: the opposite of Σ r × (I dl × B) on every coil."""
        on_coils: Array = np.cross(self.points, np.cross(self.elements, field(self.points)))
        on_rotor: Array = -on_coils.reshape(self.coils, -1, 3).sum(axis=1).T
        return on_rotor


def _local(motor: SphericalMotor, R: Array, points: Array) -> tuple[Array, Array, Array]:
    """ρ, z and the radial unit vectors' frames for every magnet and point, and the magnets' frames in the stator's."""
    frames = R @ motor.magnets.frames
    own = (points[None] - (motor.magnets.positions @ R.T)[:, None]) @ frames
    return own, np.hypot(own[..., 0], own[..., 1]), frames


def _to_stator(own: Array, rho: Array, frames: Array, strength: Array, b_rho: Array, b_z: Array) -> Array:
    over = np.divide(b_rho, rho, out=np.zeros_like(rho), where=rho > 0)
    field = np.stack([over * own[..., 0], over * own[..., 1], b_z], axis=-1) @ np.swapaxes(frames, 1, 2)
    out: Array = np.tensordot(strength, field, 1)
    return out


def core_field(motor: SphericalMotor, R: Array, block: int = 4096) -> Field:
    """magpylib.core in blocks that stay in the cache: closed form, no objects."""
    from magpylib.core import magnet_cylinder_axial_Bfield

    radius, strength = motor.magnet.radius, motor.polarity * motor.magnet.polarization

    def field(points: Array) -> Array:
        own, rho, frames = _local(motor, R, points)
        flat_rho, flat_z = rho.ravel() / radius, own[..., 2].ravel() / radius
        out = np.empty((3, flat_rho.size))
        ratio = np.full(block, 0.5 * motor.magnet.length / radius)
        for start in range(0, flat_rho.size, block):
            part = slice(start, min(start + block, flat_rho.size))
            size = part.stop - part.start
            out[:, part] = magnet_cylinder_axial_Bfield(z0=ratio[:size], r=flat_rho[part], z=flat_z[part])
        return _to_stator(own, rho, frames, strength, out[0].reshape(rho.shape), out[2].reshape(rho.shape))

    return field


def _magpylib() -> Any:
    return import_module("magpylib")  # its constructors are not typed


def _magnets(motor: SphericalMotor, R: Array) -> list[Any]:
    from scipy.spatial.transform import Rotation

    magpylib = _magpylib()

    frames, places = R @ motor.magnets.frames, motor.magnets.positions @ R.T
    return [
        magpylib.magnet.Cylinder(
            polarization=(0, 0, sign * motor.magnet.polarization),
            dimension=(2 * motor.magnet.radius, motor.magnet.length),
            position=place,
            orientation=Rotation.from_matrix(frame),
        )
        for frame, place, sign in zip(frames, places, motor.polarity, strict=True)
    ]


def getb_field(motor: SphericalMotor, R: Array) -> Field:
    """magpylib.getB with 24 cylinder objects, summed."""
    magpylib = _magpylib()
    magnets = _magnets(motor, R)

    def field(points: Array) -> Array:
        out: Array = magpylib.getB(magnets, points, sumup=True)
        return out

    return field


def getft_torque(motor: SphericalMotor, R: Array, across: int, along: int, around: int) -> Callable[[], Array]:
    """magpylib.getFT: 24 cylinders on 24 coils of circular loops in one batched call; ready to be called."""
    from scipy.spatial.transform import Rotation

    magpylib, magnets = _magpylib(), _magnets(motor, R)
    radii, heights, turns = motor.electromagnet.filaments(across, along)
    coils = []
    for frame, place in zip(motor.electromagnets.frames, motor.electromagnets.positions, strict=True):
        loops = [
            magpylib.current.Circle(
                current=current,
                diameter=2 * radius,
                position=place + height * frame[:, 2],
                orientation=Rotation.from_matrix(frame),
            )
            for radius, height, current in zip(radii, heights, turns, strict=True)
        ]
        coils.append(magpylib.Collection(loops))

    def torque() -> Array:
        result = magpylib.getFT(magnets, coils, pivot=(0, 0, 0), meshing=around, squeeze=False)
        on_coils: Array = np.asarray(result)[1].reshape(len(magnets), len(coils), 3).sum(axis=0)
        return -on_coils.T

    return torque


def cfsem_field(motor: SphericalMotor, R: Array, loops: int = 16) -> Field:
    """cfsem: every magnet as `loops` circular filaments at Gauss points along its rim, all pairs in one call."""
    import cfsem

    node, weight = np.polynomial.legendre.leggauss(loops)
    heights = 0.5 * motor.magnet.length * node
    currents = motor.magnet.polarization / MU0 * 0.5 * motor.magnet.length * weight
    rims = np.full(loops, motor.magnet.radius)

    def field(points: Array) -> Array:
        own, rho, frames = _local(motor, R, points)
        b_rho, b_z = cfsem.flux_density_circular_filament(
            currents, rims, heights, np.ascontiguousarray(rho.ravel()), np.ascontiguousarray(own[..., 2].ravel()), False
        )
        return _to_stator(own, rho, frames, motor.polarity, b_rho.reshape(rho.shape), b_z.reshape(rho.shape))

    return field
