"""Torque characteristic and sensor field without tables: any parts, any pose, to a given precision.

Truth for the tables, and the only path for parts that are tilted, off-centre or not bodies of revolution about an axis
through the centre. Costs about a second per orientation where a table takes microseconds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, rotation, vectors
from haptorb.errors import GeometryError, InputError
from haptorb.magnetics.interaction import BoundedValue, wrench
from haptorb.magnetics.source import PlacedSource, RoundBody, Source

__all__ = ["exact_sensor_field", "exact_torque_characteristic"]

_CENTRE = np.zeros(3)


def exact_torque_characteristic(
    rotor: Source, coils: Sequence[PlacedSource], R_SR: ArrayLike, *, precision: float = 1e-7
) -> BoundedValue:
    """(..., 3, m) torque on the rotor about the centre per ampere in each coil [N·m/A], and its error bound.

    `rotor` holds all magnets in the rotor's frame (a `SourceSum`), `coils` the coils placed in the stator's, R_SR
    (..., 3, 3). Each coil's torque is reached to `precision` of its own magnitude, or PrecisionError is raised;
    GeometryError where a coil reaches into a magnet.

    >>> from haptorb.magnetics.coil import Coil
    >>> from haptorb.magnetics.magnets import CylinderMagnet
    >>> magnet = PlacedSource(CylinderMagnet(5e-3, 4e-3, 1.2), (0, 0, 30e-3), np.eye(3))
    >>> coil = PlacedSource(Coil(100, 2e-3, 5e-3, 4e-3), (0, 0, 20e-3), np.eye(3))
    >>> tilt = [[1, 0, 0], [0, 0.99, -0.14106735979665885], [0, 0.14106735979665885, 0.99]]    # by 8°: pulled back
    >>> bool(exact_torque_characteristic(magnet, [coil], tilt).value[0, 0] < 0)
    True
    """
    turns = rotation(R_SR, "R_SR")
    flat = turns.reshape(-1, 3, 3)
    value, bound = np.empty((len(flat), 3, len(coils))), np.empty((len(flat), 3, len(coils)))
    for n, turn in enumerate(flat):
        magnets = PlacedSource(rotor, _CENTRE, turn)
        for j, coil in enumerate(coils):
            body = coil.source
            if not isinstance(body, RoundBody):
                raise InputError(f"coil {j + 1} must be a winding (a RoundBody); got {type(body).__name__}")
            on_coil = wrench(magnets, body, coil.position, coil.turn, about=_CENTRE, precision=precision)
            value[n, :, j] = -on_coil.value[3:]  # the rotor feels the opposite of what the coil feels
            bound[n, :, j] = on_coil.bound[3:]
    shape = (*turns.shape[:-2], 3, len(coils))
    return BoundedValue(value.reshape(shape), bound.reshape(shape))


def exact_sensor_field(rotor: Source, sensors: ArrayLike, R_SR: ArrayLike) -> Array:
    """(..., k, 3) flux density [T], stator frame, at sensor positions (k, 3) [m] for orientations R_SR (..., 3, 3).

    Raises GeometryError for a sensor inside a magnet.
    """
    turns, places = rotation(R_SR, "R_SR"), vectors(sensors, "sensors")
    own = np.einsum("...ji,kj->...ki", turns, places)  # Rᵀ p: the sensors as the rotor sees them
    inside = rotor.contains(own)
    if inside.any():
        where = np.argwhere(inside.reshape(-1, len(places)))[0][1]
        raise GeometryError(f"sensor {where + 1} at {places[where].tolist()} m lies inside a magnet: move it out")
    field: Array = np.einsum("...ij,...kj->...ki", turns, rotor.field(own))
    return field
