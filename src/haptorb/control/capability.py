"""Capability of a device over its workspace: peak and continuous torque or force, condition number, heat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from haptorb.arrays import Array
from haptorb.compiled import kernel
from haptorb.control.array_allocation import ArrayAllocator
from haptorb.control.minimum_power import minimum_power_currents, solve_bounded_power
from haptorb.devices.base import State
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import DeviceError, InputError
from haptorb.rotations import rotation_from_euler

__all__ = ["ArrayLayer", "ContactForces", "MotorCapability", "array_capability", "map_contact", "motor_capability"]


@dataclass(frozen=True)
class MotorCapability:
    """Capability over a grid of tilts (ψ, λ), at the worst spin φ each; axes are the stator's X, Y, Z.

    tilts        (t,) [rad] values of ψ and of λ
    spins        number of φ evaluated per tilt
    peak         (t, t, 3) torque about each axis alone, currents at their limits [N·m]
    continuous   (t, t, 3) the same with continuous currents [N·m]
    condition    (t, t) ratio of the largest to the smallest singular value of the channels' torque per ampere
    weakest      (t, t) smallest singular value [N·m/A]
    power        (t, t, 3) minimum heat for a torque about each axis, at the reference temperature [W/(N·m)²]
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
    """Capability of `motor` over its workspace, with `model`. DeviceError if it lacks torque about an axis."""
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
    # the peak is limited by the supply's voltage too
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
    """(n, m) heat of every channel [W] per 1 N·m about `axis`, by Bai 2012 eq. (4)."""
    currents = minimum_power_currents(K / np.sqrt(resistance), np.eye(3)[axis])
    heat: Array = currents**2
    return heat


def _torques(K: Array, limit: Array) -> Array:
    out = np.empty((len(K), 3))
    _greatest(np.ascontiguousarray(K), np.ascontiguousarray(limit), out)
    return out


@kernel
def _greatest(K: Array, limit: Array, out: Array) -> None:
    """out (n, 3): peak torque about each axis with the other two zero, from the scale of an infeasible one."""
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


# --------------------------------------------------------------------------------------------------
# Capability of a coil array: force along the axes by height, at the centre and at the weakest point of the workspace.


_DIRECTIONS = np.vstack([np.eye(3), -np.eye(3)])
_FORCE_TOLERANCE = 1e-3  #: relative error up to which a force counts as delivered
_FRACTIONS = np.array([0.02, 0.1, 0.25, 0.4, 0.55, 0.7, 0.85])  #: of the bound on a force: starts of the search
_HALVINGS = 14
_POINTS_PER_SIDE = 5  #: grid points along each side of a plate; or around the rim of a dome's workspace


@final
@dataclass(frozen=True)
class ArrayLayer:
    """Forces on an upright tool (radial over a dome) at one height above contact, with the accompanying torque."""

    height: float  #: above contact [m]
    peak: Array  #: (3,) along x, y and z at the centre, the weaker direction of each [N]
    lasting: Array  #: (3,) the same with continuous currents in all coils [N]
    weakest: float  #: peak force in the worst of six directions at the worst point [N]
    passive: float  #: magnitude of the force at zero current at the centre [N]
    watts: float  #: heat for 1 N upwards at the centre, coils cold [W]


@final
@dataclass(frozen=True)
class ContactForces:
    """Peak force in the worst of six directions on a tool in contact, over the workspace in plan view."""

    x: Array  #: (n,) [m]
    y: Array  #: (k,) [m]
    weakest: Array  #: (k, n) [N]; NaN outside the workspace

    @property
    def worst_place(self) -> tuple[float, float]:
        """x and y [m] of the point with the lowest peak force."""
        row, column = np.unravel_index(int(np.nanargmin(self.weakest)), self.weakest.shape)
        return float(self.x[column]), float(self.y[row])

    @property
    def median(self) -> float:
        """Median peak force over the workspace [N]."""
        return float(np.nanmedian(self.weakest))


def map_contact(device: CoilArray, size: int = 13) -> ContactForces:
    """Evaluate `size` × `size` points of the workspace: exact model, currents and supply at their limits.

    >>> from haptorb.devices.loader import load
    >>> forces = map_contact(load("planar"), 3)
    >>> forces.weakest.shape, bool(forces.median >= np.nanmin(forces.weakest) > 0.0)
    ((3, 3), True)
    """
    surface, near = device.surface, device.contact_height
    strong = ArrayAllocator(device.driven_current, device.greatest_resistance, power=device.supply.power)
    rim = near * float(np.sin(surface.half_angle))
    width, depth = (rim, rim) if surface.is_dome else surface.half_width
    x, y = np.linspace(-width, width, size), np.linspace(-depth, depth, size)
    weakest = np.full((size, size), np.nan)
    for row, column in np.ndindex(size, size):
        p = np.array([x[column], y[row], near])
        if surface.is_dome:
            square = float(p[:2] @ p[:2])
            if square > rim * rim * (1 + 1e-9):
                continue
            p[2] = np.sqrt(near * near - square)
        state = State.at(p, axis=p if surface.is_dome else (0.0, 0.0, 1.0))
        weakest[row, column] = _reach(device, state, strong).min()
    return ContactForces(x, y, weakest)


def array_capability(device: CoilArray, layers: int = 5) -> tuple[ArrayLayer, ...]:
    """Compute `ArrayLayer`s from contact to the top of the workspace.

    >>> from haptorb.devices.loader import load
    >>> bool(array_capability(load("tetrahedron"), 2)[0].peak[2] > 0.2)
    True
    """
    power, hot = device.supply.power, device.greatest_resistance
    strong = ArrayAllocator(device.driven_current, hot, power=power)
    lasting = ArrayAllocator(device.sustained_current_together, hot, power=power)
    found = []
    for height in np.linspace(0.0, device.surface.thickness, layers):
        places = _list_places(device, float(height))
        peaks = np.array([_reach(device, state, strong) for state in places])
        middle = device.wrench_map(places[0], device.models[0])
        currents = strong.allocate(middle, np.array([0.0, 0.0, 0.01, 0, 0, 0]) + middle.passive).currents
        watts = 1e4 * float(device.coils.resistance @ currents**2)
        found.append(
            ArrayLayer(
                float(height), np.minimum(peaks[0, :3], peaks[0, 3:]), _weaker(_reach(device, places[0], lasting)),
                float(peaks.min()), float(np.linalg.norm(middle.passive[:3])), watts,
            )
        )  # fmt: skip
    return tuple(found)


def _weaker(forces: Array) -> Array:
    return np.minimum(forces[:3], forces[3:])


def _reach(device: CoilArray, state: State, allocator: ArrayAllocator) -> Array:
    """(6,) peak net force along ±x, ±y, ±z at `state`, passive force included [N].

    The feasible forces along a line are an interval, because currents within their limits and the supply's power are a
    convex set. It is found by bisection; 0 if the passive force perpendicular to the line cannot be compensated.
    """
    wrench_map = device.wrench_map(state, device.models[0])
    forces, passive = wrench_map.matrix[:3], wrench_map.passive[:3]
    found = np.zeros(6)
    wanted = np.zeros(6)

    def can_give(size: float, direction: Array) -> bool:
        wanted[:3] = size * direction
        given = wrench_map.wrench(allocator.allocate(wrench_map, wanted).currents)[:3]
        return bool(np.abs(given - wanted[:3]).max() <= _FORCE_TOLERANCE * max(size, most * _FORCE_TOLERANCE))

    for n, direction in enumerate(_DIRECTIONS):
        most = float(np.abs(direction @ forces) @ allocator.current_limit + direction @ passive)
        if most <= 0.0:
            continue
        known = next((size for size in most * _FRACTIONS if can_give(size, direction)), None)
        if known is None:
            continue
        least, beyond = known, most
        for _ in range(_HALVINGS):
            middle = 0.5 * (least + beyond)
            least, beyond = (middle, beyond) if can_give(middle, direction) else (least, middle)
        found[n] = least
    return found


def _list_places(device: CoilArray, height: float) -> list[State]:
    """Grid points of the workspace at `height` [m], the centre first."""
    surface, far = device.surface, device.contact_height + height
    middle = State.at((0.0, 0.0, far), axis=(0.0, 0.0, 1.0))
    if surface.is_dome:
        angles = 2 * np.pi * np.arange(2 * _POINTS_PER_SIDE) / (2 * _POINTS_PER_SIDE)
        sine, cosine = np.sin(surface.half_angle), np.cos(surface.half_angle)
        return [middle, *(State.at(far * np.array([sine * np.cos(a), sine * np.sin(a), cosine])) for a in angles)]
    across = [np.linspace(-side, side, _POINTS_PER_SIDE) for side in surface.half_width]
    return [middle, *(State.at((x, y, far), axis=(0.0, 0.0, 1.0)) for x in across[0] for y in across[1])]
