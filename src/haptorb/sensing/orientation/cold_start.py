"""Orientation from nothing: the grid node whose field looks most like what is read, then least squares from there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.numerics.arrays import Array, Records
from haptorb.numerics.compiled import kernel
from haptorb.numerics.rotations import rotation_from_euler
from haptorb.numerics.state_arrays import StateArray, Stateful
from haptorb.sensing.orientation.field_model import unpack
from haptorb.sensing.orientation.gauss_newton import FIT, fit_orientation
from haptorb.sensing.orientation.readings import reading_limit
from haptorb.sensing.orientation.spin_ambiguity import spin_period

__all__ = ["ColdStart", "OrientationFix"]

_STEP = np.radians(4.0)  #: between the nodes: Gauss–Newton finds the way from half of that
_BEYOND = np.radians(4.0)  #: the grid reaches further than the workspace
_CANDIDATES = 8  #: nodes tried, the most alike first
_APART = np.radians(7.0)  #: two candidates that are nearer to each other would lead to the same place
_EXACT, _STEPS = 1e-6, 25  #: last step of a fit from a node [rad], and its steps at most
_POOR = 0.1  #: residual over field that no orientation of the rotor explains
_FEWEST = 8  #: sensors without which several orientations may look alike


class OrientationFix(NamedTuple):
    """Where the rotor is, but for the branch of its spin."""

    R_SR: Array
    strength: float
    covariance: Array  #: (3, 3) of R_SR as a rotation vector, stator frame [rad²]
    outliers: int


class ColdStart(Stateful):
    """A grid over the workspace and one period of spin, with the field at every node."""

    def __init__(self, motor: SphericalMotor, model: Array, noise: float) -> None:
        self._model = model
        self._slopes, self._fit = np.zeros((motor.sensors, 3, 3)), np.zeros(1, FIT)
        self._fit["noise"], self._fit["taken"] = noise, np.nan
        reach = motor.workspace_tilt + _BEYOND
        tilts = np.linspace(-reach, reach, 2 * int(np.ceil(reach / _STEP)) + 1)
        period = spin_period(motor) or 2 * np.pi
        turns = period * np.arange(int(np.ceil(period / _STEP))) / np.ceil(period / _STEP)
        angles = np.meshgrid(tilts, tilts, turns, indexing="ij")
        self._nodes = rotation_from_euler(*(angle.ravel() for angle in angles))
        field = motor.sensor_field(self._nodes, "table")
        self.limit = reading_limit(motor, self._nodes, field)  #: [T]
        self._largest = float(np.sqrt((field**2).sum(axis=2).max()))
        self._fields = np.ascontiguousarray(field.reshape(len(field), -1))

    def state_arrays(self) -> Mapping[str, StateArray]:
        """The last fit: the next one may begin with its slopes."""
        return {"slopes": self._slopes, "fit": self._fit}

    def search(self, field: Array, usable: Array, trusted: Array) -> OrientationFix | None:
        """The orientation that explains `field` (k, 3) [T], or None; arguments as for `fit_orientation`."""
        fit = self._fit
        trusted[:] = usable
        count = int(usable.sum())
        if count < _FEWEST:
            return None
        likeness = np.empty(len(self._nodes))
        _fill_cosines(self._fields, field, usable, self._largest, likeness)
        rms = float(np.sqrt((field**2).sum() / (3 * count)))
        tried: list[Array] = []
        for node in np.argsort(-likeness)[: 40 * _CANDIDATES]:
            R = self._nodes[node]
            if any(np.trace(R.T @ other) > 1 + 2 * np.cos(_APART) for other in tried):
                continue
            tried.append(R)
            trusted[:] = usable
            fit["rotation"], fit["strength"] = R, 1.0
            converged, residual, outliers = _try_node(fit, self._model, field, usable, count, trusted, self._slopes)
            if converged and residual <= _POOR * rms and 2 * outliers <= count:  # safety: start-explained
                found = fit.copy()[0]
                return OrientationFix(found["rotation"], float(found["strength"]), found["covariance"], outliers)
            if len(tried) == _CANDIDATES:
                break
        trusted[:] = usable
        return None


@kernel
def _try_node(
    fit: Records, model: Array, field: Array, usable: Array, count: int, trusted: Array, slopes: Array
) -> tuple[bool, float, int]:
    return fit_orientation(fit[0], unpack(model), field, usable, count, trusted, slopes, _EXACT, _STEPS)


@kernel
def _fill_cosines(fields: Array, field: Array, usable: Array, largest: float, out: Array) -> None:
    """out (n,) cosine between what is read and every node's field, over the usable sensors.

    A reading longer than any the rotor can give is shortened to that: one broken sensor must not outvote the others.
    """
    places = field.shape[0]
    read, weight = np.empty(3 * places), np.empty(3 * places)
    for k in range(places):
        length = np.sqrt(field[k, 0] ** 2 + field[k, 1] ** 2 + field[k, 2] ** 2)
        share = 1.0 if length <= largest else largest / length
        for i in range(3):
            read[3 * k + i] = share * field[k, i] * usable[k]
            weight[3 * k + i] = usable[k]
    for n in range(fields.shape[0]):
        both, own = 0.0, 0.0
        for i in range(3 * places):
            node = fields[n, i] * weight[i]
            both += node * read[i]
            own += node * node
        out[n] = both / np.sqrt(max(own, 1e-30))
