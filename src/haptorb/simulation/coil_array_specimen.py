"""Specimen of a coil array: coils drawn within its tolerances, their fields from loops, the magnets as currents.

Coils are displaced and tilted, with deviating radii and turns, and magnets have a deviating remanence. Coils and
magnets share nothing with the controller's model: a winding is current loops by elliptic integrals (Smythe, Static and
Dynamic Electricity, §7.10), a magnet is the current around its sides (Ampère), on which the coils' field exerts F = I ∮
dl × B. The field of each coil is tabulated in advance, on a fine grid near it and a coarse one elsewhere. A soft core
is that of the file; its response to the drawn coils and magnets is in solid harmonics, as in the controller's model.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple
from zlib import crc32

import numpy as np

from haptorb.arrays import Array, gauss_legendre
from haptorb.compiled import kernel
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.coil_array import ArrayMover, BuildTolerance, CoilArray
from haptorb.devices.coil_array_wrench_map import ArrayMap, add_core
from haptorb.devices.placed_coils import PlacedCoils, place_coils
from haptorb.magnetics.current_sheets import loop_field
from haptorb.magnetics.dipole import MU0
from haptorb.magnetics.soft_sphere import response_to_source

__all__ = ["ArrayTruth", "draw_coils", "draw_strength", "fill_array_truth", "make_array_truth"]

#: Points along and around each side of a long magnet, from few to many; there are fewer along a flat one.
_RULES = ((3, 6), (4, 8), (5, 11), (7, 17), (9, 26), (13, 48))
#: Greatest half size of a magnet over its distance from the winding up to which each rule but the last is used.
_LIMITS = np.array((0.12, 0.3, 0.55, 1.0, 1.8))
_LOOPS = (4, 6)  #: of a winding, across and along, at Gauss points
_CELLS_NEAR = 32  #: steps of the fine grid over the winding's greatest size, which is as wide as … (see _REACH)
_REACH = 2.5  #: sizes of the winding that the fine grid spans from its centre
_MARGIN = 2  #: steps of a grid beyond its ends, which interpolation needs


class ArrayTruth(NamedTuple):
    """Drawn coils and magnets in the form that compiled code needs."""

    centres: Array  #: (m, 3) [m]
    axes: Array  #: (m, 3)
    sizes: Array  #: (m, 4) inner radius, outer radius, half length, greatest size [m]
    fine: Array  #: (m, n, n', 2) B_ρ/ρ [T/(A·m)] and B_z [T/A] over radius and height
    coarse: Array  #: (m, n, n', 2) the same, with steps `coarseness` times as wide
    coarseness: float
    points: Array  #: (6, n) places [m] and current elements [A·m] of all magnets and rules, mover frame
    spans: Array  #: (g, rules + 1) the first point of each magnet's rules
    magnets: Array  #: (g, 4) centres, mover frame, and half the greatest size of each [m]
    core: ArrayMap  #: drawn coils and magnets with the core
    strength: float  #: of the magnets over the file's


@kernel
def _weigh(t: float, w: Array) -> None:
    """Weights w (4,) of cubic convolution (Keys 1981) at t, 0 to 1, between the second and the third point."""
    w[0] = t * (-0.5 + t * (1.0 - 0.5 * t))
    w[1] = 1.0 + t * t * (-2.5 + 1.5 * t)
    w[2] = t * (0.5 + t * (2.0 - 1.5 * t))
    w[3] = t * t * (-0.5 + 0.5 * t)


@kernel
def _look_up(table: Array, x: float, y: float, a: Array, b: Array) -> tuple[float, float]:
    """B_ρ/ρ and B_z at `x` and `y` steps of the grid from its second point; held at its ends."""
    i = min(max(int(np.floor(x)), 0), table.shape[0] - 4)
    j = min(max(int(np.floor(y)), 0), table.shape[1] - 4)
    _weigh(min(x - i, 1.0), a)
    _weigh(min(y - j, 1.0), b)
    over, axial = 0.0, 0.0
    for k in range(4):
        first, second = 0.0, 0.0
        for n in range(4):
            first += b[n] * table[i + k, j + n, 0]
            second += b[n] * table[i + k, j + n, 1]
        over += a[k] * first
        axial += a[k] * second
    return over, axial


@kernel
def fill_array_truth(t: ArrayTruth, pose: Array, out: Array, passive: Array) -> None:
    """Fill out (6, m) [N/A, N·m/A] and passive (6,) [N, N·m], torque about p, for the mover at `pose` (4, 3), R above
    p."""
    R, p, a, b = pose[:3], pose[3], np.empty(4), np.empty(4)
    placed = np.empty((9, t.points.shape[1]))
    for n in range(placed.shape[1]):
        for i in range(3):
            arm, flow = 0.0, 0.0
            for k in range(3):
                arm += R[i, k] * t.points[k, n]
                flow += R[i, k] * t.points[3 + k, n]
            placed[i, n], placed[3 + i, n], placed[6 + i, n] = p[i] + arm, arm, flow
    for j in range(t.centres.shape[0]):
        cx, cy, cz = t.centres[j, 0], t.centres[j, 1], t.centres[j, 2]
        ax, ay, az = t.axes[j, 0], t.axes[j, 1], t.axes[j, 2]
        inner, outer, half, size = t.sizes[j, 0], t.sizes[j, 1], t.sizes[j, 2], t.sizes[j, 3]
        scale = _CELLS_NEAR / size
        for i in range(6):
            out[i, j] = 0.0
        for g in range(t.magnets.shape[0]):
            x, y, z = p[0] - cx, p[1] - cy, p[2] - cz
            for k in range(3):
                x += R[0, k] * t.magnets[g, k]
                y += R[1, k] * t.magnets[g, k]
                z += R[2, k] * t.magnets[g, k]
            along = x * ax + y * ay + z * az
            across = np.sqrt(max(x * x + y * y + z * z - along * along, 0.0))
            radius = t.magnets[g, 3]
            away = np.sqrt(max(inner - across, across - outer, 0.0) ** 2 + max(abs(along) - half, 0.0) ** 2)
            rule = 0
            while rule < _LIMITS.shape[0] and radius > _LIMITS[rule] * max(away - radius, 0.0):
                rule += 1
            for n in range(t.spans[g, rule], t.spans[g, rule + 1]):
                x, y, z = placed[0, n] - cx, placed[1, n] - cy, placed[2, n] - cz
                along = x * ax + y * ay + z * az
                x -= along * ax
                y -= along * ay
                z -= along * az
                rho = np.sqrt(x * x + y * y + z * z)
                sign = 1.0 if along >= 0.0 else -1.0
                if max(rho, abs(along)) < _REACH * size:
                    over, axial = _look_up(t.fine[j], scale * rho, scale * abs(along), a, b)
                else:
                    wide = scale / t.coarseness
                    over, axial = _look_up(t.coarse[j], wide * rho, wide * abs(along), a, b)
                over *= sign
                bx, by, bz = over * x + axial * ax, over * y + axial * ay, over * z + axial * az
                ix, iy, iz = placed[6, n], placed[7, n], placed[8, n]
                fx, fy, fz = iy * bz - iz * by, iz * bx - ix * bz, ix * by - iy * bx
                rx, ry, rz = placed[3, n], placed[4, n], placed[5, n]
                out[0, j] += fx
                out[1, j] += fy
                out[2, j] += fz
                out[3, j] += ry * fz - rz * fy
                out[4, j] += rz * fx - rx * fz
                out[5, j] += rx * fy - ry * fx
    passive[:] = 0.0
    if t.core.core_radius > 0.0:
        add_core(t.core, pose, out, passive, 0)
    for i in range(6):
        for j in range(out.shape[1]):
            out[i, j] *= t.strength
        passive[i] *= t.strength * t.strength


@kernel
def _fill_grid(radii: Array, heights: Array, turns: Array, step: float, out: Array) -> None:
    """out (n, n', 2): field of loops (f,) at radii (i − 1) step and heights (j − 1) step; even, and odd in B_ρ/ρ."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            over, axial = 0.0, 0.0
            for f in range(radii.shape[0]):
                a, b = loop_field(radii[f], abs(i - 1) * step, (j - 1) * step - heights[f])
                over += MU0 * turns[f] * a
                axial += MU0 * turns[f] * b
            out[i, j, 0], out[i, j, 1] = over, axial


def _flow_around(tool: ArrayMover) -> tuple[Array, Array, Array]:
    """Points, spans and magnets of `tool`, as `ArrayTruth` has them."""
    points, spans, magnets, count = [], [], [], 0
    for magnet in tool.magnets:
        frame, starts = rotation_to_axis(magnet.axis), []
        for along, around in _RULES:
            starts.append(count)
            share = 0.5 * magnet.length / np.hypot(magnet.outer_radius, 0.5 * magnet.length)
            node, weight = gauss_legendre(int(np.ceil(along * share)))
            angle = 2 * np.pi * (np.arange(around) + 0.5) / around
            for radius, sense in ((magnet.outer_radius, 1.0), (magnet.inner_radius, -1.0)):
                if radius == 0.0:
                    continue
                rim = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(around)], axis=1)
                flow = np.stack([-np.sin(angle), np.cos(angle), np.zeros(around)], axis=1)
                # surface current J/μ0 per length, times the length of the band, times the step around it
                bands = 0.5 * magnet.length * weight * sense * magnet.remanence / MU0 * (2 * np.pi * radius / around)
                for height, band in zip(0.5 * magnet.length * node, bands, strict=True):
                    at = rim + np.array([0.0, 0.0, height])
                    points.append(np.hstack([at @ frame.T + magnet.position, band * flow @ frame.T]).T)
                    count += around
        spans.append([*starts, count])
        magnets.append([*magnet.position, float(np.hypot(magnet.outer_radius, 0.5 * magnet.length))])
    return np.ascontiguousarray(np.hstack(points)), np.array(spans), np.array(magnets)


def make_array_truth(device: CoilArray, windings: PlacedCoils, strength: float = 1.0) -> ArrayTruth:
    """Tables of drawn `windings`, and currents of the tool's magnets, which are `strength` times as strong."""
    count, surface, tool = len(windings.turns), device.surface, device.tool
    sizes = np.column_stack([
        windings.inner_radius, windings.outer_radius, 0.5 * windings.length,
        np.maximum(windings.outer_radius, 0.5 * windings.length),
    ])  # fmt: skip
    # Maximum distance of a magnet from a coil, with a margin for a hand that pulls the tool out of its workspace.
    across = surface.dome_radius or float(np.hypot(*surface.half_width))
    far = 1.5 * (float(np.linalg.norm(windings.position, axis=1).max()) + across + surface.thickness + tool.reach)
    near = int(np.ceil(_REACH * _CELLS_NEAR)) + 2 * _MARGIN
    coarseness = max(1.0, far / (_REACH * float(sizes[:, 3].min())))
    fine, coarse = np.empty((count, near, near, 2)), np.empty((count, near, near, 2))
    for number in range(count):
        radii, heights, turns = windings.coil(number).filaments(*_LOOPS)
        step = float(sizes[number, 3]) / _CELLS_NEAR
        _fill_grid(radii, heights, turns, step, fine[number])
        _fill_grid(radii, heights, turns, coarseness * step, coarse[number])
    core = device.magnetics
    if device.core is not None:
        responses = [response_to_source(device.core, placed, core.order) for placed in place_coils(windings)]
        core = core._replace(responses=np.stack(responses))
    return ArrayTruth(
        np.ascontiguousarray(windings.position), np.ascontiguousarray(windings.axis), sizes, fine, coarse, coarseness,
        *_flow_around(tool), core, strength,
    )  # fmt: skip


# --------------------------------------------------------------------------------------------------
# Drawing of a specimen.


def draw_coils(device: CoilArray, specimen: int = 0) -> PlacedCoils:
    """Coils of a `specimen` of `device` within its tolerances; reproducible for one file and number."""
    coils, tolerance = device.windings, device.tolerance
    draw = np.random.Generator(np.random.PCG64([crc32(device.digest.encode()), specimen]))
    shift, lean = draw.standard_normal((2, *coils.position.shape))
    stronger, edges = draw.standard_normal(len(coils.turns)), draw.standard_normal((3, len(coils.turns)))
    axis = coils.axis + tolerance.tilt * np.cross(lean, coils.axis)
    inner, outer, length = tolerance.winding * edges
    return replace(
        coils,
        position=coils.position + tolerance.position * shift,
        axis=axis / np.linalg.norm(axis, axis=1, keepdims=True),
        turns=coils.turns * (1.0 + tolerance.strength * stronger),
        inner_radius=np.maximum(coils.inner_radius + inner, 0.5 * coils.inner_radius),
        outer_radius=np.maximum(coils.outer_radius + outer, 0.5 * (coils.inner_radius + coils.outer_radius)),
        length=np.maximum(coils.length + length, 0.5 * coils.length),
    )


def draw_strength(device: CoilArray, specimen: int = 0) -> float:
    """Strength of the magnets of a `specimen` over the file's; 1 for a device without tolerances."""
    if device.tolerance == BuildTolerance():
        return 1.0
    draw = np.random.Generator(np.random.PCG64([crc32(device.digest.encode()), specimen, 0x6]))
    return 1.0 + device.uncertainty.remanence * float(draw.standard_normal())
