"""Zárate 2020, section II.B and Figs. 1, 4: parts of the prototype, and the core's response (errata E15, E18)."""

from __future__ import annotations

import numpy as np

from haptorb.arrays import gauss_legendre
from haptorb.devices.api import electromagnet
from haptorb.devices.base import State
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.magnetics.dipole import MU0
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.entry import Entry, read_count, read_entry
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Report
from haptorb_papers.reproduce.zarate2020.forces import drive_fully
from haptorb_papers.reproduce.zarate2020.true_wrench import true_wrench

__all__ = ["items"]

_AT = Citation("zarate2020", "hw", "§II.B")
_STEEL = 2.1  #: [T] saturation of low-carbon steel, handbooks


def items(report: Report) -> tuple[tuple[Item, ...], None]:
    """Entries as the device has them, what follows from them, and what only the prototype could tell."""
    device = electromagnet(load("omni"))
    supply, coils = device.supply, device.coils
    full = float(coils.current_limit[0])
    pulls = {d: -1e3 * float(true_wrench(device, State.at((0, 0, 1e-3 * d)), (0, 0, 0))[2]) for d in (50, 60, 70)}
    table = -1e3 * float(device.wrench_map(State.at((0, 0, 0.05)), "exact").passive[2])
    report(0.6)
    most = np.linalg.norm(device.moment_per_current @ coils.current_limit)
    saturated = _STEEL / MU0 * 4 / 3 * np.pi * device.core_radius**3
    axes = int((np.count_nonzero(np.abs(device.hall.positions) > 1e-6, axis=1) == 1).sum())
    found = (
        _AT.item("core", "diameter of the steel core", 30.0, read_entry(device, "core_radius", 2e3), "mm"),
        _AT.item("coils", "orthogonal coils", 3, read_count(device, "coils.names")),
        _AT.item("resistance", "resistance of a coil at room temperature, 'roughly'", 0.6,
                 read_entry(device, "coils.resistance[0]"), "Ω", 0.01,
                 "'roughly'; 100 W / 12.9² A² = 0.601 Ω"),
        _AT.item("voltage", "supply", 12.0, read_entry(device, "supply.voltage"), "V"),
        _AT.item("current", "peak current of a coil: printed, and of the simulated coil at full duty, room "
                 "temperature", 24.0, drive_fully(device)[0], "A", 0.01, "it builds up to 12 V over 0.6 Ω",
                 erratum="E15", corrected=20.0),
        _AT.item("limit", "current limit of the device file", 24.0,
                 read_entry(device, "coils.current_limit[0]"), "A", 1e-9, erratum="E15", corrected=20.0),
        _AT.item("duty", "bits of the duty", 12, read_entry(device, "supply.duty_bits")),
        _AT.note("duty-current", "one step of the duty, as current", 1e3 * full / 2**supply.duty_bits, "mA"),
        _AT.note("duty-force", "the same as force at contact", 48.0 * full / 2**supply.duty_bits, "mN"),
        _AT.claim("shunt", "0.01 Ω shunt: one 10 µV step of an INA219, as current", 1.0,
                 read_entry(device, "supply.current_step", 1e3), "mA"),
        _AT.item("hall", "Hall sensors", 9, read_count(device, "hall.positions")),
        _AT.item("hall-axes", "of them along the coils' axes: 'five' serve the calibration", 5,
                 Entry(axes, "omni: hall.positions", device.assumed["hall.positions"]), where="§II.C"),
        _AT.item("hall-distance", "their distance from the core's centre", 0.055,
                 Entry(np.linalg.norm(device.hall.positions, axis=1).mean(), "omni: hall.positions"), "m", 1e-6,
                 "coordinates in the file are rounded", where="§II.C"),
        _AT.claim("core-pull-50", "pull of the core on the tool at 50 mm, currents off: 'small'", 0.0, pulls[50], "mN",
                 0.2, "series against images; permeability infinite", erratum="E18", corrected=_pull_by_images(device)),
        *(
            _AT.note(f"core-pull-{d}", f"the same at {d} mm", pulls[d], "mN")
            for d in (60, 70)
        ),
        _AT.compare("core-pull-table", "the same at 50 mm by the servo's table, against the series", pulls[50],
                table, "mN", 0.2, "table of the loop, 0.3 %", erratum="E18"),
        _AT.note("core-share", "that as a share of the sustained 258 mN", pulls[50] / 258.0, "1"),
        _AT.note("saturation", "greatest |m_e| over the core's moment at 2.1 T ('m_e ≪ m_saturation')",
                 most / saturated, "1", "all three coils at 20 A; the model is linear, so this is not computed with"),
        _AT.exempt("hysteresis", "no hysteresis seen at updates of 50 Hz", "a property of the prototype's steel, "
                      "whose kind is not given"),
        _AT.exempt("size", "150 mm × 150 mm × 95 mm outside, six fans, acrylic and printed parts",
                      "nothing computed here depends on them", "§II.B, Fig. 4"),
        _AT.exempt("fem", "sizes of magnet and coils were tuned with FEM", "neither the model nor its results are "
                      "printed"),
        _AT.exempt("coil-shape", "shape and turns of the three coils", "not printed, only m_e per ampere (Fig. 7); "
                      "`haptorb inspect omni` predicts it from assumed windings", "Fig. 4"),
        _AT.exempt("figure-1", "the device in use", "a photograph", "Fig. 1"),
        _AT.exempt("figure-5", "the software's pipeline", "a diagram; its parts are equations (3) to (6) and Fig. 3",
                      "Fig. 5"),
    )  # fmt: skip
    report(1.0)
    return found, None


def _pull_by_images(device: SphericalElectromagnet, d: float = 0.05) -> float:
    """[mN] of the core on the tool at `d` [m]: each charge of the ring's faces has −q a/s at a²/s and q a/s within."""
    tool, a = device.tool, device.core_radius
    nodes, weights = gauss_legendre(8)
    squares = 0.5 * (tool.outer_radius**2 + tool.inner_radius**2) + 0.5 * nodes * (
        tool.outer_radius**2 - tool.inner_radius**2
    )
    turns = 2 * np.pi * np.arange(24) / 24
    at, q = [], []
    for side in (1.0, -1.0):
        for square, weight in zip(squares, weights, strict=True):
            for turn in turns:
                at.append((np.sqrt(square) * np.cos(turn), np.sqrt(square) * np.sin(turn), d + side * tool.length / 2))
                q.append(side * weight / 2 / len(turns))
    s, charge = np.array(at), np.array(q)
    charge *= tool.remanence / MU0 * np.pi * (tool.outer_radius**2 - tool.inner_radius**2)
    far = np.linalg.norm(s, axis=1)
    total = 0.0
    for image, share in ((s * (a / far[:, None]) ** 2, -charge * a / far), (0 * s, charge * a / far)):
        apart = s[:, None] - image
        total += float(charge @ (apart[..., 2] / np.linalg.norm(apart, axis=-1) ** 3) @ share)
    return -1e3 * MU0 / (4 * np.pi) * total
