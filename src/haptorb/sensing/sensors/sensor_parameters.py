"""What a reading owes to the lasting errors of its sensor: 15 parameters each, and how far they are known beforehand.

A sensor with errors θ = (b, E, d) reads r = (1 + E) B(x + d) + b where an ideal one at x reads B(x): an offset b (3)
[T], a matrix E (3, 3) of gain, cross-axis and rotation together, and a displacement d (3) [m].
"""

from __future__ import annotations

from typing import Final

import numpy as np

from haptorb.devices.sensor_errors import SensorErrors
from haptorb.numerics.arrays import Array
from haptorb.sensing.tool.tool_field import ToolModel, tool_field

__all__ = ["DISPLACEMENT", "MIXING", "OFFSET", "PARAMETERS", "prior_covariance", "sensitivity", "tool_readings"]

PARAMETERS: Final = 15  #: of one sensor
OFFSET: Final = slice(0, 3)
MIXING: Final = slice(3, 12)  #: rows of E one after another
DISPLACEMENT: Final = slice(12, 15)

_SHIFT = 5e-5  #: of a difference quotient [m]


def tool_readings(model: ToolModel, p: Array, R: Array) -> tuple[Array, Array, Array]:
    """B (k, 3) [T] of the tool at p (3,) [m] and R (3, 3) with the core's answer; J (k, 3, 5) as `tool_field`; and
    ∂B/∂x (k, 3, 3) [T/m] by each sensor's place x."""
    k = len(model.sensors)
    B, J = np.empty((k, 3)), np.empty((k, 3, 5))
    gradient, unused = np.empty((k, 3, 3)), np.empty((k, 3, 5))
    above, below = np.empty((k, 3)), np.empty((k, 3))
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = _SHIFT
        tool_field(model._replace(sensors=model.sensors + shift), p, R, above, unused)
        tool_field(model._replace(sensors=model.sensors - shift), p, R, below, unused)
        gradient[:, :, axis] = (above - below) / (2 * _SHIFT)
    tool_field(model, p, R, B, J)
    return B, J, gradient


def sensitivity(B: Array, gradient: Array, mixing: Array | None = None) -> Array:
    """(k, 3, 15) ∂r/∂θ of readings of the field B (k, 3) [T] whose derivative by place is gradient (k, 3, 3) [T/m].

    mixing (k, 3, 3): 1 + E of each sensor; None: that of ideal ones.
    """
    count = len(B)
    S = np.zeros((count, 3, PARAMETERS))
    S[:, :, OFFSET] = np.eye(3)
    for axis in range(3):
        S[:, axis, 3 + 3 * axis : 6 + 3 * axis] = B
    S[:, :, DISPLACEMENT] = gradient if mixing is None else mixing @ gradient
    return S


def prior_covariance(errors: SensorErrors) -> Array:
    """(15, 15) covariance of θ of one sensor of which the device file's distributions are all that is known.

    >>> prior = prior_covariance(SensorErrors(gain=0.01, offset=5e-5, placement=2e-4))
    >>> np.sqrt(np.diag(prior))[[0, 3, 4, 12]].round(6).tolist()
    [5e-05, 0.01, 0.0, 0.0002]
    """
    C = np.zeros((PARAMETERS, PARAMETERS))
    C[OFFSET, OFFSET] = errors.offset**2 * np.eye(3)
    C[DISPLACEMENT, DISPLACEMENT] = errors.placement**2 * np.eye(3)
    for i in range(3):
        for j in range(3):
            at = 3 + 3 * i + j
            if i == j:
                C[at, at] = errors.gain**2
            else:  # a rotation is antisymmetric
                C[at, at] = errors.cross**2 + errors.angle**2
                C[at, 3 + 3 * j + i] = -(errors.angle**2)
    return C
