"""Error models of the kinds of devices."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

from haptorb.analysis.array_errors import array_errors
from haptorb.analysis.electromagnet_errors import tool_errors
from haptorb.analysis.error_budget import ErrorModel
from haptorb.analysis.motor_errors import motor_errors
from haptorb.devices.arm import Arm
from haptorb.devices.base import Device, device_function, unsupported
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.estimation.calibration_file import Calibration

__all__ = ["error_model"]


@device_function
@singledispatch
def error_model(
    device: Device,
    asked: float | None = None,
    estimator: str | None = None,
    calibration: Calibration | None = None,
) -> ErrorModel[Any, Any]:
    """Create the error model of a device, by its kind; `haptorb inspect --errors` needs it.

    Parameters
    ----------
    device : Device
        The device.
    asked : float, optional
        Magnitude of the commanded wrench [N or N·m]; None: half of the smallest peak in the workspace.
    estimator : str, optional
        Name of the estimator; None: the default one.
    calibration : Calibration, optional
        Calibration of the device.

    Returns
    -------
    ErrorModel
        Sources of error and the chain from the commanded to the delivered wrench.

    Raises
    ------
    InputError
        For a kind without an error model, and for an infeasible wrench or option.
    UnknownName
        For another estimator.
    """
    raise unsupported(device, "`haptorb inspect --errors`", error_model)


@error_model.register
def _(
    device: Arm, asked: float | None = None, estimator: str | None = None, calibration: Calibration | None = None
) -> ErrorModel[Any, Any]:
    """Raise InputError, which lists the known errors of an arm."""
    step, supply, per_ampere = device.encoder.step, device.supply, device.force_per_ampere
    raise InputError(
        f"there is no error budget of '{device.name}': the file of a haptic arm states no tolerances. Known are steps "
        f"of position ({1e3 * step:g} mm), steps and noise of the current "
        f"({1e3 * per_ampere * supply.current_step:.3g} and {1e3 * per_ampere * supply.current_noise:.3g} mN) and dry "
        f"friction ({device.effector.coulomb:g} N); `haptorb inspect {device.name}` shows the rest"
    )


error_model.register(SphericalElectromagnet, tool_errors)
error_model.register(SphericalMotor, motor_errors)
error_model.register(CoilArray, array_errors)
