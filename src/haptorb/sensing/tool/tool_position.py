"""Where the tool is, from the field sensors alone, while the coils are driven: `--tracker hall`.

What coils and core do per ampere is known (calibrated), the measured currents give it, and it is subtracted; what is
left is the tool's magnet and the core's answer to it. Place and axis that explain it best are the estimate; the turn
about the axis leaves no trace in the field of a round magnet and is taken as zero.

What is measured in every tick goes through the filter of `sensing.place_filter`: 100 Hz (−3 dB) at any rate of the
loop, the place not late at steady velocity, the velocity 7 ms late.

Where a driver reads the sensors in turns, what it did not read in a tick is NaN. The last reading of each stands in,
less the coils' field at the time when it was taken (`sensing.current_history`), and is held against where the tool was
then, by its velocity.

A tick whose readings are consistent but contain too little is skipped: for 10 ms the tool's pose is extrapolated to
where it should be by then, and the estimate says how old what was seen of it is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import State, rotation_to_axis
from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import GeometryError, InputError
from haptorb.numerics.arrays import Array, check_finite
from haptorb.numerics.state_arrays import StateArray, Stateful, choose, make_numbers
from haptorb.sensing.controller_model import ControllerModel
from haptorb.sensing.estimator import Estimator
from haptorb.sensing.kept_estimate import KeptEstimate
from haptorb.sensing.sample import Estimate, Sample
from haptorb.sensing.tool.current_history import CurrentHistory
from haptorb.sensing.tool.tool_field import ToolModel, coil_field, pack_model, tool_field
from haptorb.sensing.tool.tool_following import (
    LOCATED,
    LOST,
    REVERSED,
    UNEXPLAINED,
    UNREAD,
    VAGUE,
    filter_fit,
    fit_anew,
    follow_tool,
    is_explained,
    subtract_coils,
)
from haptorb.sensing.tool.tracker_state import make_sensors, make_tracker

__all__ = ["IN_TURNS", "HallTracker"]

#: bandwidth [Hz] for drivers that read the sensors in turns, six ticks for all: more lets through noise only
IN_TURNS = 30.0

_PAUSE = 0.05  #: without a sample for so long the velocity says nothing any more [s]
_CARRIED = 0.01  #: for so long the tool's motion is extrapolated while the readings contain too little [s]
_VERDICTS = ("", "lost", "reversed")
_WAIT = 0.02  #: between two searches from nothing [s]: a search takes longer than a tick


class HallTracker(Estimator):
    """Uses the field sensors; the sample's `pose` is ignored.

    device     a spherical electromagnet with at least two field sensors
    model      of the device, for the wrench map; None: its first
    offsets    (k, 3) [T] of the sensors at zero current without a tool, as calibration found them
    bandwidth  of place and axis [Hz]

    `verdict` says why an estimate is not valid: "lost", "reversed" (the tool's magnet is the wrong way round: forces
    would invert), or "" where it is.

    Raises InputError for a device without such sensors, a bandwidth or offsets that cannot be.

    >>> from haptorb.devices.loader import load
    >>> HallTracker(load("omni")).verdict
    'lost'
    """

    state_kind = "hall"
    LOST: Final = "lost"
    REVERSED: Final = "reversed"

    def __init__(
        self,
        device: SphericalElectromagnet,
        model: str | None = None,
        *,
        offsets: ArrayLike | None = None,
        bandwidth: float = 100.0,
    ) -> None:
        if device.shell is None or device.sensors < 2:
            raise InputError(
                f"device '{device.name}': locating a tool needs at least two field sensors of a spherical "
                "electromagnet; "
                "use another tracker"
            )
        if not 1.0 <= bandwidth <= 1000.0:
            raise InputError(f"bandwidth must be between 1 and 1000 Hz; got {bandwidth!r}")
        correction = device.hall.correction
        if correction is not None:
            offsets = correction.offset
            if int(correction.used.sum()) < 2:
                raise InputError(
                    f"device '{device.name}': fewer than two field sensors work; repair them and calibrate again, or "
                    "use another tracker"
                )
        zero = np.zeros((device.sensors, 3)) if offsets is None else check_finite(offsets, "offsets")
        if zero.shape != (device.sensors, 3):
            raise InputError(f"offsets must have shape ({device.sensors}, 3); got {zero.shape}")
        self._device = device
        self._controller_model = ControllerModel(device, model)
        self._shape, tool = (device.sensors, 3), ToolModel.of(device)
        self._model, self._grid = pack_model(device, tool), _grid(device)
        self._fields = _fields_at(tool, self._grid)
        self.bandwidth: Final = float(bandwidth)
        hall, supply = device.hall, device.supply
        self._moments = np.array(device.moment_per_current, dtype=np.float64)
        self._per_ampere_rms = np.sqrt((coil_field(device) ** 2).mean(axis=(0, 1)))
        self._read = (supply.current_noise**2 + supply.current_step**2 / 12) * (self._moments @ self._moments.T)
        self._history = CurrentHistory(device.channels, device.sensors)
        self.noise = float(np.hypot(max(hall.noise, 1e-7), hall.step / np.sqrt(12)))  #: of one reading [T]
        if correction is None:
            lasting = 0.0 if offsets is not None else device.hall.errors.offset
        else:
            lasting = correction.uncertainty
        self._tracker = make_tracker(device, self.noise, self.bandwidth, lasting)
        self._sensors = make_sensors(device, zero)
        self._lagged = np.full(device.channels, np.nan)  # currents through the core's lag
        self._fields *= np.repeat(self._sensors["used"], 3)
        self._filter = self._tracker["filter"]
        self._moment_noise: Array = self._tracker["moment_noise"][0]
        self._moment_noise[:] = self._read
        #: (5, 5) of what was seen last, noise only: place [m²], turns about two axes across the tool's [rad²]
        self.covariance: Array = self._tracker["covariance"][0]
        self.verdict: str = self.LOST
        self._found, self._t, self._searched = False, -math.inf, -math.inf
        nowhere = State(0.0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))
        self._last = Estimate(nowhere, WrenchMap(np.zeros((6, device.channels)), np.zeros(6)), False, math.inf)
        self._kept = KeptEstimate(device.channels)
        self._numbers = make_numbers("verdict", "found", "t", "searched")

    def state_arrays(self) -> Mapping[str, StateArray]:
        """Filter, sensors, lagged currents [A], the last estimate, and where the search is."""
        own = {"tracker": self._tracker, "sensors": self._sensors, "lagged": self._lagged, "search": self._numbers[0]}
        return {**own, **self._kept.arrays}

    def state_parts(self) -> Mapping[str, Stateful]:
        """Currents that wait for fields, and the controller model."""
        return {"history": self._history, "model": self._controller_model}

    def gather_state(self) -> None:
        """Copy the last estimate."""
        self._kept.store(self._last)
        cells = self._numbers[1]
        cells[0], cells[1], cells[2], cells[3] = (
            _VERDICTS.index(self.verdict), self._found, self._t, self._searched
        )  # fmt: skip

    def apply_state(self) -> None:
        """Take it over."""
        self._last = self._kept.load()
        verdict, found, self._t, self._searched = self._numbers[1]
        self.verdict, self._found = _VERDICTS[choose(verdict, len(_VERDICTS))], bool(found)

    @property
    def residual(self) -> float:
        """rms of what the last estimate leaves unexplained [T]."""
        return float(self._tracker["residual"][0])

    def update(self, sample: Sample) -> Estimate:
        """The estimate after `sample`. Raises InputError for readings of other sensors than the device's."""
        read = np.ascontiguousarray(sample.field)
        if read.shape != self._shape:
            raise InputError(
                f"device '{self._device.name}' has {self._device.sensors} field sensors; the sample has {read.shape[0]}"
            )
        currents, taken = sample.currents, sample.t - sample.field_age
        if sample.currents_age != sample.field_age:  # a board's; a simulated device's are of one moment
            read, currents, taken = self._match_currents(sample)
        tracker, sensors, model, pose = self._tracker, self._sensors, self._model, np.empty((6, 3))
        if self._found:
            dt = sample.t - self._t
            if not 0.0 <= dt <= _PAUSE:
                self._filter["velocity"] = self._filter["axis_rate"] = 0.0
                dt = 0.0
            code = follow_tool(tracker, sensors, model, read, currents, self._lagged, taken, sample.t, dt, pose)
        else:  # what is left of the readings without the coils; the place is still to be searched
            whole = subtract_coils(tracker, sensors, model, read, currents, self._lagged, taken, sample.t)
            code = UNEXPLAINED if whole else UNREAD
        if code == UNEXPLAINED:
            self._found = False
            if sample.t - self._searched < _WAIT:
                return self._unknown(sample.t, self.verdict or self.LOST)
            self._searched = sample.t
            code = self._search(pose)
        unsure = code == VAGUE and self._found and sample.t - self._t <= _CARRIED  # safety: tool-carried
        if not (code == LOCATED or unsure):
            self._found = self._found and code == UNREAD
            return self._unknown(sample.t, self.REVERSED if code == REVERSED else self.LOST)
        state = State(sample.t, pose[:3], pose[3], pose[5], pose[4])
        try:
            wrench_map = self._controller_model.wrench_map(state)
        except GeometryError:
            self._found = False
            return self._unknown(sample.t, self.LOST)
        if not unsure:
            self._t = sample.t
        self._found, self.verdict = True, ""
        self._last = Estimate(state, wrench_map, True, sample.t - self._t)
        return self._last

    @property
    def remark(self) -> str:
        """Sensors that differ from ideal ones and are not calibrated."""
        errors, name = self._device.hall.errors, self._device.name
        if self._device.hall.correction is not None or not (errors.offset or errors.gain or errors.placement):
            return ""
        return (
            f"the field sensors of {name} are not calibrated: the tool's position is some millimetres off, or lost; "
            "run "
            f"`haptorb calibrate {name}` and load its file with --calibration FILE, or calibration=FILE in Python"
        )

    @property
    def model(self) -> str:
        """The controller model."""
        return self._controller_model.name

    def change_model(self, name: str) -> None:
        """Go over to the device's model `name` in the wrench map, without a step."""
        self._controller_model.change(name)

    def _match_currents(self, sample: Sample) -> tuple[Array, Array, float]:
        """The field (k, 3) [T] that waited for these currents, the currents (m,) [A] at its time, and that time [s];
        the tracker learns by how much they may be wrong."""
        history = self._history
        history.take(sample)
        moments = self._moments * history.doubt
        self._moment_noise[:] = self._read + moments @ moments.T
        self._tracker["swing"] = self._per_ampere_rms @ history.doubt
        return history.field, history.currents, history.taken

    def _unknown(self, t: float, why: str) -> Estimate:
        self.verdict = why
        last = self._last
        return Estimate(last.state, last.wrench_map, False, t - self._t, reversed=why == self.REVERSED)

    def _search(self, pose: Array) -> int:
        """From nothing: the grid's fields most like what is read, either way round, and the fit from each."""
        tracker, sensors = self._tracker, self._sensors
        cross = self._fields @ sensors["field"].ravel()
        misfits = (self._fields**2).sum(axis=1) - 2 * np.abs(cross)
        best, limit, covariance = math.inf, float(tracker["limit"][0]), self.covariance.copy()
        readings = int(tracker["readings"][0])
        for at in _choose_starts(self._grid, np.argsort(misfits).tolist(), 4):
            p, R = self._grid[at].copy(), rotation_to_axis(math.copysign(1.0, cross[at]) * self._grid[at])
            good, misfit = fit_anew(tracker, sensors, self._model, p, R)
            if good and misfit < best:
                best, covariance = misfit, self.covariance.copy()
                pose[:3], pose[3] = R, p
            if is_explained(best, readings, 0.5 * limit):
                break
        self.covariance[:] = covariance
        if not is_explained(best, readings, limit):
            tracker["residual"] = math.sqrt(best / max(readings - 5, 1))
            return LOST
        return filter_fit(tracker, best, readings, -1.0, pose)


def _grid(device: SphericalElectromagnet) -> Array:
    """(n, 3) [m] places over the shell and a little more; 15 mm apart, from where the fit finds its way."""
    half = min(device.workspace_half_angle + math.radians(15), math.pi)
    count = 60
    z = 1 - (np.arange(count) + 0.5) / count * (1 - math.cos(half))
    turn = math.pi * (1 + math.sqrt(5)) * np.arange(count)
    s = np.sqrt(1 - z * z)
    directions = np.column_stack([s * np.cos(turn), s * np.sin(turn), z])
    distances = device.contact_distance + device.shell_thickness * np.array([0.1, 0.5, 0.9])
    places: Array = np.ascontiguousarray((distances[:, None, None] * directions).reshape(-1, 3))
    return places


def _fields_at(model: ToolModel, places: Array) -> Array:
    """(n, 3 k) [T] of radial tools at `places`."""
    k = len(model.sensors)
    B, J = np.empty((k, 3)), np.empty((k, 3, 5))
    rows = np.empty((len(places), 3 * k))
    for row, p in zip(rows, places, strict=True):
        tool_field(model, p, rotation_to_axis(p), B, J)
        row[:] = B.ravel()
    return rows


def _choose_starts(places: Array, order: list[int], count: int) -> list[int]:
    """The first `count` of `order` that are at least 12 mm from each other: starts that differ."""
    chosen: list[int] = []
    for at in order:
        if all(float(((places[at] - places[other]) ** 2).sum()) > 12e-3**2 for other in chosen):
            chosen.append(at)
            if len(chosen) == count:
                break
    return chosen
