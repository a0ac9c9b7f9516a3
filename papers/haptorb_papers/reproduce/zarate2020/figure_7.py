"""Zárate 2020, Fig. 7: the core's moment over the currents, from the Hall sensors by eq. (5).

Each coil of the simulated device alone carries up to 12.9 A either way, the tool half a metre away; nine sensors are
read with their noise. Every reading of the five on the axes becomes a moment by eq. (5), all nine together the 3×3 map
and the offsets. Nothing but currents and fields is used: the device file's own map is only what the result is compared
with.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.api import electromagnet
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.estimation.coil_calibration import MagneticCalibration, excitation, magnetic_calibration
from haptorb.estimation.types import HandGoal
from haptorb.magnetics.dipole import MU0
from haptorb.runtime.drivers.sim import SimDriver
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Drawing

__all__ = ["MomentCourse", "items", "moment_course"]

_AMPERES = 12.9  #: 100 W in 0.6 Ω
_PUBLISHED = (2.52, 2.70, 2.82)  #: m_e at that current, along each coil's own axis [A·m²]
_STEP, _HOLD, _SETTLE = 2e-3, 0.03, 0.012  #: of the driver, of one current, of which not looked at [s]


@dataclass(frozen=True)
class MomentCourse:
    """One entry per current that was tried."""

    currents: Array  #: (n, m) measured [A]
    moments: Array  #: (n, 3) from the sensors, offsets taken out [A·m²]
    calibration: MagneticCalibration


def moment_course(
    device: SphericalElectromagnet, seed: int = 0, report: Callable[[float], None] = lambda share: None
) -> MomentCourse:
    """Excite, read, regress."""
    limit = float(device.coils.current_limit.max())
    wanted = excitation(device, share=_AMPERES / limit, levels=6, repeats=2)
    away = HandGoal(np.array([0.0, 0.0, 0.5]), np.array([0.0, 0.0, 0.0, 1.0]), 0.0, False)
    currents, fields = np.empty_like(wanted), np.empty((len(wanted), device.sensors, 3))
    driver, tick = SimDriver.of(device, _STEP, lambda now: away, seed), 0
    with driver:
        for n, amperes in enumerate(wanted):
            duties, samples = amperes * device.coils.resistance / device.supply.voltage, []
            for part in range(round(_HOLD / _STEP)):
                sample = driver.read(tick * _STEP)
                driver.write(duties)
                tick += 1
                if part * _STEP > _SETTLE:
                    samples.append(sample)
            currents[n] = np.mean([sample.currents for sample in samples], axis=0)
            fields[n] = np.mean([sample.field for sample in samples], axis=0)
            report(0.9 * (n + 1) / len(wanted))
    found = magnetic_calibration(device, wanted, currents, fields)
    return MomentCourse(currents, _read_moments(device, fields - found.offsets), found)


def _read_moments(device: SphericalElectromagnet, fields: Array) -> Array:
    """(n, 3) [A·m²] by eq. (5), from the sensors on each axis; fields (n, k, 3) [T]."""
    distances = np.linalg.norm(device.hall.positions, axis=1)
    found = []
    for axis in range(3):
        along = np.flatnonzero(np.abs(device.hall.positions[:, axis]) > 0.999 * distances)
        found.append((2 * np.pi / MU0 * distances[along] ** 3 * fields[:, along, axis]).mean(axis=1))
    return np.stack(found, axis=1)


def items(report: Callable[[float], None]) -> tuple[tuple[Item, ...], Drawing]:
    """The three moments at 12.9 A, how straight the lines are, and what draws them."""
    from haptorb.devices.loader import load

    device = replace(electromagnet(load("omni")), tolerance=None)  # the paper's, as far as it is printed
    course = moment_course(device, report=report)
    matrix, names = course.calibration.moment_per_current, device.coils.names
    left = course.moments - course.currents @ matrix.T
    bent = float(np.abs(left).max() / np.abs(course.moments).max())
    off = matrix - np.diag(np.diag(matrix))
    found = [
        Item(f"fig7-{name}", "zarate2020", "Fig. 7", f"m_e along {name} at 12.9 A in coil {name}", printed,
             float(matrix[k, k] * _AMPERES), "A·m²", 0.02, basis="assumed",
             why="the simulated coils have the printed moments; identified again from noisy sensor readings")
        for k, (name, printed) in enumerate(zip(names, _PUBLISHED, strict=True))
    ]  # fmt: skip
    found += [
        Item("fig7-linear", "zarate2020", "Fig. 7", "greatest departure from a straight line, of the greatest moment",
             0.0, bent, "1", 0.02, why="the simulated core is linear, as the text has it", implied=True,
             basis="assumed"),
        Item("fig7-skew", "zarate2020", "Fig. 7", "greatest term off the diagonal, of the coil's own", None,
             float(np.abs(off).max() / np.diag(matrix).min()), "1", None,
             why="the text has such terms without a number; ours are assumed in the device file"),
        Item("fig7-truth", "zarate2020", "Fig. 7", "greatest error of the map found, of the device's own map", None,
             float(np.abs(matrix - device.moment_per_current).max() / np.abs(device.moment_per_current).max()), "1",
             None, why="the simulated device knows its own map; a real one does not"),
    ]  # fmt: skip
    report(1.0)
    return tuple(found), lambda path: _draw_figure(course, names, path)


def _draw_figure(course: MomentCourse, names: tuple[str, ...], path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    matrix = course.calibration.moment_per_current
    for coil, (panel, name) in enumerate(zip(figure.subplots(1, 3, sharey=True), names, strict=True)):
        alone = np.abs(course.currents).argmax(axis=1) == coil
        i = course.currents[alone, coil]
        order = np.argsort(i)
        for axis, letter in enumerate("xyz"):
            panel.plot(i[order], course.moments[alone][order, axis], f"C{axis}o", ms=3)
            ends = np.array([-_AMPERES, _AMPERES])
            panel.plot(ends, matrix[axis, coil] * ends, f"C{axis}-", lw=1,
                       label=f"m_{letter}: {1e3 * matrix[axis, coil]:+.1f} mA·m²/A")  # fmt: skip
        panel.plot([_AMPERES], [_PUBLISHED[coil]], "k*", ms=10, label=f"printed: {_PUBLISHED[coil]:g} A·m²")
        panel.set(xlabel=f"I_{name} [A]")
        panel.set_title(f"coil {name} alone", loc="left")
        panel.legend(frameon=False, fontsize=8)
        panel.grid(alpha=0.3)
    figure.axes[0].set_ylabel("moment of the core [A·m²]")
    figure.savefig(path, dpi=120)
    return path
