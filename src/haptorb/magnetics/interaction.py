"""Force and torque between bodies at any pose, to a given precision.

The source's field is taken where the target's currents flow: F = ∮ I dl × B over the target's filaments (Gauss points
across and along, equal steps around, so that every direction converges exponentially). Field evaluations are cheap in
closed form, so this direction costs about a hundredth of meshing the magnets. The tests
compare it with a second formulation, force on magnetic charges σB over a magnet's faces, and with the flux linkage.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite, rotation, vectors
from haptorb.errors import GeometryError, InputError, PrecisionError
from haptorb.magnetics.source import RoundBody, Source

__all__ = ["BoundedValue", "filament_wrench", "wrench"]

#: Gauss points across, along, and steps around: balanced for flat coils near flat magnets, each row about 2.7 times the
#: one before
LEVELS = (
    (3, 3, 30),
    (5, 4, 40),
    (7, 6, 54),
    (10, 8, 72),
    (14, 11, 100),
    (20, 16, 144),
    (29, 22, 210),
    (42, 32, 300),
)
_ROUNDING = 4e-15  #: rounding error of a sum, relative to the sum of magnitudes


@dataclass(frozen=True, slots=True)
class BoundedValue:
    """Value with the bound of its numerical error.

    Parameters
    ----------
    value : ndarray, shape (...)
        The value, in the unit of the computed quantity, such as [N, N·m].
    bound : ndarray, shape (...)
        Difference between the last two refinements, in the same unit and shape.
    """

    value: Array
    bound: Array


def wrench(
    source: Source,
    target: RoundBody,
    position: ArrayLike,
    turn: ArrayLike,
    *,
    about: ArrayLike | None = None,
    precision: float = 1e-8,
) -> BoundedValue:
    """Compute force and torque of a magnetic source on a round body, with a bound of the error.

    Parameters
    ----------
    source : Source
        Source of the field; its frame is the frame of the result.
    target : RoundBody
        Magnet or coil (carrying one ampere) on which force and torque act.
    position : array_like, shape (3,)
        Centre of the target in the source's frame [m].
    turn : array_like, shape (3, 3)
        Rotation from the target's frame to the source's frame.
    about : array_like, shape (3,), optional
        Point about which the torque is taken [m]; None: the target's centre.
    precision : float
        Wanted error relative to the magnitude of force and of torque [1], or to a thousandth of the sum of |dF| where
        symmetry makes them vanish.

    Returns
    -------
    BoundedValue
        Force and torque, shape (6,) [N, N·m], and the reached bound of each component, shape (6,).

    Raises
    ------
    PrecisionError
        If the precision is not reached; the message states the best value.
    GeometryError
        If the target reaches into the source.

    Notes
    -----
    F = ∮ I dl × B over the target's current filaments, at Gauss points across and along the body and in equal steps
    around it, so that the error falls exponentially with the number of points (Lorentz force).

    Examples
    --------
    >>> from haptorb.magnetics.magnets import CylinderMagnet
    >>> magnet = CylinderMagnet(radius=0.02, length=0.04, polarization=1.3)
    >>> push = wrench(magnet, magnet, (0, 0, 0.05), np.diag([1.0, -1.0, -1.0]))    # opposed, 10 mm apart
    >>> round(float(push.value[2]), 3)
    265.537
    """
    place, R = _pose(position, turn)
    pivot = place if about is None else vectors(about, "about")

    def integral(level: tuple[int, int, int]) -> tuple[Array, Array]:
        points, elements = _elements(target, level, place, R)
        _check_outside(source, points)
        return filament_wrench(source.field(points), points, elements, pivot)

    return _refine(integral, precision, "wrench")


def filament_wrench(field: Array, points: Array, elements: Array, pivot: Array) -> tuple[Array, Array]:
    """Force and torque (6,) about `pivot` on current elements I dl (n, 3) [A·m] at `points` (n, 3) in `field` (n, 3).

    Also their gross (2,): the sums of |dF| [N] and of |dT| [N·m], against which cancellation is judged.
    """
    df = np.cross(elements, field)
    dt = np.cross(points - pivot, df)
    gross = np.array([np.linalg.norm(df, axis=1).sum(), np.linalg.norm(dt, axis=1).sum()])
    return np.concatenate([df.sum(axis=0), dt.sum(axis=0)]), gross


def _pose(position: ArrayLike, turn: ArrayLike) -> tuple[Array, Array]:
    place, R = vectors(position, "position"), rotation(turn, "turn")
    if place.shape != (3,) or R.shape != (3, 3):
        raise InputError(f"one pose needs shapes (3,) and (3, 3); got {place.shape} and {R.shape}")
    return place, R


def _check_outside(source: Source, points: Array) -> None:
    inside = source.contains(points)
    if inside.any():
        where = points[inside][0].tolist()
        raise GeometryError(f"the bodies overlap at {where} m: no force is defined between them there; move them apart")


@lru_cache(maxsize=64)
def _circle_nodes(steps: int) -> tuple[Array, Array]:
    angle = 2 * np.pi * (np.arange(steps) + 0.5) / steps
    return np.cos(angle), np.sin(angle)


def _elements(target: RoundBody, level: tuple[int, int, int], place: Array, R: Array) -> tuple[Array, Array]:
    """Points (n, 3) [m] and current elements I dl (n, 3) [A·m] of a target's filaments, in the common frame."""
    radii, heights, currents = target.filaments(level[0], level[1])
    cosine, sine = _circle_nodes(level[2])
    points = np.empty((len(radii), level[2], 3))
    points[..., 0] = radii[:, None] * cosine
    points[..., 1] = radii[:, None] * sine
    points[..., 2] = heights[:, None]
    elements = np.zeros_like(points)
    step = (2 * np.pi / level[2]) * (radii * currents)[:, None]
    elements[..., 0] = -step * sine
    elements[..., 1] = step * cosine
    return points.reshape(-1, 3) @ R.T + place, elements.reshape(-1, 3) @ R.T


def _refine(
    integral: Callable[[tuple[int, int, int]], tuple[Array, Array]], precision: float, what: str
) -> BoundedValue:
    """Evaluate LEVELS in turn until two agree: the coarser one's error is the bound of the finer one's."""
    if not 0 < float(check_finite(precision, "precision")) < 1:
        raise InputError(f"precision must be a relative error between 0 and 1; got {precision!r}")
    best: tuple[float, BoundedValue] | None = None
    last, _ = integral(LEVELS[0])
    for level in LEVELS[1:]:
        value, gross = integral(level)
        parts = [slice(0, 3), slice(3, 6)] if len(value) == 6 else [slice(0, 1)]
        bound = np.empty_like(value)
        reached = 0.0
        for part, whole in zip(parts, gross, strict=True):
            change = float(np.linalg.norm(value[part] - last[part])) + _ROUNDING * whole
            bound[part] = change
            size = max(float(np.linalg.norm(value[part])), 1e-3 * whole)
            reached = max(reached, change / size if size else 0.0)
        if best is None or reached < best[0]:
            best = (reached, BoundedValue(value, bound))
        if reached <= precision:
            return BoundedValue(value, bound)
        last = value
    assert best is not None
    raise PrecisionError(
        f"the {what} converged to {best[0]:.1e} relative, not to {precision:.1e}; "
        "request less, or keep the bodies further apart"
    )
