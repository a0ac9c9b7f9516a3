"""The parts of a spherical motor that make field and torque, as every model takes them."""

from __future__ import annotations

from typing import Protocol

from haptorb.devices.motor.layouts import Layout
from haptorb.numerics.arrays import Array
from haptorb.physics.sources.coil import Coil
from haptorb.physics.sources.cylinder import CylinderMagnet
from haptorb.physics.sources.multipole import MultipoleSource

__all__ = ["MotorParts"]


class MotorParts(Protocol):
    """Round magnets on a rotor, round coils and field sensors on a stator, all axes through one centre."""

    @property
    def name(self) -> str:
        """Of the device."""

    @property
    def magnets(self) -> Layout:
        """Where the magnets are, in the rotor's frame."""

    @property
    def polarity(self) -> Array:
        """(p,) [1]: +1 where a magnet is polarized outward, −1 inward (other values scale its strength)."""

    @property
    def magnet(self) -> CylinderMagnet:
        """One of them, polarized along its +z, which points outward."""

    @property
    def electromagnets(self) -> Layout:
        """Where the coils are, in the stator's frame."""

    @property
    def electromagnet(self) -> Coil:
        """One of them; positive current is right-handed about the outward axis."""

    @property
    def sensor_layout(self) -> Layout:
        """Where the field sensors are, in the stator's frame."""

    @property
    def magnet_model(self) -> MultipoleSource | None:
        """The published model of one magnet."""

    @property
    def coil_model(self) -> MultipoleSource | None:
        """The published model of one coil, per ampere."""
