"""Accuracy of the tool pose from field sensors, and the resulting force error: `haptorb inspect DEVICE --sensing`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rich.console import Console

from haptorb.arrays import Array
from haptorb.devices.api import electromagnet
from haptorb.devices.base import Device, State, rotation_to_axis
from haptorb.devices.electromagnet import FORCE_JND, SphericalElectromagnet
from haptorb.devices.field_sensors import SensorErrors
from haptorb.display import format_quantity
from haptorb.errors import InputError
from haptorb.estimation.hall_pose_fit import better_sensors, with_sensors
from haptorb.estimation.hall_tracker import noise_share
from haptorb.estimation.sensor_calibration import (
    SensorKnowledge,
    pose_covariance,
    predict_knowledge,
    shell_sample,
    without_errors,
)
from haptorb.terminal import Column, TextTable, print_table, print_text

__all__ = ["SensingAccuracy", "SensingRow", "compute_row", "sensing_accuracy", "sensing_cases", "summarize_sensing"]


# --------------------------------------------------------------------------------------------------
# `haptorb inspect DEVICE --sensing`: errors of the tool pose, and the resulting errors of the force.


FORCE_N = 0.3  #: commanded force [N]
_EDDY_FREQUENCY_HZ = 50.0  #: frequency at which the core's lag is evaluated [Hz]
_STEEL_BALL_M = (
    0.03,
    0.12,
)  #: radius of a steel ball and its distance from the centre, in any direction but upwards [m]
_MOMENT_ERROR = 3e-3  #: relative error of the moment map after the step `magnetic`, with sensors of 1 % gain error
_POSE_DRAWS = 6  #: sampled pose errors at each place


@dataclass(frozen=True)
class SensingCase:
    """One device and the knowledge about its sensors."""

    name: str
    device: SphericalElectromagnet
    knowledge: SensorKnowledge


@dataclass(frozen=True)
class SensingRow:
    """Root mean squares over the shell: radial tool, all coils at `current` [A]."""

    name: str
    current: float  #: [A]
    place: float  #: position error of the tool, by the tracker [m]
    axis: float  #: direction error of its axis, by the tracker [rad]
    bound: float  #: lower bound of the position error, Cramér and Rao [m]
    force: float  #: force error at a commanded force of 0.3 N [N]
    jnd: float  #: the same in just-noticeable differences


@dataclass(frozen=True)
class SensingAccuracy:
    """Sensing accuracy of one device: a table of cases."""

    device: str
    rows: tuple[SensingRow, ...]

    def row(self, name: str, current: float) -> SensingRow:
        """Return the row of case `name` at `current` [A]."""
        return next(row for row in self.rows if (row.name, row.current) == (name, current))

    def numbers(self) -> dict[str, Any]:
        """Return plain JSON types, units in the keys."""
        return {
            "device": self.device,
            "asked_n": FORCE_N,
            "rows": [
                {
                    "case": row.name,
                    "current_a": row.current,
                    "place_m": row.place,
                    "axis_deg": math.degrees(row.axis),
                    "place_bound_m": row.bound,
                    "force_n": row.force,
                    "force_jnd": row.jnd,
                }
                for row in self.rows
            ],
        }

    def show(self, console: Console) -> None:
        """Print the table on `console`."""
        table = TextTable(
            (
                Column("lasting errors", kind="key"), Column("coils", "A"), Column("place", "mm"), Column("axis", "°"),
                Column("least place", "mm"), Column("force", "mN"), Column("force", "JND"),
            ),
            "Tool by the field sensors: errors over the shell, rms, first order",
        )  # fmt: skip
        for row in self.rows:
            table.add_row(
                row.name, f"{row.current:.0f}", f"{1e3 * row.place:.2f}", f"{math.degrees(row.axis):.2f}",
                f"{1e3 * row.bound:.2f}", f"{1e3 * row.force:.1f}", f"{row.jnd:.2f}",
            )  # fmt: skip
        print_table(console, table)
        print_text(
            console,
            f"Noise is in every row, filtered to 100 Hz at 1 kHz. force: of {1e3 * FORCE_N:.0f} mN commanded in any "
            f"direction. JND: just-noticeable difference, {100 * FORCE_JND:.0f} % of force. least: Cramér-Rao bound. "
            "Errors as in the device file; a row that names one error has only that error.",
            "dim",
        )


def sensing_accuracy(device: Device) -> SensingAccuracy:
    """Compute the table of `device`; InputError if its field sensors cannot locate a tool."""
    located = electromagnet(device, "`haptorb inspect --sensing`")
    if located.sensors < 2:
        raise InputError(
            f"device '{device.name}' has {located.sensors} field sensors; at least two are needed to locate a tool"
        )
    currents = (0.0, float(device.driven_current.min()))
    rows = [compute_row(case, current) for case in sensing_cases(located) for current in currents]
    return SensingAccuracy(device.name, tuple(rows))


def summarize_sensing(device: SphericalElectromagnet) -> str:
    """Summarise for the card: all errors of the device file, coils at full current, before and after calibration."""
    current = float(device.driven_current.min())
    wanted = ("all, not calibrated", "all, calibrated: sensors")
    before, after = (compute_row(case, current) for case in sensing_cases(device, readings=120) if case.name in wanted)
    return (
        f"position {1e3 * after.place:.1f} mm, axis {math.degrees(after.axis):.1f}°, force {1e3 * after.force:.0f} mN "
        f"({after.jnd:.1f} JND) rms over the shell at {current:.0f} A after `haptorb calibrate`, "
        f"{1e3 * before.place:.1f} mm before; --sensing lists the errors"
    )


def sensing_cases(device: SphericalElectromagnet, readings: int = 360) -> Iterator[SensingCase]:
    """Yield the cases: each error alone, then all together before and after each step of a calibration.

    readings: number of readings of the tool in the step `sensors`.
    """
    k, errors, core = device.sensors, device.hall.errors, device.core_dynamics
    heat = device.coils.heat
    warmth = device.hall.warming * (heat.derate - heat.ambient)
    drift = (errors.offset_drift * warmth, errors.gain_drift * warmth)
    eddy = core.spread * core.lag(_EDDY_FREQUENCY_HZ)
    none, ideal = SensorErrors(), without_errors(device)
    yield SensingCase("none: noise and quantisation only", ideal, SensorKnowledge.of(none, k))
    for name, text in (
        ("offset", f"offset {1e3 * errors.offset:g} mT"),
        ("gain", f"gain {100 * errors.gain:g} %"),
        ("cross", f"cross-axis {100 * errors.cross:g} %"),
        ("placement", f"placement {1e3 * errors.placement:g} mm"),
        ("angle", f"angle {math.degrees(errors.angle):.2g}°"),
    ):
        alone = replace(none, **{name: getattr(errors, name)})
        yield SensingCase(text, ideal, SensorKnowledge.of(alone, k))
    yield SensingCase(f"drift over {warmth:.0f} K", ideal, replace(SensorKnowledge.of(none, k), drift=drift))
    yield SensingCase("remanence", device, replace(SensorKnowledge.of(none, k), remanent=core.remanent_moment))
    yield SensingCase(
        f"core's lag {100 * core.spread:.0f} % off, currents at {_EDDY_FREQUENCY_HZ:.0f} Hz", device,
        replace(SensorKnowledge.of(none, k), eddy=eddy),
    )  # fmt: skip
    earth = 0.0 if device.tolerance is None else device.tolerance.earth_field / math.sqrt(3)
    if earth:
        text = f"earth's field {format_quantity(math.sqrt(3) * earth, 'T')}, in any direction"
        yield SensingCase(text, ideal, replace(SensorKnowledge.of(none, k), uniform=earth))
    radius, away = _STEEL_BALL_M
    text = f"steel ball of {1e3 * radius:.0f} mm radius, {1e3 * away:.0f} mm away"
    yield SensingCase(text, ideal, replace(SensorKnowledge.of(none, k), steel=_STEEL_BALL_M))
    rest = {"drift": drift, "remanent": core.remanent_moment}
    every = SensorKnowledge.of(errors, k, uniform=earth)
    yield SensingCase("all, not calibrated", device, replace(every, **rest))  # type: ignore[arg-type]
    known = SensorKnowledge.of(replace(errors, offset=0.0), k, moments=_MOMENT_ERROR)
    yield SensingCase("all, calibrated: magnetic", device, replace(known, **rest))  # type: ignore[arg-type]
    found = predict_knowledge(device, readings)
    part = replace(known, coils=found.coils)
    yield SensingCase("all, calibrated: fields", device, replace(part, **rest))  # type: ignore[arg-type]
    yield SensingCase("all, calibrated: sensors", device, replace(found, **rest))  # type: ignore[arg-type]
    moving = replace(found, **rest, eddy=eddy)  # type: ignore[arg-type]
    yield SensingCase(f"the same, currents at {_EDDY_FREQUENCY_HZ:.0f} Hz", device, moving)
    if k == len(better_sensors(device)):
        ringed = with_sensors(device, better_sensors(device))
        there = replace(predict_knowledge(ringed, readings), **rest)  # type: ignore[arg-type]
        yield SensingCase("all, calibrated: sensors, in two rings", ringed, there)


def compute_row(case: SensingCase, current: float) -> SensingRow:
    """Compute root mean squares over the shell for `case`, all coils at `current` [A]."""
    device = case.device
    currents = np.full(device.channels, current)
    places, weights = shell_sample(device)
    squares = np.zeros(4)
    draw = np.random.default_rng(0)
    for p, weight in zip(places, weights, strict=True):
        reached, bound = pose_covariance(device, p, p, currents, case.knowledge, noise_share())
        force = _force_error(device, p, reached, draw)
        squares += weight * np.array(
            [np.trace(reached[:3, :3]), np.trace(reached[3:, 3:]), np.trace(bound[:3, :3]), force]
        )
    place, axis, least, force_rms = np.sqrt(squares).tolist()
    return SensingRow(case.name, current, place, axis, least, force_rms, force_rms / (FORCE_JND * FORCE_N))


def _force_error(device: SphericalElectromagnet, p: Array, covariance: Array, draw: np.random.Generator) -> float:
    """Return the mean square force error [N²] at p (3,) [m], radial tool, caused by pose errors with `covariance`."""
    R = rotation_to_axis(p)
    true = device.wrench_map(_state(p, R), device.models[0])
    root = np.linalg.cholesky(covariance + 1e-18 * np.eye(5))
    total = 0.0
    for _ in range(_POSE_DRAWS):
        wrong = root @ draw.standard_normal(5)
        axis = R[:, 2] + wrong[3] * np.cross(R[:, 0], R[:, 2]) + wrong[4] * np.cross(R[:, 1], R[:, 2])
        believed = device.wrench_map(_state(p + wrong[:3], rotation_to_axis(axis)), device.models[0])
        asked = draw.standard_normal(3)
        asked *= FORCE_N / np.linalg.norm(asked)
        currents = np.linalg.lstsq(believed.matrix[:3], asked - believed.passive[:3], rcond=None)[0]
        given = true.matrix[:3] @ currents + true.passive[:3]
        total += float(((given - asked) ** 2).sum())
    return total / _POSE_DRAWS


def _state(p: Array, R: Array) -> State:
    return State(0.0, R, np.ascontiguousarray(p), np.zeros(3), np.zeros(3))
