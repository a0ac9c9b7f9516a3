"""Error models of the kinds of devices."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

from haptorb.analysis.array_errors import array_errors
from haptorb.analysis.electromagnet_errors import tool_errors
from haptorb.analysis.error_budget import ErrorModel
from haptorb.analysis.motor_errors import motor_errors
from haptorb.devices.base import Device, device_function, unsupported
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.motor import SphericalMotor
from haptorb.estimation.calibration import Calibration

__all__ = ["error_model"]


@device_function
@singledispatch
def error_model(
    device: Device,
    asked: float | None = None,
    estimator: str | None = None,
    calibration: Calibration | None = None,
) -> ErrorModel[Any, Any]:
    """Error model of `device` for a commanded wrench of `asked` [N or N·m], by its kind.

    None: half of the smallest peak in the workspace, the default estimator, no calibration. Raises InputError for a
    kind without an error model, and for what the device cannot give or have; UnknownName for another estimator.
    """
    raise unsupported(device, "`haptorb inspect --errors`", error_model)


error_model.register(SphericalElectromagnet, tool_errors)
error_model.register(SphericalMotor, motor_errors)
error_model.register(CoilArray, array_errors)
