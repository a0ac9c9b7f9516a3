"""Force and torque between two multipole models, as Bai 2012 writes them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, rotation, vectors
from haptorb.magnetics.multipole import MultipoleSource

__all__ = ["multipole_wrench"]


def multipole_wrench(
    source: MultipoleSource,
    target: MultipoleSource,
    position: ArrayLike,
    turn: ArrayLike,
    about: ArrayLike | None = None,
) -> Array:
    """Force and torque (6,) [N, N·m] of `source` on `target` at `position` (3,) [m], turned by `turn` (3, 3).

    F = Σ q B at the target's poles, and T = Σ r × q B about `about` (3,) [m], else about the target's centre. Written
    out for pole pairs that is Bai 2012 eq. (9) with a minus in its second bracket and with arm × force (erratum E5):
    T = μ0/4π Σ m_r m_s [R_r₊ × (R_r₊s₊ − R_r₊s₋) − R_r₋ × (R_r₋s₊ − R_r₋s₋)].

    >>> north = MultipoleSource(0.01, 0.002, [1.0], 1)
    >>> bool(multipole_wrench(north, north, (0, 0, 0.05), np.eye(3))[2] < 0)     # aligned: they attract
    True
    """
    place = vectors(position, "position")
    poles = target.poles @ rotation(turn, "turn").T + place
    pivot = place if about is None else vectors(about, "about")
    forces = target.strengths[:, None] * source.field(poles)
    return np.concatenate([forces.sum(axis=0), np.cross(poles - pivot, forces).sum(axis=0)])
