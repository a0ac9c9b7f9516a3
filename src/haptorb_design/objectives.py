"""Quantities of a candidate for the objectives and constraints of design files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Literal

import numpy as np

from haptorb.arrays import Array, cap_directions
from haptorb.devices import tables
from haptorb.devices.base import Device, State, require
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.electromagnet import (
    CHIP_EDGE_M,
    GREATEST_LEAN,
    PEN_RADIUS_M,
    SphericalElectromagnet,
    find_sensor_field,
    pen_distance,
)
from haptorb.devices.electromagnet_wrench_map import Windings, fill_wound
from haptorb.devices.motor import SphericalMotor, measure_ring_pull
from haptorb.devices.motor_layout import Layout
from haptorb.devices.placed_coils import find_farthest, find_spacing
from haptorb.devices.table_cache import load_field_table, load_torque_table
from haptorb.devices.tables import PairTable, series_torque_table
from haptorb.devices.weight_regulator import Regulator, torque_over_sine
from haptorb.errors import GeometryError, InputError, UnknownName
from haptorb.estimation.hall_pose_fit import position_accuracy
from haptorb.magnetics.coil import COPPER_DENSITY, Coil
from haptorb.magnetics.magnets import ChargedRing, CylinderMagnet, dipole_on_charges
from haptorb.magnetics.soft_sphere import add_response_wrench, harmonic_sums, response_to_charges, weigh_charges
from haptorb.rotations import rotation_from_euler
from haptorb_design.problem import DesignCandidate, DesignQuantity, Sense

__all__ = [
    "PARTS_QUANTITIES",
    "QUANTITIES",
    "REGULATOR_QUANTITIES",
    "SENSING_QUANTITIES",
    "TOOL_FORCE_QUANTITIES",
    "WARMTH_QUANTITIES",
    "Compute",
    "array_air",
    "array_copper",
    "array_envelope",
    "array_magnets",
    "array_mass",
    "array_of",
    "array_spacing",
    "describe",
    "electromagnet_of",
    "find_continuous",
    "find_heat",
    "find_heaviest",
    "find_isotropy",
    "find_peak",
    "find_pull",
    "find_worst",
    "greatest_force",
    "motor_of",
    "motor_torque_find_heaviest",
    "option",
    "quantity",
    "quantity_names",
    "shell_places",
    "spread_angles",
    "tool_force_find_heaviest",
    "torque_per_ampere",
    "windings_of",
]


# --------------------------------------------------------------------------------------------------
# Registry of the quantities by name.


Compute = Callable[[DesignCandidate], float]


def describe(name: str, unit: str, sense: Sense, text: str, by_kind: Mapping[str, Compute]) -> DesignQuantity:
    """Quantity with an implementation for each kind of device; InputError for a device of another kind."""
    kinds = tuple(by_kind)

    def compute(candidate: DesignCandidate) -> float:
        kind = candidate.device.kind
        if kind.name not in by_kind:
            raise InputError(
                f"quantity '{name}' is computed for devices of kind {' and '.join(kinds)}; "
                f"'{candidate.base.name}' is a {kind.title}"
            )
        return float(by_kind[kind.name](candidate))

    return DesignQuantity(name, unit, sense, text, kinds, compute)


def option(candidate: DesignCandidate, name: str, default: float) -> float:
    """The number `name` of the design file's table [evaluation]; InputError unless it is a positive number."""
    value = candidate.options.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
        raise InputError(f"evaluation.{name} must be a positive number in SI units; got {value!r}")
    return float(value)


# --------------------------------------------------------------------------------------------------
# Force or torque of a coil array on its tool, in the worst direction and position, from the exact wrench map.
#
# The tool is upright over a plate and radial over a dome, at `height` of the design file's table [evaluation] above
# contact. A force is produced by the currents with the least heat, whatever the accompanying torque, and vice versa, as
# with `haptorb run --render`. The forces {K i} of currents within their limits and the supply's power are a convex set
# about zero; its greatest ball has the radius min over unit vectors n of max n·K i. The minimum is at the normal of a
# facet (a product of two columns of K), at a main axis of K R⁻¹ Kᵀ, or between them: directions all around and a local
# search find it.


Part = Literal["force", "torque"]  #: of a wrench

_ARRAY_FORCE_PLACES = 40
_RIM = 12  #: positions on the rim of a dome's workspace, where arrays are weakest
_AROUND = 60  #: sampled directions at every position, on a hemisphere
_ARRAY_FORCE_ROUNDS = 5  #: of the local search


def array_of(candidate: DesignCandidate) -> CoilArray:
    """The candidate's device; InputError if it is not a coil array."""
    return require(candidate.device, CoilArray, "this quantity")


def _array_force_list_states(candidate: DesignCandidate) -> list[State]:
    device, count = array_of(candidate), int(option(candidate, "places", _ARRAY_FORCE_PLACES))
    surface = device.surface
    height = option(candidate, "height", 1.0) if "height" in candidate.options else 0.0
    far = device.contact_height + height
    if surface.is_dome:
        turns = 2 * np.pi * np.arange(_RIM) / _RIM
        sine, cosine = np.sin(surface.half_angle), np.cos(surface.half_angle)
        rim = np.column_stack([sine * np.cos(turns), sine * np.sin(turns), np.full(_RIM, cosine)])
        return [State.at(far * place) for place in (*cap_directions(surface.half_angle, count), *rim)]
    side = max(int(np.sqrt(count)), 2)
    across = [np.linspace(-half, half, side) for half in surface.half_width]
    return [State.at((x, y, far), axis=(0.0, 0.0, 1.0)) for x in across[0] for y in across[1]]


def _array_force_maps(candidate: DesignCandidate) -> tuple[Array, Array]:
    """(n, 6, m) wrench per ampere [N/A, N·m/A] and (n, 6) wrench without current [N, N·m] at the n places."""

    def compute() -> tuple[Array, Array]:
        device = array_of(candidate)
        maps = [device.wrench_map(state, device.models[0]) for state in _array_force_list_states(candidate)]
        return np.stack([one.matrix for one in maps]), np.stack([one.passive for one in maps])

    return candidate.share("array: maps", compute)


def _find_map(candidate: DesignCandidate, part: Part) -> Array:
    """(n, 3, m) of force or torque; InputError for the torque of a tool that has no torque about one axis."""
    if part == "torque" and len(array_of(candidate).tool.magnets) == 1:
        raise InputError("a tool with one magnet has no torque about the magnet's axis: give it a second one")
    K = _array_force_maps(candidate)[0]
    return K[:, :3] if part == "force" else K[:, 3:]


def find_heaviest(candidate: DesignCandidate, part: Part = "force") -> tuple[float, Array]:
    """Greatest of the least heats for a force [W/N²] at the reference temperature, and the squares (m,) of the currents
    [A²/N²] that make it: in the worst direction and place; infinite where a direction has no force. Torques alike."""
    K, resistance = _find_map(candidate, part), array_of(candidate).coils.resistance
    values, axes = np.linalg.eigh((K / resistance) @ K.transpose(0, 2, 1))
    worst = int(np.argmin(values[:, 0]))
    least, most = float(values[worst, 0]), float(values[worst, 2])
    if not least > 1e-12 * most:
        return np.inf, np.full(len(resistance), np.inf)
    currents = K[worst].T @ axes[worst, :, 0] / (least * resistance)
    return 1.0 / least, currents**2


def find_heat(candidate: DesignCandidate, part: Part = "force") -> float:
    """[W/N²], see `find_heaviest`."""
    return find_heaviest(candidate, part)[0]


def find_peak(candidate: DesignCandidate, part: Part = "force") -> float:
    """[N] at full current, within the supply's power."""
    return _array_force_ball(candidate, array_of(candidate).driven_current, part)


def find_continuous(candidate: DesignCandidate, part: Part = "force") -> float:
    """[N] with continuous currents in all coils."""
    device = array_of(candidate)
    return _array_force_ball(candidate, np.minimum(device.sustained_current_together, device.driven_current), part)


def find_isotropy(candidate: DesignCandidate, part: Part = "force") -> float:
    """Ratio of minimum to maximum force per ampere over directions, worst position; 0 with fewer than three coils."""
    K = _find_map(candidate, part)
    values = np.linalg.svd(K, compute_uv=False)
    return float((values[:, 2] / values[:, 0]).min()) if K.shape[2] >= 3 else 0.0


def find_pull(candidate: DesignCandidate) -> float:
    """[N] maximum force without current; 0 without a core."""
    return float(np.linalg.norm(_array_force_maps(candidate)[1][:, :3], axis=1).max())


def _array_force_ball(candidate: DesignCandidate, limit: Array, part: Part) -> float:
    device, K = array_of(candidate), _find_map(candidate, part)
    resistance, power = device.greatest_resistance, device.supply.power

    def reach(normals: Array, at: Array) -> Array:
        return greatest_force(normals @ at, limit, resistance, power)

    first, second = np.triu_indices(len(limit), 1)
    facets: Array = np.cross(K[:, :, first], K[:, :, second], axis=1).transpose(0, 2, 1)
    axes = np.linalg.eigh((K / resistance) @ K.transpose(0, 2, 1))[1].transpose(0, 2, 1)
    around = np.broadcast_to(cap_directions(np.pi / 2, _AROUND), (len(K), _AROUND, 3))
    size = np.linalg.norm(facets, axis=2, keepdims=True)
    parallel = size <= 1e-9 * size.max(axis=1, keepdims=True, initial=0.0)
    facets = np.where(parallel, around[:, :1], facets / np.where(parallel, 1.0, size))
    normals = np.concatenate([facets, axes, around], axis=1)
    found = reach(normals, K)
    place, row = np.unravel_index(np.argmin(found), found.shape)
    least, normal = float(found[place, row]), normals[place, row]
    cap = cap_directions(0.2, _AROUND) - np.array([0.0, 0.0, 1.0])
    for _ in range(_ARRAY_FORCE_ROUNDS):
        near = normal + cap @ State.at(0.5 * normal).R_SR.T  # only its direction counts
        near /= np.linalg.norm(near, axis=1, keepdims=True)
        values = reach(near, K[place])
        best = int(np.argmin(values))
        if values[best] < least:
            least, normal = float(values[best]), near[best]
        cap = 0.4 * cap
    return least


def greatest_force(per_ampere: Array, limit: Array, resistance: Array, power: float) -> Array:
    """Greatest c·i [N] for c = `per_ampere` (..., m) [N/A] with |i_j| ≤ `limit` (m,) [A] and Σ R_j i_j² ≤ `power` [W].

    The currents are min(μ |c_j|/R_j, I_j): coils reach their limits in the order of R_j I_j/|c_j|, and μ is what uses
    up the power with the first few at theirs. Exact.
    """
    c = np.abs(per_ampere)
    c = np.maximum(c, 1e-12 * c.max(axis=-1, keepdims=True) + 1e-300)
    heat = resistance * limit**2
    supplied = min(power, 2.0 * float(heat.sum()))
    turn = resistance * limit / c  # μ at which a coil is at its limit
    order = np.argsort(turn, axis=-1)

    def sort(values: Array) -> Array:
        return np.take_along_axis(np.broadcast_to(values, c.shape), order, axis=-1)

    full, rest = sort(heat), sort(c**2 / resistance)
    none = np.zeros((*c.shape[:-1], 1))
    before = np.concatenate([none, np.cumsum(full, axis=-1)], axis=-1)  # heat of the first k, at their limits
    after = np.concatenate([np.cumsum(rest[..., ::-1], axis=-1)[..., ::-1], none], axis=-1)  # of the others, for μ = 1
    needed = before[..., :-1] + sort(turn) ** 2 * after[..., :-1]
    k = (needed <= supplied).sum(axis=-1)[..., None]
    force = np.concatenate([none, np.cumsum(sort(c * limit), axis=-1)], axis=-1)
    left = np.maximum(supplied - np.take_along_axis(before, k, axis=-1), 0.0) * np.take_along_axis(after, k, axis=-1)
    found: Array = (np.take_along_axis(force, k, axis=-1) + np.sqrt(left))[..., 0]
    return found


# --------------------------------------------------------------------------------------------------
# Worst orientation in a motor's workspace: an even sample, and a local search from its worst points.
#
# The torque of a spherical motor has narrow minima between its poles; a grid of a few thousand orientations still
# misses 20 % of the worst heat. A few hundred samples find the regions of the minima, and steps along the three angles
# converge to them.


_STARTS = 12  #: worst points of the sample from which the search continues
_ORIENTATIONS_ROUNDS = 7
_STEPS = np.array([[i, j, k] for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0) for k in (-1.0, 0.0, 1.0)])


@lru_cache(maxsize=16)
def spread_angles(tilt: float, count: int) -> Array:
    """(count, 3) angles ψ, λ, φ [rad] that fill the workspace |ψ|, |λ| ≤ `tilt`, 0 ≤ φ < 2π evenly, edges included.

    Kronecker's sequence of the generalised golden ratio (Roberts 2018): even for every count, deterministic. ψ and λ
    are scaled by 1.2 and cut at the edge, where motors are weakest.
    """
    root = 1.2207440846057596  # x⁴ = x + 1
    share = np.mod(0.5 + np.outer(np.arange(count), root ** -np.arange(1.0, 4.0)), 1.0)
    tilts = np.clip(1.2 * (2 * share[:, :2] - 1), -1.0, 1.0) * tilt
    angles: Array = np.column_stack([tilts, 2 * np.pi * share[:, 2]])
    angles.flags.writeable = False
    return angles


def find_worst(value: Callable[[Array], Array], tilt: float, count: int) -> tuple[float, Array]:
    """Least of `value`, (n, 3, 3) rotations → (n,), over the workspace, and the angles (3,) ψ, λ, φ [rad] of it.

    `count` orientations are sampled first, and about three times 12 × 27 more in the local search, which converges to
    the local minima near the sample's 12 worst points.
    """
    angles = spread_angles(tilt, count)
    found = value(_rotations(angles))
    order = np.argsort(found, kind="stable")[:_STARTS]
    at, least = angles[order].copy(), found[order]
    step = 2.0 * tilt / max(count, 8) ** (1 / 3)
    for _ in range(_ORIENTATIONS_ROUNDS):
        near = at[:, None] + step * _STEPS
        near[..., :2] = np.clip(near[..., :2], -tilt, tilt)
        values = value(_rotations(near.reshape(-1, 3))).reshape(len(at), len(_STEPS))
        best = np.argmin(values, axis=1)
        here = np.arange(len(at))
        at, least = near[here, best], np.minimum(least, values[here, best])
        step *= 0.5
        if len(at) > 4:  # most starts converge to the same few minima
            keep = np.argsort(least, kind="stable")[: max(4, len(at) // 2)]
            at, least = at[keep], least[keep]
    lowest = int(np.argmin(least))
    return float(least[lowest]), at[lowest]


def _rotations(angles: Array) -> Array:
    return np.ascontiguousarray(rotation_from_euler(angles[:, 0], angles[:, 1], angles[:, 2]))


# --------------------------------------------------------------------------------------------------
# Torque of a spherical motor, and the heat that it takes, in the worst direction and orientation in the workspace.
#
# Quantities of the same names for a coil array are above. All use the exact model level: the torque of one magnet and
# one coil comes from zonal harmonics (`series_torque_table`) or, where these do not converge, from the exact table. Of
# a zonotope {K i, |i| ≤ I} the greatest ball has the radius min over the facets' normals n of Σ |n·K_k| I_k, and every
# normal is a product of two columns of K.


_MOTOR_TORQUE_ORIENTATIONS = 400
_MOTOR_TORQUE_MOTOR, _MOTOR_TORQUE_ARRAY = "spherical-motor", "coil-array"


def motor_of(candidate: DesignCandidate) -> SphericalMotor:
    """The candidate's device; InputError if it is not a spherical motor."""
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
        tables.torque_characteristic(
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


def motor_torque_find_heaviest(candidate: DesignCandidate) -> tuple[float, Array]:
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


def _motor_torque_heat(candidate: DesignCandidate) -> float:
    return motor_torque_find_heaviest(candidate)[0]


def _motor_torque_peak(candidate: DesignCandidate) -> float:
    return _motor_torque_ball(candidate, motor_of(candidate).driven_current)


def _motor_torque_continuous(candidate: DesignCandidate) -> float:
    motor = motor_of(candidate)
    return _motor_torque_ball(candidate, np.minimum(motor.sustained_current_together, motor.driven_current))


def _motor_torque_ball(candidate: DesignCandidate, limit: Array) -> float:
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


def _motor_torque_isotropy(candidate: DesignCandidate) -> float:
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


def _motor_torque_model_error(candidate: DesignCandidate) -> float:
    motor, torque = motor_of(candidate), torque_per_ampere(candidate)
    angles = spread_angles(motor.workspace_tilt, _count(candidate))
    R = np.ascontiguousarray(rotation_from_euler(angles[:, 0], angles[:, 1], angles[:, 2]))
    exact = torque(R)
    other = motor.torque_characteristic(R, "dipole") @ motor.groups
    return float(np.linalg.norm(other - exact, axis=1).max() / np.linalg.norm(exact, axis=1).max())


def _count(candidate: DesignCandidate) -> int:
    return int(option(candidate, "orientations", _MOTOR_TORQUE_ORIENTATIONS))


_TORQUE_OVER = "in the worst direction, and the worst orientation or position in the workspace"
QUANTITIES = (
    describe(
        "heat_per_torque_squared",
        "W/(N·m)²",
        "minimise",
        f"Smallest heat for a torque, divided by its square, {_TORQUE_OVER}; coils at their reference temperature.",
        {_MOTOR_TORQUE_MOTOR: _motor_torque_heat, _MOTOR_TORQUE_ARRAY: partial(find_heat, part="torque")},
    ),
    describe(
        "peak_torque",
        "N·m",
        "maximise",
        f"Torque at full current available in every direction, {_TORQUE_OVER}.",
        {_MOTOR_TORQUE_MOTOR: _motor_torque_peak, _MOTOR_TORQUE_ARRAY: partial(find_peak, part="torque")},
    ),
    describe(
        "continuous_torque",
        "N·m",
        "maximise",
        f"Continuous torque in all channels, {_TORQUE_OVER}.",
        {_MOTOR_TORQUE_MOTOR: _motor_torque_continuous, _MOTOR_TORQUE_ARRAY: partial(find_continuous, part="torque")},
    ),
    describe(
        "torque_isotropy",
        "",
        "maximise",
        "Ratio of smallest to largest torque per ampere over all directions, in the worst orientation or position.",
        {_MOTOR_TORQUE_MOTOR: _motor_torque_isotropy, _MOTOR_TORQUE_ARRAY: partial(find_isotropy, part="torque")},
    ),
    describe(
        "cogging",
        "N·m",
        "minimise",
        "Largest torque on the rotor without current over the workspace: the remainder of weight and regulator.",
        {_MOTOR_TORQUE_MOTOR: _cogging},
    ),
    describe(
        "torque_model_error",
        "",
        "minimise",
        "Largest error of a channel's torque by the dipole model over the workspace, relative to the largest "
        "torque per ampere.",
        {_MOTOR_TORQUE_MOTOR: _motor_torque_model_error},
    ),
)


# --------------------------------------------------------------------------------------------------
# Construction of a coil array: copper, magnets, envelope, and gaps between its parts.


def array_magnets(device: Device) -> float:
    """[m³] of all magnets in the tool."""
    tool = require(device, CoilArray, "this quantity").tool
    return float(sum(np.pi * (one.outer_radius**2 - one.inner_radius**2) * one.length for one in tool.magnets))


def array_mass(device: Device) -> float:
    """[kg] of the tool, from the file."""
    return require(device, CoilArray, "this quantity").tool.mass


def array_copper(candidate: DesignCandidate) -> float:
    """[kg] of the copper, from resistance and dimensions of the windings."""
    device = array_of(candidate)
    coils = device.windings
    volume = np.pi * (coils.outer_radius**2 - coils.inner_radius**2) * coils.length
    return float(COPPER_DENSITY * (coils.fill(device.coils) * volume).sum())


def array_envelope(candidate: DesignCandidate) -> float:
    """[m] from the origin to the dome, or to the farthest corner of a winding, whichever is farther."""
    device = array_of(candidate)
    return max(device.surface.dome_radius, float(find_farthest(device.windings).max()))


def array_air(candidate: DesignCandidate) -> float:
    """[m] minimum gap between a winding and the core, the dome or the plate."""
    device = array_of(candidate)
    coils, surface = device.windings, device.surface
    if surface.is_dome:
        over = surface.dome_radius - find_farthest(coils)
    else:
        axis = coils.axis[:, 2]
        tops = coils.position[:, 2] + np.abs(axis) * coils.length / 2 + np.sqrt(1 - axis**2) * coils.outer_radius
        over = surface.height - tops
    core = np.inf if device.core is None else float(coils.nearest.min()) - device.core.radius
    return min(core, float(over.min()))


def array_spacing(candidate: DesignCandidate) -> float:
    """[m] minimum gap between two windings; 0 where they touch or overlap."""
    return find_spacing(array_of(candidate).windings)


# --------------------------------------------------------------------------------------------------
# Force of a spherical electromagnet on a radial tool in contact, in the worst direction and position in the workspace.
#
# Quantities of the same names for a coil array are above. All use the tool's magnet at its true size, and windings and
# core at theirs where these are known. The forces {K i, |i| ≤ I} of three coils fill a parallelepiped,
# whose greatest ball has the radius min over k of I_k/|row k of K⁻¹|.


_TOOL_FORCE_PLACES = 40
_TOOL_FORCE_ELECTROMAGNET, _TOOL_FORCE_ARRAY = "spherical-electromagnet", "coil-array"


def electromagnet_of(candidate: DesignCandidate) -> SphericalElectromagnet:
    """The candidate's device; InputError if it is not a spherical electromagnet."""
    return require(candidate.device, SphericalElectromagnet, "this quantity")


def _tool_force_list_states(candidate: DesignCandidate) -> list[State]:
    device = electromagnet_of(candidate)
    places = cap_directions(device.workspace_half_angle, int(option(candidate, "places", _TOOL_FORCE_PLACES)))
    return [State.at(device.contact_distance * place) for place in places]


def _tool_force_maps(candidate: DesignCandidate) -> tuple[Array, Array, Array]:
    """(n, 3, 3) force per ampere [N/A], (1, 3) force without current [N], (n, 3, 3) by the published model."""

    def compute() -> tuple[Array, Array, Array]:
        device, states = electromagnet_of(candidate), _tool_force_list_states(candidate)
        return (
            _find_coil_force(device, states),
            np.stack([_find_core_force(device, state) for state in states[:1]]),  # the same at every position
            np.stack([device.wrench_map(state, "published").force for state in states]),
        )

    return candidate.share("electromagnet: maps", compute)


def _list_charges(device: SphericalElectromagnet, azimuth: int = 8) -> Array:
    """(4, n) of the tool's magnet, in the tool's frame [m, A·m]."""
    tool = device.tool
    return ChargedRing(
        tool.outer_radius, tool.inner_radius, tool.length, tool.remanence, radial=2, azimuth=azimuth
    ).rows


def _find_coil_force(device: SphericalElectromagnet, states: Sequence[State]) -> Array:
    """(n, 3, 3) force per ampere [N/A] of the device's first model, without the table of the core's pull, which takes
    longer than the rest of a candidate."""
    charges, out = _list_charges(device), np.empty((len(states), 6, 3))
    for state, matrix in zip(states, out, strict=True):
        p, R = np.ascontiguousarray(state.p), np.ascontiguousarray(state.R_SR)
        if device.has_sizes:
            fill_wound(charges, *device.wound_coils, p, R, matrix)
        else:
            dipole_on_charges(charges, R, p, matrix)
    force: Array = out[:, :3] if device.has_sizes else out[:, :3] @ device.moment_per_current
    return force


def _find_core_force(device: SphericalElectromagnet, state: State) -> Array:
    """(3,) force [N] of the core on the tool without current."""
    core, p = device.core, np.ascontiguousarray(state.p)
    charges = _list_charges(device, azimuth=16)
    placed = np.vstack([state.R_SR @ charges[:3] + p[:, None], charges[3:]])
    nearest = float(np.linalg.norm(placed[:3], axis=0).min())
    order = core.order(nearest, nearest, precision=1e-7)
    sums = np.empty(((order + 2) * (order + 3) // 2, 2))
    harmonic_sums(np.ascontiguousarray(placed), core.radius, order, sums)
    shares = weigh_charges(core, order)
    responses, wrench = np.empty((1, len(shares), 2)), np.zeros((6, 1))
    response_to_charges(sums, shares, responses)
    add_response_wrench(sums, responses, core.radius, order, p, wrench)
    force: Array = wrench[:3, 0]
    return force


def tool_force_find_heaviest(candidate: DesignCandidate) -> tuple[float, Array]:
    """Greatest heat for a force [W/N²] at the reference temperature, and the squares (m,) of the currents [A²/N²] that
    make it: in the worst direction and place."""
    resistance = electromagnet_of(candidate).coils.resistance
    per_newton = np.linalg.inv(_tool_force_maps(candidate)[0])
    values, axes = np.linalg.eigh(per_newton.transpose(0, 2, 1) @ (resistance[:, None] * per_newton))
    worst = int(np.argmax(values[:, 2]))
    currents = per_newton[worst] @ axes[worst, :, 2]
    return float(values[worst, 2]), currents**2


def _tool_force_heat(candidate: DesignCandidate) -> float:
    return tool_force_find_heaviest(candidate)[0]


def _tool_force_ball(candidate: DesignCandidate, limit: Array) -> float:
    device = electromagnet_of(candidate)
    per_newton = np.linalg.inv(_tool_force_maps(candidate)[0])
    within = (limit / np.linalg.norm(per_newton, axis=2)).min()
    heat = per_newton.transpose(0, 2, 1) @ (device.greatest_resistance[:, None] * per_newton)
    supplied = np.sqrt(device.supply.power / np.linalg.eigvalsh(heat)[:, 2].max())
    return float(min(within, supplied))


def _tool_force_peak(candidate: DesignCandidate) -> float:
    return _tool_force_ball(candidate, electromagnet_of(candidate).driven_current)


def _tool_force_continuous(candidate: DesignCandidate) -> float:
    device = electromagnet_of(candidate)
    return _tool_force_ball(candidate, np.minimum(device.sustained_current_together, device.driven_current))


def _radial(candidate: DesignCandidate) -> float:
    device = electromagnet_of(candidate)
    radii = np.stack([state.R_SR[:, 2] for state in _tool_force_list_states(candidate)])
    amperes = np.einsum(
        "nij,nj->ni", np.linalg.inv(_tool_force_maps(candidate)[0]), radii
    )  # of one newton along the radius
    limit = np.minimum(device.sustained_current_together, device.driven_current)
    supplied = np.sqrt(device.supply.power / (device.greatest_resistance * amperes**2).sum(axis=1))
    return float(np.minimum((limit / np.abs(amperes)).min(axis=1), supplied).min())


def _tool_force_isotropy(candidate: DesignCandidate) -> float:
    values = np.linalg.svd(_tool_force_maps(candidate)[0], compute_uv=False)
    return float((values[:, 2] / values[:, 0]).min())


def _pull(candidate: DesignCandidate) -> float:
    return float(np.linalg.norm(_tool_force_maps(candidate)[1], axis=1).max())


def _tool_force_model_error(candidate: DesignCandidate) -> float:
    exact, _, published = _tool_force_maps(candidate)
    return float(np.linalg.norm(exact @ np.linalg.inv(published) - np.eye(3), 2, axis=(1, 2)).max())


_OVER = (
    "on a radial tool (over a plate an upright one) in contact, in the worst direction and position in the workspace"
)
TOOL_FORCE_QUANTITIES = (
    describe("heat_per_force_squared", "W/N²", "minimise",
             f"Smallest heat for a force, divided by its square, {_OVER}; coils at their reference temperature.",
             {_TOOL_FORCE_ELECTROMAGNET: _tool_force_heat, _TOOL_FORCE_ARRAY: find_heat}),
    describe("peak_force", "N", "maximise", f"Force at full current, within the supply's power, {_OVER}.",
             {_TOOL_FORCE_ELECTROMAGNET: _tool_force_peak, _TOOL_FORCE_ARRAY: find_peak}),
    describe("continuous_force", "N", "maximise",
             f"Continuous force in all coils, {_OVER}.",
             {_TOOL_FORCE_ELECTROMAGNET: _tool_force_continuous, _TOOL_FORCE_ARRAY: find_continuous}),
    describe("continuous_radial_force", "N", "maximise",
             "Force along the radius alone, in contact, continuous in all coils, at the worst position in the "
             "workspace.", {_TOOL_FORCE_ELECTROMAGNET: _radial}),
    describe("force_isotropy", "", "maximise",
             "Ratio of smallest to largest force per ampere over all directions, in contact, at the worst position.",
             {_TOOL_FORCE_ELECTROMAGNET: _tool_force_isotropy, _TOOL_FORCE_ARRAY: find_isotropy}),
    describe("core_pull", "N", "minimise",
             "Largest pull of the core on a radial tool in contact, without current.",
             {_TOOL_FORCE_ELECTROMAGNET: _pull, _TOOL_FORCE_ARRAY: find_pull}),
    describe("force_model_error", "", "minimise",
             "Largest relative error of the coils' force by the published model on a radial tool in contact.",
             {_TOOL_FORCE_ELECTROMAGNET: _tool_force_model_error}),
)  # fmt: skip


# --------------------------------------------------------------------------------------------------
# Construction of a device: sizes, gaps, masses, copper, magnets, and rough cost.


_PARTS_MOTOR, _PARTS_ELECTROMAGNET, _PARTS_ARRAY = "spherical-motor", "spherical-electromagnet", "coil-array"
_MAGNET_DENSITY = 7.5e3  #: sintered NdFeB [kg/m³]
#: EUR, assumed: retail prices of small numbers in 2024; a design file's [evaluation] may state others
_PRICES = {"magnet_price": 120.0, "copper_price": 30.0, "channel_price": 40.0, "sensor_price": 3.0}


def windings_of(candidate: DesignCandidate) -> Windings:
    """The windings of a spherical electromagnet; InputError where its file does not give their sizes."""
    device = electromagnet_of(candidate)
    if device.windings is None:
        raise InputError(f"'{candidate.base.name}' has no [windings]: their sizes are needed for this quantity")
    return device.windings


def _rotor_magnets(device: Device) -> float:
    """[m³]"""
    motor = require(device, SphericalMotor, "this quantity")
    return float(np.abs(motor.polarity).sum() * np.pi * motor.magnet.radius**2 * motor.magnet.length)


def _tool_magnet(device: Device) -> float:
    """[m³]"""
    tool = require(device, SphericalElectromagnet, "this quantity").tool
    return float(np.pi * (tool.outer_radius**2 - tool.inner_radius**2) * tool.length)


def _rotor_mass(candidate: DesignCandidate) -> float:
    base = require(candidate.base, SphericalMotor, "this quantity")
    return _mass(candidate, motor_of(candidate).rotor.mass, base.rotor.mass, _rotor_magnets)


def _tool_mass(candidate: DesignCandidate) -> float:
    base = require(candidate.base, SphericalElectromagnet, "this quantity")
    return _mass(candidate, electromagnet_of(candidate).tool.mass, base.tool.mass, _tool_magnet)


def _array_mass(candidate: DesignCandidate) -> float:
    mass, before = array_mass(candidate.device), array_mass(candidate.base)
    return _mass(candidate, mass, before, array_magnets)


def _mass(candidate: DesignCandidate, mass: float, before: float, magnets: Callable[[Device], float]) -> float:
    """Mass from the file; if only the magnets differ from the base device, corrected by their volume."""
    if mass != before:
        return mass
    return mass + _MAGNET_DENSITY * (magnets(candidate.device) - magnets(candidate.base))


def _motor_copper(candidate: DesignCandidate) -> float:
    motor = motor_of(candidate)
    coil, coils = motor.electromagnet, motor.coils
    in_series = np.abs(motor.groups).sum(axis=0)
    fill = in_series[0] * coil.resistance(1.0, coils.copper_resistivity) / coils.resistance[0]
    volume = np.pi * (coil.outer_radius**2 - coil.inner_radius**2) * coil.length
    return float(COPPER_DENSITY * fill * volume * len(motor.electromagnets))


def _winding_copper(candidate: DesignCandidate) -> float:
    device, windings = electromagnet_of(candidate), windings_of(candidate)
    coils = device.coils
    fill = windings.fill(coils.resistance, coils.copper_resistivity)
    volume = np.pi * (windings.outer_radius**2 - windings.inner_radius**2) * windings.length
    return float(COPPER_DENSITY * (fill * volume).sum())


def _motor_cost(candidate: DesignCandidate) -> float:
    return _cost(candidate, _rotor_magnets(candidate.device), _motor_copper(candidate))


def _electromagnet_cost(candidate: DesignCandidate) -> float:
    return _cost(candidate, _tool_magnet(candidate.device), _winding_copper(candidate))


def _array_cost(candidate: DesignCandidate) -> float:
    return _cost(candidate, array_magnets(candidate.device), array_copper(candidate))


def _cost(candidate: DesignCandidate, magnet_volume: float, copper: float) -> float:
    price = {key: option(candidate, key, default) for key, default in _PRICES.items()}
    return (
        price["magnet_price"] * _MAGNET_DENSITY * magnet_volume
        + price["copper_price"] * copper
        + price["channel_price"] * candidate.device.channels
        + price["sensor_price"] * candidate.device.sensors
    )


def _corner(distance: float, length: float, radius: float) -> float:
    return float(np.hypot(distance + 0.5 * length, radius))


def _motor_envelope(candidate: DesignCandidate) -> float:
    motor = motor_of(candidate)
    coil, magnet = motor.electromagnet, motor.magnet
    return max(
        _corner(motor.magnets.distance, magnet.length, magnet.radius),
        _corner(motor.electromagnets.distance, coil.length, coil.outer_radius),
    )


def _electromagnet_envelope(candidate: DesignCandidate) -> float:
    return electromagnet_of(candidate).dome_radius


def _gap(candidate: DesignCandidate) -> float:
    """Gap between the outermost of the inner parts and the innermost of the outer ones."""
    motor = motor_of(candidate)
    coil, magnet = motor.electromagnet, motor.magnet
    sizes = [
        (motor.electromagnets.distance, float(coil.length), float(coil.outer_radius)),
        (motor.magnets.distance, float(magnet.length), float(magnet.radius)),
    ]
    inner, outer = sorted(sizes)
    return outer[0] - 0.5 * outer[1] - _corner(*inner)


def _air(candidate: DesignCandidate) -> float:
    device, windings = electromagnet_of(candidate), windings_of(candidate)
    free = device.dome_radius - device.dome_wall
    return float(min(free - windings.corners.max(), windings.inner_radius.min() - device.core_radius))


def _spacing(candidate: DesignCandidate) -> float:
    motor = motor_of(candidate)
    return min(
        _neighbours(motor.electromagnets, motor.electromagnet.outer_radius, motor.electromagnet.length),
        _neighbours(motor.magnets, motor.magnet.radius, motor.magnet.length),
    )


def _neighbours(layout: Layout, radius: float, length: float) -> float:
    """Width of the gap between the inner rims of the two nearest parts; negative where they overlap."""
    cosine: Array = layout.directions @ layout.directions.T - 2 * np.eye(len(layout))
    inner = layout.distance - 0.5 * length
    half = 0.5 * float(np.arccos(np.clip(cosine.max(), -1.0, 1.0)))
    # two rims meet on the plane that halves the angle; inner·sin(half) is how far the axis is from it
    return 2.0 * float(inner * np.sin(half) - radius * np.cos(half))


def _nesting(candidate: DesignCandidate) -> float:
    """Clearance between each winding and the next, at the corner where the two cross."""
    windings = windings_of(candidate)
    order = np.argsort(windings.inner_radius)
    corners = windings.corners[order]
    return float((windings.inner_radius[order][1:] - corners[:-1]).min())


def _moment_error(candidate: DesignCandidate) -> float:
    """Maximum relative difference, over the coils, between the moments of windings and core and the stated ones."""
    device = electromagnet_of(candidate)
    made = windings_of(candidate).moment_per_current(device.core, device.moments_at)
    stated = np.linalg.norm(device.moment_per_current, axis=0)
    return float(np.abs(np.linalg.norm(made, axis=0) / stated - 1).max())


_BOTH = "of the copper, from resistance and dimensions of the windings."
PARTS_QUANTITIES = (
    describe(
        "envelope_radius",
        "m",
        "minimise",
        "Distance of the farthest corner of magnets and coils from the centre; of a spherical electromagnet, its "
        "dome; of a coil array, its dome or the farthest winding.",
        {_PARTS_MOTOR: _motor_envelope, _PARTS_ELECTROMAGNET: _electromagnet_envelope, _PARTS_ARRAY: array_envelope},
    ),
    describe(
        "clearance",
        "m",
        "maximise",
        "Gap between rotor and stator; of a spherical electromagnet, smallest gap between windings and core or "
        "the dome's wall; "
        "of a coil array also plate.",
        {_PARTS_MOTOR: _gap, _PARTS_ELECTROMAGNET: _air, _PARTS_ARRAY: array_air},
    ),
    describe(
        "spacing",
        "m",
        "maximise",
        "Gap between neighbouring parts: of magnets or coils on their spheres, at the inner rims; of nested "
        "windings, where two cross. Negative: they overlap. Of a coil array, smallest gap between two windings.",
        {_PARTS_MOTOR: _spacing, _PARTS_ELECTROMAGNET: _nesting, _PARTS_ARRAY: array_spacing},
    ),
    describe(
        "moment_error",
        "",
        "minimise",
        "Largest relative difference, over the coils, between the moment per ampere of windings and core and that "
        "of the device file.",
        {_PARTS_ELECTROMAGNET: _moment_error},
    ),
    describe(
        "magnet_volume",
        "m³",
        "minimise",
        "Volume of all magnets of rotor or tool, without the regulator.",
        {
            _PARTS_MOTOR: lambda one: _rotor_magnets(one.device),
            _PARTS_ELECTROMAGNET: lambda one: _tool_magnet(one.device),
            _PARTS_ARRAY: lambda one: array_magnets(one.device),
        },
    ),
    describe(
        "moving_mass",
        "kg",
        "minimise",
        "Mass of rotor or tool from the file; if only its magnets differ from the base device, corrected by "
        "their volume.",
        {_PARTS_MOTOR: _rotor_mass, _PARTS_ELECTROMAGNET: _tool_mass, _PARTS_ARRAY: _array_mass},
    ),
    describe(
        "copper",
        "kg",
        "minimise",
        f"Mass {_BOTH}",
        {_PARTS_MOTOR: _motor_copper, _PARTS_ELECTROMAGNET: _winding_copper, _PARTS_ARRAY: array_copper},
    ),
    describe(
        "cost",
        "EUR",
        "minimise",
        "Magnets and copper by mass, channels and field sensors by number, at the prices of [evaluation] "
        "(magnet_price, copper_price, channel_price, sensor_price); assumed prices otherwise.",
        {_PARTS_MOTOR: _motor_cost, _PARTS_ELECTROMAGNET: _electromagnet_cost, _PARTS_ARRAY: _array_cost},
    ),
)


# --------------------------------------------------------------------------------------------------
# Accuracy of the pose from the field sensors, by the Cramér–Rao bound, and clearance of the sensors.
#
# The bounds are of one sample with its noise, currents off; lasting errors of the sensors are left out, as a
# calibration takes most of them away.


_SENSING_MOTOR, _SENSING_ELECTROMAGNET = "spherical-motor", "spherical-electromagnet"
_LAYERS, _DIRECTIONS = 4, 16
_SENSING_ORIENTATIONS = 100


def shell_places(device: SphericalElectromagnet) -> Array:
    """(64, 3) [m] positions of the tool's magnet that fill the shell: four layers, 16 directions each."""
    share = (np.arange(_LAYERS) + 0.5) / _LAYERS
    distances = device.contact_distance + device.shell_thickness * share
    directions = cap_directions(device.workspace_half_angle, _DIRECTIONS)
    places: Array = (distances[:, None, None] * directions).reshape(-1, 3)
    return places


def _position(candidate: DesignCandidate) -> float:
    device = electromagnet_of(candidate)
    if device.sensors < 2:
        raise InputError("locating a tool needs at least two field sensors: add them to [hall]")
    deviations = position_accuracy(device, shell_places(device))[:, :3]
    return float(np.sqrt((deviations**2).sum(axis=1).mean()))


def _orientation(candidate: DesignCandidate) -> float:
    motor = motor_of(candidate)
    table = load_field_table(motor.magnet, motor.magnets.distance, motor.sensor_layout.distance, precision=1e-5)
    angles = spread_angles(motor.workspace_tilt, int(option(candidate, "orientations", _SENSING_ORIENTATIONS)))
    R = np.ascontiguousarray(rotation_from_euler(angles[:, 0], angles[:, 1], angles[:, 2]))
    field, slope = np.empty((len(R), motor.sensors, 3)), np.empty((len(R), motor.sensors, 3, 3))
    tables.sensor_field_gradient(
        table.cells, table.scale, motor.magnets.directions, motor.polarity, motor.sensor_layout.directions, R, field,
        slope,
    )  # fmt: skip
    J = slope.reshape(len(R), -1, 3)
    variance = motor.hall.noise**2 + motor.hall.step**2 / 12
    spread = variance * np.trace(np.linalg.inv(J.transpose(0, 2, 1) @ J), axis1=1, axis2=2)
    return float(np.sqrt(spread.mean()))


def _room(candidate: DesignCandidate) -> float:
    device = electromagnet_of(candidate)
    at = device.hall.positions
    chip = option(candidate, "chip", CHIP_EDGE_M)
    dome = np.linalg.norm(at, axis=1) - device.dome_radius
    pen = pen_distance(device, at, option(candidate, "lean", GREATEST_LEAN)) - option(candidate, "pen", PEN_RADIUS_M)
    apart = np.linalg.norm(at[:, None] - at[None], axis=2) + np.diag(np.full(len(at), np.inf))
    return float(min(dome.min() - chip, pen.min() - chip, apart.min() - 2 * chip))


def _field(candidate: DesignCandidate) -> float:
    return float(find_sensor_field(electromagnet_of(candidate)).max())


SENSING_QUANTITIES = (
    describe("sensing_error", "m", "minimise",
             "Rms over the shell of the Cramér–Rao bound of the position error of one sample: radial "
             "tool, currents off.", {_SENSING_ELECTROMAGNET: _position}),
    describe("orientation_error", "rad", "minimise",
             "Rms over the workspace of the Cramér–Rao bound of the orientation error of one sample.",
             {_SENSING_MOTOR: _orientation}),
    describe("sensor_clearance", "m", "maximise",
             "Smallest clearance around the field sensors (half a chip: chip of [evaluation]): to the dome, to each "
             "other, and "
             "to a pen (radius: pen) tilted from the radius by up to lean [rad] anywhere in the workspace.",
             {_SENSING_ELECTROMAGNET: _room}),
    describe("sensor_field", "T", "minimise",
             "Upper bound of the reading of one axis of a field sensor: a tool in contact anywhere, leaning up to 15°, "
             "and all coils at the current that the supply drives.", {_SENSING_ELECTROMAGNET: _field}),
)  # fmt: skip


# --------------------------------------------------------------------------------------------------
# Heat, supply and stress of the windings while a device holds a load, or carries its full current.
#
# The load is `load` of the design file's table [evaluation], in N or N·m. It is applied continuously in the direction,
# and at the place or orientation, where it takes the most heat; resistances are those at the derating temperature.


_WARMTH_MOTOR, _WARMTH_ELECTROMAGNET, _WARMTH_ARRAY = "spherical-motor", "spherical-electromagnet", "coil-array"
_LOADS = {_WARMTH_MOTOR: 0.1, _WARMTH_ELECTROMAGNET: 0.05, _WARMTH_ARRAY: 0.05}  #: N·m and N
_FIND_HEAVIEST = {
    _WARMTH_MOTOR: motor_torque_find_heaviest,
    _WARMTH_ELECTROMAGNET: tool_force_find_heaviest,
    _WARMTH_ARRAY: find_heaviest,
}


def _channel_powers(candidate: DesignCandidate) -> Array:
    """(m,) heat [W] of the channels that hold the load."""
    device = candidate.device
    load = option(candidate, "load", _LOADS[device.kind.name])
    warm = device.coils.resistance_at(np.full(device.channels, device.coils.heat.derate))
    powers: Array = _FIND_HEAVIEST[device.kind.name](candidate)[1] * load**2 * warm
    return powers


def _temperature(candidate: DesignCandidate) -> float:
    device = candidate.device
    rise = device.coils.heat.network(device.channels).rise_per_watt @ _channel_powers(candidate)
    return float(device.coils.heat.ambient + rise.max())


def _power(candidate: DesignCandidate) -> float:
    return float(_channel_powers(candidate).sum())


def _hoop(coil: Coil, current: float, extra: float = 0.0, mirror: float = 1.0) -> float:
    """J B r [Pa] at the inner radius, with the coil's own field there, `mirror` times, and `extra` [T]."""
    density = coil.turns * current / (coil.length * (coil.outer_radius - coil.inner_radius))
    own = float(coil.field((coil.inner_radius, 0.0, 0.0))[2]) * current
    return abs(density * (mirror * abs(own) + extra) * coil.inner_radius)


def _motor_stress(candidate: DesignCandidate) -> float:
    motor = motor_of(candidate)
    # a magnet that stands before the coil adds its own field; half its polarization is more than it has outside
    return _hoop(motor.electromagnet, float(motor.driven_current.max()), 0.5 * motor.magnet.polarization)


def _winding_stress(candidate: DesignCandidate) -> float:
    device, windings = electromagnet_of(candidate), windings_of(candidate)
    fields = 2e-7 * windings.parts(device.core)[:, 1] / windings.inner_radius**3  # of the core, on the coil's axis
    both = zip(windings.coils, device.driven_current.tolist(), fields.tolist(), strict=True)
    return max(_hoop(coil, current, field * current) for coil, current, field in both)


def _array_stress(candidate: DesignCandidate) -> float:
    device = array_of(candidate)
    coils, currents = device.windings, device.driven_current
    # the tool's magnets as a motor's; a soft core mirrors at most the coil's own field
    magnets = 0.5 * max(magnet.remanence for magnet in device.tool.magnets)
    mirror = 2.0 if device.core is not None else 1.0
    sizes = np.column_stack([coils.turns, coils.inner_radius, coils.outer_radius, coils.length, currents])
    return max(_hoop(Coil(*size[:4]), size[4], magnets, mirror) for size in np.unique(sizes, axis=0).tolist())


_LOAD = "with the load of [evaluation] applied continuously in the worst direction and position"
WARMTH_QUANTITIES = (
    describe("temperature", "K", "minimise", f"Temperature of the hottest winding {_LOAD}.",
             {_WARMTH_MOTOR: _temperature, _WARMTH_ELECTROMAGNET: _temperature, _WARMTH_ARRAY: _temperature}),
    describe("supply_power", "W", "minimise", f"Heat of all windings {_LOAD}: power from the supply.",
             {_WARMTH_MOTOR: _power, _WARMTH_ELECTROMAGNET: _power, _WARMTH_ARRAY: _power}),
    describe("coil_stress", "Pa", "minimise",
             "Hoop stress of a free turn at the inner radius, J B r, at full current, with an upper bound of the "
             "field there.",
             {_WARMTH_MOTOR: _motor_stress, _WARMTH_ELECTROMAGNET: _winding_stress, _WARMTH_ARRAY: _array_stress}),
)  # fmt: skip


# --------------------------------------------------------------------------------------------------
# The weight-compensating regulator of a motor: accuracy, volume of magnet, and disturbance by the coils.


_REGULATOR_TILTS = 40


def _regulator_of(candidate: DesignCandidate) -> Regulator:
    regulator = motor_of(candidate).regulator
    if regulator is None:
        raise InputError("this quantity is of a motor with a regulator: add [regulator.stator] and [regulator.rotor]")
    return regulator


def _regulator_shares(candidate: DesignCandidate) -> Array:
    """Torque of the regulator over that of the weight, from upright to the corners of the workspace."""
    _regulator_of(candidate)
    motor = motor_of(candidate)
    if motor.weight_torque <= 0.0:
        raise InputError("the weight itself holds this rotor up: rotor.centre_of_mass is not above the centre")
    cosines = np.linspace(1.0, np.cos(motor.workspace_tilt) ** 2, _REGULATOR_TILTS)
    left: Array = np.array([torque_over_sine(float(cosine), *motor.tilt_torque) for cosine in cosines])
    return 1.0 + left / motor.weight_torque


def _regulator_error(candidate: DesignCandidate) -> float:
    return float(np.abs(_regulator_shares(candidate) - 1.0).max())


def _regulator_hold(candidate: DesignCandidate) -> float:
    return float(_regulator_shares(candidate)[0])


def _regulator_volume(candidate: DesignCandidate) -> float:
    regulator = _regulator_of(candidate)
    rings = (regulator.stator_ring, regulator.rotor_ring)
    return float(sum(np.pi * (ring.outer_radius**2 - ring.inner_radius**2) * ring.length for ring in rings))


def _regulator_pull(candidate: DesignCandidate) -> float:
    _regulator_of(candidate)
    return measure_ring_pull(motor_of(candidate))


REGULATOR_QUANTITIES = (
    describe("regulator_error", "", "minimise",
             "Greatest difference, over the tilts of the workspace, of the regulator's torque from the weight's, "
             "relative to the weight's at that tilt.", {"spherical-motor": _regulator_error}),
    describe("regulator_hold", "", "maximise",
             "Torque of the regulator over that of the weight at a small tilt: from 1 on it holds the rotor up.",
             {"spherical-motor": _regulator_hold}),
    describe("regulator_volume", "m³", "minimise", "Volume of the regulator's two rings.",
             {"spherical-motor": _regulator_volume}),
    describe("regulator_pull", "", "minimise",
             "Greatest torque per ampere of a coil on the regulator's ring on the rotor, relative to a coil's greatest "
             "on the magnets.", {"spherical-motor": _regulator_pull}),
)  # fmt: skip


_KNOWN = {
    one.name: one
    for one in (
        *QUANTITIES,
        *TOOL_FORCE_QUANTITIES,
        *PARTS_QUANTITIES,
        *WARMTH_QUANTITIES,
        *SENSING_QUANTITIES,
        *REGULATOR_QUANTITIES,
    )
}


def quantity(name: str) -> DesignQuantity:
    """The quantity of that name; UnknownName with the nearest ones for another.

    >>> quantity("core_pull").unit
    'N'
    """
    if name not in _KNOWN:
        raise UnknownName("quantity", name, sorted(_KNOWN))
    return _KNOWN[name]


def quantity_names(kind: str | None = None) -> tuple[str, ...]:
    """Names of all quantities, or of those that devices of `kind` have, in alphabetical order.

    >>> "core_pull" in quantity_names("spherical-motor")
    False
    """
    return tuple(sorted(name for name, one in _KNOWN.items() if kind is None or kind in one.kinds))
