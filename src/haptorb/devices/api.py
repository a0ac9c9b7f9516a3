"""Devices by name, and their magnetics: wrench map of any device; torque per ampere and field of a spherical motor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite, rotation, vectors
from haptorb.compiled import kernel
from haptorb.devices.base import Device, State, WrenchMap, check_distance, require
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import find_device
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import InputError

__all__ = ["electromagnet", "field", "motor", "sensor_field", "torque_characteristic", "wrench_map"]


def wrench_map(device: Device | str | Path, state: State, model: str | None = None) -> WrenchMap:
    """Compute the wrench per ampere of every channel of a device at one pose.

    Parameters
    ----------
    device : Device, str or Path
        Device, or its name in the catalogue, or path of its file.
    state : State
        Pose of the mover.
    model : str, optional
        One of `device.models`; None: the first.

    Returns
    -------
    WrenchMap
        `matrix` (6, m) [N/A, N·m/A] and `passive` (6,) [N, N·m]; stator frame, torque about the mover's origin.

    Raises
    ------
    UnknownName
        If the device has no such model.
    GeometryError
        If a magnet would be inside a coil or the core at this pose.

    Examples
    --------
    >>> per_ampere = wrench_map("omni", State.at((0, 0, 0.05)), model="published").matrix
    >>> round(float(-1e3 * per_ampere[2, 2]), 1)        # pull of the z coil [mN/A]
    50.5
    """
    known = find_device(device)
    return known.wrench_map(state, model or known.models[0])


# --------------------------------------------------------------------------------------------------
# A device that must be of one kind, for programs that support only that.


def electromagnet(device: Device | str | Path, what: str = "this function") -> SphericalElectromagnet:
    """`device`, loaded if it is a name or a file. Raises InputError that names `what` if it is no spherical
    electromagnet."""
    return require(find_device(device), SphericalElectromagnet, what)


def motor(device: Device | str | Path, what: str = "this function") -> SphericalMotor:
    """`device`, loaded if it is a name or a file. Raises InputError that names `what` if it is no spherical motor."""
    return require(find_device(device), SphericalMotor, what)


# --------------------------------------------------------------------------------------------------
# Magnetics of a spherical motor: torque per ampere, field at its sensors, field anywhere.


def torque_characteristic(
    device: Device | str | Path, R_SR: ArrayLike, model: str = "table", *, grouped: bool = False
) -> Array:
    """Compute a motor's torque characteristic K: torque on the rotor per ampere, Bai 2012 eqs. (2)–(3).

    Parameters
    ----------
    device : Device, str or Path
        Spherical motor, or its name in the catalogue, or path of its file.
    R_SR : array_like, shape (3, 3) or (n, 3, 3)
        Rotation from the rotor's frame to the stator frame.
    model : str
        "table" (interpolated, servo speed), "exact", "published" (multipoles of Bai 2012) or "dipole".
    grouped : bool
        One column per channel (coils wired in series) instead of one per coil.

    Returns
    -------
    ndarray, shape (3, m) or (n, 3, m)
        Torque per ampere [N·m/A] in the stator frame; m coils, or channels.

    Raises
    ------
    InputError
        If R_SR is not a rotation, or the device is not a spherical motor.
    UnknownName
        If there is no such model.

    Notes
    -----
    The torque is T = K i. "exact" integrates the magnets' closed-form fields over the thick windings; iron and
    saturation are left out.

    Examples
    --------
    >>> from haptorb.rotations import rotation_from_euler
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


def sensor_field(device: Device | str | Path, R_SR: ArrayLike, model: str = "table") -> Array:
    """Compute the flux density of a motor's magnets at its field sensors.

    Parameters
    ----------
    device : Device, str or Path
        Spherical motor, or its name in the catalogue, or path of its file.
    R_SR : array_like, shape (3, 3) or (n, 3, 3)
        Rotation from the rotor's frame to the stator frame.
    model : str
        "table", "exact", "published" or "dipole", as for `torque_characteristic`.

    Returns
    -------
    ndarray, shape (k, 3) or (n, k, 3)
        Flux density [T] in the stator frame. A sensor's own axes (ϑ̂, φ̂, r̂) are the columns of
        `device.sensor_layout.frames`.

    Raises
    ------
    InputError
        If R_SR is not a rotation, or the device is not a spherical motor.
    UnknownName
        If there is no such model.

    Examples
    --------
    >>> sensor_field("pmsm", np.eye(3)).shape
    (48, 3)
    """
    known = motor(device)
    R, single = _orientations(R_SR)
    B = known.sensor_field(R, model)
    return B[0] if single else B


def field(device: Device | str | Path, R_SR: ArrayLike, points: ArrayLike, currents: ArrayLike | None = None) -> Array:
    """Compute the flux density of a motor's magnets, and of its coils, at any points, by the exact model.

    Parameters
    ----------
    device : Device, str or Path
        Spherical motor, or its name in the catalogue, or path of its file.
    R_SR : array_like, shape (3, 3) or (n, 3, 3)
        Rotation from the rotor's frame to the stator frame.
    points : array_like, shape (p, 3)
        Points in the stator frame [m].
    currents : array_like, shape (m,), optional
        Current of each channel [A]; None: the magnets alone.

    Returns
    -------
    ndarray, shape (p, 3) or (n, p, 3)
        Flux density B [T] in the stator frame, also inside a magnet.

    Raises
    ------
    InputError
        If R_SR is not a rotation, a shape is wrong, or the device is not a spherical motor.
    GeometryError
        At a point on the edge of a magnet, where the field is infinite.

    Examples
    --------
    >>> on_axis = field("pmsm", np.eye(3), [[0.0, 0, 0]])
    >>> bool(abs(on_axis).max() < 1e-12)      # outward and inward magnets cancel at the centre
    True
    """
    known = motor(device)
    R, single = _orientations(R_SR)
    at = vectors(points, "points")
    if at.ndim != 2:
        raise InputError(f"points must have shape (p, 3); got {at.shape}")
    check_distance(at, "points")
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
