"""Derivatives of a spherical motor's torque and of its sensors' readings by how its parts are built.

Torque. A magnet and a coil whose axes u and c go through the motor's centre have the co-energy per ampere Λ(s) =
−μ0 Σ cₙ dₙ Pₙ(s), s = u·c, of the coil's and the magnet's zonal harmonics (`haptorb.devices.tables`). The harmonics
also give what a displacement does. A potential Pₙ(r̂·c)/rⁿ⁺¹ that is displaced by −e changes by −(e·∂/∂c) of
|c|ⁿ⁺¹ Pₙ₊₁/rⁿ⁺², so a magnet that is displaced by e has in addition

    δΛ = (e·c) A(s) − (e·u) D(s),   A = −μ0 Σ cₙ dₙ₊₁ Pₙ′,   D = −μ0 Σ cₙ dₙ₊₁ Pₙ₊₁′

and a coil that is displaced has the opposite. A part that is tilted about its own centre is one that is turned about
the motor's centre and displaced back. Other edges, and turns of each layer, are other cₙ. The torque on the rotor is
the derivative of the co-energy by a rotation that turns u and e. None of this is shared with the simulation, which sums
loops and charges.

Readings. The field of a magnet is in the plane of its axis, so its gradient at a sensor is four functions of s, which
are tabulated from the closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from haptorb.arrays import Array, gauss_legendre
from haptorb.compiled import kernel
from haptorb.devices.motor import SphericalMotor
from haptorb.devices.tables import PairTable, expand_discs, expand_loops, tabulate_slopes, tabulate_values
from haptorb.errors import GeometryError
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.dipole import MU0
from haptorb.magnetics.wire import overall_diameter, wind, wire_diameter

__all__ = ["MotorSlopes", "PartDeviations", "ToleranceSlopes", "count_layers"]


_ACROSS, _ALONG = 24, 12  #: loops of a winding, at Gauss points across and along
_EDGE_STEP_M = 1e-5  #: of a winding's edge, for a derivative
_LEFT = 1e-10  #: share of the first term that the terms which are left out may have
_MAX_TERMS = 1200
_FIELD_ANGLES = 1024  #: pieces of the table of a magnet's field at a sensor
_PAIR = 6  #: functions of a pair before those of the layers: k, A, D, and k by each of three edges


class MotorSlopes(NamedTuple):
    """Derivatives at one orientation: of the torque on the rotor [N·m], and of the sensors' fit.

    A part's first three columns are by its displacement [m], the other three by the tilt of its axis [1], in the frame
    in which the part rests.
    """

    magnets: Array  #: (3, p, 6)
    coils: Array  #: (3, c, 6)
    edges: Array  #: (3, c, 3) by inner radius, outer radius and length [m]
    layers: Array  #: (3, c, l) by turns in each layer
    fit_magnets: Array  #: (f, p, 6)
    fit_sensors: Array  #: (f, k, 3) by the displacement of each field sensor [m]


@dataclass
class PartDeviations:
    """How the parts of one motor differ from its file; all zeros: not at all."""

    magnets: Array  #: (p, 6) displacement [m] and tilt of the axis, rotor frame
    coils: Array  #: (c, 6) the same, stator frame
    edges: Array  #: (c, 3) excess of inner radius, outer radius and length [m]
    layers: Array  #: (c, l) turns in each layer, beyond those of a winding that is filled evenly

    @classmethod
    def none(cls, device: SphericalMotor, layers: int) -> PartDeviations:
        """No deviations of the parts of `device`, whose coils have so many layers."""
        c = len(device.electromagnets)
        return cls(np.zeros((len(device.magnets), 6)), np.zeros((c, 6)), np.zeros((c, 3)), np.zeros((c, layers)))

    def change_torque(self, slopes: MotorSlopes) -> Array:
        """(3,) torque on the rotor beside that of the file's parts [N·m]."""
        found: Array = (
            slopes.magnets.reshape(3, -1) @ self.magnets.ravel()
            + slopes.coils.reshape(3, -1) @ self.coils.ravel()
            + slopes.edges.reshape(3, -1) @ self.edges.ravel()
            + slopes.layers.reshape(3, -1) @ self.layers.ravel()
        )
        return found


def count_layers(device: SphericalMotor) -> Array:
    """(l,) turns in each layer of a coil [1], from inside; all but the last are full.

    One layer with all turns where the wire is thicker than the winding is long.
    """
    coil, coils = device.electromagnet, device.coils
    in_series = float(np.abs(device.groups).sum(axis=0)[0])
    copper = wire_diameter(coil, float(coils.resistance[0]) / in_series, coils.copper_resistivity)
    made = wind(coil.turns, coil.inner_radius, coil.length, overall_diameter(copper))
    return np.array([coil.turns]) if made is None else made.count_turns(coil.turns)


class ToleranceSlopes:
    """Derivatives of torque and readings of `device`; its coils have `layers` (l,) turns.

    Raises GeometryError for a motor without a gap between coils and magnets.
    """

    def __init__(self, device: SphericalMotor) -> None:
        self._device, self.layers = device, count_layers(device)
        self._pair = _tabulate_pair(device, len(self.layers))
        self._field = _tabulate_gradient(device)
        self._polarity = np.array(device.polarity, dtype=np.float64)

    def find(self, R: Array, currents: Array, solve: Array) -> MotorSlopes:
        """At the orientation R (3, 3), for `currents` (c,) [A] in the coils and a fit by `solve` (f, 3 k).

        Without columns in `solve` there is no fit, and its derivatives are zero.
        """
        device, layers = self._device, len(self.layers)
        p, c, k = len(device.magnets), len(device.electromagnets), len(device.sensor_layout)
        found = MotorSlopes(
            np.zeros((3, p, 6)), np.zeros((3, c, 6)), np.zeros((3, c, 3)), np.zeros((3, c, layers)),
            np.zeros((len(solve), p, 6)), np.zeros((len(solve), k, 3)),
        )  # fmt: skip
        u = np.ascontiguousarray(device.magnets.directions @ R.T)
        _fill_torque_slopes(
            self._pair.cells, self._pair.scale, u, self._polarity, device.magnets.distance,
            device.electromagnets.directions, currents, device.electromagnets.distance, found.magnets, found.coils,
            found.edges, found.layers,
        )  # fmt: skip
        if solve.size:
            _fill_fit_slopes(
                self._field.cells, self._field.scale, u, self._polarity, device.magnets.distance,
                device.sensor_layout.directions, device.sensor_layout.distance, np.ascontiguousarray(solve),
                found.fit_magnets, found.fit_sensors,
            )  # fmt: skip
        rotor = found.magnets.reshape(-1, 3) @ R, found.fit_magnets.reshape(-1, 3) @ R
        return found._replace(magnets=rotor[0].reshape(3, p, 6), fit_magnets=rotor[1].reshape(-1, p, 6))


def _tabulate_pair(device: SphericalMotor, layers: int) -> PairTable:
    """k = Λ′, A and D of a magnet and a coil, k by each edge of the winding, and k of one turn in each layer."""
    magnet, coil = device.magnet, device.electromagnet
    out, away = float(device.magnets.distance), float(device.electromagnets.distance)
    discs = out + 0.5 * magnet.length * np.array([-1.0, 1.0])
    reach, rim = float(np.hypot(away + 0.5 * coil.length, coil.outer_radius)), float(np.hypot(discs[0], magnet.radius))
    if reach >= discs[0]:
        raise GeometryError(
            f"device '{device.name}': no gap between coils and magnets: coils reach {reach * 1e3:.2f} mm from the "
            f"centre, magnets begin at {discs[0] * 1e3:.2f} mm; the error budget needs one"
        )
    terms = int(np.clip(np.log(_LEFT * (1 - reach / rim)) / np.log(reach / rim), 24, _MAX_TERMS))
    unit = np.sqrt(reach * rim)  # powers of lengths stay within the range of numbers
    charge = magnet.polarization / MU0 * np.array([-1.0, 1.0])
    faces = expand_discs(discs / unit, magnet.radius / unit, charge, terms + 1)

    def expand(one: Coil) -> Array:
        radii, heights, turns = one.filaments(_ACROSS, _ALONG)
        found: Array = expand_loops(radii / unit, (away + heights) / unit, turns, terms)
        return found

    whole, sizes = expand(coil), (coil.inner_radius, coil.outer_radius, coil.length)
    edges = []
    for step in _EDGE_STEP_M * np.eye(3):
        larger, smaller = (Coil(coil.turns, *(np.array(sizes) + way * step).tolist()) for way in (1, -1))
        edges.append((expand(larger) - expand(smaller)) / (2 * _EDGE_STEP_M))
    nodes, weights = gauss_legendre(_ALONG)
    heights, depth = (away + 0.5 * coil.length * nodes) / unit, coil.outer_radius - coil.inner_radius
    turns = [
        expand_loops(np.full(_ALONG, (coil.inner_radius + depth * share) / unit), heights, 0.5 * weights, terms)
        for share in (np.arange(layers) + 0.5) / layers
    ]
    near, steep = -MU0 * unit**2 * faces[:-1], np.zeros((2, terms + 2))
    steep[0, :-1] = steep[1, 1:] = -MU0 * unit * whole * faces[1:]  # of Pₙ′, and of Pₙ₊₁′
    torque = np.zeros((1 + 3 + layers, terms + 2))
    torque[:, :-1] = near * np.stack([whole, *edges, *turns])
    return tabulate_slopes(np.concatenate([torque[:1], steep, torque[1:]]))


def _tabulate_gradient(device: SphericalMotor) -> PairTable:
    """B_ρ/ρ, B_z, (∂B_ρ/∂ρ − B_ρ/ρ)/ρ² and (∂B_ρ/∂z)/ρ of a magnet at a sensor, ρ from the magnet's axis."""
    angles = np.pi * (np.arange(_FIELD_ANGLES) + 0.5) / _FIELD_ANGLES
    sensor = float(device.sensor_layout.distance)
    points = np.zeros((_FIELD_ANGLES, 3))
    points[:, 0], points[:, 2] = sensor * np.sin(angles), sensor * np.cos(angles) - device.magnets.distance
    field, slopes, rho = device.magnet.field(points), device.magnet.field_gradient(points), points[:, 0]
    over = field[:, 0] / rho
    return tabulate_values(np.stack([over, field[:, 2], (slopes[:, 0, 0] - over) / rho**2, slopes[:, 0, 2] / rho]))


# --------------------------------------------------------------------------------------------------
# Sums over the pairs.


@kernel
def _read_piece(cells: Array, piece: int, number: int, t: float) -> float:
    """Function `number` at the place t in a piece."""
    c = cells[piece, 6 * number : 6 * number + 6]
    return float(c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5])))))


@kernel
def _read_slope(cells: Array, piece: int, number: int, t: float) -> float:
    """Its derivative by t."""
    c = cells[piece, 6 * number : 6 * number + 6]
    return float(c[1] + t * (2.0 * c[2] + t * (3.0 * c[3] + t * (4.0 * c[4] + t * 5.0 * c[5]))))


@kernel
def _fill_cross(v: Array, out: Array) -> None:
    """out (3, 3) with out @ x = x × v."""
    out[0, 0], out[0, 1], out[0, 2] = 0.0, v[2], -v[1]
    out[1, 0], out[1, 1], out[1, 2] = -v[2], 0.0, v[0]
    out[2, 0], out[2, 1], out[2, 2] = v[1], -v[0], 0.0


@kernel
def _fill_torque_slopes(
    cells: Array, scale: float, magnets: Array, polarity: Array, magnet_distance: float, coils: Array, currents: Array,
    coil_distance: float, by_magnets: Array, by_coils: Array, by_edges: Array, by_layers: Array,
) -> None:  # fmt: skip
    """Add to the derivatives of `MotorSlopes` those of the torque; magnets (p, 3) and coils (c, 3) are axes, in S."""
    last = cells.shape[0] - 1
    X, Y = np.empty((3, 3)), np.empty((3, 3))
    for j in range(coils.shape[0]):
        c = coils[j]
        _fill_cross(c, X)
        for i in range(magnets.shape[0]):
            u = magnets[i]
            _fill_cross(u, Y)
            s = u[0] * c[0] + u[1] * c[1] + u[2] * c[2]
            chord = scale * math.sqrt(max(2.0 - 2.0 * s, 1e-18))
            piece = min(int(chord), last)
            t, per_cosine = chord - piece, -scale * scale / chord  # dt/ds
            size = polarity[i] * currents[j]
            k, A = size * _read_piece(cells, piece, 0, t), size * _read_piece(cells, piece, 1, t)
            D, steep = size * _read_piece(cells, piece, 2, t), size * per_cosine
            dk, dA = steep * _read_slope(cells, piece, 0, t), steep * _read_slope(cells, piece, 1, t)
            dD = steep * _read_slope(cells, piece, 2, t)
            for a in range(3):
                across = X[a, 0] * u[0] + X[a, 1] * u[1] + X[a, 2] * u[2]  # (u × c)_a
                for b in range(3):
                    along = across * (dA * c[b] - dD * u[b])
                    moved = A * X[a, b] + along
                    by_magnets[a, i, b] += moved
                    by_magnets[a, i, 3 + b] += k * X[a, b] + dk * across * c[b] - magnet_distance * moved
                    moved = -D * Y[a, b] - along
                    by_coils[a, j, b] += moved
                    by_coils[a, j, 3 + b] += -k * Y[a, b] + dk * across * u[b] - coil_distance * moved
                    by_edges[a, j, b] += across * size * _read_piece(cells, piece, 3 + b, t)
            for n in range(by_layers.shape[2]):
                turn = size * _read_piece(cells, piece, _PAIR + n, t)
                for a in range(3):
                    by_layers[a, j, n] += turn * (X[a, 0] * u[0] + X[a, 1] * u[1] + X[a, 2] * u[2])


@kernel
def _fill_fit_slopes(
    cells: Array, scale: float, magnets: Array, polarity: Array, magnet_distance: float, sensors: Array,
    sensor_distance: float, solve: Array, by_magnets: Array, by_sensors: Array,
) -> None:  # fmt: skip
    """Add to the derivatives of `MotorSlopes` those of the fit by `solve` (f, 3 k); all directions (., 3) in S."""
    last = cells.shape[0] - 1
    w, q, J, total, M = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 6))
    for j in range(sensors.shape[0]):
        total[:] = 0.0
        for i in range(magnets.shape[0]):
            u, z, cosine = magnets[i], 0.0, 0.0
            for a in range(3):
                cosine += u[a] * sensors[j, a]
                w[a] = sensor_distance * sensors[j, a] - magnet_distance * u[a]
                z += w[a] * u[a]
            square = 0.0
            for a in range(3):
                q[a] = w[a] - z * u[a]
                square += q[a] * q[a]
            chord = scale * math.sqrt(max(2.0 - 2.0 * cosine, 0.0))
            piece = min(int(chord), last)
            t, size = chord - piece, polarity[i]
            over = size * _read_piece(cells, piece, 0, t)
            axial = size * _read_piece(cells, piece, 1, t)
            curved = size * _read_piece(cells, piece, 2, t)
            mixed = size * _read_piece(cells, piece, 3, t)
            rest = -(2.0 * over + square * curved) - over  # ∂B_z/∂z − B_ρ/ρ
            for a in range(3):
                for b in range(3):
                    J[a, b] = curved * q[a] * q[b] + mixed * (q[a] * u[b] + u[a] * q[b]) + rest * u[a] * u[b]
                J[a, a] += over
            turned = axial  # u·B
            for a in range(3):
                within = J[a, 0] * u[0] + J[a, 1] * u[1] + J[a, 2] * u[2]
                for b in range(3):
                    total[a, b] += J[a, b]
                    M[a, b] = -J[a, b]
                    field = over * q[b] + axial * u[b]
                    M[a, 3 + b] = -u[a] * field - J[a, b] * z + within * w[b]
                M[a, 3 + a] += turned
            for f in range(solve.shape[0]):
                x, y, v = solve[f, 3 * j], solve[f, 3 * j + 1], solve[f, 3 * j + 2]
                for b in range(6):
                    by_magnets[f, i, b] += x * M[0, b] + y * M[1, b] + v * M[2, b]
        for f in range(solve.shape[0]):
            for b in range(3):
                for a in range(3):
                    by_sensors[f, j, b] += solve[f, 3 * j + a] * total[a, b]
