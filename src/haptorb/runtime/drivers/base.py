"""Interface to a device, simulated or real: read a sample, write duties, switch the coils off at the end."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.arrays import Array, vectors
from haptorb.compiled import kernel
from haptorb.control.trip_reasons import CoilState
from haptorb.devices.base import Device
from haptorb.earlier_names import warn_earlier
from haptorb.errors import DriverError, InputError
from haptorb.estimation.types import Pose, Sample

__all__ = [
    "CHANNELS",
    "DUTY_FULL",
    "DUTY_STEPS",
    "HALL_SENSORS",
    "SPAN_3V3",
    "SPAN_5V",
    "THERMOMETERS",
    "Driver",
    "HallSensors",
    "check_electronics",
    "counts",
    "fill_field",
    "invalid_pose",
    "quantise_duties",
]


_UNKNOWN = np.full(7, np.nan)

_NO_WRENCH = np.full(6, np.nan)

#: methods of a driver before version 0.2.0 → present names
_EARLIER_METHODS: Final = {"truth": "wrench_actual", "target": "hand_goal", "squeeze": "write_grip_force"}


class Driver(ABC):
    """Interface to a device, simulated or real; the base class of every driver.

    Coils are off before `open`, after `close`, and after leaving a `with` block. A subclass implements `open`, `close`,
    `read` and `write`, and sets the attributes below.

    Attributes
    ----------
    name : str
        Name on the command line, as in `--driver`.
    simulated : bool
        True only if the device cannot exert forces on a person.
    lead : float
        Time before a tick at which `prepare` is called [s].
    """

    name: str
    simulated: bool
    lead: float = 0.0

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        for earlier, now in _EARLIER_METHODS.items():
            if earlier in cls.__dict__ and now not in cls.__dict__:
                warn_earlier(f"{cls.__name__}.{earlier}() is now called {now}()")
                setattr(cls, now, cls.__dict__[earlier])

    @abstractmethod
    def open(self) -> None:
        """Connect to the device, with the coils off.

        Raises
        ------
        DriverError
            If the device does not respond; the message states what did not, and what to do.
        """

    @abstractmethod
    def close(self) -> None:
        """Switch the coils off, then disconnect. May be called twice."""

    def prepare(self, now: float) -> None:
        """Do work for the coming tick that need not wait for it; `read` must also work without it.

        Raises only what `read` will raise again.

        Parameters
        ----------
        now : float
            Time of the tick [s].
        """
        return

    @abstractmethod
    def read(self, now: float) -> Sample:
        """Read the sensors, within the tick.

        Parameters
        ----------
        now : float
            Time of the tick [s].

        Returns
        -------
        Sample
            The measurements, with their ages; never an invented reading.

        Raises
        ------
        DriverError
            If the device does not respond in time.
        """

    @abstractmethod
    def write(self, duties: Array) -> Array:
        """Apply duty cycles to the coils, within the tick.

        Parameters
        ----------
        duties : ndarray, shape (m,)
            Duty cycle of each channel, −1 to 1 of the supply voltage [1].

        Returns
        -------
        ndarray, shape (m,)
            Duty cycles that are actually applied, after clipping and quantisation [1].

        Raises
        ------
        DriverError
            If the device does not respond in time.
        """

    def write_grip_force(self, force: float) -> float:
        """Apply a force to the device's gripper, within the tick, after `write`; by default there is none.

        Parameters
        ----------
        force : float
            Force between thumb and finger, positive to open [N].

        Returns
        -------
        float
            Force that is actually commanded [N].

        Raises
        ------
        DriverError
            If the device does not respond in time.
        """
        return 0.0

    @property
    def coil_state(self) -> CoilState:
        """Whether current can flow, as confirmed by the device. OFF only if the device confirmed it: UNKNOWN
        between the command to switch off and the confirmation. A driver without that information returns UNKNOWN."""
        return CoilState.UNKNOWN

    @property
    def field_axes(self) -> Array | None:
        """(k, 3) unit vectors, stator frame: the direction in which each one-axis field sensor measures; None:
        three-axis sensors."""
        return None

    @property
    def calibration(self) -> bytes | None:
        """Id of the calibration stored in the open device: 16 bytes, zeros for none; None: it has no memory."""
        return None

    def remember(self, calibration: bytes) -> bool:
        """Store the id of a calibration in the open device.

        Parameters
        ----------
        calibration : bytes
            Id of the calibration, 16 bytes.

        Returns
        -------
        bool
            False if the device has no memory.

        Raises
        ------
        DriverError
            If storing fails.
        """
        return False

    def engage(self) -> None:
        """Clear a trip that the hardware latched, when the user engages; no current flows before the next `write`.

        By default it does nothing.

        Raises
        ------
        DriverError
            If the trip cannot be cleared.
        """
        return

    def cool(self) -> None:
        """Set simulated coils to the ambient temperature; no effect on a real device."""
        return

    def wrench_actual(self) -> Array:
        """Return the actual wrench of coils and core on the mover in the last tick, if the driver knows it.

        Returns
        -------
        ndarray, shape (6,)
            Force [N] and torque [N·m] in the stator frame; NaN on a real device.
        """
        return _NO_WRENCH

    def hand_goal(self) -> Array:
        """Return the goal of the simulated hand, if there is one.

        Returns
        -------
        ndarray, shape (7,)
            Position [m], then quaternion (x, y, z, w); NaN on a real device.
        """
        return _UNKNOWN

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


# --------------------------------------------------------------------------------------------------
# Electronics of both real drivers: three coils, nine Hall sensors, duties in PWM steps, no tracker.


CHANNELS = 3
HALL_SENSORS = 9  #: sensor positions
THERMOMETERS = 3
DUTY_FULL = 4095  #: largest duty, in steps
DUTY_STEPS = 4096  #: steps in one PWM period: a duty of n steps is n / 4096 of the supply

_UPRIGHT, _STILL = np.eye(3), np.zeros(3)
_UPRIGHT.flags.writeable = _STILL.flags.writeable = False


def invalid_pose(now: float) -> Pose:
    """An invalid pose, for devices without a tracker."""
    return Pose(now, _UPRIGHT, _STILL, _STILL, _STILL, valid=False)


def check_electronics(device: Device, driver: str, reader: str) -> Array:
    """Return the positions of the device's Hall sensors (9, 3) [m].

    Raises DriverError, which states what `driver` and `reader` support, unless the device has as many.
    """
    if device.channels != CHANNELS:
        raise DriverError(f"{driver} serves {CHANNELS} coils; device '{device.name}' has {device.channels}")
    positions: Array | None = getattr(getattr(device, "hall", None), "positions", None)
    if positions is None or len(positions) != HALL_SENSORS:
        raise DriverError(f"{reader} reads {HALL_SENSORS} Hall sensors; device '{device.name}' has another number")
    return positions


@kernel
def quantise_duties(duties: Array, steps: NDArray[np.int64]) -> bool:
    """Fill `steps` (3,), signed PWM steps, with duties (3,) in −1…1 [1], clipped, NaN as zero; return whether any is
    not zero."""
    some = False
    for i in range(CHANNELS):
        whole = min(max(duties[i] * DUTY_STEPS, -DUTY_FULL), DUTY_FULL)
        steps[i] = 0 if duties[i] != duties[i] else round(whole)
        some = some or steps[i] != 0
    return some


def counts(duties: ArrayLike) -> list[int]:
    """Convert duties (3,) in −1…1 [1] to signed PWM steps, clipped; NaN becomes zero.

    Raises InputError for another shape.

    >>> counts([0.5, -2.0, float("nan")])
    [2048, -4095, 0]
    """
    asked = np.ascontiguousarray(duties, dtype=np.float64)
    if asked.shape != (CHANNELS,):
        raise InputError(f"duties must have one entry per coil, shape ({CHANNELS},); got shape {asked.shape}")
    steps = np.empty(CHANNELS, np.int64)
    quantise_duties(asked, steps)
    return [int(one) for one in steps]


# --------------------------------------------------------------------------------------------------
# Conversion of Hall readings to field: linear sensors, three axes at each position, or the radial one only.
#
# A DRV5055A2 (assumed) gives half its supply at zero field and 50 mV/mT at 5 V; the converter measures against the same
# supply, so the range 0…1 stands for −50…+50 mT however far the 5 V are off. At 3.3 V it gives 30 mV/mT: −55…+55 mT.


SPAN_5V = 5.0 / 50.0  #: field over the converter's full range [T], both at 5 V: a board
SPAN_3V3 = 3.3 / 30.0  #: the same, both at 3.3 V: a Raspberry Pi


@kernel
def fill_field(field: Array, radial: Array, axes: int, span: float, axis: int, first: int, shares: Array) -> None:
    """Write `shares` (n,) 0…1 of the range `span` [T], of sensors from `first` on, into `field` (k, 3) [T]: along
    `axis`, or where the sensors have only one, along radial (k, 3)."""
    for n in range(len(shares)):
        tesla = (shares[n] - 0.5) * span
        if axes == 3:
            field[first + n, axis] = tesla
        else:
            for i in range(3):
                field[first + n, i] = tesla * radial[first + n, i]


class HallSensors:
    """Hall sensors at `positions` (k, 3) [m]: three axes each, along the device's x, y, z, or one, radially outward.

    axes         3 or 1
    span         field over the converter's full range [T]
    directions   (k, 3) measuring directions of one-axis sensors; None for three axes

    Raises InputError if a position is not a finite 3-vector, or is at the centre, where the radius is undefined; for
    other axes, or a span that is not positive.

    >>> radial = HallSensors([[0.0, 0.0, -0.055]], axes=1)
    >>> field = radial.empty_field()
    >>> radial.put(field, 0, 0, (0.6,))                          # 10 mT outward: along −z
    >>> field.round(4).tolist()
    [[0.0, 0.0, -0.01]]
    """

    def __init__(self, positions: Array | list[list[float]], axes: int = 3, span: float = SPAN_5V) -> None:
        at = vectors(positions, "positions of the Hall sensors")
        distance = np.linalg.norm(at, axis=1, keepdims=True)
        if axes not in (1, 3):
            raise InputError(f"a Hall sensor has one axis or three; got {axes}")
        if (distance == 0).any():
            raise InputError("a Hall sensor at the centre has no radial direction")
        if not span > 0.0:
            raise InputError(f"the span of a Hall sensor must be above 0 T; got {span}")
        self.axes, self.span = axes, span
        self.radial: Array = np.ascontiguousarray(at / distance)  #: (k, 3) unit vectors, outward

    @property
    def directions(self) -> Array | None:
        """(k, 3) unit vectors, stator frame, of one-axis sensors; None: each measures all three."""
        return self.radial if self.axes == 1 else None

    def empty_field(self) -> Array:
        """Field (k, 3) of NaN [T]: nothing was read."""
        return np.full(self.radial.shape, np.nan)

    def put(self, field: Array, axis: int, first: int, shares: tuple[float, ...]) -> None:
        """Write readings of `axis` of the sensors from `first` on to `field` (k, 3) [T]; shares 0…1 of the range [1].

        Tangential components, which one-axis sensors do not measure, are zero. An estimator must use the radial ones.
        """
        fill_field(field, self.radial, self.axes, self.span, axis, first, np.array(shares, dtype=np.float64))

    def shares(self, field: Array) -> Array:
        """Readings (axes, k) in shares of the converter's range 0…1 [1] at a true field (k, 3) [T], clipped as in the
        sensor."""
        visible = field.T if self.axes == 3 else np.einsum("ki,ki->k", field, self.radial)[None]
        shares: Array = np.clip(visible / self.span + 0.5, 0.0, 1.0)
        return shares
