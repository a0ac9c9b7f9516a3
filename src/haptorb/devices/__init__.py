"""Devices: device files, kinds of device, and wrench maps of their coils."""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.lazy_names import lazy_names

if TYPE_CHECKING:
    from haptorb.devices.base import DeviceKind
    from haptorb.devices.base import register as register_kind
    from haptorb.devices.coil_array import CoilArray
    from haptorb.devices.core_parameters import fit_eddy_lag
    from haptorb.devices.electromagnet import SphericalElectromagnet
    from haptorb.devices.electromagnet_capability import ShellCapability, shell_capability
    from haptorb.devices.geometry import Geometry
    from haptorb.devices.loader import parse as parse_device
    from haptorb.devices.motor import SphericalMotor
    from haptorb.devices.schema import CommonFile as DeviceFile

__all__ = [
    "CoilArray",
    "DeviceFile",
    "DeviceKind",
    "Geometry",
    "ShellCapability",
    "SphericalElectromagnet",
    "SphericalMotor",
    "fit_eddy_lag",
    "parse_device",
    "register_kind",
    "shell_capability",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "haptorb.devices.base": "DeviceKind register>register_kind",
        "haptorb.devices.coil_array": "CoilArray",
        "haptorb.devices.electromagnet": "SphericalElectromagnet",
        "haptorb.devices.electromagnet_capability": "ShellCapability shell_capability",
        "haptorb.devices.core_parameters": "fit_eddy_lag",
        "haptorb.devices.geometry": "Geometry",
        "haptorb.devices.loader": "parse>parse_device",
        "haptorb.devices.motor": "SphericalMotor",
        "haptorb.devices.schema": "CommonFile>DeviceFile",
    },
)
