"""haptorb: design, simulate and run spherical electromagnetic haptic devices.

Public names are here and in `haptorb.worlds`, `haptorb.devices`, `haptorb.kinds`, `haptorb.magnetics`,
`haptorb.testing`, `haptorb_study` and `haptorb_design`. All other modules are internal.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.earlier_names import EARLIER, get_earlier, install_finder
from haptorb.lazy_names import lazy_names
from haptorb.version import __version__ as __version__

if TYPE_CHECKING:
    from haptorb.analysis.error_budget import ErrorSource
    from haptorb.analysis.stability import GRIPS, HandGrip, SampledLoop
    from haptorb.cli.error_report import report_errors as inspect_errors
    from haptorb.control.trip_reasons import CoilState
    from haptorb.devices.api import field, sensor_field, torque_characteristic, wrench_map
    from haptorb.devices.base import Device, State, WrenchMap
    from haptorb.devices.loader import load
    from haptorb.errors import (
        CalibrationError,
        DeviceError,
        DriverError,
        GeometryError,
        HaptorbError,
        InputError,
        PlatformError,
        PrecisionError,
        RecordingError,
        RecordingWarning,
        ServoError,
        UnknownName,
        WorldError,
    )
    from haptorb.estimation.types import Estimate, Estimator, Pose, Sample, TrackedPose
    from haptorb.recording.recording import Recording
    from haptorb.replay.replay import Replay
    from haptorb.rotations import rotation_from_euler
    from haptorb.runtime.config import RunConfig
    from haptorb.runtime.drivers.base import Driver
    from haptorb.runtime.servo import Servo
    from haptorb.runtime.trackers.base import Feed, RawPose
    from haptorb.simulation.base import Simulation
    from haptorb.simulation.force_map import force_map

__all__ = [
    "GRIPS",
    "CalibrationError",
    "CoilState",
    "Device",
    "DeviceError",
    "Driver",
    "DriverError",
    "ErrorSource",
    "Estimate",
    "Estimator",
    "Feed",
    "GeometryError",
    "HandGrip",
    "HaptorbError",
    "InputError",
    "PlatformError",
    "Pose",
    "PrecisionError",
    "RawPose",
    "Recording",
    "RecordingError",
    "RecordingWarning",
    "Replay",
    "RunConfig",
    "Sample",
    "SampledLoop",
    "Servo",
    "ServoError",
    "Simulation",
    "State",
    "TrackedPose",
    "UnknownName",
    "WorldError",
    "WrenchMap",
    "field",
    "force_map",
    "inspect_errors",
    "load",
    "rotation_from_euler",
    "sensor_field",
    "torque_characteristic",
    "wrench_map",
]

_get, __dir__ = lazy_names(
    __name__,
    {
        "haptorb.analysis.error_budget": "ErrorSource",
        "haptorb.analysis.stability": "GRIPS HandGrip SampledLoop",
        "haptorb.cli.error_report": "report_errors>inspect_errors",
        "haptorb.control.trip_reasons": "CoilState",
        "haptorb.devices.api": "field sensor_field torque_characteristic wrench_map",
        "haptorb.devices.base": "Device State WrenchMap",
        "haptorb.devices.loader": "load",
        "haptorb.errors": "CalibrationError DeviceError DriverError GeometryError HaptorbError InputError "
        "PlatformError PrecisionError RecordingError RecordingWarning ServoError UnknownName WorldError",
        "haptorb.estimation.types": "Estimate Estimator Pose Sample TrackedPose",
        "haptorb.recording.recording": "Recording",
        "haptorb.replay.replay": "Replay",
        "haptorb.rotations": "rotation_from_euler",
        "haptorb.runtime.config": "RunConfig",
        "haptorb.runtime.drivers.base": "Driver",
        "haptorb.runtime.servo": "Servo",
        "haptorb.runtime.trackers.base": "Feed RawPose",
        "haptorb.simulation.base": "Simulation",
        "haptorb.simulation.force_map": "force_map",
    },
)

install_finder()


def __getattr__(name: str) -> object:
    return get_earlier(__name__, name) if f"{__name__}:{name}" in EARLIER else _get(name)
