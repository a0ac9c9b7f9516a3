"""Comparison of the candidates: computed and measured force over displacement, quantities, ratings, choice."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import RecordingError
from haptorb.figure_file import show_text_as_is
from haptorb.files import replace_file
from haptorb.worlds import SnapFit
from haptorb_study.feel.designs import Candidate, Candidates
from haptorb_study.feel.insertion_forces import course, explain_peaks
from haptorb_study.feel.peak_comparison import compare_peaks
from haptorb_study.feel.session import SCORES, FeelSession
from haptorb_study.feel.trace import COLUMNS

if TYPE_CHECKING:
    pass

__all__ = ["collect_traces", "comparison", "plot_comparison"]


def comparison(candidates: Candidates, session: FeelSession | None = None) -> dict[str, dict[str, Any]]:
    """Design → its quantities (SI), remarks, ratings and choice: the data of the plot."""
    scores = session.scores() if session else {}
    choice = session.choice() if session else None
    felt = collect_traces(session) if session else {}
    table = {}
    for design in candidates.designs:
        count, score = scores.get(design.name, (0, math.nan))
        chosen = choice is not None and (choice.design, choice.digest) == (design.name, design.digest)
        run = course(design)
        peaks = compare_peaks(design, run, felt.get(design.name, []))
        table[design.name] = {
            "title": design.title,
            "material": design.material,
            **run.numbers,
            **{f"felt_{one.way}_force_n": one.felt for one in peaks},
            "felt": len(felt.get(design.name, [])),
            "peaks": [reason for one in peaks for reason in one.sentences],
            **_list_shares(design),
            "ratings": count,
            "score": score,
            "chosen": chosen,
            "remarks": list(design.remarks),
        }
    return table


def _list_shares(design: Candidate) -> dict[str, dict[str, float]]:
    if not isinstance(design.world, SnapFit):
        return {}
    return {f"{one.way}_shares": one.numbers() for one in explain_peaks(design.world)}


def collect_traces(session: FeelSession) -> dict[str, list[Array]]:
    """Design → traces (n, 18) of its current version, by COLUMNS and HAND; empty ones left out."""
    found: dict[str, list[Array]] = {}
    now = {design.name: design.digest for design in session.candidates.designs}
    for feeling in session.feelings():
        if now.get(feeling.design) == feeling.digest and session.has_trace(feeling.trace):
            rows = session.trace_with_hand(feeling.trace)
            if len(rows):
                found.setdefault(feeling.design, []).append(rows)
    return found


def plot_comparison(candidates: Candidates, path: str | Path, session: FeelSession | None = None) -> Path:
    """Plot the comparison into the PNG or SVG file at `path`: lines computed, dots measured."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    table = comparison(candidates, session)
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    force, bars = figure.subplots(1, 2, width_ratios=(2, 1))
    felt = collect_traces(session) if session else {}
    for number, design in enumerate(candidates.designs):
        colour = f"C{number}"
        run = course(design)
        label = design.title + (" (chosen)" if table[design.name]["chosen"] else "")
        force.plot(run.place * 1e3, run.coming_out, color=colour, label=label)
        force.plot(run.place * 1e3, -run.going_in, color=colour, linestyle="--")
        for rows in felt.get(design.name, []):
            x, pull = rows[:, COLUMNS.index("x_m")], -rows[:, COLUMNS.index("fx_n")]
            force.plot(x * 1e3, pull, ".", color=colour, markersize=1.5, alpha=0.4)
    force.axhline(0.0, color="0.6", linewidth=0.8)
    force.set(
        xlabel="X' (mm), out of the socket",
        ylabel="pull of the hand (N)",
        title="solid: pull out, dashed: insert, dots: recorded",
    )
    force.legend()
    names = [design.name for design in candidates.designs]
    values = [table[name]["score"] for name in names]
    bars.barh(names, np.nan_to_num(values), color=[f"C{number}" for number in range(len(names))])
    for row, name in enumerate(names):
        count = table[name]["ratings"]
        bars.text(0.1, row, f"{values[row]:.1f} ({count})" if count else "not rated", va="center")
    bars.set(xlim=(0, SCORES[1]), xlabel=f"mean score ({SCORES[0]}–{SCORES[1]})", title=candidates.title)
    bars.invert_yaxis()
    target = Path(path)
    try:
        with replace_file(target) as part:
            show_text_as_is(figure).savefig(part, format=target.suffix.lstrip(".") or "png", dpi=150)
    except (OSError, ValueError) as cause:
        raise RecordingError(f"{target}: cannot be drawn ({cause})") from cause
    return target
