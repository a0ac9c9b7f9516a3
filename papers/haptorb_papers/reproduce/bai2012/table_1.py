"""Bai 2012, Table 1: the two bodies, the strengths that model them, and the missing units (erratum E1)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.api import motor
from haptorb.magnetics import multipole
from haptorb.magnetics.multipole import MAGNET_STRENGTHS, load_published
from haptorb.magnetics.multipole_fit import residual, shell_region
from haptorb.magnetics.source import Source
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.entry import read_count, read_entry
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Drawing, Report

__all__ = ["BY_COIL", "BY_MAGNET", "items"]

_AT = Citation("bai2012", "t1", "Table 1")
_INCH = 25.4
R_PM, R_EM = 67.9e-3, 56.8e-3  #: [m]
#: where the coils are, as one magnet sees them, and where the magnets are, as one coil sees them
BY_MAGNET = shell_region(R_PM, 53.0e-3, 60.61e-3, 1.2)
BY_COIL = shell_region(R_EM, 65.36e-3, 70.44e-3, 1.2)


def items(report: Report) -> tuple[tuple[Item, ...], Drawing]:
    """Every entry as the device has it, moments against strengths, and the models' field in the gap."""
    device = motor("pmsm")
    pm, em = load_published("bai2012-pm"), load_published("bai2012-em")
    printed, aspect = load_published("bai2012-pm-printed"), load_published("bai2012-em-aspect")
    once, often = MAGNET_STRENGTHS[0] + 10 * sum(MAGNET_STRENGTHS[1:]), 10 * sum(MAGNET_STRENGTHS)
    per_metre = pm.body.moment[2] / pm.body.length
    found = (
        _AT.item("pm-a", "PM: a", 15.875, read_entry(device, "magnet.radius", 1e3), "mm"),
        _AT.item("pm-l", "PM: l, printed without a unit", 0.2, read_entry(device, "magnet.length", 1e3 / _INCH), "inch",
                 erratum="E1"),
        _AT.item("pm-polarization", "PM: μ₀M₀", 1.31, read_entry(device, "magnet.polarization"), "T"),
        _AT.item("pm-n", "PM: n, dipoles on a loop", 10, read_entry(multipole, "PUBLISHED[bai2012-pm].model.per_loop")),
        _AT.claim("pm-strengths", "PM: number of strengths, k + 1", 5, read_count(multipole, "MAGNET_STRENGTHS")),
        _AT.item("pm-ratio", "PM: l̄/l that gives the magnet its moment", 0.3, per_metre / once, "1", 1e-3,
                 "strengths are printed with three digits", erratum="E1", corrected=0.2),
        _AT.claim("pm-moment", "PM: moment, by strengths (printed) and by polarization (here)", 33.5 * 5.08e-3 * 0.2
                 + 10 * 410.2 * 5.08e-3 * 0.2, pm.model.moment[2], "A·m²", 1e-9, "(m₀ + n Σ m_j) l̄ by hand",
                 erratum="E1"),
        *(
            _AT.claim(f"pm-{name}", f"PM: field {1e3 * z:.3g} mm above its middle, by strengths (printed) and by its "
                     "exact body", 1e6 * pm.model.field((0, 0, z))[2], 1e6 * pm.body.field((0, 0, z))[2], "µT",
                     1e6 * share * pm.model.field((0, 0, z))[2], why, erratum="E1", where="eq. (8)")
            for name, z, share, why in (("near", 0.03, 0.03, "3 %: a model of 41 pairs of poles"),
                                        ("far", 0.5, 0.005, "0.5 %: strengths are printed with three digits"))
        ),
        _AT.note("pm-per-metre", "PM: moment per metre of length, μ₀M₀/μ₀ · πa²", per_metre, "A·m"),
        _AT.note("pm-printed", "PM: moment of the strengths over the magnet's with l̄/l = 0.3",
                 printed.model.moment[2] / printed.body.moment[2], "1", "50 % too large: this reading is rejected"),
        _AT.note("pm-often", "PM: the same with l̄/l = 0.2 and the axis counted n times", 0.2 * often / per_metre, "1",
                 "7.5 % too large: equation (8) counts j = 0 n times"),
        _AT.item("em-a", "EM: a", 15.88, read_entry(device, "electromagnet.outer_radius", 1e3), "mm"),
        _AT.item("em-ar", "EM: a_r, inner over outer radius", 0.3,
                 read_entry(device, "electromagnet.inner_radius", 1e3 / 15.88), "1", 1e-9),
        _AT.item("em-l", "EM: l, printed without a unit", 0.3, read_entry(device, "electromagnet.length", 1e3 / _INCH),
                 "inch", erratum="E1"),
        _AT.item("em-turns", "EM: turns", 1000, read_entry(device, "electromagnet.turns")),
        _AT.item("em-n", "EM: n, dipoles on a loop", 16, read_entry(multipole, "PUBLISHED[bai2012-em].model.per_loop")),
        _AT.claim("em-strengths", "EM: number of strengths, k + 1", 7, read_count(multipole, "COIL_STRENGTHS")),
        _AT.item("em-ratio", "EM: l̄/l", 0.442,
                 read_entry(multipole, "PUBLISHED[bai2012-em].model.pole_distance", 1e3 / (0.3 * _INCH)), "1", 1e-9),
        _AT.note("em-moment", "EM: moment per ampere, by the winding", em.body.moment[2], "A·m²/A"),
        _AT.note("em-moments", "EM: moment of the strengths over that of the winding", em.model.moment[2]
                 / em.body.moment[2], "1", "they were fitted to the near field, not to the moment"),
        _AT.note("em-aspect", "EM: the same with l read as l/2a = 0.3",
                 aspect.model.moment[2] / aspect.body.moment[2], "1", "37 % too large: this reading is rejected"),
        _AT.note("pm-gap", "PM: rms error of the published model's field where the coils are",
                 residual(pm.body, pm.model, BY_MAGNET).rms, "1"),
        _AT.note("em-gap", "EM: rms error of the published model's field where the magnets are",
                 residual(em.body, em.model, BY_COIL).rms, "1"),
    )  # fmt: skip
    report(1.0)
    return found, lambda path: _draw_figure(
        ((pm.body, pm.model, R_PM - 60.61e-3), (em.body, em.model, 65.36e-3 - R_EM)), path
    )


def _draw_figure(bodies: tuple[tuple[Source, Source, float], ...], path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    across = np.linspace(0, 30e-3, 200)
    titles = ("one magnet, where the coils begin", "one coil at 1 A, where the magnets begin")
    for panel, (body, model, height), title in zip(figure.subplots(1, 2), bodies, titles, strict=True):
        at = np.column_stack([across, np.zeros_like(across), np.full_like(across, height)])
        for source, style, label in ((body, "C0-", "exact"), (model, "C1--", "published multipoles")):
            panel.plot(1e3 * across, 1e3 * _axial(source, at), style, label=label)
        panel.set(xlabel="from the axis [mm]", ylabel="axial field [mT]")
        panel.set_title(f"{title} ({1e3 * height:.1f} mm off)", loc="left", fontsize=10)
        panel.grid(alpha=0.3)
        panel.legend(frameon=False)
    figure.savefig(path, dpi=120)
    return path


def _axial(source: Source, at: Array) -> Array:
    axial: Array = source.field(at)[:, 2]
    return axial
