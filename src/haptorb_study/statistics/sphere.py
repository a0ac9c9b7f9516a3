"""Directional statistics on the sphere: errors in local axes, mean direction, and spread."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite
from haptorb.errors import InputError

__all__ = ["DirectionSpread", "error_vectors", "find_away_axes", "local_axes", "summarize_directions"]


_MIN_NORM = 1e-9  #: norm below which a direction is undefined


@dataclass(frozen=True)
class DirectionSpread:
    """Mean direction and concentration (Fisher 1953; Mardia & Jupp 2000, §10.3)."""

    count: int
    theta_deg: float  #: polar angle of the mean direction [deg]; NaN where the directions cancel
    phi_deg: float  #: azimuth [deg]
    resultant: float  #: mean resultant length, 0 to 1; 1: identical
    kappa: float  #: concentration, (n − 1)/(n − n·resultant); infinite for identical directions, NaN for one
    spread_deg: float  #: SD in each of two tangential directions, 1/√κ [deg]; of little meaning below κ = 3


def local_axes(ways: ArrayLike) -> tuple[Array, Array]:
    """(up, round): unit tangents (..., 3) at `ways` (..., 3), towards the top and along φ.

    NaN at the top itself, and at the bottom, where every way leads away.

    >>> up, round_ = local_axes([1.0, 0.0, 0.0])
    >>> up.tolist(), round_.tolist()
    ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0])
    """
    n = _unit(ways, "ways")
    flat = np.hypot(n[..., 0], n[..., 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        cos, sin = (np.where(flat > _MIN_NORM, n[..., k] / flat, np.nan) for k in (0, 1))
    up = np.stack([-n[..., 2] * cos, -n[..., 2] * sin, np.where(np.isfinite(cos), flat, np.nan)], axis=-1)
    return up + 0.0, np.stack([-sin, cos, np.where(np.isfinite(cos), 0.0, np.nan)], axis=-1) + 0.0


def find_away_axes(ways: ArrayLike, hand_deg: float) -> Array:
    """(..., 3) unit tangents at `ways` (..., 3) away from a hand at the azimuth `hand_deg`.

    The horizontal direction from the hand to the vertical axis, in the tangent plane; known at the top too. NaN where
    that direction is the normal.

    >>> (find_away_axes([0.0, 0.0, 1.0], 180.0).round(9) + 0.0).tolist()
    [1.0, 0.0, 0.0]
    """
    n = _unit(ways, "ways")
    away = -np.array([math.cos(math.radians(hand_deg)), math.sin(math.radians(hand_deg)), 0.0])
    along = away - (n @ away)[..., None] * n
    size = np.linalg.norm(along, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        found: Array = np.where(size > _MIN_NORM, along / size, np.nan) + 0.0
    return found


def error_vectors(asked: ArrayLike, answered: ArrayLike) -> Array:
    """(n, 3) errors [deg] in the tangent planes at `asked` (n, 3): length and direction of the arc to `answered`.

    Their lengths are angles, so a component is a share of the angle along its axis. NaN where the answer lies opposite,
    every way being equally short, and where an answer is missing (NaN).

    >>> error_vectors([[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]).tolist()
    [[90.0, 0.0, 0.0]]
    """
    n = _unit(asked, "asked")
    given = np.asarray(answered, dtype=float)
    if given.shape != n.shape:
        raise InputError(f"answered directions must have the shape of the asked ones, {n.shape}; got {given.shape}")
    with np.errstate(invalid="ignore", divide="ignore"):
        a = given / np.linalg.norm(given, axis=-1, keepdims=True)
    cos = np.sum(n * a, axis=-1, keepdims=True)
    side = a - cos * n
    sin = np.linalg.norm(side, axis=-1, keepdims=True)
    angle = np.degrees(np.arctan2(sin, cos))
    with np.errstate(invalid="ignore", divide="ignore"):
        found = np.where(sin > _MIN_NORM, angle * side / sin, np.where(cos > 0, 0.0, np.nan))
    return np.where(np.isfinite(a), found, np.nan) + 0.0


def summarize_directions(ways: ArrayLike) -> DirectionSpread:
    """Mean direction and spread of `ways` (n, 3), n ≥ 1.

    Directions that cancel, such as two opposite ones, have no mean direction; their resultant is zero and κ has the
    smallest value for their number.

    >>> one = summarize_directions([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    >>> one.resultant, one.kappa, one.theta_deg
    (0.0, 0.5, nan)
    """
    n = _unit(ways, "ways")
    if n.ndim != 2 or not len(n):
        raise InputError(f"a mean direction needs directions, shape (n, 3); got {n.shape}")
    count, total = len(n), n.sum(axis=0)
    length = float(np.linalg.norm(total))
    resultant = min(1.0, length / count)
    theta = phi = math.nan
    if resultant > _MIN_NORM:
        theta = math.degrees(math.atan2(math.hypot(total[0], total[1]), total[2]))
        phi = math.degrees(math.atan2(total[1], total[0]))
    rest = count - length
    kappa = math.nan if count < 2 else math.inf if rest < 1e-12 * count else (count - 1) / rest
    spread = 0.0 if math.isinf(kappa) else math.degrees(kappa**-0.5)
    return DirectionSpread(count, theta, phi, resultant, kappa, spread)


def _unit(ways: ArrayLike, name: str) -> Array:
    n = check_finite(ways, name)
    if n.ndim < 1 or n.shape[-1] != 3:
        raise InputError(f"{name} must be directions, shape (..., 3); got {n.shape}")
    length = np.linalg.norm(n, axis=-1, keepdims=True)
    if (length <= _MIN_NORM).any():
        raise InputError(f"{name} must be directions; a vector of length zero has none")
    unit: Array = n / length
    return unit
