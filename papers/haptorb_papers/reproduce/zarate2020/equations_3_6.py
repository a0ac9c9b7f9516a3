"""Zárate 2020, eqs. (3) to (6): from a required moment to a duty; calibration, and resistance (erratum E26)."""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.api import electromagnet
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.estimation.coil_calibration import excitation, magnetic_calibration
from haptorb.magnetics import dipole
from haptorb.magnetics.dipole import MU0
from haptorb.simulation.coil_circuits import coil_step, cold_coils
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.entry import read_entry
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Report
from haptorb_papers.reproduce.zarate2020.drive import Drive, drive_course
from haptorb_papers.reproduce.zarate2020.second_coils import compute_coil_fields

__all__ = ["items"]

_AT = Citation("zarate2020", "drive", "§II.C")


def items(report: Report) -> tuple[tuple[Item, ...], None]:
    """Duties of the drive, the field that (5) inverts, a calibration with noise, and R_t of a warm coil."""
    device = electromagnet(load("omni"))
    cold = device.coils.resistance_at(np.full(3, device.coils.heat.ambient))
    field = float(dipole.field((0, 0, 2.82), (0, 0, 0.055))[2])
    found_m = _calibrate(device)
    truth = device.moment_per_current
    report(0.5)
    course = drive_course(device)
    late = course.t >= 0.2
    found = (
        _AT.claim("4-5", "(4): duty for 5 A, I R/V₀, and the drive's", 5 * cold[0] / 12.0, _duty(device, 5), "1", 1e-9,
                 "steady current, cold coil", where="eqs. (3), (4)"),
        _AT.set_and_find("4-range", "greatest duty, u ∈ [−1, 1], for 40 A", 1.0, _duty(device, 40), "1", 1e-12,
                         "the drive's limit is set to it", implied=False, where="eq. (4)"),
        _AT.claim("5-field", "(5): μ₀ m_e/(2π d³) at 0.055 m for 2.82 A·m², and the dipole's field on its axis",
                 1e3 * MU0 * 2.82 / (2 * np.pi * 0.055**3), 1e3 * field, "mT", 1e-9, where="eq. (5)"),
        _AT.compare("5-diagonal", "(5): m_e per ampere from simulated Hall readings, greatest relative error of the "
                "diagonal", 0.0, np.abs(np.diag(found_m) / np.diag(truth) - 1).max(), "1", 0.01,
                "noise of the device file", where="eq. (5)"),
        _AT.compare("5-skew", "(5): the same of the terms off the diagonal, over the diagonal", 0.0,
                 np.abs(found_m - truth).max() / np.diag(truth).mean(), "1", 0.01, "noise of the device file",
                 where="eq. (5)"),
        _AT.claim("5-c", "'c maps input current to m_e' [A·m²/A]; in (5) c stands for current over field [A/T]",
                 2.82 / 12.9, 12.9 / field, "A/T", 1e-6, "2.82 A·m² at 12.9 A, 55 mm off", erratum="E26",
                 corrected=12.9 * 2 * np.pi * 0.055**3 / (MU0 * 2.82), where="eq. (5)"),
        _AT.item("5-mu0", "μ₀, 'the relative permeability of air' [1]; as used, of the vacuum [T·m/A]", 4e-7 * np.pi,
                 read_entry(dipole, "MU0"), "T·m/A", 1e-20, erratum="E26", where="eq. (5)"),
        _AT.claim("6-resistance", "(6): resistance of a coil 60 K warmer, estimated over the true one, after 0.2 s",
                 1.0,
                 (course.estimate[late] / course.resistance[late]).mean(), "1", 0.01, "noise of the current sensor",
                 where="eq. (6)"),
        _AT.claim("energy", "'able to accumulate some heat … and continuously dissipates it': energy from the supply "
                 "that is neither in the coil nor in the air after 60 s at half duty, relative", 0.0,
                 _find_lost_energy(device), "1", 1e-3, "trapezoids of 20 ms", where="§III"),
        _AT.exempt("5-five", "calibration 'with the help of five hall sensors'", "the paper does not say which five; "
                      "ours uses all nine", "eq. (5)"),
    )  # fmt: skip
    report(1.0)
    return found, None


def _find_lost_energy(device: SphericalElectromagnet, dt: float = 0.02, seconds: float = 60.0) -> float:
    """Of one simulated coil: ∫ V₀ u i dt less C_w x_w + C_b x_b + ∫ G_ba x_b dt, over the first of them."""
    heat, coils = device.coils.heat, cold_coils(device)
    step = device.coils.heat.coil.step(dt)
    coils["duty"][0] = 0.5
    given = lost = before = 0.0
    for _ in range(round(seconds / dt)):
        coil_step(coils, step, dt)
        rise = float(coils["body"][0]) - heat.ambient
        given += device.supply.voltage * 0.5 * float(coils["mean"][0]) * dt
        lost += heat.body_to_air * 0.5 * (before + rise) * dt
        before = rise
    stored = heat.winding_capacity * (float(coils["winding"][0]) - heat.ambient) + heat.body_capacity * before
    return (given - stored - lost) / given


def _duty(device: SphericalElectromagnet, ampere: float) -> float:
    """Duty of the x coil after the inductance has had its part: the second of two ticks with the same current."""
    drive = Drive(device)
    current, none = np.array([float(ampere), 0.0, 0.0]), np.zeros(3)
    drive.duties(current, none, none)
    return float(drive.duties(current, none, none)[0])


def _calibrate(device: SphericalElectromagnet) -> Array:
    rng = np.random.default_rng(5)
    wanted = excitation(device)
    currents = wanted + device.supply.current_noise * rng.normal(size=wanted.shape)
    fields = np.einsum("sim,nm->nsi", compute_coil_fields(device, device.hall.positions), wanted)
    fields = fields + device.hall.noise * rng.normal(size=fields.shape)
    return magnetic_calibration(device, wanted, currents, fields).moment_per_current
