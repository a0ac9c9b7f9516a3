"""The pair tables of one spherical motor, and the device's torque and field looked up in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from haptorb.devices.tables import table_kernels
from haptorb.devices.tables.pair_table import PairTable, Progress
from haptorb.devices.tables.table_cache import load_field_table, load_torque_table
from haptorb.numerics.arrays import Array

if TYPE_CHECKING:
    from haptorb.devices.motor.parts import MotorParts

__all__ = ["MotorTables", "motor_tables"]


@dataclass(frozen=True)
class MotorTables:
    """k(u·c) of one magnet and one coil, and f(u·s), g(u·s) of one magnet and one sensor."""

    torque_pair: PairTable
    field_pair: PairTable

    def torque(self, motor: MotorParts, R: Array) -> Array:
        """(n, 3, coils) torque on the rotor per ampere in every coil [N·m/A], for R (n, 3, 3)."""
        coils = motor.electromagnets.directions
        out = np.empty((len(R), 3, len(coils)))
        table = self.torque_pair
        table_kernels.torque_characteristic(
            table.cells, table.scale, motor.magnets.directions, motor.polarity, coils, np.ascontiguousarray(R), out
        )
        return out

    def field(self, motor: MotorParts, R: Array) -> Array:
        """(n, sensors, 3) flux density at the sensors [T], stator frame, for R (n, 3, 3)."""
        sensors = motor.sensor_layout.directions
        out = np.empty((len(R), len(sensors), 3))
        table = self.field_pair
        table_kernels.sensor_field(
            table.cells, table.scale, motor.magnets.directions, motor.polarity, sensors, np.ascontiguousarray(R), out
        )
        return out


def motor_tables(motor: MotorParts, progress: Progress | None = None) -> MotorTables:
    """Built from the exact model, or read from the cache; PrecisionError if the parts are too close for a table."""
    magnet, out = motor.magnet, motor.magnets.distance
    return MotorTables(
        load_torque_table(magnet, out, motor.electromagnet, motor.electromagnets.distance, progress=progress),
        load_field_table(magnet, out, motor.sensor_layout.distance, progress=progress),
    )
