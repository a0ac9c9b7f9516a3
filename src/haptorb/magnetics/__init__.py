"""Magnetics: fields of magnets, coils and soft spheres, and forces and torques between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.lazy_names import lazy_names

if TYPE_CHECKING:
    from haptorb.magnetics.coil import Coil
    from haptorb.magnetics.dipole import MU0, Dipole
    from haptorb.magnetics.dipole import field as dipole_field
    from haptorb.magnetics.dipole import field_gradient as dipole_field_gradient
    from haptorb.magnetics.dipole import force as dipole_force
    from haptorb.magnetics.dipole import torque as dipole_torque
    from haptorb.magnetics.interaction import BoundedValue, wrench
    from haptorb.magnetics.magnets import CylinderMagnet, RingMagnet
    from haptorb.magnetics.soft_sphere import SoftSphere
    from haptorb.magnetics.source import PlacedSource, Source

__all__ = [
    "MU0",
    "BoundedValue",
    "Coil",
    "CylinderMagnet",
    "Dipole",
    "PlacedSource",
    "RingMagnet",
    "SoftSphere",
    "Source",
    "dipole_field",
    "dipole_field_gradient",
    "dipole_force",
    "dipole_torque",
    "wrench",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "haptorb.magnetics.coil": "Coil",
        "haptorb.magnetics.dipole": "MU0 Dipole field>dipole_field field_gradient>dipole_field_gradient "
        "force>dipole_force torque>dipole_torque",
        "haptorb.magnetics.interaction": "BoundedValue wrench",
        "haptorb.magnetics.magnets": "CylinderMagnet RingMagnet",
        "haptorb.magnetics.soft_sphere": "SoftSphere",
        "haptorb.magnetics.source": "PlacedSource Source",
    },
)
