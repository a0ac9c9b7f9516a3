"""Zárate 2020, eqs. (3), (4), (6): the commanded current in a winding that is 60 K warmer.

At first the drive uses the cold winding's resistance. With the running estimate of eq. (6) the current is right
again within 0.2 s; without it, it stays 15 to 20 % too small for as long as the coil is warm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from haptorb.arrays import Array
from haptorb.control.drive import choose_duties
from haptorb.control.guard import make_coils, make_state
from haptorb.devices.api import electromagnet
from haptorb.devices.base import Device
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import InputError
from haptorb.simulation.coil_circuits import chop, coil_step, cold_coils
from haptorb_papers.reproduce.item import Item

__all__ = ["Drive", "DriveCourse", "drive_course", "items"]

_RISE, _WANTED, _DT = 60.0, 5.0, 1e-3


class Drive:
    """The drive of `device` by itself, with the kernel that the loop runs: no ramp, no limits, no trips."""

    def __init__(self, device: Device) -> None:
        self._drive, self._coils = make_state(device, _DT)["drive"], make_coils(device)
        self.resistance: Array = self._coils["resistance"]  #: (m,) as learned [Ω]

    def duties(self, wanted: Array, measured: Array, applied: Array) -> Array:
        """(m,) duties in −1…1 for `wanted` currents, after learning from `measured` currents under `applied` duties."""
        coils = self._coils
        coils["current_commanded"], coils["current"], coils["applied"] = wanted, measured, applied
        choose_duties(self._drive[0], coils)
        chosen: Array = coils["duty"].copy()
        return chosen


@dataclass(frozen=True)
class DriveCourse:
    """One coil's currents under the same wish."""

    t: Array  #: [s]
    compensated: Array  #: [A]
    uncompensated: Array  #: [A]
    estimate: Array  #: of the resistance [Ω]
    resistance: Array  #: the true one [Ω]
    wanted: float  #: [A]


def drive_course(
    device: SphericalElectromagnet, rise: float = _RISE, wanted: float = _WANTED, seconds: float = 0.5, seed: int = 0
) -> DriveCourse:
    """`wanted` [A] from t = 0 in coils `rise` [K] warmer than the drive assumes; currents read with noise."""
    if not (0 < wanted <= device.coils.current_limit.min() and abs(rise) <= 120 and seconds > 0):
        raise InputError(
            f"needs a current the coils may carry and a rise to 120 K; got {wanted} A, {rise} K, {seconds} s"
        )
    rng = np.random.default_rng(seed)
    heat, supply = device.coils.heat.coil.step(_DT), device.supply
    ask = np.full(device.channels, wanted)
    believed = device.coils.resistance_at(np.full(device.channels, device.coils.heat.ambient))
    courses = []
    for compensates in (True, False):
        coils, drive = cold_coils(device), Drive(device)
        coils["winding"] += rise
        coils["body"] += rise
        applied, chopped = np.zeros(device.channels), np.empty(device.channels)
        lines = []
        for tick in range(round(seconds / _DT)):
            reading = coils["current"] + supply.current_noise * rng.normal(size=device.channels)
            duties = drive.duties(ask, reading, applied) if compensates else ask * believed / supply.voltage
            chop(np.ascontiguousarray(duties), float(2**supply.duty_bits), chopped)
            coils["duty"] = applied = chopped.copy()
            coil_step(coils, heat, _DT)
            true = device.coils.resistance_at(coils["winding"])
            lines.append((tick * _DT, coils["current"][0], drive.resistance[0], true[0]))
        courses.append(np.array(lines).T)
    (t, good, estimate, true), (_, bad, _, _) = courses
    return DriveCourse(t, good, bad, estimate, true, wanted)


def items(report: Callable[[float], None]) -> tuple[tuple[Item, ...], Callable[[Path], Path]]:
    """Errors with and without compensation, and what draws both."""
    from haptorb.devices.loader import load

    course = drive_course(electromagnet(load("omni")))
    report(1.0)
    after = course.t >= 0.2
    with_it = 100 * float(np.abs(course.compensated[after] / course.wanted - 1).max())
    without = 100 * float(np.abs(course.uncompensated[after] / course.wanted - 1).min())
    found = (
        Item("drive-compensated", "zarate2020", "eq. (6)",
             "largest current error after 0.2 s, 60 K above the assumed temperature", 0.0, with_it, "%", 1.0,
             why="1 %: a tenth of a just-noticeable difference", implied=True, basis="own"),
        Item("drive-uncompensated", "zarate2020", "eq. (3)", "the same without the resistance estimate, smallest", None,
             without, "%", None),
    )  # fmt: skip
    return found, lambda path: _draw_figure(course, path)


def _draw_figure(course: DriveCourse, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    top, low = figure.subplots(2, 1, sharex=True)
    top.axhspan(0.99 * course.wanted, 1.01 * course.wanted, color="k", alpha=0.12, label="± 1 %")
    top.plot(course.t, course.compensated, "C0", label="with the resistance estimate, eq. (6)")
    top.plot(course.t, course.uncompensated, "C3", label="with the cold resistance")
    top.axvline(0.2, color="k", lw=0.8, ls=":")
    top.set(ylabel="current [A]", ylim=(0.75 * course.wanted, 1.08 * course.wanted))
    top.set_title(f"{course.wanted:g} A asked of a winding 60 K warmer than assumed", loc="left")
    top.legend(frameon=False)
    low.plot(course.t, course.resistance, "k--", label="true")
    low.plot(course.t, course.estimate, "C0", label="estimated")
    low.set(xlabel="time [s]", ylabel="resistance [Ω]")
    low.legend(frameon=False)
    figure.savefig(path, dpi=120)
    return path
