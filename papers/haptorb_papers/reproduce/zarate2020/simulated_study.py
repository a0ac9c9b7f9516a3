"""Zárate 2020, Figs. 8 and 9 as the kit draws them, for simulated participants: the procedure, no evidence.

The participants' recall was fitted to the errors of Fig. 9 (`haptorb_study.simulated`), so their
errors follow the print by construction. What the pictures show is that the same 25 places, 300 trials and analysis
give figures that can be laid beside the published ones.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from haptorb_study.analysis import Analysis

__all__ = ["draw_study", "simulate_study"]

_PEOPLE = 6


@cache
def simulate_study(seed: int = 0) -> Analysis:
    """The published study, 25 set-points asked twice, answered by six simulated participants."""
    from haptorb_study.analysis import analysis_of, measure_tool_rings
    from haptorb_study.columns import tidy
    from haptorb_study.database import database
    from haptorb_study.simulated import rehearse
    from haptorb_study.study_file import study_of

    with TemporaryDirectory() as folder:
        place = Path(folder, "simulated.db")
        engine = database(place)
        study = study_of('name = "published"')
        rehearse(engine, study, _PEOPLE, seed=seed)
        rings = measure_tool_rings(tidy(engine, study))
        engine.dispose()
        return replace(analysis_of(place), rings=rings)


def draw_study(path: Path) -> Path:
    """Fig. 8, left and right, and Fig. 9 of the simulated study, with the printed errors in the last."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.projections.polar import PolarAxes

    from haptorb_study.figures import draw_answers, draw_confusion, draw_error

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
