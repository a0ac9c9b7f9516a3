"""Effect of each error of a motor's field sensors on orientation and torque: `haptorb estimators DEVICE --sensors`.

Least squares is asked, the default of the loop, at random orientations over the workspace, no currents flowing; errors
as the device file has them, each alone and all together, on several devices that are drawn from these distributions.
A displaced sensor reads the exact field at its true place.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from rich.console import Console

from haptorb.arrays import Array
from haptorb.cli.training import random_workspace
from haptorb.devices.field_sensors import SensorErrors, draw_sensors
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.estimation.motor_orientation import LeastSquaresOrientation
from haptorb.notebook import NotebookReport
from haptorb.simulation.hall_sensors import FAILURES, make_halls, read_halls
from haptorb.simulation.noise_generator import seed_noise
from haptorb.terminal import Column, TextTable, print_table, print_text
from haptorb_papers.estimators.comparison import ASKED, TORQUE_JND, orientation_gaps, torque_error
from haptorb_papers.estimators.contestants import collect_outputs

__all__ = ["SensorEffect", "SensorEffects", "find_effects"]

_ELSEWHERE = 1.0  #: a pause after which the rotor must be located again [s]


@dataclass(frozen=True)
class _Case:
    name: str
    errors: SensorErrors = field(default_factory=SensorErrors)
    noise: bool = False  #: of the device file, with its step
    warmth: float = 0.0  #: above the temperature of calibration [K]
    dead: int = 0  #: number of sensors that read nothing
    strength: float = 1.0  #: of all magnets


@dataclass(frozen=True)
class SensorEffect:
    """One disturbance: root mean squares over orientations and devices."""

    disturbance: str
    orientation: float  #: but for the branch of spin [rad]
    torque: float  #: error of the actual torque at a commanded 60 mN·m [N·m]
    jnd: float  #: 95th percentile of that error, in just-noticeable differences
    refused: float  #: share of the readings without a valid answer


@dataclass(frozen=True)
class SensorEffects(NotebookReport):
    """The whole table."""

    device: str
    sensors: int
    devices: int  #: that were drawn
    orientations: int  #: of each
    rows: tuple[SensorEffect, ...]

    def show(self, console: Console) -> None:
        """Print the report on `console`."""
        print_effects(self, console)

    def _summarize(self) -> str:
        return f"<SensorEffects of {self.device}: {len(self.rows)} disturbances>"

    def row(self, disturbance: str) -> SensorEffect:
        """The row whose name begins so."""
        return next(row for row in self.rows if row.disturbance.startswith(disturbance))

    def numbers(self) -> dict[str, Any]:
        """Plain JSON types, units in the keys."""
        return {
            "device": self.device,
            "sensors": self.sensors,
            "devices": self.devices,
            "orientations": self.orientations,
            "asked_nm": ASKED,
            "rows": [
                {
                    "disturbance": row.disturbance,
                    "orientation_deg": math.degrees(row.orientation),
                    "torque_error_nm": row.torque,
                    "torque_error_jnd": row.jnd,
                    "refused": row.refused,
                }
                for row in self.rows
            ],
        }


def find_effects(
    motor: SphericalMotor, *, orientations: int = 100, devices: int = 4, seed: int = 0,
    report: Callable[[float], None] | None = None,
) -> SensorEffects:  # fmt: skip
    """Every disturbance of `motor`'s field sensors, on so many devices each; `report` gets the share that is done.

    Raises InputError for a motor without field sensors.
    """
    if motor.sensors < 3:
        raise InputError(f"device '{motor.name}' has {motor.sensors} field sensors; an orientation needs at least 3")
    R = random_workspace(motor, orientations, seed)
    true = motor.torque_characteristic(R, "table") @ motor.groups
    ideal = motor.sensor_field(R, "table")
    estimator, rows, cases = LeastSquaresOrientation(motor), [], _list_cases(motor)
    for number, case in enumerate(cases):
        gaps, wrong, valid = [], [], []
        for specimen in range(devices):
            readings = _readings(motor, case, R, ideal, specimen, seed)
            output = collect_outputs(estimator, motor, readings, _ELSEWHERE)
            good = output.valid > 0
            gaps.append(orientation_gaps(motor, output.R[good], R[good]))
            wrong.append(torque_error(motor, output, case.strength * true))
            valid.append(output.valid)
            if report is not None:
                report((number + (specimen + 1) / devices) / len(cases))
        off, error = np.concatenate(gaps), np.concatenate(wrong)
        rows.append(
            SensorEffect(
                case.name,
                float(np.sqrt((off**2).mean())) if len(off) else math.nan,
                float(np.sqrt((error**2).mean())),
                float(np.percentile(error, 95) / (TORQUE_JND * ASKED)),
                float(1.0 - np.mean(valid)),
            )
        )
    return SensorEffects(motor.name, motor.sensors, devices, orientations, tuple(rows))


def _list_cases(motor: SphericalMotor) -> tuple[_Case, ...]:
    hall, errors, heat = motor.hall, motor.hall.errors, motor.coils.heat
    warmth = hall.warming * (heat.derate - heat.ambient)
    none = SensorErrors()

    def isolate(*names: str) -> SensorErrors:
        return replace(none, **{name: getattr(errors, name) for name in names})

    return (
        _Case("none"),
        _Case(f"noise {1e3 * hall.noise:g} mT, step {1e3 * hall.step:g} mT", noise=True),
        _Case(f"offset {1e3 * errors.offset:g} mT", isolate("offset")),
        _Case(f"gain {100 * errors.gain:g} %", isolate("gain")),
        _Case(f"cross-axis {100 * errors.cross:g} %", isolate("cross")),
        _Case(f"placement {1e3 * errors.placement:g} mm", isolate("placement")),
        _Case(f"angle {math.degrees(errors.angle):.2g}°", isolate("angle")),
        _Case(f"drift over {warmth:.0f} K", isolate("offset_drift", "gain_drift"), warmth=warmth),
        _Case("one dead sensor", dead=1),
        _Case("four dead sensors", dead=4),
        _Case("magnets 2 % weaker", strength=0.98),
        _Case("all errors, cold", errors, noise=True),
        _Case(f"all errors, {warmth:.0f} K warmer, one dead", errors, noise=True, warmth=warmth, dead=1),
    )


def _readings(motor: SphericalMotor, case: _Case, R: Array, ideal: Array, specimen: int, seed: int) -> Array:
    """(n, k, 3) [T], stator frame: what the sensors of device `specimen` say at R (n, 3, 3)."""
    drawn = draw_sensors(case.errors, motor.sensors, specimen)
    frames = motor.sensor_layout.frames
    halls = make_halls(frames, drawn, motor.hall if case.noise else replace(motor.hall, noise=0.0, step=0.0))
    chosen = np.random.default_rng([specimen, seed]).choice(motor.sensors, case.dead, replace=False)
    halls["failure"][chosen] = FAILURES["dead"]
    if drawn.placement.any():
        places = motor.sensor_layout.positions + np.einsum("kij,kj->ki", frames, drawn.placement)
        true = motor.field(R, places) - motor.field(R, motor.sensor_layout.positions) + ideal
    else:
        true = ideal
    readings: Array = np.ascontiguousarray(case.strength * true)
    noise = seed_noise(seed + 1000 * specimen)
    for reading in readings:
        read_halls(halls, noise, case.warmth, reading)
    return readings


# --------------------------------------------------------------------------------------------------
# Table on a terminal.


def print_effects(effects: SensorEffects, console: Console) -> None:
    """Print the table of what each error of the field sensors does."""
    table = TextTable(
        (
            Column("errors", kind="key"), Column("orientation error", "°"), Column("torque error", "mN·m"),
            Column("torque error", "JND"), Column("refused", "%"),
        ),
        f"Least squares with the {effects.sensors} field sensors of '{effects.device}'",
    )  # fmt: skip
    for row in effects.rows:
        table.add_row(
            row.disturbance, f"{np.degrees(row.orientation):.4f}", f"{1e3 * row.torque:.3g}", f"{row.jnd:.2g}",
            f"{100 * row.refused:.3g}",
        )  # fmt: skip
    print_table(console, table)
    print_text(
        console,
        f"\nrms over {effects.orientations} orientations of each of {effects.devices} devices drawn from the device "
        "file's distributions. Torque error: error of the actual torque at a commanded 60 mN·m; JND: its 95th "
        "percentile over 12.7 %, the just-noticeable difference.",
    )
