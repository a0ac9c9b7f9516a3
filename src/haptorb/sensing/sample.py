"""The measurements of a driver in one tick, and the estimate from them."""

from __future__ import annotations

from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.numerics.arrays import Array
from haptorb.numerics.record import record

__all__ = ["Estimate", "Pose", "Sample"]


@record
class Pose:
    """A pose from a tracker: position and orientation, time of measurement, and validity."""

    t: float  #: time at which the pose was measured [s], on the sample's clock
    R_SR: Array  #: (3, 3)
    p: Array  #: (3,) [m]
    w: Array  #: (3,) [rad/s]
    v: Array  #: (3,) [m/s]
    valid: bool


@record
class Sample:
    """The measurements of one tick; arrays have one entry per channel or per sensor.

    t             time of the tick that read [s]
    currents      (m,) measured [A]
    temperatures  (m,) coil boundary [K]
    field         (k, 3) field sensors [T]; (0, 3) if the device has none
    pose          the tracker's last pose; not valid for a rotor that is measured by its field
    currents_age  age of the currents at t [s], from the middle of their sensors' averaging time; negative if
                  they were measured after the tick began
    field_age     the same for the field [s]
    """

    t: float
    currents: Array
    temperatures: Array
    field: Array
    pose: Pose
    currents_age: float = 0.0
    field_age: float = 0.0


@record
class Estimate:
    """The estimate: state of the mover, wrench map there, age, and limits of validity."""

    state: State
    wrench_map: WrenchMap
    valid: bool  #: False: where the mover is, is not known; nothing may be asked of the coils
    age: float  #: of the pose behind it [s]
    oriented: bool = True  #: False: R_SR and w are not estimated, they are NaN; the wrench map was found without them
    spin_period: float = 0.0  #: turns about the mover's z are known but for a multiple of this [rad]; 0: absolutely
    covariance: Array | None = None  #: (3, 3) of the orientation as a rotation vector, stator frame [rad²], if known
    strength: float = 1.0  #: of the mover's magnets, relative to the device file, where the estimator finds it
    disbelieved: int = 0  #: number of field sensors whose readings were left out
    reversed: bool = False  #: the mover's magnet is the wrong way round: every force would invert
