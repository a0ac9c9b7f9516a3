"""What coils and a led tool cannot tell of the sensors: common changes that change no reading, or hardly any.

Each is a linear function of the sensors' errors. Its standard deviation after the calibration is held against that of
the device file: where most of it is left, the readings said nothing, and only the device file does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.numerics.arrays import Array
from haptorb.sensing.sensors.sensor_parameters import PARAMETERS, prior_covariance

__all__ = ["find_observed_share", "list_unobserved"]

_UNOBSERVED = 0.7  #: share of the prior's standard deviation that is left


def _functions(device: SphericalElectromagnet, used: NDArray[np.bool_]) -> dict[str, tuple[Array, str, float, str]]:
    """Name → (c (15 k,) with value c·θ, what it is, factor to its unit, unit)."""
    k, count = device.sensors, int(used.sum())
    places = device.hall.positions
    out: dict[str, tuple[Array, str, float, str]] = {}
    for axis, name in enumerate("xyz"):
        c = np.zeros((k, PARAMETERS))
        i, j = (axis + 1) % 3, (axis + 2) % 3  # E of sensors turned by ω: 1 − [ω]×
        c[:, 3 + 3 * i + j], c[:, 3 + 3 * j + i] = 0.5 / count, -0.5 / count
        out[f"turn-{name}"] = (c, f"rotation of all sensors together about {name}", float(np.degrees(1.0)), "°")
    c = np.zeros((k, PARAMETERS))
    c[:, [3, 7, 11]] = 1.0 / (3 * count)
    out["gain"] = (c, "common gain of all sensors (one with the strength of magnet and coils)", 100.0, "%")
    c = np.zeros((k, PARAMETERS))
    c[:, 12:15] = places / np.linalg.norm(places, axis=1)[:, None] / count
    out["distance"] = (c, "common distance of all sensors from the centre", 1e3, "mm")
    return {name: ((row * used[:, None]).ravel(), what, scale, unit) for name, (row, what, scale, unit) in out.items()}


def find_observed_share(
    device: SphericalElectromagnet, covariance: Array, used: NDArray[np.bool_]
) -> dict[str, tuple[float, float]]:
    """Name → standard deviation that is left of that of the device file (1: nothing was observed), and what is left.

    covariance (15 k, 15 k) of the errors θ [T, 1, m] after the calibration; used (k,).
    """
    prior = np.kron(np.eye(device.sensors), prior_covariance(device.hall.errors))
    out = {}
    for name, (c, _, scale, _) in _functions(device, used).items():
        before, after = float(np.sqrt(c @ prior @ c)), float(np.sqrt(c @ covariance @ c))
        out[name] = (after / before if before > 0 else 0.0, scale * after)
    return out


def list_unobserved(device: SphericalElectromagnet, covariance: Array, used: NDArray[np.bool_]) -> tuple[str, ...]:
    """One sentence for each common change that the readings said nothing of.

    covariance (15 k, 15 k) of the errors θ [T, 1, m] after the calibration; used (k,).
    """
    functions = _functions(device, used)
    lines = []
    for name, (share, left) in find_observed_share(device, covariance, used).items():
        _, what, _, unit = functions[name]
        if share > _UNOBSERVED:
            lines.append(f"{what}: known only from the device file, to {left:.2g} {unit}")
    return tuple(lines)
