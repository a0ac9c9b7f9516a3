"""How well real field sensors tell where the tool is: what the tracker reaches, and the best that any estimate can do.

Two kinds of errors. Noise is new in every reading, and the tracker's filter averages it. Lasting errors stay, and no
filter helps: those of the sensors (`sensor_parameters`), of the coils' field that is subtracted, and what remains in
the core. With J the field's derivative by the pose, Σ the covariance of all errors and W the weight that the tracker
gives to the readings, the tracker's covariance is A Σ Aᵀ, A = (Jᵀ W J)⁻¹ Jᵀ W, and the bound of Cramér and Rao, for
errors of which Σ is all that is known, is (Jᵀ Σ⁻¹ J)⁻¹. Both are first order in the errors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from haptorb.devices.electromagnet.core_dynamics import CoreDynamics
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.field_sensors import FieldSensors
from haptorb.devices.sensor_errors import SensorErrors
from haptorb.devices.state import rotation_to_axis
from haptorb.numerics.arrays import Array, check_finite
from haptorb.sensing.sensors.sensor_parameters import PARAMETERS, prior_covariance, sensitivity, tool_readings
from haptorb.sensing.tool.tool_field import ToolModel, coil_field, moment_field

__all__ = ["SensorKnowledge", "pose_covariance", "without_errors"]

_CALIBRATED = 1e-3  #: standard deviation of the moment map's entries that the tracker assumes, of their column


@dataclass(frozen=True)
class SensorKnowledge:
    """What is known of the sensors' lasting errors.

    covariance  (15 k, 15 k) of the sensors' errors θ, as in `sensor_parameters`
    coils       (3 k, m) standard deviation of what each sensor reads per ampere, where that was measured [T/A]; None:
                it is computed from moments, whose entries are known to `moments`, and the sensors' errors apply to it
    moments     standard deviation of the moment map's entries, relative to their column
    drift       (2,) offset [T] and gain [1] by which the sensors drifted since, standard deviations
    remanent    moment that may be left in the core, standard deviation of each axis [A·m²]
    eddy        share of the moment that may be missing because the core lags, standard deviation
    """

    covariance: Array
    coils: Array | None = None
    moments: float = 0.0
    drift: tuple[float, float] = (0.0, 0.0)
    remanent: float = 0.0
    eddy: float = 0.0

    @classmethod
    def of(cls, errors: SensorErrors, count: int, **known: float) -> SensorKnowledge:
        """Of `count` sensors of which the distributions of `errors` are all that is known."""
        whole = np.kron(np.eye(count), prior_covariance(errors))
        return cls(whole, **known)  # type: ignore[arg-type]


def without_errors(device: SphericalElectromagnet) -> SphericalElectromagnet:
    """`device` with sensors that have noise and quantisation only, and a core that follows the currents: a study.

    >>> from haptorb.devices.loader import load
    >>> without_errors(load("omni")).hall.errors.offset
    0.0
    """
    hall = device.hall
    return replace(device, hall=FieldSensors(hall.positions, hall.noise, hall.step), core_dynamics=CoreDynamics())


def pose_covariance(
    device: SphericalElectromagnet,
    p: ArrayLike,
    axis: ArrayLike,
    currents: ArrayLike,
    knowledge: SensorKnowledge,
    share: float = 1.0,
) -> tuple[Array, Array]:
    """(5, 5) covariance of place [m²] and two turns across the axis [rad²]: of the tracker, and the least possible.

    The tool is at p (3,) [m] with `axis` (3,); currents (m,) [A]; share: of the noise's standard deviation that the
    filter leaves.

    >>> from haptorb.devices.loader import load
    >>> omni = without_errors(load("omni"))
    >>> ideal = SensorKnowledge.of(SensorErrors(), omni.sensors)
    >>> reached, bound = pose_covariance(omni, (0, 0, 0.06), (0, 0, 1), (0, 0, 0), ideal)
    >>> bool(np.allclose(reached, bound, rtol=1e-3)), bool(1e-4 < np.sqrt(np.trace(bound[:3, :3])) < 1e-2)
    (True, True)
    """
    at, along, i = (check_finite(value, name) for value, name in ((p, "p"), (axis, "axis"), (currents, "currents")))
    model, hall, supply = ToolModel.of(device), device.hall, device.supply
    B, J, gradient = tool_readings(model, np.ascontiguousarray(at), rotation_to_axis(along))
    per_ampere, unit = coil_field(device).reshape(-1, device.channels), moment_field(device).reshape(-1, 3)
    readings = 3 * device.sensors
    noise = hall.noise**2 + hall.step**2 / 12
    ampere = (supply.current_noise**2 + supply.current_step**2 / 12) * per_ampere @ per_ampere.T
    whole, slope = B, gradient
    if knowledge.coils is None:  # the sensors' errors apply to the coils' field as well
        moment = device.moment_per_current @ i
        whole, slope = B + (unit @ moment).reshape(-1, 3), gradient + _moment_gradient(model.sensors, moment)
    lasting = _spread(sensitivity(whole, slope), knowledge.covariance)
    columns = (device.moment_per_current**2).sum(axis=0)
    if knowledge.coils is None:
        lasting += float(columns @ (knowledge.moments * i) ** 2) * unit @ unit.T
    else:
        lasting += np.diag((knowledge.coils**2) @ i**2)
    late = knowledge.eddy * unit @ device.moment_per_current @ i
    lasting += knowledge.remanent**2 * unit @ unit.T + np.outer(late, late)
    lasting += knowledge.drift[0] ** 2 * np.eye(readings) + np.diag((knowledge.drift[1] * whole.ravel()) ** 2)
    Σ = share**2 * (noise * np.eye(readings) + ampere) + lasting
    doubt = _CALIBRATED**2 + knowledge.eddy**2  # the tracker knows how far the core's lag may be off
    believed = doubt * float(columns @ i**2) + device.core_dynamics.remanent_moment**2
    W = np.linalg.inv(noise * np.eye(readings) + ampere + believed * unit @ unit.T)
    j = J.reshape(-1, 5)
    A = np.linalg.solve(j.T @ W @ j, j.T @ W)
    return A @ Σ @ A.T, np.linalg.inv(j.T @ np.linalg.solve(Σ, j))


def _spread(S: Array, covariance: Array) -> Array:
    """(3 k, 3 k) covariance of readings whose sensitivity to the sensors' errors is S (k, 3, 15)."""
    count = len(S)
    full = np.zeros((3 * count, PARAMETERS * count))
    for k in range(count):
        full[3 * k : 3 * k + 3, PARAMETERS * k : PARAMETERS * (k + 1)] = S[k]
    spread: Array = full @ covariance @ full.T
    return spread


def _moment_gradient(at: Array, moment: Array) -> Array:
    """(k, 3, 3) ∂B/∂x [T/m] of a dipole `moment` (3,) [A·m²] at the centre, at places (k, 3) [m].

    ∂B_i/∂x_j = 3 K/r⁵ [m_i x_j + m_j x_i + (m·x)(δ_ij − 5 x_i x_j/r²)], K = μ0/4π.
    """
    r2 = (at**2).sum(axis=1)[:, None, None]
    along = (at @ moment)[:, None, None]
    outer = at[:, :, None] * at[:, None, :]
    both = moment[None, :, None] * at[:, None, :] + at[:, :, None] * moment[None, None, :]
    slope: Array = 3e-7 / r2**2.5 * (both + along * (np.eye(3) - 5 * outer / r2))
    return slope
