"""Series of sintered NdFeB by their letters, and the check that a magnet keeps its polarization.

A magnet works where the field strength in it, opposed to its polarization J, stays below the knee of its curve J(H);
beyond, a part of J is lost for good. That field strength is the magnet's own (B − J)/µ0, with those of its neighbours
and of the coils at their peak. The knee moves towards zero as the magnet warms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Annotated, Literal, final

import numpy as np

from haptorb.arrays import Array, gauss_legendre
from haptorb.devices import quantity as q
from haptorb.devices.build_checks import BuildCheck, format_bound
from haptorb.devices.schema import Form, Meaning, Positive, Without
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.dipole import MU0, MU0_OVER_4PI
from haptorb.magnetics.magnets import CylinderMagnet, RingMagnet

__all__ = [
    "ANY_MAGNET",
    "SERIES",
    "Letters",
    "MagnetSeries",
    "MagnetUse",
    "Temperature",
    "charge_field",
    "check_magnet",
    "choose_series",
    "coil_field",
    "own_field",
]


@final
@dataclass(frozen=True)
class MagnetSeries:
    """One series: least intrinsic coercivity at 20 °C, its change with temperature, and the strongest magnet sold."""

    letters: str
    coercivity: float  #: H_cJ at 20 °C [A/m]
    drift: float  #: of it, relative [1/K]
    greatest_remanence: float  #: [T]

    def knee(self, temperature: float) -> float:
        """Field strength [A/m] at which the curve J(H) bends, at `temperature` [K]."""
        return max(_SQUARENESS * self.coercivity * (1 + self.drift * (temperature - _REFERENCE_K)), 0.0)


#: Coercivities and temperature coefficients of suppliers' tables of sintered NdFeB: Arnold Magnetic Technologies,
#: "Neodymium-Iron-Boron Magnet Grades" (N −0.75, M −0.675, H −0.605 %/K), Shanghai Magnet's performance table (N −0.76,
#: M −0.68 %/K) and others, which agree on H_cJ to 1 % and on its drift to 0.05 %/K. N55 and some of N50, N52 have 876
#: kA/m; the commoner 955 kA/m is taken.
SERIES = (
    MagnetSeries("N", 955e3, -7.5e-3, 1.51),
    MagnetSeries("M", 1114e3, -6.75e-3, 1.48),
    MagnetSeries("H", 1353e3, -6.05e-3, 1.45),
    MagnetSeries("SH", 1592e3, -5.5e-3, 1.43),
    MagnetSeries("UH", 1990e3, -5.0e-3, 1.38),
    MagnetSeries("EH", 2388e3, -4.7e-3, 1.30),
    MagnetSeries("AH", 2786e3, -4.5e-3, 1.25),
)
_SQUARENESS = 0.9  #: H_k / H_cJ: where J is 10 % lower; sintered NdFeB has at least this
_REFERENCE_K = 293.15  #: [K]
_REMANENCE_DRIFT = -1.2e-3  #: of all of them, relative [1/K]
_TURN, _PIECES = 80, 48  #: points around half a face, and pieces of a loop
_RADII, _HEIGHTS = (0.03, 0.25, 0.5, 0.75, 0.9), (-0.9, -0.5, 0.0, 0.5, 0.9)  #: of a wall and of half a length

Letters = Annotated[
    Literal["N", "M", "H", "SH", "UH", "EH", "AH"] | None,
    Meaning("series of sintered NdFeB: the letters of its grade, which say how much opposed field it withstands"),
    Without("the strongest series that is sold with this remanence"),
]
Temperature = Annotated[
    q.Temperature | None,
    Positive,
    Meaning("greatest temperature of the magnet"),
    Form("> 0 K"),
    Without("the windings' stop temperature: nothing in the device is warmer"),
]


@final
@dataclass(frozen=True)
class MagnetUse:
    """Grade and temperature of a magnet, as stated in the device file."""

    letters: str | None = None  #: None: the strongest series with its remanence
    greatest_temperature: float | None = None  #: [K]; None: the windings' stop temperature


ANY_MAGNET = MagnetUse()  #: of which nothing is stated


def choose_series(remanence: float, letters: str | None) -> MagnetSeries:
    """The series with these letters; or, for None, the strongest that is sold with `remanence` [T].

    >>> choose_series(1.31, None).letters, choose_series(1.31, "SH").letters
    ('UH', 'SH')
    """
    if letters is not None:
        return next(one for one in SERIES if one.letters == letters)
    return next((one for one in reversed(SERIES) if one.greatest_remanence >= remanence), SERIES[0])


def own_field(magnet: CylinderMagnet | RingMagnet) -> float:
    """Greatest field strength in the magnet against its polarization, by itself [A/m].

    Away from its edges, where it is infinite in a zone that holds no volume.
    """
    wall, half = magnet.outer_radius - magnet.inner_radius, 0.5 * magnet.length
    rho, z = np.meshgrid(magnet.inner_radius + wall * np.array(_RADII), half * np.array(_HEIGHTS), indexing="ij")
    upper = _face_strength(magnet, rho.ravel(), half - z.ravel())
    lower = _face_strength(magnet, rho.ravel(), half + z.ravel())
    return float(magnet.polarization) / MU0 * float((upper + lower).max())


@cache
def _list_nodes() -> tuple[Array, Array]:
    """Gauss's points and weights around the axis: computed once, because they take as long as the rest of a check."""
    nodes, weights = gauss_legendre(_TURN)
    return nodes, weights


def _face_strength(magnet: CylinderMagnet | RingMagnet, rho: Array, depth: Array) -> Array:
    """(n,) field strength along the axis, at `depth` [m] below a face of unit charge per area, off the axis by `rho`.

    The integral over the radius in closed form, that around the axis at Gauss's points, which crowd where the face is
    near (φ = w sinh u). A device is read without compiled code.
    """
    nodes, weights = _list_nodes()
    w = (depth / np.hypot(rho, depth))[:, None]
    most = np.arcsinh(np.pi / w)
    u = 0.5 * most * (1 + nodes)
    share = 0.5 * most * weights * w * np.cosh(u) / np.pi  # of half a turn
    cosine = np.cos(w * np.sinh(u))
    b, c = rho[:, None] * cosine, (rho**2 + depth**2)[:, None]

    def primitive(r: float) -> Array:
        found: Array = (b * r - c) / ((c - b * b) * np.sqrt(r * r - 2 * r * b + c))
        return found

    total: Array = (share * (primitive(magnet.outer_radius) - primitive(magnet.inner_radius))).sum(axis=1)
    return 0.5 * depth * total


def coil_field(coil: Coil, points: Array) -> Array:
    """(n, 3) flux density per ampere [T/A] at `points` (n, 3) [m] outside the coil, in its frame, by loops of straight
    pieces: within 1 %, and without compiled code, as a device is read without it."""
    phi = 2 * np.pi * (np.arange(_PIECES) + 0.5) / _PIECES
    cosine, sine = np.cos(phi), np.sin(phi)
    out = np.zeros(points.shape)
    for radius, height, count in zip(*coil.filaments(4, 3), strict=True):
        x, y, z = points[:, :1] - radius * cosine, points[:, 1:2] - radius * sine, points[:, 2:] - height
        per_cube = count * radius * (x * x + y * y + z * z) ** -1.5
        out[:, 0] += (per_cube * z * cosine).sum(axis=1)
        out[:, 1] += (per_cube * z * sine).sum(axis=1)
        out[:, 2] -= (per_cube * (x * cosine + y * sine)).sum(axis=1)
    return MU0 / (2 * _PIECES) * out


def charge_field(rows: Array, points: Array) -> Array:
    """(n, 3) flux density [T] at `points` (n, 3) [m] of charges rows (4, k): places [m] and strengths [A·m]."""
    x, y, z = (points[:, k, None] - rows[k] for k in range(3))
    strength = rows[3] * (x * x + y * y + z * z) ** -1.5
    found: Array = MU0_OVER_4PI * np.stack([(strength * one).sum(axis=1) for one in (x, y, z)], axis=1)
    return found


def check_magnet(
    name: str, key: str, magnet: CylinderMagnet | RingMagnet, use: MagnetUse, stop: float,
    neighbours: float, coils: float,
) -> list[BuildCheck]:  # fmt: skip
    """Whether a magnet, with `key` as its remanence in the file, keeps its polarization.

    neighbours, coils: the greatest fields [T] against it of other magnets and of the coils at their peak; stop: of the
    windings [K].
    """
    remanence = float(magnet.polarization)
    series = choose_series(remanence, use.letters)
    warm = stop if use.greatest_temperature is None else use.greatest_temperature
    share = 1 + _REMANENCE_DRIFT * (warm - _REFERENCE_K)
    parts = (share * own_field(magnet), share * max(neighbours, 0.0) / MU0, coils / MU0)
    value = sum(parts)
    enough = [one.letters for one in SERIES if one.knee(warm) >= value and one.greatest_remanence >= remanence]
    origin = "stated" if use.letters else f"the strongest with {remanence:.4g} T"
    needed = f"{enough[0]} or stronger is needed" if enough else "none is sold that is strong enough"
    own, beside, driven = (format_bound(part, "A/m") for part in parts)
    return [
        BuildCheck(
            "magnets that the series is sold with", f"{name}, {key}", remanence, series.greatest_remanence, "T",
            "reduce it, or take a weaker series, which is sold with more", note=f"series {series.letters}, {origin}",
        ),
        BuildCheck(
            "magnets that keep their polarization", f"{name}, field strength against it", value, series.knee(warm),
            "A/m", "take a stronger series, make the magnet longer along its axis, or keep it cooler",
            note=f"own {own}, neighbours {beside}, coils {driven}; series {series.letters}, {origin}, at "
            f"{warm - 273.15:.0f} °C; {needed}",
        ),
    ]  # fmt: skip
