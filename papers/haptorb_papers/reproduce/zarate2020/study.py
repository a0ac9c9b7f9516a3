"""Zárate 2020, section IV, Figs. 8 and 9: design of the study, and results that need participants."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cache
from math import sqrt
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.entry import Entry, read_entry
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Drawing, Report
from haptorb_study.analysis.analysis import Analysis
from haptorb_study.order import plan
from haptorb_study.set_points import PUBLISHED_ERRORS, directions, list_published
from haptorb_study.study_file import study_of

__all__ = ["draw_study", "items", "simulate_study"]


# --------------------------------------------------------------------------------------------------
# Zárate 2020, Figs. 8 and 9 as the kit draws them, for simulated participants: the procedure, no evidence.
#
# The participants' recall was fitted to the errors of Fig. 9 (`haptorb_study.simulated.participant`), so their
# errors follow the print by construction. What the pictures show is that the same 25 places, 300 trials and analysis
# give figures that can be laid beside the published ones.


_SIMULATED_STUDY_PEOPLE = 6


@cache
def simulate_study(seed: int = 0) -> Analysis:
    """The published study, 25 set-points asked twice, answered by six simulated participants."""
    from haptorb_study.analysis.analysis import analysis_of
    from haptorb_study.analysis.error_by_latitude import measure_tool_rings
    from haptorb_study.columns import tidy
    from haptorb_study.database import database
    from haptorb_study.simulated.rehearsal import rehearse
    from haptorb_study.study_file import study_of

    with TemporaryDirectory() as folder:
        place = Path(folder, "simulated.db")
        engine = database(place)
        study = study_of('name = "published"')
        rehearse(engine, study, _SIMULATED_STUDY_PEOPLE, seed=seed)
        rings = measure_tool_rings(tidy(engine, study))
        engine.dispose()
        return replace(analysis_of(place), rings=rings)


def draw_study(path: Path) -> Path:
    """Fig. 8, left and right, and Fig. 9 of the simulated study, with the printed errors in the last."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.projections.polar import PolarAxes

    from haptorb_study.analysis.figures import draw_answers, draw_confusion, draw_error

    analysis = simulate_study()
    figure = Figure(figsize=(13, 10.5), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, height_ratios=(1.35, 1))
    left, right = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1], projection="polar")
    assert isinstance(right, PolarAxes)
    draw_confusion(left, analysis)
    draw_answers(right, analysis)
    below = figure.add_subplot(grid[1, :])
    draw_error(below, analysis)
    left.set_title("Fig. 8, left, simulated: answers to each set-point", loc="left", fontsize=10)
    right.set_title("Fig. 8, right, simulated: correct answers; arrows: a third or more of the wrong ones", fontsize=10)
    below.set_title("Fig. 9: simulated participants beside the printed means", loc="left", fontsize=10)
    figure.suptitle(analysis.origin, color="#c0392b", fontsize=10)
    figure.savefig(path, dpi=110)
    return path


_AT = Citation("zarate2020", "study", "§IV")
_STUDY_PEOPLE = "answers of people; `haptorb study run` runs the same procedure and computes the same figures"


def items(report: Report) -> tuple[tuple[Item, ...], Drawing]:
    """Set-points, order and counts of the study as the kit runs it."""
    points = list_published()
    u = directions(points)
    apart = np.degrees(np.arccos(np.clip(u @ u.T, -1, 1))) + 360 * np.eye(len(points))
    rings = sorted({point.theta_deg for point in points})
    study = study_of('name = "published"')
    plans = [plan(study, person) for person in range(6)]
    prompts = [[prompt for part in one["parts"] for prompt in part["prompts"] if prompt.get("phase") != "practice"]
               for one in plans]  # fmt: skip
    numbers = [[prompt["set_point"] for prompt in one] for one in prompts]
    report(0.7)
    world = study.make_world(study.conditions[0].name, points[0].number)
    spacing = float(np.diff(rings).mean())
    twice = 2.0 * float(np.mean([set(Counter(one).values()) == {2} for one in numbers]))
    own = "haptorb's layout and order of the study"
    found = (
        _AT.item("points", "set-points", 25, Entry(len(points), own)),
        _AT.item("rings", "angles θ with an error of their own in Fig. 9", 4, Entry(len(rings), own), erratum="E31",
                 where="Fig. 9"),
        _AT.item("meridian", "set-points apart along a meridian", 18.0, Entry(spacing, own), "°", 1e-9,
                 where="§I"),
        _AT.assume("nearest", "nearest set-points apart: 'evenly separated by 18°'", 18.0, apart.min(), "°", 1e-9,
                   "the paper does not list its points; 1 + 4 + 8 + 12 on four rings are assumed so that this is true"),
        _AT.item("twice", "how often a person is asked for each point: 'exactly twice'", 2,
                 Entry(twice, own), "1", 1e-9),
        _AT.item("per-person", "data points per user", 50, Entry(len(numbers[0]), own)),
        _AT.compare("random", "share of the users whose order differs from all others'", 1.0,
                len({tuple(one) for one in numbers}) / len(numbers), "1", 0.0, "'randomly selected'"),
        _AT.item("theta-1", "θ₁ of the rendered map: 'same mapping parameters as in Fig. 2'", 18.0,
                 read_entry(world, "half_width_deg"), "°"),
        _AT.item("theta-2", "θ₂ of it", 54.0, read_entry(world, "cut_off_deg"), "°"),
        _AT.claim("repulsive", "sign of its moment: 'only repulsive forces'", 1.0,
                  Entry(np.sign(read_entry(world, "moment").value), own), "1", 0.0),
        *_test_trend(),
        _AT.exempt("confusion", "confusion matrix of 25 set-points, answers biased towards the next higher set-point",
                      _STUDY_PEOPLE, "Fig. 8"),
        _AT.exempt("gravity", "gravity as the reason for it", _STUDY_PEOPLE, "Fig. 9"),
        _AT.exempt("arrows", "arrows where a third of the wrong answers went to one point", _STUDY_PEOPLE, "Fig. 8"),
        _AT.exempt("discern", "'users can discern at least 25 locations'", _STUDY_PEOPLE, "Abstract"),
    )  # fmt: skip
    report(1.0)
    return found, draw_study


def _test_trend() -> list[Item]:
    """Fig. 9: the four printed errors, and those of six simulated people, who were calibrated to them."""
    fitted = (
        "parameters of the simulated people were calibrated to the four printed means: 3 standard errors of six people"
    )
    rings = {ring.theta_deg: ring for ring in simulate_study().rings}
    found = []
    for theta, (mean, spread) in PUBLISHED_ERRORS.items():
        found.append(
            _AT.assume(f"error-{theta:.0f}", f"error at θ = {theta:.0f}°, {mean:g} ± {spread:g}", mean,
                       rings[theta].mean, "mm", 3 * spread / sqrt(rings[theta].trials), fitted, where="Fig. 9")
        )  # fmt: skip
    printed = [(theta, *PUBLISHED_ERRORS[theta], ring.trials) for theta, ring in sorted(rings.items())]
    here = [(theta, ring.mean, ring.sd, ring.trials) for theta, ring in sorted(rings.items())]
    return [
        *found,
        _AT.note("trend-printed", "'the error increases as a function of the angle': slope of the printed means over "
                 "its standard error", _find_slope(printed), "1", "weighted by the printed spreads and 12, 48, 96 and "
                 "144 answers; above 1.96 the increase is significant", where="Fig. 9"),
        _AT.assume("grows", "the same of the simulated people: 1 if above 1.96", 1.0, float(_find_slope(here) > 1.96),
                   "1", 0.0, fitted, where="Fig. 9"),
    ]  # fmt: skip


def _find_slope(rows: list[tuple[float, float, float, int]]) -> float:
    """Slope of a straight line through means (θ, mean, standard deviation, number), over its standard error."""
    theta, mean, spread, count = np.array(rows).T
    weight = count / spread**2
    away = theta - (weight @ theta) / weight.sum()
    return float((weight * away) @ mean / sqrt((weight * away) @ away))
