"""What the Hall tracker remembers between two ticks, and the settings that it goes by: two structured arrays.

`TRACKER` holds what is there once, in an array of one record; `SENSOR` what every field sensor has, in k records.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.numerics.arrays import Array, Records, fields
from haptorb.sensing.tool.place_filter import FILTER
from haptorb.sensing.tool.tool_field import moment_field

__all__ = ["SENSOR", "TRACKER", "coil_error", "make_sensors", "make_tracker"]

_REACH = 15e-3  #: how far outside the shell a tool's position is still valid [m]

#: There is one.
TRACKER = fields(
    # settings
    ("noise", "f8"),  # of one reading [T]
    ("bandwidth", "f8"),  # of place and axis [Hz]
    ("nearest", "f8"),  # distance from the centre below which a tool's position is invalid [m]
    ("furthest", "f8"),  # distance from the centre above which a tool's position is invalid [m]
    ("lowest", "f8"),  # cosine of the steepest place
    ("readings", "i8"),  # of all axes of the sensors that are used
    ("lasting", "f8"),  # standard deviation of the error that stays in a reading of the tool [T]
    ("coil_error", "f8"),  # share of the coils' own field that may be left in a reading
    ("eddy_share", "f8"),  # of the currents' moment that lags
    ("eddy_time", "f8"),  # constant of the lag [s]
    ("eddy_doubt", "f8"),  # standard deviation of that share
    ("remanent", "f8"),  # moment that may stay in the core, standard deviation of each axis [A·m²]
    ("coupling", "f8", (3, 3)),  # UᵀU, U the field of unit moments at all sensors [T²/(A²·m⁴)]
    # this tick
    ("moment_noise", "f8", (3, 3)),  # covariance of the moment from the currents' noise [A²·m⁴]
    ("swing", "f8"),  # field that the currents may be wrong by, where they change quickly [T]
    ("limit", "f8"),  # what may be left unexplained [T]
    ("weight", "f8", (3, 3)),  # G of `tool_fit`: what is known about the moment [A²·m⁴/T²]
    ("rates", "f8", (5,)),  # of the place [m/s] and of the turns about the mover's x and y [rad/s]
    # remembered
    ("lagged_at", "f8"),  # time of the currents that went through the lag last [s]
    ("share", "f8"),  # of the readings that are new in a tick, averaged
    ("residual", "f8"),  # rms of what the last fit left unexplained [T]
    ("misfit", "f8"),  # its square, averaged [T²]
    ("covariance", "f8", (5, 5)),  # of what was seen last: place [m²], turns about two axes across the tool's [rad²]
    ("filter", FILTER),
)

#: Of each field sensor: what it said last of the tool alone, and what is known about it.
SENSOR = fields(
    ("used", "?"),  # False: it has failed and is left out
    ("offset", "f8", (3,)),  # at zero current without a tool [T]
    ("gain", "f8", (3, 3)),  # field per reading
    ("per_moment", "f8", (3, 3)),  # field per moment along x, y, z of the electromagnet [T/(A·m²)]
    ("left", "f8", (3,)),  # of the reading without offset and coils, in the sensor's axes [T]
    ("field", "f8", (3,)),  # of tool and core alone [T]
    ("taken", "f8", (3,)),  # when that was read, per axis [s]; -inf before the first reading
    ("age", "f8", (3,)),  # how long ago that is [s]
)


def make_tracker(device: SphericalElectromagnet, noise: float, bandwidth: float, lasting: float) -> Records:
    """(1,) TRACKER for `device`, whose readings have `noise` and `lasting` errors [T]: no tool was seen yet."""
    made = np.zeros(1, dtype=TRACKER)
    made["noise"], made["bandwidth"], made["share"] = noise, bandwidth, 1.0
    made["nearest"] = device.contact_distance - _REACH
    made["furthest"] = device.contact_distance + device.shell_thickness + _REACH
    made["lowest"] = math.cos(min(device.workspace_half_angle + math.radians(30), math.pi))
    used = _find_used(device)
    made["readings"], made["lasting"] = 3 * int(used.sum()), lasting
    made["coil_error"] = 0.0 if device.hall.correction is not None else coil_error(device)
    core = device.core_dynamics
    made["eddy_share"], made["eddy_time"] = core.eddy_share, core.eddy_time
    made["eddy_doubt"], made["remanent"] = core.spread * core.eddy_share, core.remanent_moment
    made["lagged_at"] = -math.inf
    per_moment = moment_field(device) * used[:, None, None]
    made["coupling"] = np.einsum("kia,kib->ab", per_moment, per_moment)
    made["residual"] = math.inf
    made["covariance"] = math.inf
    return made


def make_sensors(device: SphericalElectromagnet, offsets: Array) -> Records:
    """(k,) SENSOR for `device` with `offsets` (k, 3) [T]: nothing was read yet."""
    made = np.zeros(device.sensors, dtype=SENSOR)
    correction = device.hall.correction
    made["used"], made["per_moment"] = _find_used(device), moment_field(device)
    made["offset"], made["gain"] = offsets, np.eye(3) if correction is None else correction.gain
    made["left"] = made["field"] = made["taken"] = made["age"] = -math.inf
    made["field"][~made["used"]] = 0.0
    return made


def coil_error(device: SphericalElectromagnet) -> float:
    """Standard deviation of the coils' field that remains in a reading of sensors without calibration, as a share.

    >>> from haptorb.devices.loader import load
    >>> 0.01 < coil_error(load("omni")) < 0.03
    True
    """
    errors, at = device.hall.errors, np.linalg.norm(device.hall.positions.reshape(-1, 3), axis=1)
    far = 3 * errors.placement / float(at.mean()) if len(at) else 0.0  # a dipole's field falls with the cube
    return math.sqrt(errors.gain**2 + 2 * errors.cross**2 + 2 * errors.angle**2 + far**2)


def _find_used(device: SphericalElectromagnet) -> NDArray[np.bool_]:
    """(k,) sensors that have not failed."""
    correction = device.hall.correction
    return np.ones(device.sensors, dtype=np.bool_) if correction is None else correction.used
