"""Zárate 2020, sections III and V: power, current and force, which must agree with one another (erratum E15)."""

from __future__ import annotations

from math import log10, pi, sqrt

import numpy as np

from haptorb.apps.reproduce.citation import Citation
from haptorb.apps.reproduce.item import Item
from haptorb.apps.reproduce.registry import Report
from haptorb.devices.electromagnet.api import electromagnet
from haptorb.devices.loader import load
from haptorb.devices.state import State
from haptorb.physics.sources.dipole import MU0
from haptorb.physics.thermal import single_time_constant

__all__ = ["items"]

_AT = Citation("zarate2020", "power", "§III")


def items(report: Report) -> tuple[tuple[Item, ...], None]:
    """48 mN/A and what it says of the magnet; 17 W, 100 W, 230 W and their forces; what the coils' heat allows."""
    device = electromagnet(load("omni"))
    tool, ohm = device.tool, 0.6
    contact = State.at((0, 0, device.contact_distance))
    mean = np.linalg.norm(device.moment_per_current, axis=0).mean()
    per_moment = 6 * MU0 / (4 * pi * device.contact_distance**4)
    per_ampere = per_moment * tool.moment * mean
    exact = -float(device.wrench_map(contact, "exact").matrix[2, 2])
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
        _AT.item("outside", "outside diameter of the tool's ring", 12.0, 2e3 * tool.outer_radius, "mm"),
        _AT.item("inside", "inside diameter", 5.0, 2e3 * tool.inner_radius, "mm"),
        _AT.item("height", "its height", 24.0, 1e3 * tool.length, "mm"),
        _AT.item("per-ampere", "force per current at 5 cm, mean of the three coils", 48.0, 1e3 * per_ampere, "mN/A",
                 0.5, "two digits; the remanence is assumed so that this holds, and the next item checks that"),
        _AT.note("per-ampere-z", "the same for the z coil, magnet at its size", 1e3 * exact, "mN/A",
                 "E16: 15.6 % above the dipole's"),
        _AT.claim("magnet", "1 if the remanence that 48 mN/A asks of this ring is neodymium's, 1 to 1.5 T", 1.0,
                 float(1.0 < remanence < 1.5), "1", 0.0, "handbooks"),
        _AT.note("remanence", "that remanence", remanence, "T", "an N45 to N48 magnet; the device file takes 1.348 T"),
        _AT.item("p0", "power of 12.9 A through 0.6 Ω", 100.0, 12.9**2 * ohm, "W", 0.5, "12.9 has three digits"),
        _AT.item("sustained", "averaged constant force at 17 W: 48 mN/A times √(17 W/0.6 Ω)", 258.0,
                 48.0 * sqrt(17.0 / ohm), "mN", 3.0, "1 %: 17 W and 48 mN/A have two digits"),
        _AT.item("peak", "peak force at full strength: 48 mN/A times 12 V/0.6 Ω", 959.0, 48.0 * 12.0 / ohm, "mN", 2.0,
                 "two digits of 48; 24 A would give 1152 mN", erratum="E15"),
        _AT.item("peak-current", "current of the printed peak, 959 mN over 48 mN/A: printed 24 A", 24.0, 959.0 / 48.0,
                 "A", 0.05, "the paper's own figures", erratum="E15", corrected=20.0, where="§II.B"),
        _AT.item("peak-power", "power at full strength: (12 V)²/0.6 Ω", 230.0, 144.0 / ohm, "W", 12.0,
                 "5 %: 'roughly 0.6 Ω'"),
        _AT.item("newton", "'relatively large forces (1 N at contact)'", 1.0, 0.048 * 20, "N", 0.05,
                 "0.959 N, rounded", where="Abstract"),
        _AT.item("fifteen", "15 × P_ave, 'peaks for a few seconds', and full power", 15 * 17.0, 144.0 / ohm, "W", 16.0,
                 "'up to'"),
        _AT.item("few-seconds", "seconds that 15 × 17 W may last: 'a few', the 5 s of §V", 5.0,
                 coils.time_to(rise, 255.0 * alone), "s", 1.0, "'a few'"),
        _AT.item("full", "seconds at full power, 240 W, from cold", 5.0, coils.time_to(rise, 240.0 * alone), "s", 0.1,
                 "network fitted to the three endurances of one coil", where="§V"),
        _AT.item("half", "seconds at half duty, a quarter of the power", 60.0, coils.time_to(rise, 60.0 * alone), "s",
                 0.5, "network fitted to the three endurances of one coil", where="§V"),
        _AT.item("for-ever", "continuous power of the coil", 17.0,
                 rise / float(coils.rise_per_watt[0, 0]), "W", 0.1,
                 "network fitted to the three endurances of one coil"),
        _AT.claim("minutes", "order of magnitude of the thermal time, log₁₀ of minutes: 'in the order of minutes'", 0.0,
                 log10(float(coils.time_constants[0]) / 60.0), "1", 0.8, "an order of magnitude"),
        _AT.note("one-node-5", "time constant that one body would need for 5 s at 230 W", one_constant[0], "s",
                 "one body contradicts itself: see the next; hence two"),
        _AT.note("one-node-60", "and for 60 s at half duty", one_constant[1], "s"),
        _AT.item("force-rank", "independent force components at contact: 'three'", 3, fmap, where="§V"),
        _AT.claim("torque-rank", "independent torque components: 'a specific torque map'", 2, rank, "1", 0.0,
                 "a moment has no torque about its axis, so a torque map has two components, not three", where="§V"),
        _AT.exempt("stronger", "more force with a larger magnet, less angular resolution, more weight",
                      "a direction without numbers"),
    )  # fmt: skip
    report(1.0)
    return found, None
