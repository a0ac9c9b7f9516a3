"""Pictures of one design for its report: the hook from the side, and force over displacement, computed and felt."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from haptorb.apps.feel.candidates import Candidate
from haptorb.apps.feel.course import InsertionForces
from haptorb.apps.feel.trace import COLUMNS
from haptorb.numerics.arrays import Array
from haptorb.physics.hook import Hook

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_forces", "draw_hook"]

_DOTS = 4000  #: of forces in one picture: more cannot be distinguished
_X, _FX = COLUMNS.index("x_m"), COLUMNS.index("fx_n")


def draw_hook(hook: Hook) -> bytes:
    """The hook from the side, to scale, as SVG."""
    x = np.unique([0.0, hook.base_length, hook.ramp_end, hook.peak, hook.tip])
    figure = _make_figure(6.4, 2.2)
    axes = figure.subplots()
    outline = np.vstack([np.column_stack([x, hook.section(x)]), [[hook.tip, 0.0], [0.0, 0.0]]]) * 1e3
    axes.fill(outline[:, 0], outline[:, 1], facecolor="#e3b778", edgecolor="#7a4d12")
    axes.axvline(0.0, color="#22303c", linewidth=3)  # the wall that it grows from
    axes.set(xlabel="from the root (mm)", ylabel="mm", aspect="equal")
    axes.margins(x=0.04, y=0.25)
    return _save(figure)


def draw_forces(design: Candidate, run: InsertionForces, traces: Sequence[Array]) -> bytes:
    """The pull of the hand over X', as SVG: lines computed, dots felt."""
    figure = _make_figure(6.4, 3.4)
    axes = figure.subplots()
    for rows in traces:
        some = rows[:: max(1, len(rows) * len(traces) // _DOTS)]
        axes.plot(some[:, _X] * 1e3, -some[:, _FX], ".", color="C1", markersize=2, alpha=0.5, rasterized=True)
    axes.plot([], [], ".", color="C1", label="felt" if traces else "not felt yet")
    axes.plot(run.place * 1e3, run.coming_out, "C0", label="pull out, computed")
    axes.plot(run.place * 1e3, -run.going_in, "C0--", label="insert, computed")
    axes.axhline(0.0, color="0.6", linewidth=0.8)
    axes.set(xlabel="X' (mm), out of the socket", ylabel="pull of the hand (N)")
    axes.legend(frameon=False, fontsize=8)
    return _save(figure)


def _make_figure(width: float, height: float) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure) -> bytes:
    data = BytesIO()
    figure.savefig(data, format="svg", dpi=150)
    return data.getvalue()
