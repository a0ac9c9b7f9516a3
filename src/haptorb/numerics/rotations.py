"""Tilt and spin as rotation matrices: the XYZ Euler angles q = (ψ, λ, φ) of Bai 2012 eq. (1).

They are intrinsic: R_SR = Rx(ψ) Ry(λ) Rz(φ), tilt first, then spin about the body's own axis. Only in this order is
the paper's workspace |ψ|, |λ| ≤ 22.5°, 0 ≤ φ < 360° a cone of tilts with free spin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, check_finite

__all__ = ["rotation_from_euler"]


def rotation_from_euler(psi: ArrayLike, lam: ArrayLike, phi: ArrayLike) -> Array:
    """R_SR (..., 3, 3) that turns rotor vectors into stator vectors, from angles [rad] that broadcast together.

    Raises InputError if they do not broadcast or are not finite.

    >>> rotation_from_euler(0.0, 0.0, np.pi / 2).round(12)[:, 0].tolist()      # spin turns x into y
    [0.0, 1.0, 0.0]
    >>> rotation_from_euler(0.1, 0.2, np.zeros(5)).shape
    (5, 3, 3)
    """
    try:
        a, b, c = np.broadcast_arrays(check_finite(psi, "psi"), check_finite(lam, "lam"), check_finite(phi, "phi"))
    except ValueError as cause:
        if isinstance(cause, InputError):
            raise
        raise InputError(f"psi, lam and phi must broadcast together: {cause}") from cause
    ca, sa, cb, sb, cc, sc = np.cos(a), np.sin(a), np.cos(b), np.sin(b), np.cos(c), np.sin(c)
    rows = [
        [cb * cc, -cb * sc, sb],
        [ca * sc + sa * sb * cc, ca * cc - sa * sb * sc, -sa * cb],
        [sa * sc - ca * sb * cc, sa * cc + ca * sb * sc, ca * cb],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
