"""A soft sphere's answer to coils and magnets, in solid harmonics about its centre: for a servo, in one pass.

`soft_sphere` sums over pairs of charges. Here the answer to each source is a fixed set of coefficients C of irregular
solid harmonics, φ = Re Σ C*_lm I_lm(x/a), and everything that a set of charges feels follows from its own sums
S_lm = Σ q I_lm(x/a): a derivative of I_lm is an I of the next degree, and a turn keeps the degree. So the work grows
with charges plus coils and not with their product, and includes the pull of the sphere on the charges themselves.

    I_lm = (l−m)! P_lm(cosθ) e^{imφ}/r^{l+1}        R_lm = r^l P_lm(cosθ) e^{imφ}/(l+m)!
    1/|x − s| = Σ R*_lm(x) I_lm(s), |x| < |s|;      R_lm → −β_l I_lm/((l−m)!(l+m)!) outside a sphere of radius 1

with β_l as in `soft_sphere`. Source: Jackson, Classical Electrodynamics, sections 3.5 and 4.4, in the normalisation of
White and Head-Gordon (J. Chem. Phys. 101, 6593, 1994). Terms fall as (a²/(r_source r_charge))^l.
"""

from __future__ import annotations

from math import factorial

import numpy as np

from haptorb.errors import GeometryError
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.physics.sources.dipole import MU0
from haptorb.physics.sources.soft_sphere import SoftSphere
from haptorb.physics.sources.source import Source

__all__ = ["add_answers", "answer_to_charges", "answer_to_source", "harmonic_sums", "weigh_charges"]

_K = MU0 / (4 * np.pi)
_WITHIN = 0.6  #: radius at which a source is read, as a share of the sphere's: the field is smoother there


@kernel
def harmonic_sums(placed: Array, radius: float, order: int, sums: Array) -> None:
    """sums (k, 2), real and imaginary: Σ q I_lm(x/a) [A·m] to degree `order` + 1, number l (l + 1)/2 + m.

    placed (≥ 3, n): places [m] about the sphere's centre, the charges [A·m] in the last row.
    """
    last, top = placed.shape[0] - 1, order + 1
    sums[:] = 0.0
    value = np.empty_like(sums)
    for n in range(placed.shape[1]):
        x, y, z = placed[0, n] / radius, placed[1, n] / radius, placed[2, n] / radius
        inverse = 1.0 / (x * x + y * y + z * z)
        value[0, 0], value[0, 1] = placed[last, n] * np.sqrt(inverse), 0.0
        cx, cy, cz = x * inverse, y * inverse, z * inverse
        for l in range(1, top + 1):
            here, before, earlier = l * (l + 1) // 2, (l - 1) * l // 2, (l - 2) * (l - 1) // 2
            for m in range(l):
                for part in range(2):
                    v = (2 * l - 1) * cz * value[before + m, part]
                    if m < l - 1:
                        v -= ((l - 1) * (l - 1) - m * m) * inverse * value[earlier + m, part]
                    value[here + m, part] = v
            a, b = value[before + l - 1, 0], value[before + l - 1, 1]
            value[here + l, 0] = -(2 * l - 1) * (cx * a - cy * b)
            value[here + l, 1] = -(2 * l - 1) * (cx * b + cy * a)
        for k in range(sums.shape[0]):
            sums[k, 0] += value[k, 0]
            sums[k, 1] += value[k, 1]


@kernel
def _read(sums: Array, l: int, m: int) -> tuple[float, float]:
    """S_lm for any m from −l to l; 0 beyond."""
    if m > l or m < -l:
        return 0.0, 0.0
    if m >= 0:
        k = l * (l + 1) // 2 + m
        return sums[k, 0], sums[k, 1]
    k = l * (l + 1) // 2 - m
    sign = 1.0 if m % 2 == 0 else -1.0
    return sign * sums[k, 0], -sign * sums[k, 1]


@kernel
def add_answers(sums: Array, answers: Array, radius: float, order: int, p: Array, out: Array) -> None:
    """Add to out (6, m) the force and the torque about p (3,) [m] on the charges of `sums` in the sphere's answers.

    answers (m, k, 2): coefficients C [T·m] per ampere of every coil, or [T·m] of anything else.
    """
    part = np.empty((6, 2))
    for l in range(1, order + 1):
        for m in range(l + 1):
            # ∂z I_lm = −I_{l+1,m};  (∂x + i∂y) I_lm = I_{l+1,m+1};  (∂x − i∂y) I_lm = −I_{l+1,m−1}
            ur, ui = _read(sums, l + 1, m + 1)
            dr, di = _read(sums, l + 1, m - 1)
            zr, zi = _read(sums, l + 1, m)
            part[0, 0], part[0, 1] = 0.5 * (ur - dr), 0.5 * (ui - di)
            part[1, 0], part[1, 1] = 0.5 * (ui + di), -0.5 * (ur + dr)
            part[2, 0], part[2, 1] = -zr, -zi
            # x × ∇ = iL;  L± I_lm = (l ∓ m) I_{l,m±1};  L_z I_lm = m I_lm
            ur, ui = _read(sums, l, m + 1)
            dr, di = _read(sums, l, m - 1)
            zr, zi = _read(sums, l, m)
            ur, ui, dr, di = (l - m) * ur, (l - m) * ui, (l + m) * dr, (l + m) * di
            part[3, 0], part[3, 1] = -0.5 * (ui + di), 0.5 * (ur + dr)
            part[4, 0], part[4, 1] = 0.5 * (ur - dr), 0.5 * (ui - di)
            part[5, 0], part[5, 1] = -m * zi, m * zr
            k = l * (l + 1) // 2 + m
            for i in range(6):
                scale = -1.0 / radius if i < 3 else -1.0
                real, imaginary = scale * part[i, 0], scale * part[i, 1]
                if i >= 3:  # from the sphere's centre to p: T − p × F
                    a, b = (i - 2) % 3, (i - 1) % 3
                    real += (p[a] * part[b, 0] - p[b] * part[a, 0]) / radius
                    imaginary += (p[a] * part[b, 1] - p[b] * part[a, 1]) / radius
                for j in range(answers.shape[0]):
                    out[i, j] += real * answers[j, k, 0] + imaginary * answers[j, k, 1]


@kernel
def answer_to_charges(sums: Array, shares: Array, out: Array) -> None:
    """out (1, k, 2): the sphere's answer [T·m] to the charges of `sums` themselves; shares (k,) of `weigh_charges`."""
    for k in range(shares.shape[0]):
        out[0, k, 0] = shares[k] * sums[k, 0]
        out[0, k, 1] = shares[k] * sums[k, 1]


def weigh_charges(sphere: SoftSphere, order: int) -> Array:
    """(k,) [T·m/(A·m)] what `answer_to_charges` multiplies the sums with, to degree `order`.

    >>> weigh_charges(SoftSphere(0.1), 1).shape
    (3,)
    """
    response = sphere.response(order)
    weights = [0.0]
    for l in range(1, order + 1):
        for m in range(l + 1):
            both = 1.0 if m == 0 else 2.0
            weights.append(-_K * both * response[l - 1] / (sphere.radius * factorial(l - m) * factorial(l + m)))
    return np.array(weights)


def answer_to_source(sphere: SoftSphere, source: Source, order: int) -> Array:
    """(k, 2) coefficients C [T·m] of the sphere's answer to `source` anywhere about it (coils: per ampere).

    From the source's radial field on a sphere of radius b < a, so that sources close to the sphere do no harm:
    C_lm = β_l (2 − δ_m0)(2l + 1) a (a/b)^(l−1)/(4π l) ∫ B_r R_lm dΩ. The source's
    matter must not reach into the sphere: GeometryError.

    >>> from haptorb.physics.sources.dipole import Dipole
    >>> from haptorb.physics.sources.placement import PlacedSource
    >>> far = PlacedSource(Dipole((0, 0, 1.0)), (0, 0, 0.5), np.eye(3))
    >>> answer = answer_to_source(SoftSphere(0.02), far, 3)
    >>> moment = SoftSphere(0.02).moment_in(far.field((0, 0, 0)))[2]     # the answer's first term is that dipole's
    >>> bool(abs(answer[1, 0] - 1e-7 * moment / 0.02**2) < 1e-9 * answer[1, 0])
    True
    """
    cosine, weight = np.polynomial.legendre.leggauss(2 * order + 8)
    steps = 4 * order + 16
    angle = 2 * np.pi * (np.arange(steps) + 0.5) / steps
    sine = np.sqrt(1 - cosine**2)[:, None]
    level = np.repeat(cosine[:, None], steps, axis=1)
    unit = np.stack([sine * np.cos(angle), sine * np.sin(angle), level], axis=-1)
    if source.contains(sphere.radius * unit).any():
        raise GeometryError("a source reaches into the soft sphere, where no field is defined; move it out")
    radial = (source.field(_WITHIN * sphere.radius * unit) * unit).sum(axis=-1)
    flux = radial * weight[:, None] * (2 * np.pi / steps)
    response = sphere.response(order)
    out = np.zeros(((order + 1) * (order + 2) // 2, 2))
    for (l, m), harmonic in _regular(unit, order).items():
        if l:
            both = (1.0 if m == 0 else 2.0) * _WITHIN ** (1 - l)
            c = response[l - 1] * both * (2 * l + 1) * sphere.radius / (4 * np.pi * l) * (flux * harmonic).sum()
            out[l * (l + 1) // 2 + m] = c.real, c.imag
    return out


def _regular(unit: Array, order: int) -> dict[tuple[int, int], Array]:
    """R_lm at unit vectors (..., 3)."""
    x, y, z = np.moveaxis(unit, -1, 0)
    across = x + 1j * y
    found = {(0, 0): np.ones_like(across)}
    for l in range(1, order + 1):
        found[l, l] = -across / (2 * l) * found[l - 1, l - 1]
        for m in range(l):
            value = (2 * l - 1) * z * found[l - 1, m]
            if m < l - 1:
                value = value - found[l - 2, m]
            found[l, m] = value / ((l + m) * (l - m))
    return found
