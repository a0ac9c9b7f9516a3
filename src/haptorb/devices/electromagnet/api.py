"""The door to a spherical electromagnet, for programs that work for no other kind."""

from __future__ import annotations

from haptorb.devices.device import Device, require
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet

__all__ = ["electromagnet"]


def electromagnet(device: Device, what: str = "this function") -> SphericalElectromagnet:
    """`device`, if it is a spherical electromagnet; InputError, which calls the program `what`, if not."""
    return require(device, SphericalElectromagnet, what)
