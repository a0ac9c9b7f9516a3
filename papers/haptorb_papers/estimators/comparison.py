"""Comparison of estimators under every disturbance: error of K, of the actual torque, of orientation, and time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from rich.console import Console

from haptorb.arrays import Array
from haptorb.cli.training import figure_4, random_workspace, relative_error
from haptorb.control.allocation import MinimumPowerAllocator
from haptorb.devices.base import WrenchMap
from haptorb.devices.field_sensors import SensorErrors, draw_sensors
from haptorb.devices.motor import SphericalMotor
from haptorb.estimation.motor_orientation import spin_period
from haptorb.estimation.network import TrainedNetworks
from haptorb.notebook import NotebookReport
from haptorb.simulation.hall_sensors import FAILURES, make_halls, read_halls
from haptorb.simulation.noise_generator import seed_noise
from haptorb.terminal import Column, TextTable, print_table, print_text
from haptorb_papers.estimators.contestants import EstimatorOutput, collect_outputs, make_estimators

__all__ = [
    "ASKED",
    "NOISES",
    "TORQUE_JND",
    "CoilTrace",
    "Disturbance",
    "EstimatorComparison",
    "EstimatorRow",
    "compare",
    "disturbances",
    "orientation_gaps",
    "torque_error",
]


# --------------------------------------------------------------------------------------------------
# What estimators are tried against: noise, offset, a sensor that fails, magnets that differ from the device file.


@dataclass(frozen=True)
class Disturbance:
    """One way in which readings are not what the device's model says."""

    name: str
    noise: float | None = None  #: of one reading [T]; None: noise and step of the device file
    offset: float = 0.0  #: standard deviation over the sensors [T]
    gain: float = 0.0  #: standard deviation over the sensors, relative; as much again across axes
    failed: int = 0  #: number of the sensor that has failed, from 1; 0: none
    failure: str = "dead"
    strength: float = 1.0  #: of all magnets, relative to the device file

    def readings(self, motor: SphericalMotor, R: Array, seed: int = 0) -> Array:
        """(n, k, 3) [T], stator frame: what the sensors of `motor` say at R (n, 3, 3), no currents flowing."""
        ideal = self.noise is not None
        halls = make_halls(
            motor.sensor_layout.frames,
            draw_sensors(SensorErrors(self.gain, self.offset, self.gain), motor.sensors, seed),
            motor.hall if self.noise is None else replace(motor.hall, noise=self.noise, step=0.0),
        )
        if ideal:
            halls["reach"] = motor.hall.greatest_reading
        if self.failed:
            halls["failure"][self.failed - 1] = FAILURES[self.failure]
        noise = seed_noise(seed)
        field = self.strength * motor.sensor_field(R, "table")
        for reading in field:
            read_halls(halls, noise, 0.0, reading)
        return field


NOISES = tuple(
    Disturbance(f"noise {1e3 * sigma:g} mT" if sigma else "ideal sensors", noise=sigma)
    for sigma in (0.0, 1e-5, 1e-4, 1e-3)
)


def _own_sensor(motor: SphericalMotor, coil: int) -> int:
    """Number, from 1, of the sensor nearest to the axis of `coil`, from 0."""
    return int(np.argmax(motor.sensor_layout.directions @ motor.electromagnets.directions[coil])) + 1


def disturbances(motor: SphericalMotor, coil: int) -> tuple[Disturbance, ...]:
    """All of them; the sensor that fails is the one on the axis of `coil`, from 0."""
    own = _own_sensor(motor, coil)
    return (
        *NOISES,
        Disturbance("as in the device file"),
        Disturbance("offset 0.5 mT", offset=0.5e-3),
        Disturbance("gain, cross-axis 1 %", gain=0.01),
        Disturbance(f"sensor {own} dead", failed=own),
        Disturbance(f"sensor {own} saturated", failed=own, failure="saturated"),
        Disturbance("magnets +2 %", strength=1.02),
        Disturbance("magnets −2 %", strength=0.98),
    )


#: field of a row → its key with the unit; shares have none
_KEYS = {
    "worst": "worst_nm_per_a",
    "torque": "torque_error_nm",
    "jnd": "torque_error_jnd",
    "orientation": "orientation_deg",
}

TORQUE_JND = 0.127  #: just noticeable difference of a torque of 60 mN·m, relative
ASKED = 0.06  #: torque that is asked of the motor [N·m]
_ELSEWHERE = 1.0  #: a pause after which an estimator must locate the rotor again [s]


@dataclass(frozen=True)
class EstimatorRow:
    """One estimator under one disturbance."""

    estimator: str
    disturbance: str
    figure_4: float  #: NRMSE of the coil's K on the trajectory of Fig. 4
    workspace: float  #: the same over the workspace
    worst: float  #: greatest error of a component of the coil's K over the workspace [N·m/A]
    torque: float  #: rms error of the actual torque at a commanded 60 mN·m [N·m]
    jnd: float  #: 95th percentile of that error, in just noticeable differences
    orientation: float  #: root mean square error of the orientation, but for the branch of spin [°]; NaN: not estimated
    refused: float  #: share of the readings to which the estimator gave no valid answer


@dataclass(frozen=True)
class CoilTrace:
    """K of the coil along the trajectory of Fig. 4, sensors as in the device file."""

    t: Array  #: (n,) [s]
    true: Array  #: (n, 3) [N·m/A]
    estimated: dict[str, Array]


@dataclass(frozen=True)
class EstimatorComparison(NotebookReport):
    """The whole table, and what the figure is drawn from."""

    device: str
    coil: int  #: number, from 1
    rows: tuple[EstimatorRow, ...]
    course: CoilTrace
    latency: dict[str, dict[str, float]]  #: [µs] by estimator: p5, median, p95 of one update, warm
    noises: tuple[float, ...] = field(default=(0.0, 1e-5, 1e-4, 1e-3))  #: [T] of the first disturbances

    def show(self, console: Console) -> None:
        """Print the report on `console`."""
        print_comparison(self, console)

    def _summarize(self) -> str:
        names = ", ".join(self.estimators)
        return f"<EstimatorComparison of {self.device}, electromagnet {self.coil}: {names}; {len(self.rows)} rows>"

    def row(self, estimator: str, disturbance: str) -> EstimatorRow:
        """The row of these two."""
        return next(row for row in self.rows if (row.estimator, row.disturbance) == (estimator, disturbance))

    @property
    def estimators(self) -> tuple[str, ...]:
        """In the table's order."""
        return tuple(dict.fromkeys(row.estimator for row in self.rows))

    @property
    def disturbances(self) -> tuple[str, ...]:
        """In the table's order."""
        return tuple(dict.fromkeys(row.disturbance for row in self.rows))

    def numbers(self) -> dict[str, Any]:
        """Everything as plain JSON types; not a number is null."""

        def to_json(value: Any) -> Any:
            return None if isinstance(value, float) and not np.isfinite(value) else value

        return {
            "device": self.device,
            "electromagnet": self.coil,
            "rows": [{_KEYS.get(name, name): to_json(value) for name, value in vars(row).items()} for row in self.rows],
            "latency_us": self.latency,
            "figure_4": {
                "t_s": self.course.t.tolist(),
                "true_nm_per_a": self.course.true.tolist(),
                "estimated_nm_per_a": {name: K.tolist() for name, K in self.course.estimated.items()},
            },
        }


def compare(
    motor: SphericalMotor,
    networks: TrainedNetworks,
    *,
    orientations: int = 500,
    seed: int = 0,
    report: Callable[[float], None] | None = None,
) -> EstimatorComparison:
    """Every estimator against every disturbance; `report` is called with the share that is done.

    K of the coil on the X axis (EM17) is taken from its channel, which counts it and its antipode alike. Where the
    network leaves a channel out, its K is zero, and counts as such.
    """
    coil = int(np.argmax(motor.electromagnets.directions[:, 0]))
    channel = int(np.flatnonzero(motor.groups[coil])[0])
    share = float(motor.groups[coil, channel] / np.abs(motor.groups[:, channel]).sum())
    places = {"figure": figure_4(721), "workspace": random_workspace(motor, orientations, seed)}
    t = np.linspace(0, 2 * np.pi, len(places["figure"]))
    interval = {"figure": float(t[1]), "workspace": _ELSEWHERE}
    true = {name: motor.torque_characteristic(R, "table") @ motor.groups for name, R in places.items()}
    cases = disturbances(motor, coil)
    known = make_estimators(motor, networks)
    rows, estimated, latency = [], {}, {}
    for number, case in enumerate(cases):
        for place, (name, estimator) in enumerate(known.items()):
            outputs = {
                where: collect_outputs(estimator, motor, case.readings(motor, R, seed + 1), interval[where])
                for where, R in places.items()
            }
            rows.append(_row(motor, name, case, outputs, places, true, channel, share))
            if case == cases[4]:
                estimated[name] = share * outputs["figure"].K[:, :, channel]
                times = np.percentile(1e6 * outputs["figure"].seconds, (5, 50, 95))
                latency[name] = dict(zip(("p5", "median", "p95"), times.round(2).tolist(), strict=True))
            if report is not None:
                report((number + (place + 1) / len(known)) / len(cases))
    course = CoilTrace(t, share * true["figure"][:, :, channel], estimated)
    return EstimatorComparison(motor.name, coil + 1, tuple(rows), course, latency)


def _row(
    motor: SphericalMotor, name: str, case: Disturbance, outputs: dict[str, EstimatorOutput], places: dict[str, Array],
    true: dict[str, Array], channel: int, share: float,
) -> EstimatorRow:  # fmt: skip
    one = {where: share * case.strength * K[:, :, channel] for where, K in true.items()}
    found = {where: share * answer.K[:, :, channel] for where, answer in outputs.items()}
    over = outputs["workspace"]
    wrong = torque_error(motor, over, case.strength * true["workspace"])
    gaps = orientation_gaps(motor, over.R, places["workspace"])
    return EstimatorRow(
        name,
        case.name,
        relative_error(found["figure"], one["figure"]),
        relative_error(found["workspace"], one["workspace"]),
        float(np.abs(found["workspace"] - one["workspace"]).max()),
        float(np.sqrt((wrong**2).mean())),
        float(np.percentile(wrong, 95) / (TORQUE_JND * ASKED)),
        float(np.degrees(np.sqrt((gaps**2).mean()))),
        float(1.0 - over.valid.mean()),
    )


def torque_error(motor: SphericalMotor, output: EstimatorOutput, true: Array) -> Array:
    """(n,) error [N·m] of the torque that the true K makes of the currents that the estimated K asks for."""
    allocator = MinimumPowerAllocator(motor.coils.current_limit, resistance=motor.coils.resistance)
    directions = np.random.default_rng(7).standard_normal((len(true), 3))
    wanted = ASKED * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    wrong = np.empty(len(true))
    for number, (K, torque) in enumerate(zip(output.K, wanted, strict=True)):
        matrix = np.zeros((6, motor.channels))
        matrix[3:] = K
        currents = np.zeros(motor.channels)
        if output.valid[number]:
            currents = allocator.allocate(
                WrenchMap(matrix, np.zeros(6)), np.concatenate([np.zeros(3), torque])
            ).currents
        wrong[number] = np.linalg.norm(true[number] @ currents - torque)
    return wrong


def orientation_gaps(motor: SphericalMotor, found: Array, true: Array) -> Array:
    """(n,) angle between orientations [rad], the least over all branches of spin."""
    period = spin_period(motor)
    relative = np.swapaxes(true, 1, 2) @ found
    if period:
        angle = np.arctan2(relative[:, 1, 0] - relative[:, 0, 1], relative[:, 0, 0] + relative[:, 1, 1])
        turn = period * np.round(angle / period)
        c, s, zero, one = np.cos(turn), np.sin(turn), np.zeros_like(turn), np.ones_like(turn)
        back = np.stack([c, s, zero, -s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
        relative = relative @ back
    vector = 0.5 * np.stack(
        [
            relative[:, 2, 1] - relative[:, 1, 2],
            relative[:, 0, 2] - relative[:, 2, 0],
            relative[:, 1, 0] - relative[:, 0, 1],
        ],
        axis=1,
    )
    cosine = 0.5 * (np.trace(relative, axis1=1, axis2=2) - 1)
    gaps: Array = np.arctan2(np.linalg.norm(vector, axis=1), cosine)
    return gaps


# --------------------------------------------------------------------------------------------------
# Table on a terminal.


def print_comparison(comparison: EstimatorComparison, console: Console) -> None:
    """Print the tables."""
    table = TextTable(
        (
            Column("readings", kind="key"), Column("estimator", kind="key"), Column("NRMSE, Fig. 4", "%"),
            Column("NRMSE, workspace", "%"), Column("worst", "mN·m/A"), Column("torque error", "mN·m"),
            Column("torque error", "JND"), Column("orientation error", "°"), Column("refused", "%"),
        ),
        f"K of electromagnet {comparison.coil} of '{comparison.device}', and its effect",
    )  # fmt: skip
    for disturbance in comparison.disturbances:
        for number, estimator in enumerate(comparison.estimators):
            row = comparison.row(estimator, disturbance)
            table.add_row("" if number else disturbance, estimator, *_cells(row))
        table.end_section()
    print_table(console, table)
    print_text(
        console,
        "\nNRMSE: rms error over rms. Torque error: rms error of the actual torque at a commanded 60 mN·m; JND: its "
        "95th percentile over 12.7 %, the just-noticeable difference.",
    )
    for name, times in comparison.latency.items():
        print_text(console, f"one update of {name}: median {times['median']:.0f} µs, 95 % within {times['p95']:.0f} µs")


def _cells(row: EstimatorRow) -> tuple[str, ...]:
    angle = "not estimated" if np.isnan(row.orientation) else f"{row.orientation:.4f}"
    return (
        f"{100 * row.figure_4:.3g}",
        f"{100 * row.workspace:.3g}",
        f"{1e3 * row.worst:.3g}",
        f"{1e3 * row.torque:.3g}",
        f"{row.jnd:.2g}",
        angle,
        f"{100 * row.refused:.3g}",
    )
