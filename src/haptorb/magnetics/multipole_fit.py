"""Distributed multipole models fitted to a body's exact field in a region, with their field error.

For given loops k, pairs per loop n and pole distance l̄ the field is linear in the strengths: least squares gives them.
l̄ is searched on a line, and k and n over all that a budget of dipoles allows. What is left is reported, never hidden.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar

from haptorb.arrays import Array, vectors
from haptorb.compiled import kernel
from haptorb.errors import GeometryError, InputError
from haptorb.magnetics import source
from haptorb.magnetics.dipole import MU0_OVER_4PI
from haptorb.magnetics.multipole import MultipoleSource, loop_poles
from haptorb.magnetics.source import RoundBody

__all__ = ["MultipoleFit", "fit_multipole", "residual", "shell_region"]

_RATIO_RANGE = (0.02, 1.05)  #: search range of l̄/l
_COARSE_RATIOS = (0.1, 0.4, 0.8)  #: l̄/l of the coarse search
_MAX_FINE_SEARCHES = 4  #: number of (k, n) with a fine search of l̄


@dataclass(frozen=True, slots=True)
class MultipoleFit:
    """A fitted model and its field error in the region, relative to the exact field there.

    rms       √(mean |ΔB|²) over √(mean |B|²)
    greatest  greatest |ΔB| over greatest |B|
    """

    model: MultipoleSource
    rms: float
    greatest: float


def shell_region(distance: float, inner: float, outer: float, half_angle: float, count: int = 2000) -> Array:
    """(count, 3) points [m] in a body's own frame: region of the opposite bodies in a ball joint.

    The body's centre is `distance` from the joint's centre, its z axis outward; the points fill the part of the shell
    between radii `inner` and `outer` [m] about the joint's centre that lies within `half_angle` [rad] of that axis,
    evenly by volume (a Kronecker sequence: the same points every time).

    Raises InputError for an empty region.

    >>> points = shell_region(67.9e-3, 53.0e-3, 60.6e-3, 1.0)
    >>> bool(points[:, 2].max() < -7.2e-3)
    True
    """
    for value, what in ((inner, "inner"), (outer, "outer"), (half_angle, "half_angle")):
        source.length(value, what)
    if inner > outer or half_angle > np.pi or count < 1:
        raise InputError(
            "a region needs inner ≤ outer, half_angle ≤ π and one point or more; "
            f"got {inner} m, {outer} m, {half_angle} rad and {count} points"
        )
    # Powers of the root of x⁴ = x + 1 are a low-discrepancy sequence in three dimensions.
    step = 1.2207440846057596 ** -np.arange(1.0, 4.0)
    a, b, c = ((0.5 + np.arange(count)[:, None] * step) % 1.0).T
    radius = np.cbrt(inner**3 + a * (outer**3 - inner**3))
    cosine = 1 - b * (1 - np.cos(half_angle))
    across = radius * np.sqrt(1 - cosine**2)
    return np.stack(
        [across * np.cos(2 * np.pi * c), across * np.sin(2 * np.pi * c), radius * cosine - distance], axis=1
    )


def fit_multipole(
    body: RoundBody,
    points: ArrayLike,
    *,
    most_dipoles: int = 100,
    loops: int | None = None,
    per_loop: int | None = None,
    pole_distance: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> MultipoleFit:
    """Model of `body` with at most `most_dipoles` pole pairs and the smallest rms field error at `points` (n, 3) [m].

    `loops` k, `per_loop` n and `pole_distance` l̄ [m] are searched unless given. Raises GeometryError for points inside
    the body, InputError for a budget that cannot be met or too few points.

    >>> from haptorb.magnetics.magnets import CylinderMagnet
    >>> magnet = CylinderMagnet(15.875e-3, 5.08e-3, 1.31)
    >>> region = shell_region(67.9e-3, 53.0e-3, 60.6e-3, 1.2, count=400)
    >>> fit = fit_multipole(magnet, region, loops=4, per_loop=10, pole_distance=1.0e-3)
    >>> fit.rms < 0.02, fit.model.dipoles
    (True, 41)
    """
    at = np.ascontiguousarray(vectors(points, "points").reshape(-1, 3))
    if body.contains(at).any():
        raise GeometryError(
            f"point {at[body.contains(at)][0].tolist()} m of the region lies inside {body!r}: "
            "a multipole model has no field there to compare; choose a region outside"
        )
    if pole_distance is not None:
        source.length(pole_distance, "pole_distance")
    pairs = _candidates(most_dipoles, loops, per_loop)
    exact = body.field(at)
    if 3 * len(at) < 4 * max(k + 1 for k, _ in pairs):
        raise InputError(f"{len(at)} points are too few to fit {max(k + 1 for k, _ in pairs)} strengths; give more")
    # a coarse search of all, on fewer points, selects a few
    if pole_distance is None and len(pairs) > _MAX_FINE_SEARCHES:
        every, total = 4 if len(at) > 800 else 1, len(pairs) + _MAX_FINE_SEARCHES
        few, exact_few = np.ascontiguousarray(at[::every]), exact[::every]
        rough = []
        for done, (k, n) in enumerate(pairs, 1):
            tries = [_strengths(body, few, exact_few, k, n, ratio * body.length)[1] for ratio in _COARSE_RATIOS]
            rough.append((min(tries), k, n))
            if progress is not None:
                progress(done, total)
        count, pairs = len(pairs), [(k, n) for _, k, n in sorted(rough)[:_MAX_FINE_SEARCHES]]
    else:
        count, total = 0, len(pairs)
    best: tuple[float, int, int, float] | None = None
    for done, (k, n) in enumerate(pairs, count + 1):
        if pole_distance is None:
            found = minimize_scalar(
                lambda ratio, k=k, n=n: _strengths(body, at, exact, k, n, ratio * body.length)[1],
                bounds=_RATIO_RANGE,
                method="bounded",
                options={"xatol": 5e-4},
            )
            trial = (float(found.fun), k, n, float(found.x) * body.length)
        else:
            trial = (_strengths(body, at, exact, k, n, pole_distance)[1], k, n, pole_distance)
        if best is None or trial < best:
            best = trial
        if progress is not None:
            progress(done, total)
    assert best is not None
    _, k, n, between = best
    model = MultipoleSource(body.outer_radius, between, _strengths(body, at, exact, k, n, between)[0], n)
    return residual(body, model, at)


def residual(body: RoundBody, model: MultipoleSource, points: ArrayLike) -> MultipoleFit:
    """Field error of any `model` (a published one, for example) against the exact field of `body` at `points` (n, 3)
    [m].

    >>> from haptorb.magnetics.multipole import load_published
    >>> pm = load_published("bai2012-pm")
    >>> round(residual(pm.body, pm.model, shell_region(67.9e-3, 53.0e-3, 60.6e-3, 1.2)).rms, 2)
    0.1
    """
    exact = body.field(points)
    off = np.linalg.norm(model.field(points) - exact, axis=-1)
    size = np.linalg.norm(exact, axis=-1)
    rms = float(np.sqrt(np.mean(off**2) / np.mean(size**2)))
    return MultipoleFit(model, rms, float(off.max() / size.max()))


def _candidates(most: int, loops: int | None, per_loop: int | None) -> list[tuple[int, int]]:
    """(k, n) with at most `most` = 1 + k n dipoles; with n free, the few largest of every k."""
    if loops is not None and loops < 0:
        raise InputError(f"loops must not be negative; got {loops}")
    if per_loop is not None and per_loop < 1:
        raise InputError(f"per_loop must be 1 or more; got {per_loop}")
    pairs = []
    for k in range(16) if loops is None else [loops]:
        if k == 0:
            pairs.append((0, 1))
            continue
        greatest = (most - 1) // k
        for n in range(max(3, greatest - 3), greatest + 1) if per_loop is None else [per_loop]:
            if 1 <= n <= greatest:
                pairs.append((k, n))
    if not pairs:
        raise InputError(
            f"{loops if loops is not None else 'loops'} loops of {per_loop or '3 or more'} pole pairs need more than "
            f"{most} dipoles; allow more dipoles, or ask for fewer loops"
        )
    return pairs


@kernel
def _loop_fields(poles: Array, per_loop: int, half: float, points: Array, out: Array) -> None:
    """out[j, 3 p + i]: field component i at point p of loop j with unit strengths, pole pairs at z = ±half."""
    out[:] = 0.0
    for i in range(poles.shape[0]):
        j = 0 if i == 0 else 1 + (i - 1) // per_loop
        for p in range(points.shape[0]):
            dx, dy = points[p, 0] - poles[i, 0], points[p, 1] - poles[i, 1]
            up, down = points[p, 2] - half, points[p, 2] + half
            flat = dx * dx + dy * dy
            a2, b2 = flat + up * up, flat + down * down
            a, b = MU0_OVER_4PI / (a2 * np.sqrt(a2)), MU0_OVER_4PI / (b2 * np.sqrt(b2))
            out[j, 3 * p] += (a - b) * dx
            out[j, 3 * p + 1] += (a - b) * dy
            out[j, 3 * p + 2] += a * up - b * down


def _strengths(body: RoundBody, points: Array, exact: Array, k: int, n: int, between: float) -> tuple[Array, float]:
    """Least-squares strengths (k + 1,) and the rms residual relative to the exact field's rms."""
    columns = np.empty((k + 1, 3 * len(points)))
    _loop_fields(loop_poles(body.outer_radius, k, n), n, 0.5 * between, points, columns)
    scale = np.linalg.norm(columns, axis=1)  # a small l̄ gives small columns: scaling improves the conditioning
    strengths, *_ = np.linalg.lstsq((columns / scale[:, None]).T, exact.ravel(), rcond=None)
    strengths = strengths / scale
    return strengths, float(np.linalg.norm(columns.T @ strengths - exact.ravel()) / np.linalg.norm(exact))
