"""Devices: device files, kinds of device, and wrench maps of their coils."""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.lazy_names import lazy_names

if TYPE_CHECKING:
    from haptorb.devices.base import DeviceKind
    from haptorb.devices.coil_array import CoilArray
    from haptorb.devices.core_parameters import fit_eddy_lag
    from haptorb.devices.electromagnet import SphericalElectromagnet
    from haptorb.devices.electromagnet_capability import ShellCapability, shell_capability
    from haptorb.devices.geometry import Geometry
    from haptorb.devices.loader import parse as parse_device
    from haptorb.devices.motor import SphericalMotor
    from haptorb.devices.quantity import (
        Angle,
        Conductance,
        Current,
        Damping,
        Duration,
        FieldDrift,
        Force,
        ForceRate,
        HeatCapacity,
        Inductance,
        Inertia,
        InverseKelvin,
        Length,
        MagneticMoment,
        Mass,
        Modulus,
        MomentPerCurrent,
        Number,
        Polarization,
        Power,
        Resistance,
        Slew,
        Stiffness,
        Temperature,
        TemperatureStep,
        Torque,
        TorqueRate,
        TurnDamping,
        TurnStiffness,
        Voltage,
    )
    from haptorb.devices.registry import register as register_kind
    from haptorb.devices.schema import CommonFile as DeviceFile
    from haptorb.devices.schema import Count, Meaning, Point, Positive, Section, Text

__all__ = [
    "Angle",
    "CoilArray",
    "Conductance",
    "Count",
    "Current",
    "Damping",
    "DeviceFile",
    "DeviceKind",
    "Duration",
    "FieldDrift",
    "Force",
    "ForceRate",
    "Geometry",
    "HeatCapacity",
    "Inductance",
    "Inertia",
    "InverseKelvin",
    "Length",
    "MagneticMoment",
    "Mass",
    "Meaning",
    "Modulus",
    "MomentPerCurrent",
    "Number",
    "Point",
    "Polarization",
    "Positive",
    "Power",
    "Resistance",
    "Section",
    "ShellCapability",
    "Slew",
    "SphericalElectromagnet",
    "SphericalMotor",
    "Stiffness",
    "Temperature",
    "TemperatureStep",
    "Text",
    "Torque",
    "TorqueRate",
    "TurnDamping",
    "TurnStiffness",
    "Voltage",
    "fit_eddy_lag",
    "parse_device",
    "register_kind",
    "shell_capability",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "haptorb.devices.base": "DeviceKind",
        "haptorb.devices.coil_array": "CoilArray",
        "haptorb.devices.core_parameters": "fit_eddy_lag",
        "haptorb.devices.electromagnet": "SphericalElectromagnet",
        "haptorb.devices.electromagnet_capability": "ShellCapability shell_capability",
        "haptorb.devices.geometry": "Geometry",
        "haptorb.devices.loader": "parse>parse_device",
        "haptorb.devices.motor": "SphericalMotor",
        "haptorb.devices.quantity": "Angle Conductance Current Damping Duration FieldDrift Force ForceRate "
        "HeatCapacity Inductance Inertia InverseKelvin Length MagneticMoment "
        "Mass Modulus MomentPerCurrent Number Polarization Power Resistance "
        "Slew Stiffness Temperature TemperatureStep Torque TorqueRate "
        "TurnDamping TurnStiffness Voltage",
        "haptorb.devices.registry": "register>register_kind",
        "haptorb.devices.schema": "CommonFile>DeviceFile Count Meaning Point Positive Section Text",
    },
)
