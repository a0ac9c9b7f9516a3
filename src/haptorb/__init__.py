"""haptorb: design, simulate and run spherical electromagnetic haptic devices.

Names are loaded when they are first used, so that `haptorb --help` does not wait for a compiler.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from haptorb.version import __version__ as __version__

#: public name → module that defines it
_HOME = {
    "State": "haptorb.devices.base",
    "WrenchMap": "haptorb.devices.base",
    "Device": "haptorb.devices.base",
    "Servo": "haptorb.runtime.servo",
    "Recording": "haptorb.recording.recording",
    "load": "haptorb.devices.loader",
    "force_map": "haptorb.simulation.force_map",
    "wrench_map": "haptorb.devices.api",
    "field": "haptorb.devices.motor",
    "sensor_field": "haptorb.devices.motor",
    "torque_characteristic": "haptorb.devices.motor",
    "rotation_from_euler": "haptorb.rotations",
}

__all__ = [
    "Device",
    "Recording",
    "Servo",
    "State",
    "WrenchMap",
    "field",
    "force_map",
    "load",
    "rotation_from_euler",
    "sensor_field",
    "torque_characteristic",
    "wrench_map",
]

if TYPE_CHECKING:
    from haptorb.devices.api import wrench_map
    from haptorb.devices.base import Device, State, WrenchMap
    from haptorb.devices.loader import load
    from haptorb.devices.motor import field, sensor_field, torque_characteristic
    from haptorb.recording.recording import Recording
    from haptorb.rotations import rotation_from_euler
    from haptorb.runtime.servo import Servo
    from haptorb.simulation.force_map import force_map


#: earlier public name → today's
_EARLIER = {"felt_map": "force_map"}


def __getattr__(name: str) -> object:
    if name in _EARLIER:
        from warnings import warn

        warn(f"haptorb.{name} is now called haptorb.{_EARLIER[name]}", DeprecationWarning, stacklevel=2)
        name = _EARLIER[name]
    if name not in _HOME:
        raise AttributeError(f"module 'haptorb' has no attribute '{name}'")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
