"""Report of a feel session: one self-contained HTML file with geometry, forces, strain, stress and ratings."""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Sequence
from html import escape
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from haptorb.arrays import Array
from haptorb.beams import MATERIALS, Hook
from haptorb.display import scroll_table_html
from haptorb.errors import RecordingError
from haptorb.figure_file import show_text_as_is
from haptorb.files import replace_file
from haptorb.worlds import Outlet, SnapFit
from haptorb.worlds.base import parameters
from haptorb.worlds.base import values as parameter_values
from haptorb_study.feel.comparison import collect_traces
from haptorb_study.feel.designs import Candidate
from haptorb_study.feel.insertion_forces import InsertionForces, course, explain_peaks
from haptorb_study.feel.peak_comparison import compare_peaks
from haptorb_study.feel.session import SCORES, FeelSession
from haptorb_study.feel.trace import COLUMNS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_forces", "draw_hook", "make_report", "write_report"]


# --------------------------------------------------------------------------------------------------
# Figures of one design: side view of the hook, and computed and measured force over displacement.


_MAX_POINTS = 4000  #: points drawn in one figure: more cannot be distinguished
_X_COLUMN, _FX_COLUMN = COLUMNS.index("x_m"), COLUMNS.index("fx_n")


def draw_hook(hook: Hook) -> bytes:
    """Side view of the hook, to scale, as SVG."""
    x = np.unique([0.0, hook.base_length, hook.ramp_end, hook.peak, hook.tip])
    figure = _make_figure(6.4, 2.2)
    axes = figure.subplots()
    outline = np.vstack([np.column_stack([x, hook.section(x)]), [[hook.tip, 0.0], [0.0, 0.0]]]) * 1e3
    axes.fill(outline[:, 0], outline[:, 1], facecolor="#e3b778", edgecolor="#7a4d12")
    axes.axvline(0.0, color="#22303c", linewidth=3)  # the wall at its root
    axes.set(xlabel="from the root (mm)", ylabel="mm", aspect="equal")
    axes.margins(x=0.04, y=0.25)
    return _save(figure)


def draw_forces(design: Candidate, run: InsertionForces, traces: Sequence[Array]) -> bytes:
    """Pull of the hand over X', as SVG: lines computed, dots measured."""
    figure = _make_figure(6.4, 3.4)
    axes = figure.subplots()
    for rows in traces:
        some = rows[:: max(1, len(rows) * len(traces) // _MAX_POINTS)]
        axes.plot(
            some[:, _X_COLUMN] * 1e3, -some[:, _FX_COLUMN], ".", color="C1", markersize=2, alpha=0.5, rasterized=True
        )
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
    show_text_as_is(figure).savefig(data, format="svg", dpi=150)
    return data.getvalue()


_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#22303c;max-width:62rem;margin:2rem auto;padding:0 1rem}
h1{margin-bottom:.2rem}h2{margin-top:2.2rem;border-bottom:1px solid #d5dde4}
.simulated,.warn{background:#fdecea;color:#8c1d14;border-left:5px solid #c0392b;padding:.7rem 1rem}
.simulated{font-weight:600}.quiet{color:#5b6b78;font-size:14px}
table{border-collapse:collapse;margin:.8rem 0}.wide{overflow-x:auto}
th,td{padding:.25rem .8rem;text-align:right;border-bottom:1px solid #e3e9ee}
th:first-child,td:first-child{text-align:left}th{color:#4d5f6e;font-weight:600}img{max-width:100%;height:auto}
"""


def write_report(session: FeelSession, path: Path, facts: Sequence[str] = ()) -> Path:
    """Write the report of `session` to `path`, complete or not at all; `facts`: sentences on device and scale."""
    text = make_report(session, facts)
    try:
        with replace_file(path) as part:
            part.write_text(text, encoding="utf-8")
    except OSError as cause:
        raise RecordingError(f"{path}: the report cannot be written ({cause.strerror})") from cause
    return path


def make_report(session: FeelSession, facts: Sequence[str] = ()) -> str:
    """The report as HTML; the first of `facts` is printed at the top."""
    candidates, felt = session.candidates, collect_traces(session)
    runs = {design.name: course(design) for design in candidates.designs}
    title = escape(candidates.title)
    body = [f"<h1>{title}</h1>"]
    body += [f"<p class='{'quiet' if number else 'simulated'}'>{escape(fact)}</p>" for number, fact in enumerate(facts)]
    body += _report_compare(session, runs, felt)
    body += _list_ratings(session)
    for design in candidates.designs:
        body += _describe(design, runs[design.name], felt.get(design.name, []))
    return (
        f"<!doctype html>\n<html lang='en'><head><meta charset='utf-8'><title>{title}</title>"
        f"<meta name='viewport' content='width=device-width'><style>{_STYLE}</style></head><body>"
        + "\n".join(body)
        + "</body></html>\n"
    )


def _report_compare(session: FeelSession, runs: dict[str, InsertionForces], felt: dict[str, list[Array]]) -> list[str]:
    choice, scores = session.choice(), session.scores()
    rows = []
    for design in session.candidates.designs:
        run, (count, score) = runs[design.name], scores[design.name]
        numbers, root = run.numbers, run.root
        chosen = choice is not None and (choice.design, choice.digest) == (design.name, design.digest)
        rows.append([
            design.title + (" (chosen)" if chosen else ""), f"{numbers['insertion_force_n']:.1f}",
            f"{numbers['pull_out_force_n']:.1f}", _number(None if root is None else root.strain, 100.0, ".2f"),
            _number(None if root is None else root.stress, 1e-6, ".0f"),
            _number(None if root is None else root.margin, 1.0, ".2g"),
            str(len(felt.get(design.name, []))),
            f"{score:.1f} ({count})" if count else "not rated",
        ])  # fmt: skip
    head = [
        "design", "insert [N]", "pull out [N]", "strain at the root [%]", "stress at the root [MPa]", "yield margin",
        "times felt", f"mean score {SCORES[0]} to {SCORES[1]} (ratings)",
    ]  # fmt: skip
    return ["<h2>Designs compared</h2>", scroll_table_html(head, rows)]


def _list_ratings(session: FeelSession) -> list[str]:
    people = session.people()
    if not people:
        return ["<h2>Ratings</h2>", "<p>No design has been rated yet.</p>"]
    now = {design.name: design.digest for design in session.candidates.designs}
    counted = [one for one in session.ratings() if now.get(one.design) == one.digest]
    rows = []
    for design in session.candidates.designs:
        cells = []
        for person in people:
            given = [one for one in counted if (one.design, one.person) == (design.name, person)]
            cells.append(", ".join(f"{one.score}{' (blind)' if one.blind else ''}" for one in given) or "–")
        rows.append([design.title, *cells])
    body = ["<h2>Ratings</h2>", scroll_table_html(["design", *(person or "no code" for person in people)], rows)]
    if old := session.find_outdated():
        body.append(
            f"<p class='quiet'>{len(old)} ratings are left out, because their designs have been changed or removed.</p>"
        )
    return body


def _describe(design: Candidate, run: InsertionForces, traces: Sequence[Array]) -> list[str]:
    body = [f"<h2>{escape(design.title)}</h2>"]
    body += [f"<p class='warn'>{escape(remark)}</p>" for remark in design.remarks]
    if design.hook is not None:
        body += [_image(draw_hook(design.hook), f"hook of {design.title}, from the side")]
        body.append(scroll_table_html(["size", "value"], _list_sizes(design, design.hook)))
        if design.material in MATERIALS:
            source = MATERIALS[design.material].source
            body.append(f"<p class='quiet'>Values of the material: {escape(source)}.</p>")
    else:
        known = parameters(type(design.world))
        rows = [[name, f"{value} {known[name].unit}"] for name, value in parameter_values(design.world).items()]
        body.append(scroll_table_html(["parameter", "value"], rows))
    if run.root is not None:
        body.append(f"<p>{escape(run.root.sentence[:1].upper() + run.root.sentence[1:])}.</p>")
    if isinstance(design.world, SnapFit):
        body += _show_shares(design.world)
    body.append(_image(draw_forces(design, run, traces), f"force over displacement of {design.title}"))
    reasons = [reason for one in compare_peaks(design, run, traces) for reason in one.sentences]
    body += [f"<p>{escape(sentence)}.</p>" for sentence in reasons or ["Not felt in this session"]]
    return body


def _show_shares(world: SnapFit) -> list[str]:
    """Contributions to the peak forces, step by step."""
    ways = explain_peaks(world)
    rows = [
        ["handbook: P (μ + tan α)/(1 − μ tan α)", *(f"{one.handbook:.2f}" for one in ways)],
        ["the pull bends the hook, too", *(f"{one.pull_bends:+.2f}" for one in ways)],
        ["the bent face is turned", *(f"{one.face_turns:+.2f}" for one in ways)],
        [f"edges rounded by {world.edge * 1e3:.3g} mm", *(f"{one.edges_rounded:+.2f}" for one in ways)],
        ["greatest force", *(f"{one.total:.2f}" for one in ways)],
    ]
    if world.hooks > 1:
        rows.append(["coupling of the hooks, part 0.1 mm off centre", *(f"{one.off_middle:+.2f}" for one in ways)])
    return [
        "<p>How the greatest forces follow from the formula of design guides for snap-fits, all hooks together, "
        "with all friction:</p>",
        scroll_table_html(["share", "insert [N]", "pull out [N]"], rows),
    ]


def _list_sizes(design: Candidate, hook: Hook) -> list[list[str]]:
    lengths = {
        "base length": hook.base_length, "peak": hook.peak, "thickness": hook.thickness, "height of the wedge":
        hook.height, "width": hook.width,
    }  # fmt: skip
    rows = [[name, f"{value * 1e3:.4g} mm"] for name, value in lengths.items()]
    rows += [
        ["insertion angle", f"{math.degrees(hook.front):.4g}°"],
        ["retention angle", f"{math.degrees(hook.rear):.4g}°"],
    ]
    rows.append(["material", f"{design.material}: E = {hook.youngs_modulus / 1e9:.4g} GPa, ν = {hook.poisson_ratio:g}"])
    if design.material in MATERIALS:
        rows.append(["condition", MATERIALS[design.material].condition])
    if isinstance(design.world, SnapFit | Outlet):
        rows.append(["friction", f"{design.world.friction:g}"])
    return rows


def _number(value: float | None, factor: float, form: str) -> str:
    return "–" if value is None else f"{value * factor:{form}}"


def _image(data: bytes, what: str) -> str:
    return f"<p><img alt='{escape(what, quote=True)}' src='data:image/svg+xml;base64,{b64encode(data).decode()}'></p>"
