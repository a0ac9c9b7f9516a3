"""Bai 2012, Fig. 8: forces, torques and currents while a tilted plug is pulled and then righted.

The paper's curves are not legible as numbers; its text says that F_X' is constant, that F_Y' is not zero and shrinks as
x grows, and that the torque becomes zero with the tilt. Magnitudes follow from Table 3 with E = 113 GPa (E7), corrected
by E9 and E10; h is assumed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb.control.linkage import Gains
from haptorb.devices.motor import motor
from haptorb.estimation.network import networks_path
from haptorb_papers.reproduce.bai2012.two_phases import ARM, FORCE_SCALE, X_0, PhaseRecord, two_phases
from haptorb_papers.reproduce.hook_quadrature import compute_pull_stiffness
from haptorb_papers.reproduce.item import Basis, Item

__all__ = ["items"]

_PAPER, _WHERE = "bai2012", "Fig. 8"


def items(report: Callable[[float], None]) -> tuple[tuple[Item, ...], Callable[[Path], Path]]:
    """The statements about Fig. 8, and what draws it."""
    trained = networks_path(motor("pmsm")).is_file()
    pull, right = two_phases(report=lambda done: report(0.5 * done if trained else done))
    force = pull["object_wrench"]
    place = pull["object"][:, 0]
    line = np.polynomial.Polynomial.fit(place, force[:, 1], 1)
    stiffness = compute_pull_stiffness()
    width = 6.3e-3 / math.cos(math.radians(2.0))
    torque = np.linalg.norm(np.concatenate([pull["asked"], right["asked"]])[:, 3:], axis=1)
    last = right["object_wrench"][-50:, 5].mean()

    def one(
        name: str, what: str, published: float | None, computed: float, unit: str, tolerance: float | None,
        erratum: str = "", basis: Basis = "computed",
    ) -> Item:  # fmt: skip
        why = "" if tolerance is None else "noise of sensors and hand; the loop runs at 1 kHz"
        return Item(
            f"fig8-{name}",
            _PAPER,
            _WHERE,
            what,
            published,
            float(computed),
            unit,
            tolerance,
            erratum,
            why=why,
            implied=published is not None,
            basis=basis,
        )

    found: tuple[Item, ...] = (
        one("fx", "F_X' of phase 1, eq. (17) with E9 and E10", stiffness * 0.134 * (width - 4.8e-3),
            -force[:, 0].mean(), "N", 0.05, "E9"),
        one("fx-constant", "greatest change of F_X' over its mean: 'constant'", 0.0,
            np.ptp(force[:, 0]) / abs(force[:, 0].mean()), "1", 2e-3),
        one("fy-start", "F_Y' where phase 1 begins, eq. (17) with E9 and E10",
            stiffness * 2 * math.tan(math.radians(2.0)) * (ARM - X_0), line(X_0), "N", 1.0, "E9"),
        one("fy-line", "greatest departure of F_Y' from a straight line, over its mean", 0.0,
            np.abs(force[:, 1] - line(place)).max() / force[:, 1].mean(), "1", 5e-3),
        one("fy-falls", "decrease of F_Y' per displacement, eq. (17) with E9 and E10",
            -stiffness * 2 * math.tan(math.radians(2.0)) * 1e-3, line.deriv()(X_0) * 1e-3, "N/mm", 0.2, "E9"),
        one("torque-zero", "torque about Z' when the plug is upright, over that at 2°: 'becomes zero'", 0.0,
            abs(last) / abs(right["object_wrench"][:20, 5].mean()), "1", 5e-3, "E20"),
        one("given", "torque on the rotor against the torque asked, both phases, rms over rms", 0.0,
            _departure(pull, right), "1", 0.02, basis="own"),
        one("sum", "sum of the currents of the parts against the commanded currents, largest difference", 0.0,
            max(_explanation_error(pull), _explanation_error(right)), "A", 5e-3, basis="own"),
        one("torque", "greatest torque asked of the motor", None, torque.max(), "N·m", None),
    )  # fmt: skip
    if trained:  # by `haptorb train`: the paper's own way from the field to the torque per ampere
        other = two_phases(estimator="network", report=lambda done: report(0.5 + 0.5 * done))
        what = "the same with the network in place of least squares"
        found += (one("given-network", what, None, _departure(*other), "1", None),)
    return found, lambda path: _draw_figure(pull, right, path)


def _departure(*courses: PhaseRecord) -> float:
    asked = np.concatenate([course["asked"][:, 3:] for course in courses])
    given = np.concatenate([course["given"][:, 3:] for course in courses])
    return float(np.sqrt(((given - asked) ** 2).sum() / (asked**2).sum()))


def _explanation_error(course: PhaseRecord) -> float:
    parts = course.psi + course.lam + course.phi + course.rest
    return float(np.abs(parts - course["wanted"]).max())


def _draw_figure(pull: PhaseRecord, right: PhaseRecord, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 14), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(5, 2)
    gains = Gains().scale(FORCE_SCALE)
    of_forces, of_torques = np.array(gains.translate_torque), np.array(gains.rotate_torque)
    for column, (course, along, label) in enumerate(
        ((pull, 1e3 * (pull["object"][:, 0] - X_0), "X' − x₀ (mm)"), (right, np.degrees(right.tilt), "ε_z (°)"))
    ):
        top, torques, *lower = axes[:, column]
        wrench = course["object_wrench"]
        if column == 0:
            top.plot(along, wrench[:, 0], "C1", label="F_X' on the plug: −1 times (17)'s, which is the pull")
            top.plot(along, wrench[:, 1], "C0", label="F_Y' on the plug")
            top.set(ylabel="N", title="Phase 1, translating: pulled at a tilt of 2°")
            expected = [
                (of_forces[0] * wrench[:, 1], "η̂₁ F_Y' of (6b)"),
                (of_forces[1] * wrench[:, 0], "η̂₂ F_X' of (6b)"),
            ]
        else:
            top.plot(along, wrench[:, 5], "C2", label="T_Z' about o' on the plug")
            top.set(ylabel="N·m", title="Phase 2, rotating: turned upright")
            expected = [(of_torques[2] * wrench[:, 5], "η₃ T_φ' of (5b)")]
        asked, given = course.euler_torque("asked"), course.euler_torque("given")
        for axis, name in enumerate(("T_ψ", "T_λ", "T_φ")):
            torques.plot(along, given[:, axis], color=f"C{axis}", linewidth=0.8, alpha=0.6)
            torques.plot(along, asked[:, axis], color=f"C{axis}", linestyle="--", label=name)
        for values, name in expected:
            torques.plot(along[::60], values[::60], "k.", ms=4, label=name)
        torques.set(ylabel="N·m", title=f"torque about ψ, λ, φ (× {FORCE_SCALE:g}): asked dashed, given solid")
        # Phase 2 turns the handle about φ, where phase 1 asks for nothing of its own.
        parts = (
            (course.psi, "T_ψ, from F_Y'") if column == 0 else (course.phi, "T_φ, from T_φ'"),
            (course.lam, "T_λ, from F_X'") if column == 0 else (course.lam, "T_λ"),
        )
        for panel, (currents, name) in zip(lower[:2], parts, strict=True):
            _currents(panel, along, currents, f"currents for {name}")
        _currents(lower[2], along, course["wanted"], "all currents summed, with those for weight and regulator")
        top.legend(fontsize=8)
        if column == 0:  # between the lines
            torques.legend(fontsize=8, ncols=5, loc="center", bbox_to_anchor=(0.5, 0.64))
        else:
            torques.legend(fontsize=8, ncols=2)
        for panel in axes[:, column]:
            panel.set_xlabel(label)
            if column == 1:
                panel.invert_xaxis()
    lines = axes[4, 0].get_lines()
    figure.legend(
        lines,
        [str(n + 1) for n in range(len(lines))],
        loc="outside lower center",
        ncols=12,
        title="channel",
        fontsize=8,
    )
    figure.savefig(path, dpi=110)
    return path


def _currents(panel: Any, along: Array, currents: Array, title: str) -> None:
    for channel in range(currents.shape[1]):
        colour = f"C{channel % 10}"
        panel.plot(along, currents[:, channel], color=colour, linewidth=0.9, linestyle="-" if channel < 10 else "--")
    panel.set(ylabel="A", title=title)
    if np.abs(currents).max() < 1e-3:  # noise around nothing is to look like nothing
        panel.set_ylim(-0.05, 0.05)
