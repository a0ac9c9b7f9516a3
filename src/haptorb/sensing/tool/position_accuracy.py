"""How well field sensors can tell where the tool is: the best that any unbiased estimate can do (Cramér and Rao).

What limits it, in this order: the field of the tool falls with the cube of the distance, its change with the fourth
power, so that the sensors' distance from the tool counts most; then the sensors' noise; then, under current, what is
not known about the coils' own field, through the noise of the current readings and the errors of the calibration.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import rotation_to_axis
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, check_finite, vectors
from haptorb.sensing.tool.tool_field import ToolModel, coil_field, tool_field

__all__ = ["better_sensors", "position_accuracy", "with_sensors"]


def position_accuracy(
    device: SphericalElectromagnet,
    places: ArrayLike,
    axes: ArrayLike | None = None,
    currents: ArrayLike = (0.0, 0.0, 0.0),
    *,
    noise: float | None = None,
    calibration: float = 0.0,
) -> Array:
    """(n, 5) standard deviations of one sample: place [m] along stator x y z, two turns across the axis [rad].

    places (n, 3) [m]; axes (n, 3), radial where none are given; currents (m,) [A]; noise of one reading [T], the
    device's where none is given; calibration: standard deviation of each entry of the 3 × m moment map, as a share of
    its column.

    Raises InputError for other shapes, and where nothing is noisy.

    >>> from haptorb.devices.loader import load
    >>> deviation = position_accuracy(load("omni"), [(0.0, 0.0, 0.05)])[0]
    >>> bool(5e-4 < deviation[0] < 2e-3)          # across the axis it is about a millimetre at the assumed places
    True
    """
    at = vectors(places, "places").reshape(-1, 3)
    along = at if axes is None else vectors(axes, "axes").reshape(-1, 3)
    amperes = check_finite(currents, "currents")
    if along.shape != at.shape or amperes.shape != (device.channels,):
        raise InputError(
            f"needs one axis per place and {device.channels} currents; got {at.shape}, {along.shape}, {amperes.shape}"
        )
    hall, supply = device.hall, device.supply
    sigma = hall.noise if noise is None else float(check_finite(noise, "noise"))
    if sigma < 0 or calibration < 0 or sigma + hall.step == 0:
        raise InputError(
            f"noise and calibration must be 0 T or more, and not all of them 0 T; got {sigma} T, {calibration} T"
        )
    per_ampere = coil_field(device).reshape(-1, device.channels)
    ampere2 = supply.current_noise**2 + supply.current_step**2 / 12
    spread = (sigma**2 + hall.step**2 / 12) * np.eye(len(per_ampere)) + ampere2 * per_ampere @ per_ampere.T
    if calibration:
        unit = per_ampere @ np.linalg.inv(device.moment_per_current)
        errors = calibration * np.linalg.norm(device.moment_per_current, axis=0) * amperes  # A·m² per coil
        spread += float(errors @ errors) * unit @ unit.T
    weight = np.linalg.inv(spread)
    model = ToolModel.of(device)
    k = device.sensors
    B, J = np.empty((k, 3)), np.empty((k, 3, 5))
    out = np.empty((len(at), 5))
    for row, p, axis in zip(out, at, along, strict=True):
        tool_field(model, np.ascontiguousarray(p), rotation_to_axis(axis), B, J)
        j = J.reshape(-1, 5)
        row[:] = np.sqrt(np.diag(np.linalg.inv(j.T @ weight @ j)))
    return out


def with_sensors(device: SphericalElectromagnet, positions: ArrayLike) -> SphericalElectromagnet:
    """`device` with its field sensors at `positions` (k, 3) [m]: a study, not another file.

    Raises InputError for fewer than two, or one inside the core.
    """
    at = vectors(positions, "positions").reshape(-1, 3)
    if len(at) < 2 or float(np.linalg.norm(at, axis=1).min()) <= device.core_radius:
        raise InputError("field sensors must be at least two, outside the core")
    return replace(device, hall=replace(device.hall, positions=at, correction=None))


def better_sensors(device: SphericalElectromagnet) -> Array:
    """(9, 3) [m] a better placement than the assumed one: two level rings at the dome's equator, clear of the pen.

    Four sensors 4 mm off the dome, five at twice its radius, all 3 mm above the centre: as high as a pen that leans
    outwards at the workspace's edge allows. The near ring is close to the tool, the far one sees it from another side;
    the assumed places waste five of nine sensors on the half that is away from the tool. Under the dome's skin it would
    be twice as good again; but there the coils' field is no dipole's, and exceeds a Hall sensor's range of 40 mT.

    >>> from haptorb.devices.loader import load
    >>> (1e3 * better_sensors(load("omni"))[4]).tolist()
    [60.0, 0.0, 3.0]
    """

    def ring(count: int, radius: float, begin: float) -> Array:
        turn = 2 * np.pi * (np.arange(count) + begin) / count
        return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(count, 3e-3)])

    return np.vstack([ring(4, device.dome_radius + 4e-3, 0.5), ring(5, 2 * device.dome_radius, 0.0)])
