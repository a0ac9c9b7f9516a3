"""Figure of a comparison of estimators."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from haptorb_papers.estimators.comparison import EstimatorComparison

__all__ = ["plot_comparison", "plot_disturbances", "plot_noise"]

#: estimator → colour that people who confuse red and green can tell apart, and marker
STYLE = {"network": ("#d55e00", "o"), "linear": ("#8a8a8a", "s"), "least-squares": ("#0072b2", "D")}
INK = "#1a1a1a"


def plot_comparison(comparison: EstimatorComparison, path: Path) -> None:
    """Draw the figure into `path`: Fig. 4's courses and their errors, error against noise, and every disturbance."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    spaced = ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08, wspace=0.04, hspace=0.06)
    figure = Figure(figsize=(13.5, 8.4), layout=spaced)
    halves: Any = figure.subfigures(2, 1)
    above, below = halves
    _courses(above.subplots(1, 3), comparison)
    left, right = below.subplots(1, 2, width_ratios=(1, 2))
    plot_noise(left, comparison)
    plot_disturbances(right, comparison)
    figure.suptitle(
        f"From field to torque: three estimators of '{comparison.device}', electromagnet {comparison.coil}",
        x=0.01, ha="left", fontweight="bold", color=INK,
    )  # fmt: skip
    figure.savefig(path, dpi=150)


def _courses(places: Any, comparison: EstimatorComparison) -> None:
    course = comparison.course
    for column, (axis, name) in enumerate(((1, "Y"), (2, "Z"))):
        place = places[column]
        place.plot(course.t, 1e3 * course.true[:, axis], color=INK, lw=3.5, alpha=0.25, label="true")
        for estimator, K in course.estimated.items():
            style = {"least-squares": "--"}.get(estimator, "-")
            place.plot(course.t, 1e3 * K[:, axis], style, color=STYLE[estimator][0], lw=1.2, label=estimator)
        _set_title(place, f"torque per ampere about {name} along Fig. 4 [mN·m/A]", "t [s]")
        if column == 0:
            place.legend(frameon=False, fontsize=8, loc="best")
    place = places[2]
    for estimator, K in course.estimated.items():
        error = 1e3 * np.linalg.norm(K - course.true, axis=1)
        place.semilogy(course.t, np.maximum(error, 1e-6), color=STYLE[estimator][0], lw=1.2, label=estimator)
    _set_title(place, "error along it [mN·m/A]", "t [s]")


def plot_noise(place: Any, comparison: EstimatorComparison) -> None:
    """Error of K over the workspace against the noise of a reading, into the axes `place`."""
    names = comparison.disturbances[: len(comparison.noises)]
    noise = 1e3 * np.array(comparison.noises)
    left = noise[1] / 10  # where "no noise" stands on a logarithmic axis
    for estimator in comparison.estimators:
        errors = [100 * comparison.row(estimator, name).workspace for name in names]
        colour, marker = STYLE[estimator]
        place.loglog(np.maximum(noise, left), np.maximum(errors, 1e-6), color=colour, marker=marker, ms=5, lw=1.2)
        place.annotate(
            estimator, (noise[-1], errors[-1]), xytext=(6, 0), textcoords="offset points", color=colour, fontsize=8,
            va="center",
        )  # fmt: skip
    place.set_xticks([left, *noise[1:]], ["none", *(f"{value:g}" for value in noise[1:])])
    place.minorticks_off()
    place.set_xlim(left / 2, noise[-1] * 12)
    _set_title(place, "NRMSE over the workspace against noise [%]", "noise of one reading, rms [mT]")


def plot_disturbances(place: Any, comparison: EstimatorComparison) -> None:
    """Error of a delivered torque by estimator, for everything else that disturbs it, into the axes `place`."""
    names = comparison.disturbances[len(comparison.noises) :]
    height = 0.26
    for offset, estimator in enumerate(comparison.estimators):
        rows = [comparison.row(estimator, name) for name in names]
        values = np.array([row.jnd for row in rows])
        y = np.arange(len(names)) + (offset - 1) * height
        median = comparison.latency[estimator]["median"]
        place.barh(y, values, 0.9 * height, color=STYLE[estimator][0], label=f"{estimator}: {median:.0f} µs an update")
        for at, row in zip(y, rows, strict=True):
            place.annotate(
                f"{row.jnd:.2g}", (row.jnd, at), xytext=(4, 0), textcoords="offset points", fontsize=7.5, va="center",
                color=INK, bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.4},
            )  # fmt: skip
    place.axvline(1.0, color=INK, lw=0.9, ls=":")
    place.annotate(
        "just noticeable", (1.0, 1.0), xycoords=("data", "axes fraction"), xytext=(4, -11),
        textcoords="offset points", fontsize=8, color=INK,
    )  # fmt: skip
    place.set_yticks(range(len(names)), names)
    place.invert_yaxis()
    place.set_xscale("log")
    low, high = place.get_xlim()
    place.set_xlim(low, 20 * high)
    _set_title(
        place, "error of a delivered torque of 60 mN·m, 95 % of the workspace [JND]", "just noticeable differences"
    )
    place.legend(frameon=False, fontsize=8, loc="lower right")


def _set_title(place: Any, title: str, x: str) -> None:
    place.set_title(title, loc="left", fontsize=9.5, color=INK)
    place.set_xlabel(x, fontsize=9)
    place.tick_params(labelsize=8)
    place.spines[["top", "right"]].set_visible(False)
    place.grid(alpha=0.25, lw=0.5)
