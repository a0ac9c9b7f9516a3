"""The guided motion of a motor's handle: the plug is pulled out of its outlet, put back, and wriggled.

Eighteen seconds in the translating mode, where a tilt λ moves the plug out, ψ moves it sideways. Forty degrees of tilt
are the plug's whole way with the gains of `assembly`. At rest the plug is out, which asks nothing of the
coils.
"""

from __future__ import annotations

import math
from typing import final

import numpy as np

from haptorb.devices.device import Device
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.runtime.pointer.guide import GuidedMotion

__all__ = ["HandleMotion", "handle_guide", "handle_quaternion"]

_HOME = math.radians(-20.0)  #: λ where the plug is home
_OUT = math.radians(20.0)  #: λ where it is out
_HALF = math.radians(-13.0)  #: λ of the wriggle: a little pulled
_ASIDE = math.radians(6.0)  #: ψ of the wriggle
_NOWHERE = np.zeros(3)


@kernel
def _smooth(t: float, start: float, end: float) -> float:
    """0 before `start`, 1 after `end`, between them the path of least jerk (Flash and Hogan 1985): a hand's."""
    s = min(max((t - start) / (end - start), 0.0), 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


@kernel
def _fill_quaternion(psi: float, lam: float, phi: float, q: Array) -> None:
    a, b, c = math.sin(0.5 * psi), math.sin(0.5 * lam), math.sin(0.5 * phi)
    u, v, w = math.cos(0.5 * psi), math.cos(0.5 * lam), math.cos(0.5 * phi)
    q[0] = a * v * w + u * b * c
    q[1] = u * b * w - a * v * c
    q[2] = u * v * c + a * b * w
    q[3] = u * v * w - a * b * c


@kernel
def _handle(t: float, q: Array) -> None:
    lam = (
        _HOME
        + (_OUT - _HOME) * _smooth(t, 1.0, 5.0)  # out
        + (_HOME - _OUT) * _smooth(t, 5.5, 9.0)  # and back in
        + (_HALF - _HOME) * _smooth(t, 9.5, 11.0)
        + (_OUT - _HALF) * _smooth(t, 15.0, 18.0)
    )
    psi = _ASIDE * (_smooth(t, 11.0, 12.0) - 2.0 * _smooth(t, 12.0, 13.5) + _smooth(t, 13.5, 15.0))
    _fill_quaternion(psi, lam, 0.0, q)


def handle_quaternion(psi: float, lam: float, phi: float) -> Array:
    """(4,) the quaternion (x, y, z, w) of R = Rx(ψ) Ry(λ) Rz(φ), angles in [rad].

    >>> handle_quaternion(0.0, 0.0, np.pi).round(12).tolist()
    [0.0, 0.0, 1.0, 0.0]
    """
    q = np.empty(4)
    _fill_quaternion(float(psi), float(lam), float(phi), q)
    return q


@final
class HandleMotion(GuidedMotion):
    """A hand on the handle of a motor."""

    duration = 18.0

    def __init__(self) -> None:
        self._rest = self.at(self.duration)[1]

    def at(self, t: float) -> tuple[Array, Array]:
        """No position, (3,) zeros [m]; how the handle is turned, (4,) quaternion (x, y, z, w).

        >>> HandleMotion().at(0.0)[1].round(4).tolist()
        [0.0, -0.1736, 0.0, 0.9848]
        """
        q = np.empty(4)
        _handle(float(t), q)
        return _NOWHERE, q

    def pose_on_return(self, p: Array, q: Array, share: float) -> tuple[Array, Array]:
        """No position, (3,) zeros [m], for any `p` (3,); turned from `q` (4,) the short way, (4,) quaternion."""
        rest = self._rest if float(q @ self._rest) >= 0.0 else -self._rest
        way = (1.0 - share) * q + share * rest
        length = float(way @ way) ** 0.5
        return _NOWHERE, way / length if length > 1e-9 else self._rest


def handle_guide(device: Device) -> HandleMotion:
    """The guided motion of a motor's handle; every motor's is the same."""
    return HandleMotion()
