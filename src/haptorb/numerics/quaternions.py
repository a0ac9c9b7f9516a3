"""Unit quaternions (x, y, z, w), where a rotation matrix would have to be made for each of many poses."""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array

__all__ = ["product", "quaternion", "rotate"]


def product(a: Array, b: Array) -> Array:
    """(4,) the turn b (4,) and then the turn a (4,).

    >>> half = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])       # a quarter turn about z
    >>> product(half, half).round(12).tolist()
    [0.0, 0.0, 1.0, 0.0]
    """
    v = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(v, a[3] * b[3] - a[:3] @ b[:3])


def rotate(q: Array, v: Array) -> Array:
    """(3,) the vector v (3,), turned by q (4,) of length 1.

    >>> rotate(np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]), np.array([1.0, 0.0, 2.0])).round(12)[1:].tolist()
    [1.0, 2.0]
    """
    u = 2.0 * np.cross(q[:3], v)
    out: Array = v + q[3] * u + np.cross(q[:3], u)
    return out


def quaternion(R: Array) -> Array:
    """(4,) of a rotation (3, 3), from the greatest of its four parts, so that none is lost (Shepperd).

    >>> quaternion(np.diag([1.0, -1.0, -1.0])).tolist()
    [1.0, 0.0, 0.0, 0.0]
    """
    d, trace = np.diag(R), float(np.trace(R))
    squares = np.append(1.0 + 2.0 * d - trace, 1.0 + trace)
    k = int(np.argmax(squares))
    q = np.empty(4)
    q[k] = 0.5 * np.sqrt(squares[k])
    skew = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    if k == 3:
        q[:3] = skew / (4.0 * q[3])
        return q
    for j in range(3):
        if j != k:
            q[j] = (R[k, j] + R[j, k]) / (4.0 * q[k])
    q[3] = skew[k] / (4.0 * q[k])
    return q
