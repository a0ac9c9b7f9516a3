"""The ways of knowing a spherical motor from its field sensors, by name: a new one is one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from haptorb.devices.motor import SphericalMotor
from haptorb.errors import UnknownName
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
from haptorb.estimation.types import Estimator, EstimatorChoice, EstimatorSettings, tracker_only

__all__ = ["FIELD_ESTIMATORS", "field_estimator", "motor_estimators"]


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
    """The estimator `name` of FIELD_ESTIMATORS, ready for the loop: each of them also gives the orientation.

    `network` and `linear` find only the torque per ampere themselves; the orientation, which every world needs, comes
    from least squares beside them. `networks` names a network file; the device's own from `haptorb train` if not given.

    Raises UnknownName for another.

    >>> import haptorb
    >>> type(field_estimator("least-squares", haptorb.load("pmsm"))).__name__
    'LeastSquaresOrientation'
    """
    if name not in FIELD_ESTIMATORS:
        raise UnknownName("estimator", name, FIELD_ESTIMATORS)
    return FIELD_ESTIMATORS[name](motor, None if networks is None else read_networks(networks))


def motor_estimators(device: SphericalMotor) -> dict[str, EstimatorChoice]:
    """Name → choice for the motor `device`, the default first.

    >>> import haptorb
    >>> list(motor_estimators(haptorb.load("pmsm")))
    ['least-squares', 'network', 'linear', 'tracker']
    """
    return {name: _choice(name) for name in FIELD_ESTIMATORS} | tracker_only(device)


def _choice(name: str) -> EstimatorChoice:
    if name != "network":
        return EstimatorChoice(lambda motor, settings: FIELD_ESTIMATORS[name](motor, None))

    def make(motor: SphericalMotor, settings: EstimatorSettings) -> Estimator:
        learned = settings.learned
        return _network(motor, parse_networks(learned, "the recording's network file") if learned else None)

    return EstimatorChoice(make, check_networks, read_learned=lambda motor: networks_path(motor).read_bytes())
