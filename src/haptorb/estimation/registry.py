"""Estimators of each kind of device, by name."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import singledispatch
from pathlib import Path

from haptorb.arrays import Array
from haptorb.devices.base import Device, device_function
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import UnknownName
from haptorb.estimation.hall_tracker import IN_TURNS, HallTracker
from haptorb.estimation.motor_orientation import LeastSquaresOrientation
from haptorb.estimation.network import (
    FieldToTorque,
    LinearTorque,
    NetworkTorque,
    TrainedNetworks,
    check_networks,
    networks_path,
    parse_networks,
    read_networks,
)
from haptorb.estimation.types import Estimator, EstimatorChoice, EstimatorSettings, TrackedPose

__all__ = [
    "FIELD_ESTIMATORS",
    "check_estimator",
    "field_estimator",
    "list_estimators",
    "make_estimator",
    "read_learned",
]


@device_function
@singledispatch
def list_estimators(device: Device) -> dict[str, EstimatorChoice]:
    """List the estimators of a device, by its kind; every kind has "tracker".

    Parameters
    ----------
    device : Device
        The device.

    Returns
    -------
    dict of str to EstimatorChoice
        The estimators by their names, the default first.

    Examples
    --------
    >>> import haptorb
    >>> list(list_estimators(haptorb.load("omni-sensor-ring"))), list(list_estimators(haptorb.load("pmsm")))
    (['tracker', 'hall'], ['least-squares', 'network', 'linear', 'tracker'])
    """
    return {"tracker": EstimatorChoice(lambda device, settings: TrackedPose(device, settings.model))}


@list_estimators.register(SphericalElectromagnet)
def _(device: SphericalElectromagnet) -> dict[str, EstimatorChoice]:
    found = list_estimators.dispatch(object)(device)
    if device.sensors > 1:
        found["hall"] = EstimatorChoice(_hall, axes=3)
    return found


def _hall(device: SphericalElectromagnet, settings: EstimatorSettings) -> Estimator:
    model, offsets = settings.model, settings.offsets
    if settings.in_turns:
        return HallTracker(device, model, offsets=offsets, bandwidth=IN_TURNS)
    return HallTracker(device, model, offsets=offsets)


def _least_squares(motor: SphericalMotor, networks: TrainedNetworks | None) -> Estimator:
    return LeastSquaresOrientation(motor)


def _network(motor: SphericalMotor, networks: TrainedNetworks | None) -> Estimator:
    trained = check_networks(motor) if networks is None else networks
    return FieldToTorque(motor, NetworkTorque(motor, trained), LeastSquaresOrientation(motor))


def _linear(motor: SphericalMotor, networks: TrainedNetworks | None) -> Estimator:
    return FieldToTorque(motor, LinearTorque(motor), LeastSquaresOrientation(motor))


FIELD_ESTIMATORS: dict[str, Callable[[SphericalMotor, TrainedNetworks | None], Estimator]] = {
    "least-squares": _least_squares,
    "network": _network,
    "linear": _linear,
}


def field_estimator(name: str, motor: SphericalMotor, networks: Path | None = None) -> Estimator:
    """Create the estimator `name` of FIELD_ESTIMATORS for the loop; each of them also estimates the orientation.

    `network` and `linear` estimate only the torque per ampere; the orientation, which every world needs, is estimated
    by least squares in parallel. `networks` names a network file; the device's own from `haptorb train` if not given.

    Raises UnknownName for any other name.

    >>> import haptorb
    >>> type(field_estimator("least-squares", haptorb.load("pmsm"))).__name__
    'LeastSquaresOrientation'
    """
    if name not in FIELD_ESTIMATORS:
        raise UnknownName("estimator", name, FIELD_ESTIMATORS)
    return FIELD_ESTIMATORS[name](motor, None if networks is None else read_networks(networks))


@list_estimators.register(SphericalMotor)
def _(device: SphericalMotor) -> dict[str, EstimatorChoice]:
    return {name: _choice(name) for name in FIELD_ESTIMATORS} | list_estimators.dispatch(object)(device)


def _choice(name: str) -> EstimatorChoice:
    if name != "network":
        return EstimatorChoice(lambda motor, settings: FIELD_ESTIMATORS[name](motor, None))

    def make(motor: SphericalMotor, settings: EstimatorSettings) -> Estimator:
        learned = settings.learned
        return _network(motor, parse_networks(learned, "the recording's network file") if learned else None)

    return EstimatorChoice(make, check_networks, read_learned=lambda motor: networks_path(motor).read_bytes())


def check_estimator(device: Device, name: str | None) -> str:
    """Return `name` if it exists, or the default of `device` for None.

    Raises UnknownName for an estimator that does not exist for the device, InputError for one that is not ready, such
    as networks before their training.
    """
    known = list_estimators(device)
    if name is None:
        return next(iter(known))
    check = _find(device, known, name).check
    if check is not None:
        check(device)
    return name


def make_estimator(
    device: Device,
    name: str,
    model: str | None = None,
    offsets: Array | None = None,
    *,
    in_turns: bool = False,
    learned: bytes = b"",
) -> Estimator:
    """Create the estimator `name` of `device`, by its `model`; `offsets` (k, 3) [T] of its field sensors, if known.

    in_turns: the driver reads a part of the field sensors in each tick. learned: as `read_learned` returns it, instead
    of what this computer has. Raises UnknownName for an estimator that does not exist for the device.
    """
    choice = _find(device, list_estimators(device), name)
    return choice.make(device, EstimatorSettings(model, offsets, in_turns, learned))


def read_learned(device: Device, name: str) -> bytes:
    """File with the trained data of the estimator `name` of `device`, such as networks; empty for an estimator without
    training, or if there is none."""
    read = list_estimators(device)[name].read_learned
    with suppress(OSError):
        return b"" if read is None else read(device)
    return b""


def _find(device: Device, known: dict[str, EstimatorChoice], name: str) -> EstimatorChoice:
    if name not in known:
        raise UnknownName(f"estimator of device '{device.name}'", name, known)
    return known[name]
