"""Zárate 2020, sections III and V: consistency of power, current and force (errata E15, E34)."""

from __future__ import annotations

from math import log10, pi, sqrt

import numpy as np

from haptorb.devices.api import electromagnet
from haptorb.devices.base import State, endurance
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.magnetics import dipole
from haptorb.magnetics.dipole import MU0
from haptorb.simulation.coil_circuits import coil_step, cold_coils
from haptorb.thermal import single_time_constant
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.entry import read_entry
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Report

__all__ = ["drive_fully", "items"]

_AT = Citation("zarate2020", "power", "§III")


def items(report: Report) -> tuple[tuple[Item, ...], None]:
    """48 mN/A and what it says of the magnet; 17 W, 100 W, 230 W and their forces; what the coils' heat allows."""
    device = electromagnet(load("omni"))
    tool, ohm = device.tool, float(device.coils.resistance[0])
    contact = State.at((0, 0, device.contact_distance))
    mean = np.linalg.norm(device.moment_per_current, axis=0).mean()
    per_moment = 6 * MU0 / (4 * pi * device.contact_distance**4)
    per_ampere = _average_force(device)
    ring, exact = (-float(device.wrench_map(contact, model).matrix[2, 2]) for model in ("point-coils", "exact"))
    heat = device.coils.heat
    coils, alone = heat.network(device.channels), np.eye(device.channels)[0]  # the printed endurances: one coil alone
    rise = heat.derate - heat.ambient
    report(0.5)
    volume = pi * (tool.outer_radius**2 - tool.inner_radius**2) * tool.length
    remanence = MU0 * 0.048 / (per_moment * mean) / volume
    one_constant = [single_time_constant(p, t, 17.0) for p, t in ((230.0, 5.0), (57.5, 60.0))]
    rank = np.linalg.matrix_rank(device.wrench_map(contact, "published").torque, tol=1e-9)
    fmap = np.linalg.matrix_rank(device.wrench_map(contact, "published").force, tol=1e-9)
    found = (
        _AT.item("outside", "outside diameter of the tool's ring", 12.0, read_entry(tool, "outer_radius", 2e3), "mm"),
        _AT.item("inside", "inside diameter", 5.0, read_entry(tool, "inner_radius", 2e3), "mm"),
        _AT.item("height", "its height", 24.0, read_entry(tool, "length", 1e3), "mm"),
        _AT.assume("per-ampere", "force per current at 5 cm, mean of the three coils", 48.0, 1e3 * per_ampere, "mN/A",
                   0.5, "the ring's remanence is assumed so that this is true"),
        _AT.note("per-ampere-z", "the same for the z coil as a point, magnet at its size", 1e3 * ring, "mN/A",
                 "E16: 15.6 % above the dipole's"),
        _AT.note("per-ampere-coil", "the same, coil, core and magnet at their sizes", 1e3 * exact, "mN/A",
                 "E35: 8 % below the dipole's"),
        _AT.note("remanence", "remanence that 48 mN/A requires of this ring", remanence, "T",
                 "neodymium's, as printed: an N45 to N48 magnet; the device file takes 1.348 T"),
        _AT.item("p0", "heat in a winding of the simulated device at 12.9 A, room temperature", 100.0,
                 _heat_winding(device, 12.9), "W", 0.5, "12.9 has three digits; 0.6 Ω is the device file's"),
        _AT.item("sustained", "averaged constant force at 17 W in a coil, mean of the three coils", 258.0,
                 1e3 * per_ampere * sqrt(17.0 / ohm), "mN", 3.0, "1 %: 17 W and 48 mN/A have two digits; 48 mN/A is "
                 "an input (by the remanence), 258 mN is not"),
        _AT.item("peak", "peak force at full strength, coil at room temperature", 959.0,
                 1e3 * per_ampere * drive_fully(device)[0], "mN", 4.0, "two digits of 48; 24 A would give 1152 mN",
                 erratum="E15"),
        _AT.item("peak-power", "power at full strength, coil at room temperature", 230.0, drive_fully(device)[1], "W",
                 12.0, "5 %: 'roughly 0.6 Ω'"),
        _AT.note("fifteen", "full power over the averaged 17 W: 'peaks up to 15 × P_ave'",
                 drive_fully(device)[1] / 17.0),
        _AT.assume("full", "seconds at full power, 240 W, from cold, power constant", 5.0,
                   coils.time_to(rise, 240.0 * alone), "s", 0.1,
                   "network fitted to the three endurances of one coil", where="§V"),
        _AT.assume("half", "seconds at half duty, a quarter of the power, constant", 60.0,
                   coils.time_to(rise, 60.0 * alone), "s", 0.5,
                   "network fitted to the three endurances of one coil", where="§V"),
        *(
            _AT.note(f"{name}-current", f"the same at a constant current of {amperes:g} A, as the loop holds it",
                     seconds, "s", "the hot winding takes more power (E34)", where="§V", erratum="E34")
            for name, amperes, (_, seconds) in zip(
                ("full", "half"), (20.0, 10.0), endurance(device, (1.0, 0.5)), strict=True)
        ),
        _AT.assume("for-ever", "continuous power of the coil", 17.0,
                   rise / float(coils.rise_per_watt[0, 0]), "W", 0.1,
                   "network fitted to the three endurances of one coil"),
        _AT.assume("minutes", "order of magnitude of the thermal time, log₁₀ of minutes: 'in the order of minutes'",
                   0.0, log10(device.coils.heat.coil.time_constants[1] / 60.0), "1", 0.8,
                   "network fitted to the three endurances of one coil"),
        _AT.note("one-node-5", "time constant of a single body for 5 s at 230 W", one_constant[0], "s",
                 "a single body is contradictory: see the next row; hence two"),
        _AT.note("one-node-60", "and for 60 s at half duty", one_constant[1], "s"),
        _AT.item("force-rank", "independent force components at contact: 'three'", 3, fmap, where="§V"),
        _AT.claim("torque-rank", "independent torque components: 'a specific torque map'", 2, rank, "1", 0.0,
                 "a moment has no torque about its axis, so a torque map has two components, not three", where="§V"),
        _AT.exempt("stronger", "more force with a larger magnet, less angular resolution, more weight",
                      "a direction without numbers"),
    )  # fmt: skip
    report(1.0)
    return found, None


def _average_force(device: SphericalElectromagnet) -> float:
    """[N/A] on the tool above the core at contact, moment along it, of the mean of the coils' moments per ampere."""
    mean = np.linalg.norm(device.moment_per_current, axis=0).mean()
    summit = (0.0, 0.0, device.contact_distance)
    return -float(dipole.force((0, 0, mean), (0, 0, device.tool.moment), summit)[2])


def _simulate_coil(device: SphericalElectromagnet, duty: float, seconds: float = 0.02) -> tuple[float, float]:
    """Current [A] and heat [W] of the simulated x coil after `seconds` at `duty`, kept at room temperature."""
    coils, dt = cold_coils(device), 1e-3
    step = device.coils.heat.coil.step(dt)
    for _ in range(round(seconds / dt)):
        coils["winding"] = coils["body"] = coils["ambient"] = device.coils.reference_temperature
        coils["duty"][0] = duty
        coil_step(coils, step, dt)
    rise = float(coils["winding"][0]) - device.coils.reference_temperature
    return float(coils["current"][0]), rise / float(step[0, 2])


def _heat_winding(device: SphericalElectromagnet, amperes: float) -> float:
    return _simulate_coil(device, amperes * float(device.coils.resistance[0]) / device.supply.voltage)[1]


def drive_fully(device: SphericalElectromagnet) -> tuple[float, float]:
    """Current [A] and heat [W] of the simulated x coil at full voltage, kept at room temperature."""
    return _simulate_coil(device, 1.0)
