"""Error model of a coil array: from the commanded force to the force on the tool."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from haptorb.analysis.error_budget import Component, ErrorModel, ErrorSource, choose_size
from haptorb.analysis.error_sources import (
    ChainTrial,
    CurrentLoop,
    Effect,
    add_to,
    current_sources,
    find_origin,
    magnet_warmth,
    source,
    strengthen,
)
from haptorb.arrays import Array
from haptorb.control.array_allocation import array_allocator
from haptorb.control.capability import array_capability
from haptorb.devices.base import State, rotation_to_axis
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.coil_array_wrench_map import array_wrench
from haptorb.devices.electromagnet import FORCE_JND
from haptorb.devices.placed_coils import PlacedCoils, place_coils
from haptorb.errors import InputError, UnknownName
from haptorb.estimation.calibration_file import Calibration
from haptorb.magnetics.soft_sphere import response_to_source
from haptorb.rotations import turn_by

__all__ = ["ArrayErrors", "ArrayPoint", "ArrayTrial", "array_errors"]


# --------------------------------------------------------------------------------------------------
# Error chain of a coil array, from the commanded force to the force on the tool.
#
# The controller uses the device file and a pose; the true device has other magnets, other currents, another pose, and
# coils with errors of position, axis and strength. Both use the exact model. A soft core's response to a displaced coil
# is linearised in every component of the coil's position and axis. The force is static.


_STEP = (1e-4, 2e-3)  #: steps of a coil's position [m] and axis [rad], for the derivatives of a core's response
_STILL = np.zeros(3)


@dataclass
class ArrayTrial(ChainTrial):
    """Deviations of one device from its model."""

    strength: float  #: remanence of the tool's magnets, true over model
    shift: Array  #: (m, 3) true minus nominal position of each coil [m]
    lean: Array  #: (m, 3) rotation from the nominal to the true axis of each coil [rad]
    turns: Array  #: (m,) relative error of each coil's field
    place: Array  #: (3,) estimated minus true position of the tool [m]
    turn: Array  #: (3,) rotation from the tool's true to its estimated orientation [rad]

    def strengthen(self, factors: Array) -> None:
        """Multiply the magnets' strength by `factors` (1,)."""
        self.strength *= float(factors[0])


class ArrayPoint(NamedTuple):
    """Tool, upright over a plate or radial over a dome, and the commanded force."""

    p: Array  #: (3,) [m]
    R: Array  #: (3, 3); its columns are two tangents of the surface and its normal
    wrench: Array  #: (6,) [N, N·m]


@final
class ArrayErrors(ErrorModel[ArrayTrial, ArrayPoint]):
    """Error model of `device` for commanded forces of `asked` [N], with `sources`; a tracker measures the pose."""

    unit, jnd, motion, estimator = "N", FORCE_JND, "at rest", "tracker"
    regions = ("in contact", "lower half of the space", "upper half of the space")

    def __init__(self, device: CoilArray, asked: float, sources: tuple[ErrorSource[ArrayTrial], ...]) -> None:
        self.device, self.asked, self.sources = device.name, asked, sources
        normal, level = ("radial", "tangential") if device.surface.is_dome else ("upwards", "along the plate")
        self.components = (Component(normal, (2,)), Component(level, (0, 1)))
        self._device, self._allocator, self._loop = device, array_allocator(device), CurrentLoop(device)
        self._known = device.magnetics

    def draw_point(self, region: int, rng: np.random.Generator) -> ArrayPoint:
        """Random point in the region, uniform over the surface; the force in any direction."""
        surface, near = self._device.surface, self._device.contact_height
        height = surface.thickness * max(rng.uniform(0.5 * region - 0.5, 0.5 * region), 0.0)
        if surface.is_dome:
            cosine, around = rng.uniform(np.cos(surface.half_angle), 1.0), rng.uniform(0, 2 * np.pi)
            flat = np.sqrt(1 - cosine * cosine)
            axis = np.array([flat * np.cos(around), flat * np.sin(around), cosine])
            p, R = (near + height) * axis, rotation_to_axis(axis)
        else:
            side = np.array(surface.half_width)
            p, R = np.array([*rng.uniform(-side, side), near + height]), np.eye(3)
        direction, wrench = rng.standard_normal(3), np.zeros(6)
        wrench[:3] = self.asked * direction / np.linalg.norm(direction)
        return ArrayPoint(p, R, wrench)

    def make_trial(self) -> ArrayTrial:
        """Device without errors."""
        m = self._device.channels
        return ArrayTrial(
            **vars(ChainTrial.exact(m)), strength=1.0, shift=np.zeros((m, 3)), lean=np.zeros((m, 3)),
            turns=np.zeros(m), place=np.zeros(3), turn=np.zeros(3),
        )  # fmt: skip

    def wrench_error(self, point: ArrayPoint, trial: ArrayTrial) -> Array:
        """(3,) along two tangents of the surface and its normal [N]."""
        R = np.empty((3, 3))
        x, y, z = trial.turn.tolist()
        turn_by(x, y, z, np.ascontiguousarray(point.R), R)
        believed = self._device.wrench_map(State(0.0, R, point.p + trial.place, _STILL, _STILL), self._device.models[0])
        currents = self._loop.true_currents(self._allocator.allocate(believed, point.wrench).currents, trial)
        error: Array = point.R.T @ (self._deliver(point, trial, currents) - point.wrench[:3])
        return error

    def _deliver(self, point: ArrayPoint, trial: ArrayTrial, currents: Array) -> Array:
        """(3,) true force [N]: that of the coils is linear in the magnets' strength, that of the core quadratic."""
        known = self._known
        coils = known.coils.copy()
        coils["centre"] += trial.shift
        axis = coils["axis"] + np.cross(trial.lean, coils["axis"])
        coils["axis"] = axis / np.linalg.norm(axis, axis=1, keepdims=True)
        coils["turns"] *= 1 + trial.turns
        responses = known.responses
        if known.core_radius > 0.0:
            off = np.concatenate([trial.shift, trial.lean], axis=1)
            responses = responses + np.einsum("ji,ijkc->jkc", off, self._slopes)
            responses *= (1 + trial.turns)[:, None, None]
        pose, matrix, passive = np.empty((4, 3)), np.empty((6, len(coils))), np.empty(6)
        pose[:3], pose[3] = point.R, point.p
        array_wrench(known._replace(coils=coils, responses=responses), pose, matrix, passive)
        force: Array = trial.strength * (matrix[:3] @ currents) + trial.strength**2 * passive[:3]
        return force

    @cached_property
    def _slopes(self) -> Array:
        """(6, m, k, 2) derivatives of the core's response to each coil, by position [1/m] and rotation of its axis
        [1/rad]."""
        windings, core, order, slopes = self._device.windings, self._device.core, self._known.order, []
        assert core is not None
        for number in range(6):
            along, step = np.eye(3)[number % 3], _STEP[number // 3]
            if number < 3:
                moved = replace(windings, position=windings.position + step * along)
            else:
                moved = replace(windings, axis=windings.axis + step * np.cross(along, windings.axis))
            responses = np.stack([response_to_source(core, placed, order) for placed in place_coils(moved)])
            slopes.append((responses - self._known.responses) / step)
        return np.stack(slopes)


# --------------------------------------------------------------------------------------------------
# Error sources of a coil array.


ARRAY_SOURCES_ESTIMATORS = ("tracker",)


def move_edges(windings: PlacedCoils) -> Effect:
    """Change the field of each coil by its inner and outer radius, through the area of its mean turn."""
    inner, outer = windings.inner_radius, windings.outer_radius
    per_metre = np.stack([outer + 2 * inner, inner + 2 * outer]) / (outer**2 + outer * inner + inner**2)

    def change(trial: ArrayTrial, metres: Array) -> None:
        trial.turns += (per_metre * metres.reshape(per_metre.shape)).sum(axis=0)

    return change


def array_errors(
    device: CoilArray,
    asked: float | None = None,
    estimator: str | None = None,
    calibration: Calibration | None = None,
) -> ArrayErrors:
    """Error model of `device` for forces of `asked` [N]; None: half of the smallest peak force in its workspace.

    Raises InputError for a force that is not feasible everywhere, and for a calibration, which arrays do not have;
    UnknownName for another estimator than "tracker".
    """
    if calibration is not None:
        raise InputError(f"device '{device.name}' is a {device.kind.title}; a calibration is for electromagnets")
    if estimator not in (None, *ARRAY_SOURCES_ESTIMATORS):
        raise UnknownName(f"estimator of the error budget of '{device.name}'", str(estimator), ARRAY_SOURCES_ESTIMATORS)
    known, built, m = device.uncertainty, device.tolerance, device.channels

    def origin(key: str) -> str:
        return find_origin(device, known, key)

    def origin_of_build(key: str) -> str:
        return find_origin(device, known, key, "tolerance")

    sources: tuple[ErrorSource[ArrayTrial], ...] = (
        source("remanence", known.remanence, "1", origin("remanence"), 1, strengthen),
        magnet_warmth("temperature of the magnets", device, known),
        source("positions of the coils", built.position, "m", origin_of_build("position"), 3 * m, add_to("shift")),
        source("axes of the coils", built.tilt, "rad", origin_of_build("tilt"), 3 * m, add_to("lean")),
        source("field per ampere of the coils", built.strength, "1", origin_of_build("strength"), m, add_to("turns")),
        source(
            "edges of the windings", built.winding, "m", origin_of_build("winding"), 2 * m, move_edges(device.windings)
        ),
        source("tracked position", known.place, "m", origin("place"), 3, add_to("place")),
        source("tracked orientation", known.axis, "rad", origin("axis"), 3, add_to("turn")),
        *current_sources(device, known, known.current_offset),
    )
    most = min(layer.weakest for layer in array_capability(device))
    return ArrayErrors(device, choose_size(device.name, asked, most, "N"), sources)
