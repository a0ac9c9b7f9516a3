"""What a motor's field sensors should read and what its coils can do, as compiled code takes it: one packed array."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from haptorb.devices.motor.regulator import torque_over_sine
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.devices.tables.table_kernels import torque_characteristic
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.numerics.packing import pack, part

__all__ = ["FieldModel", "field_model", "torque_per_ampere", "unpack"]


class FieldModel(NamedTuple):
    """The parts of a motor's model, within compiled code."""

    field_cells: Array
    field_scale: float
    torque_cells: Array
    torque_scale: float
    magnets: Array  #: (p, 3) rotor frame
    polarity: Array  #: (p,)
    sensors: Array  #: (k, 3) stator frame
    coils: Array  #: (c, 3) stator frame
    groups: Array  #: (c, m)
    per_ampere: Array  #: (m, 3 k) the coils' field at the sensors [T/A]
    tilt_torque: Array  #: (n,) coefficients of weight and regulator, as `regulator.torque_over_sine` takes them [N·m]
    least: float  #: the least cosine they hold for


def field_model(motor: SphericalMotor) -> Array:
    """(n,) all of FieldModel, [T] and [N·m/A] from the motor's pair tables; `unpack` takes it apart."""
    field, torque = motor.tables.field_pair, motor.tables.torque_pair
    coefficients, least = motor.tilt_torque
    return pack(
        (field.scale, torque.scale, least),
        field.cells,
        torque.cells,
        motor.magnets.directions,
        motor.polarity,
        motor.sensor_layout.directions,
        motor.electromagnets.directions,
        motor.groups,
        motor.sensor_field_per_ampere,
        coefficients,
    )


@kernel
def unpack(model: Array) -> FieldModel:
    """What `field_model` made, its parts in their own units."""
    one = part(model, 0)
    return FieldModel(
        part(model, 1), one[0, 0], part(model, 2), one[0, 1], part(model, 3), part(model, 4)[0], part(model, 5),
        part(model, 6), part(model, 7), part(model, 8), part(model, 9)[0], one[0, 2],
    )  # fmt: skip


@kernel
def torque_per_ampere(model: FieldModel, R: Array, strength: float, matrix: Array, passive: Array) -> None:
    """Fill matrix (6, m): no force, and [N·m/A] in every channel at R (3, 3); passive (6,): weight and regulator."""
    single = np.empty((1, 3, model.coils.shape[0]))
    torque_characteristic(
        model.torque_cells, model.torque_scale, model.magnets, model.polarity, model.coils, R.reshape(1, 3, 3), single
    )
    for i in range(3):
        for j in range(matrix.shape[1]):
            matrix[i, j], matrix[3 + i, j] = 0.0, 0.0
        for c in range(model.coils.shape[0]):
            K = strength * single[0, i, c]
            for j in range(matrix.shape[1]):
                matrix[3 + i, j] += K * model.groups[c, j]
    back = torque_over_sine(R[2, 2], model.tilt_torque, model.least)
    passive[0], passive[1], passive[2] = 0.0, 0.0, 0.0
    passive[3], passive[4], passive[5] = back * R[1, 2], -back * R[0, 2], 0.0
