"""Public functions for a spherical motor's magnetics: torque per ampere, field at its sensors, field anywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.devices.device import Device, require
from haptorb.devices.loader import load
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, check_finite, rotation, vectors
from haptorb.numerics.compiled import kernel

__all__ = ["field", "motor", "sensor_field", "torque_characteristic"]


def motor(device: Device | str, what: str = "this function") -> SphericalMotor:
    """`device`, loaded if it is a name. Raises InputError that names `what` if it is not a spherical motor."""
    known = load(device) if isinstance(device, str) else device
    return require(known, SphericalMotor, what)


def torque_characteristic(
    device: Device | str, R_SR: ArrayLike, model: str = "table", *, grouped: bool = False
) -> Array:
    """K (3, m), or (n, 3, m) for a batch: torque on the rotor per ampere [N·m/A], stator frame; Bai 2012 eqs. (2)–(3).

    R_SR (3, 3) or (n, 3, 3) turns rotor vectors into stator vectors. m is the number of coils, or with `grouped` the
    number of channels (coils wired in series). `model` is "table", "exact", "published" or "dipole". Raises
    InputError for a matrix that is not a rotation, and UnknownName for another model.

    >>> from haptorb.numerics.rotations import rotation_from_euler
    >>> K = torque_characteristic("pmsm", rotation_from_euler(*np.radians((10, 5, 5))))
    >>> K[:, 16].round(6).tolist()        # electromagnet 17 [N·m/A]
    [0.0, -0.188419, 0.026007]
    """
    known = motor(device)
    R, single = _orientations(R_SR)
    K = known.torque_characteristic(R, model)
    if grouped:
        K = K @ known.groups
    return K[0] if single else K


def sensor_field(device: Device | str, R_SR: ArrayLike, model: str = "table") -> Array:
    """(k, 3), or (n, k, 3) for a batch: flux density [T] of the rotor's magnets at the sensors, stator frame.

    A sensor's own axes (ϑ̂, φ̂, r̂) are the columns of `device.sensor_layout.frames`. Arguments and errors are those of
    `torque_characteristic`.

    >>> sensor_field("pmsm", np.eye(3)).shape
    (48, 3)
    """
    known = motor(device)
    R, single = _orientations(R_SR)
    B = known.sensor_field(R, model)
    return B[0] if single else B


def field(device: Device | str, R_SR: ArrayLike, points: ArrayLike, currents: ArrayLike | None = None) -> Array:
    """(p, 3), or (n, p, 3) for a batch: flux density [T] at `points` (p, 3) [m], stator frame, exact model.

    Of the rotor's magnets, and of the coils if `currents` (channels,) [A] are given. Inside a magnet it is B
    (not H). Raises GeometryError on an edge, where the field is infinite.

    >>> on_axis = field("pmsm", np.eye(3), [[0.0, 0, 0]])
    >>> bool(abs(on_axis).max() < 1e-12)      # outward and inward magnets cancel at the centre
    True
    """
    known = motor(device)
    R, single = _orientations(R_SR)
    at = vectors(points, "points")
    if at.ndim != 2:
        raise InputError(f"points must have shape (p, 3); got {at.shape}")
    B = known.field(R, at)
    if currents is not None:
        flowing = check_finite(currents, "currents")
        if flowing.shape != (known.channels,):
            raise InputError(f"currents must have shape ({known.channels},), one per channel; got {flowing.shape}")
        B = B + known.coil_field(at, flowing)
    return B[0] if single else B


def _orientations(R_SR: ArrayLike) -> tuple[Array, bool]:
    """(n, 3, 3) checked, and whether one orientation was given; the check is compiled, as the servo comes by here."""
    R = np.asarray(R_SR, dtype=np.float64) if not isinstance(R_SR, str) else check_finite(R_SR, "R_SR")
    if R.ndim not in (2, 3) or R.shape[-2:] != (3, 3):
        raise InputError(f"R_SR must have shape (3, 3) or (n, 3, 3); got {R.shape}")
    batch = np.ascontiguousarray(R.reshape(-1, 3, 3))
    if not _are_rotations(batch):
        rotation(batch, "R_SR")  # says what is wrong
    return batch, R.ndim == 2


@kernel
def _are_rotations(R: Array) -> bool:
    for n in range(R.shape[0]):
        for i in range(3):
            for j in range(i, 3):
                dot = R[n, i, 0] * R[n, j, 0] + R[n, i, 1] * R[n, j, 1] + R[n, i, 2] * R[n, j, 2]
                if not abs(dot - (1.0 if i == j else 0.0)) <= 1e-6:  # NaN fails too
                    return False
        a, b, c = R[n, 0], R[n, 1], R[n, 2]
        turn = a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2])
        if turn + a[2] * (b[0] * c[1] - b[1] * c[0]) < 0.0:
            return False
    return True
