"""Where the tool is, from the field sensors alone, while the coils are driven: `--tracker hall`.

What coils and core do per ampere is known (calibrated), the measured currents give it, and it is subtracted; what is
left is the tool's magnet and the core's answer to it. Place and axis that explain it best are the estimate; the turn
about the axis leaves no trace in the field of a round magnet and is taken as zero.

What is measured in every tick goes through the filter of `sensing.place_filter`: 100 Hz (−3 dB) at any rate of the
loop, the place not late at steady velocity, the velocity 7 ms late.

Where a driver reads the sensors in turns, what it did not read in a tick is NaN. The last reading of each stands in,
less the coils' field at the time when it was taken, and is held against where the tool was then, by its velocity.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.state import State, rotation_to_axis
from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import GeometryError, InputError
from haptorb.physics.arrays import Array, finite
from haptorb.physics.compiled import kernel
from haptorb.sensing.estimator import Estimator
from haptorb.sensing.place_filter import corrected, predicted
from haptorb.sensing.sample import Estimate, Sample
from haptorb.sensing.tool_field import ToolModel, coil_field, moment_field, tool_field
from haptorb.sensing.tool_fit import fitted, moment_weight

__all__ = ["APART", "IN_TURNS", "HallTracker"]

#: bandwidth [Hz] for drivers that read the sensors in turns, six ticks for all: more lets through noise only
IN_TURNS = 30.0
#: by how much such drivers read the field later than the currents: a current sensor tells the last 0.5 ms' mean [s]
APART = 0.75e-3

#: a last step below this leaves its square over 70 mm, 0.1 mm and 0.2°; typical noise makes half such steps
_NEAR, _TURN = 3e-3, 0.08
_EXACT = 1e-6  #: the same for a start from nothing [m, rad]
_WARM, _COLD = 4, 40  #: evaluations at most
_MANY = 5.0  #: residuals so many times the sensors' noise are no noise
_CALIBRATED = 1e-3  #: standard deviation of the moment map's entries after a calibration, of their column
_SHARE = 0.01  #: of the coils' own field that calibration may leave unexplained
_REACH = 15e-3  #: how far outside the shell a tool is still believed to be [m]
_OUTWARD = -0.2  #: a tool whose axis points inwards by more than this cosine has its magnet the wrong way round
_VAGUE = 3e-3  #: standard deviation of the told place above which it is not known [m]
_OLD = 0.05  #: a reading that is older tells nothing any more: a sensor has gone [s]
_FRESH = 0.05  #: weight of a tick in the share of readings that are new
_GUESSED = 0.4  #: of such a change may be wrong
_LATELY = 0.01  #: for so long a change of the currents spoils readings that are still in use [s]
_PAUSE = 0.05  #: without a sample for so long the velocity says nothing any more [s]
_WAIT = 0.02  #: between two searches from nothing [s]: a search takes longer than a tick


class HallTracker(Estimator):
    """Believes the field sensors; the sample's `pose` is not looked at.

    device     a spherical electromagnet with at least two field sensors
    level      of its wrench map
    offsets    (k, 3) [T] of the sensors at zero current without a tool, as calibration found them
    bandwidth  of place and axis [Hz]
    apart      by which the field is read later than the currents [s]: they are carried on, and known the less for it

    `verdict` says why an estimate is not valid: "lost", "reversed" (the tool's magnet is the wrong way round: forces
    would invert), or "" where it is.

    Raises InputError for a device without such sensors, a bandwidth or offsets that cannot be.

    >>> from haptorb.devices.loader import load
    >>> HallTracker(load("omni")).verdict
    'lost'
    """

    LOST: Final = "lost"
    REVERSED: Final = "reversed"

    def __init__(
        self,
        device: SphericalElectromagnet,
        level: str | None = None,
        *,
        offsets: ArrayLike | None = None,
        bandwidth: float = 100.0,
        apart: float = 0.0,
    ) -> None:
        if not isinstance(device, SphericalElectromagnet) or device.sensors < 2:
            raise InputError(
                f"device '{device.name}': a tool is found by at least two field sensors of a spherical electromagnet; "
                "use another tracker"
            )
        if not 1.0 <= bandwidth <= 1000.0:
            raise InputError(f"bandwidth must be between 1 and 1000 Hz; got {bandwidth!r}")
        self._offsets = np.zeros((device.sensors, 3)) if offsets is None else finite(offsets, "offsets").copy()
        if self._offsets.shape != (device.sensors, 3):
            raise InputError(f"offsets must have shape ({device.sensors}, 3); got {self._offsets.shape}")
        self._device = device
        self._level = device.known_level(level or device.levels[0])
        self._model = ToolModel.of(device)
        self._per_ampere = coil_field(device)
        self.bandwidth: Final = float(bandwidth)
        hall, supply = device.hall, device.supply
        self._per_moment, moments = moment_field(device), np.array(device.moment_per_current, dtype=np.float64)
        self._moments, self._per_ampere_rms = moments, np.sqrt((self._per_ampere**2).mean(axis=(0, 1)))
        self._heard = -math.inf
        self._per_moment2 = np.einsum("kia,kib->ab", self._per_moment, self._per_moment)
        self._read = (supply.current_noise**2 + supply.current_step**2 / 12) * (moments @ moments.T)
        self._measured = self._read
        self._apart, self._recent, self._swing = apart, np.zeros(device.channels), np.zeros(device.channels)
        self._columns, self._weight = np.ascontiguousarray((moments**2).sum(axis=0)), np.zeros((3, 3))
        self.noise = float(np.hypot(max(hall.noise, 1e-7), hall.step / np.sqrt(12)))  #: of one reading [T]
        #: (5, 5) of what was told last, noise only: place [m²], turns about two axes across the tool's [rad²]
        self.covariance = np.full((5, 5), np.inf)
        self.residual = math.inf  #: rms of what the last estimate leaves unexplained [T]
        self.verdict: str = self.LOST
        self._grid = _grid(device)
        self._fields = _fields_at(self._model, self._grid)
        self._when, self._ages = np.full((device.sensors, 3), -np.inf), np.empty((device.sensors, 3))
        self._rates, self._share, self._misfit = np.zeros(5), 1.0, 0.0
        self._field, self._belief = np.empty((device.sensors, 3)), np.zeros((4, 3))
        self._spread = np.zeros(3)
        self._found, self._t, self._searched = False, -math.inf, -math.inf
        nowhere = State(0.0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))
        self._last = Estimate(nowhere, WrenchMap(np.zeros((6, device.channels)), np.zeros(6)), False, math.inf)

    def update(self, sample: Sample) -> Estimate:
        """The estimate after `sample`. Raises InputError for readings of other sensors than the device's."""
        field = self._field
        if sample.field.shape != field.shape:
            raise InputError(
                f"device '{self._device.name}' has {self._device.sensors} field sensors; the sample has "
                f"{sample.field.shape[0]}"
            )
        currents, swing = sample.currents, 0.0
        if self._apart > 0.0:
            currents, swing = self._carried(sample)
        coils, oldest, share = _subtracted(
            sample.field, currents, self._per_ampere, self._offsets, sample.t, field, self._when, self._ages
        )
        self._share += _FRESH * (share - self._share)
        limit = math.hypot(_MANY * self.noise, _SHARE * coils)
        p, R = np.empty(3), np.empty((3, 3))
        if not (math.isfinite(coils) and oldest <= _OLD):
            return self._unknown(sample.t, self.LOST)
        limit = math.hypot(limit, _MANY * swing)
        moment_weight(
            self._per_moment2, self._measured, self._columns, sample.currents, _CALIBRATED, self.noise, self._weight
        )
        dt = sample.t - self._t
        found, misfit = False, math.inf
        if self._found:
            if not 0.0 <= dt <= _PAUSE:
                self._belief[2:] = 0.0
                dt = 0.0
            predicted(self._belief, dt, p, R)
            _moved(self._belief, R, self._rates)
            found, misfit = fitted(
                self._model, field, self._ages, self._rates, self._per_moment, self._weight, _NEAR, _TURN, _WARM, p, R,
                self.covariance,
            )  # fmt: skip
            found = found and self._explained(misfit, limit)
        if not found:
            self._found = False
            if sample.t - self._searched < _WAIT:
                return self._unknown(sample.t, self.verdict or self.LOST)
            self._searched = sample.t
            found, misfit = self._search(field, limit, p, R)
            dt = -1.0
        self.residual = math.sqrt(misfit / max(field.size - 5, 1)) if math.isfinite(misfit) else math.inf
        if not found:
            return self._unknown(sample.t, self.LOST)
        self._misfit += (1.0 if dt < 0.0 else self._share) * (self.residual**2 - self._misfit)
        self.covariance *= max(self.noise**2, self._misfit)
        why = self._doubt(p, R, 1.0 if dt < 0.0 else self._kept())
        if why or not math.isfinite(misfit):
            self._found = False
            return self._unknown(sample.t, why)
        v, w = np.empty(3), np.empty(3)
        corrected(self._belief, self._spread, dt, self.bandwidth, p, R, v, w)
        self.covariance *= self._kept()
        state = State(sample.t, R, p, w, v)
        try:
            wrench_map = self._device.wrench_map(state, self._level)
        except GeometryError:
            self._found = False
            return self._unknown(sample.t, self.LOST)
        self._found, self._t, self.verdict = True, sample.t, ""
        self._last = Estimate(state, wrench_map, True, 0.0)
        return self._last

    def _kept(self) -> float:
        """Share of one set of readings' variance that the filter keeps; a reading that is used twice is no second."""
        return min(float(self._spread[0]) / self._share, 1.0)

    def _carried(self, sample: Sample) -> tuple[Array, float]:
        """(m,) currents when the field was read [A], and the field that this may be wrong by [T]."""
        dt = min(max(sample.t - self._heard, 1e-4), _PAUSE)
        change = self._apart / dt * (sample.currents - self._recent)
        self._swing = np.maximum(_GUESSED * np.abs(change), math.exp(-dt / _LATELY) * self._swing)
        self._recent, self._heard = sample.currents.copy(), sample.t
        moments = self._moments * self._swing
        self._measured = self._read + moments @ moments.T
        carried: Array = sample.currents + change
        return carried, float(self._per_ampere_rms @ self._swing)

    def _unknown(self, t: float, why: str) -> Estimate:
        self.verdict = why
        last = self._last
        return Estimate(last.state, last.wrench_map, False, t - self._t, reversed=why == self.REVERSED)

    def _explained(self, misfit: float, limit: float) -> bool:
        return misfit <= (self._field.size - 5) * limit * limit

    def _doubt(self, p: Array, R: Array, kept: float) -> str:
        device = self._device
        distance = float(np.linalg.norm(p))
        nearest = device.contact_distance - _REACH
        furthest = device.contact_distance + device.shell_thickness + _REACH
        vague = kept * float(np.trace(self.covariance[:3, :3])) > 3 * _VAGUE**2
        if not nearest < distance < furthest or vague:
            return self.LOST
        if p[2] < distance * math.cos(min(device.workspace_half_angle + math.radians(30), math.pi)):
            return self.LOST
        # A reversed magnet looks like one that is held upside down; nobody holds a pen by its tip.
        return self.REVERSED if float(p @ R[:, 2]) < _OUTWARD * distance else ""

    def _search(self, field: Array, limit: float, p: Array, R: Array) -> tuple[bool, float]:
        """From nothing: the grid's fields most like what is read, either way round, and the fit from each."""
        flat = field.ravel()
        self._rates[:] = 0.0
        cross = self._fields @ flat
        misfits = (self._fields**2).sum(axis=1) - 2 * np.abs(cross)
        best, found = math.inf, False
        covariance = np.empty((5, 5))
        for at in _apart(self._grid, np.argsort(misfits).tolist(), 4):
            q, Q = self._grid[at].copy(), rotation_to_axis(math.copysign(1.0, cross[at]) * self._grid[at])
            good, misfit = fitted(
                self._model, field, self._ages, self._rates, self._per_moment, self._weight, _EXACT, _EXACT, _COLD, q,
                Q, covariance,
            )  # fmt: skip
            if good and misfit < best:
                best, found = misfit, True
                p[:], R[:] = q, Q
                self.covariance[:] = covariance
            if found and self._explained(best, 0.5 * limit):
                break
        return found and self._explained(best, limit), best


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


def _apart(places: Array, order: list[int], count: int) -> list[int]:
    """The first `count` of `order` that are at least 12 mm from each other: starts that differ."""
    chosen: list[int] = []
    for at in order:
        if all(float(((places[at] - places[other]) ** 2).sum()) > 12e-3**2 for other in chosen):
            chosen.append(at)
            if len(chosen) == count:
                break
    return chosen


@kernel
def _subtracted(
    read: Array, currents: Array, per_ampere: Array, offsets: Array, t: float, out: Array, when: Array, ages: Array
) -> tuple[float, float, float]:
    """out (k, 3) = read − offsets − field of the coils, where something was read; when and ages (k, 3) [s] follow.

    Returns the rms of the coils' field [T], NaN if a current is; the age of the oldest reading [s]; the share of the
    readings that are new.
    """
    total, oldest, new = 0.0, 0.0, 0
    for k in range(read.shape[0]):
        for i in range(3):
            coils = 0.0
            for j in range(currents.shape[0]):
                coils += per_ampere[k, i, j] * currents[j]
            total += coils * coils
            left = read[k, i] - offsets[k, i] - coils
            if left - left == 0.0:  # a number
                out[k, i] = left
                when[k, i] = t
                new += 1
            ages[k, i] = t - when[k, i]
            if not ages[k, i] <= oldest:
                oldest = ages[k, i]
    return float(np.sqrt(total / read.size)), oldest, new / read.size


@kernel
def _moved(belief: Array, R: Array, rates: Array) -> None:
    """rates (5,) of the place [m/s] and of the turns about R's x and y [rad/s], from `belief` (4, 3)."""
    n, r = belief[1], belief[3]
    wx, wy, wz = n[1] * r[2] - n[2] * r[1], n[2] * r[0] - n[0] * r[2], n[0] * r[1] - n[1] * r[0]
    for i in range(3):
        rates[i] = belief[2, i]
    for j in range(2):
        rates[3 + j] = wx * R[0, j] + wy * R[1, j] + wz * R[2, j]
