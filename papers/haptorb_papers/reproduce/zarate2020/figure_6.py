"""Zárate 2020, Fig. 6: one coil at 30 % duty for three minutes, three minutes of cooling, and derived values.

The winding's temperature T_in comes from its resistance, V0 u/i, while the current is on; the boundary's, T_out, from
its sensor. No temperature compensation, as in the paper: the current falls as the wire warms. From that record, and the
device file's couplings to the other coils, four values are identified, and the three printed endurances follow: 17 W
continuously, full power (20 A, 240 W, erratum E15) for 5 s, half duty (60 W) for 60 s. A check of the chain from
sensors to endurance, not of the real coil: the simulated coil's values were themselves fitted to the printed
endurances.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.api import electromagnet
from haptorb.devices.base import Device
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import InputError
from haptorb.estimation.heat_calibration import HeatRecord, NetworkIdentification, coil_identification
from haptorb.simulation.coil_circuits import cold_coils, network_coil_step
from haptorb.simulation.electromagnet import COILS, NODES, fill_step
from haptorb_papers.reproduce.item import Item

__all__ = ["ThermalCourse", "heating_course", "items"]

_DUTY, _ON, _OFF = 0.3, 180.0, 180.0
_STEP, _LINE = 0.05, 1.0  #: of the simulation, and between lines of the record [s]


@dataclass(frozen=True)
class ThermalCourse:
    """The record and, behind it, the truth; one entry per line."""

    t: Array  #: [s]
    current: Array  #: measured [A]
    power: Array  #: V0 u i [W]
    inside: Array  #: winding by its resistance [K]; NaN without current
    outside: Array  #: boundary by its sensor [K]
    winding: Array  #: the true one [K]
    body: Array  #: the true one [K]
    coil: int  #: that was driven

    def record(self, device: Device) -> HeatRecord:
        """The record as identification takes it: nothing was measured of the other coils of `device`."""
        n, m = len(self.t), device.channels
        power, inside, outside = np.zeros((n, m)), np.full((n, m), np.nan), np.full((n, m), np.nan)
        power[:, self.coil], inside[:, self.coil], outside[:, self.coil] = self.power, self.inside, self.outside
        return HeatRecord(self.t, power, inside, outside, device.coils.heat.ambient)

    def identify(self, device: Device) -> NetworkIdentification:
        """The coil's values from the record, with the couplings of `device`, which it does not determine."""
        return coil_identification(self.record(device), device.coils.heat)


def heating_course(
    device: SphericalElectromagnet, coil: int = 1, duty: float = _DUTY, on: float = _ON, off: float = _OFF,
    seed: int = 0,
) -> ThermalCourse:  # fmt: skip
    """`duty` on `coil` for `on` [s], then `off` [s] of cooling, read with the device's noise."""
    if not (0 < abs(duty) <= 1 and on > 0 and off >= 0 and 0 <= coil < device.channels):
        raise InputError(f"needs 0 < duty ≤ 1, on > 0, off ≥ 0 and a coil that exists; got {duty}, {on}, {off}, {coil}")
    rng = np.random.default_rng(seed)
    supply, coils = device.supply, device.coils
    state, heat, core = cold_coils(device), np.empty((NODES, NODES + COILS)), coils.heat.ambient
    fill_step(coils.heat.network(device.channels), _STEP, heat)
    one, duties = state[coil : coil + 1], state["duty"]
    every, lines = round(_LINE / _STEP), []
    for line in range(round((on + off) / _LINE)):
        duties[coil] = duty if line * _LINE < on else 0.0
        readings = []
        before = float(one["winding"][0]), float(one["body"][0])
        edge = before[1] + device.thermometer_noise * rng.normal()
        for _ in range(every):
            core = network_coil_step(state, heat, core, _STEP)
            readings.append(_read(float(one["current"][0]), supply.current_noise, supply.current_step, rng))
        i = float(np.mean(readings))
        resistance = supply.voltage * duty / i if duties[coil] else np.nan
        inside = coils.reference_temperature + (resistance / coils.resistance[coil] - 1) / coils.temperature_coefficient
        step = device.thermometer_step
        outside = np.rint(edge / step) * step if step else edge
        lines.append((line * _LINE, i, supply.voltage * duties[coil] * i, inside, outside, *before))
    t, current, power, inside_t, outside_t, winding, body = np.array(lines).T
    return ThermalCourse(t, current, power, inside_t, outside_t, winding, body, coil)


def _read(value: float, noise: float, step: float, rng: np.random.Generator) -> float:
    noisy = value + noise * rng.normal()
    return float(np.rint(noisy / step) * step) if step else noisy


def items(report: Callable[[float], None]) -> tuple[tuple[Item, ...], Callable[[Path], Path]]:
    """The three endurances from the record, and what draws the course."""
    from haptorb.devices.loader import load

    device = electromagnet(load("omni"))
    course = heating_course(device)
    report(0.5)
    found = course.identify(device)
    rise = device.coils.heat.derate - device.coils.heat.ambient
    report(1.0)

    def one(name: str, what: str, believed: float, computed: float, unit: str) -> Item:
        return Item(
            f"fig6-{name}", "zarate2020", "Fig. 6", what, believed, computed, unit, 0.1 * believed, implied=True,
            why="10 %: identified from noisy readings of the simulated coil, against that coil's own", basis="own",
        )  # fmt: skip

    return (
        one("sustained", "continuous power of a coil, from the record", 17.0, found.find_sustained_power(rise), "W"),
        one("full", "seconds at full power from cold, from the record", 5.0, found.endurance(rise, 240.0), "s"),
        one("half", "seconds at half duty from cold, from the record", 60.0, found.endurance(rise, 60.0), "s"),
        Item("fig6-peak", "zarate2020", "Fig. 6", "winding after 3 min at 30 % duty", None,
             float(np.nanmax(course.inside)) - 273.15, "°C", None),
    ), lambda path: _draw_figure(device, course, found, path)  # fmt: skip


def _draw_figure(device: Device, course: ThermalCourse, found: NetworkIdentification, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5), layout="constrained")
    FigureCanvasAgg(figure)
    panel = figure.subplots()
    minutes = course.t / 60
    network, m = found.network, device.channels
    model, power = np.zeros((len(course.t), network.nodes)), course.record(device).power
    step = network.step(_LINE)
    for n in range(len(course.t) - 1):
        model[n + 1] = step @ np.concatenate([model[n], power[n]])
    model = model[:, [course.coil, m + course.coil]] + device.coils.heat.ambient
    panel.plot(minutes, course.inside - 273.15, "C3.", ms=3, label="T_in: winding, by its resistance")
    panel.plot(minutes, course.outside - 273.15, "C0.", ms=3, label="T_out: boundary, by its sensor")
    panel.plot(minutes, model - 273.15, "k-", lw=1, label="identified network")
    panel.set(xlabel="time [min]", ylabel="temperature [°C]", xlim=(0, minutes[-1]))
    right = panel.twinx()
    right.plot(minutes, course.current, "C2-", lw=1, label="I_y")
    right.set(ylabel="current [A]", ylim=(0, 1.3 * float(course.current.max())))
    lines = [*panel.get_lines()[:3], *right.get_lines()]
    panel.legend(lines, [str(line.get_label()) for line in lines], frameon=False, loc="lower center")
    panel.set_title("30 % duty for 3 min, then 3 min of cooling; fan as in the device file", loc="left")
    panel.grid(alpha=0.3)
    figure.savefig(path, dpi=120)
    return path
