"""Report of a feel session: one self-contained HTML file with geometry, forces, strain, stress and ratings."""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from haptorb.arrays import Array
from haptorb.beams import MATERIALS, Hook
from haptorb.control.allocation import Saturation
from haptorb.display import scroll_table_html
from haptorb.errors import RecordingError
from haptorb.files import replace_file
from haptorb.worlds import Outlet, SnapFit
from haptorb.worlds.base import parameters
from haptorb.worlds.base import values as parameter_values
from haptorb_study.feel.course import InsertionForces, course, explain_peaks, force_along
from haptorb_study.feel.designs import Candidate, Candidates
from haptorb_study.feel.session import COLUMNS, HAND, SCORES, FeelSession

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "PEAK_TOLERANCE",
    "PeakComparison",
    "collect_traces",
    "compare_peaks",
    "comparison",
    "draw_forces",
    "draw_hook",
    "make_report",
    "plot_comparison",
    "write_report",
]


# --------------------------------------------------------------------------------------------------
# Measured against computed peak force, and the causes of the difference [N].
#
# The world is evaluated at the position of the measured peak while one deviation after another is removed: as
# measured; straight and centred; at full sliding speed, with all friction. The rest of the difference to the computed
# peak is displacement that was not travelled. The contributions sum to the difference exactly.


PEAK_TOLERANCE = 0.05  #: relative tolerance between measured and computed peak
_SLIDING_SPEED_M_PER_S = 0.1  #: sliding speed with full friction [m/s], as in `course`
_STANDSTILL_M_PER_S = 1e-4  #: standstill below this speed [m/s]
_CENTRED_M, _STRAIGHT_DEG = 5e-5, 0.3  #: tolerances of centred [m] and straight [°] motion
_MIN_CAUSE_SHARE = 0.01  #: smallest cause that is listed, relative to the computed peak
_T, _PEAKS_X, _PEAKS_FX = (COLUMNS.index(name) for name in ("t_s", "x_m", "fx_n"))
_ASKED, _GIVEN, _GAIN, _SATURATED = (len(COLUMNS) + HAND.index(name) for name in HAND)


@dataclass(frozen=True)
class PeakComparison:
    """Computed and measured peak [N] in one direction, "insertion" or "pull_out", and causes of the difference."""

    way: str
    computed: float
    felt: float | None  #: None: the part was never moved in this direction
    causes: tuple[tuple[str, float], ...] = ()  #: cause and its contribution [N]; their sum is the difference
    hand: str = ""  #: force that did not reach the hand, and why; empty if none

    @property
    def agrees(self) -> bool:
        """Whether both agree within PEAK_TOLERANCE."""
        return self.felt is not None and abs(self.felt - self.computed) <= PEAK_TOLERANCE * self.computed

    @property
    def sentences(self) -> tuple[str, ...]:
        """Agreement, or every cause with its contribution, as text."""
        name = self.way.replace("_", "-")
        if self.felt is None:
            return (f"{name}: computed {self.computed:.1f} N, not measured: the part was not moved in this direction",)
        peaks = f"{name}: computed {self.computed:.1f} N, felt {self.felt:.1f} N"
        if self.agrees:
            found = [f"{peaks}; they agree"]
        else:
            causes = [f"{what} {amount:+.1f} N" for what, amount in self.causes]
            found = [f"{peaks}; " + "; ".join(causes)]
        if self.hand:
            found.append(f"{name}, in the hand: {self.hand}")
        return tuple(found)


def compare_peaks(design: Candidate, run: InsertionForces, traces: Sequence[Array]) -> tuple[PeakComparison, ...]:
    """Compare insertion and pull-out of `design` in `traces` (n, 18) with the computed `run`; () without traces."""
    if not traces:
        return ()
    return tuple(_peaks_compare(design, run, traces, way) for way in ("insertion", "pull_out"))


def _peaks_compare(design: Candidate, run: InsertionForces, traces: Sequence[Array], way: str) -> PeakComparison:
    sign = 1.0 if way == "pull_out" else -1.0  # of the motion along X'
    curve = run.coming_out if sign > 0 else run.going_in
    computed = float(curve.max())
    best: tuple[float, Array, int, float] | None = None
    for rows in traces:
        speeds = _speeds(rows)
        moving = np.flatnonzero(sign * speeds > _STANDSTILL_M_PER_S)
        if len(moving):
            force = -sign * rows[moving, _PEAKS_FX]
            at = int(moving[np.argmax(force)])
            if best is None or force.max() > best[0]:
                best = float(force.max()), rows, at, float(speeds[at])
    if best is None:
        return PeakComparison(way, computed, None)
    felt, rows, at, speed = best
    x = float(rows[at, _PEAKS_X])
    slow = -sign * force_along(design, x, speed)
    quick = -sign * force_along(design, x, sign * _SLIDING_SPEED_M_PER_S)
    reached = float((sign * rows[:, _PEAKS_X]).max()) * sign
    peak_at = float(run.place[int(curve.argmax())])
    steps = (
        (_explain_place(x, peak_at, reached, sign), quick - computed),
        (f"slow motion ({1e3 * abs(speed):.1f} mm/s), without full friction:", slow - quick),
        (_explain_aside(rows[at]), felt - slow),
    )
    causes = tuple((what, amount) for what, amount in steps if abs(amount) >= _MIN_CAUSE_SHARE * computed)
    return PeakComparison(way, computed, felt, causes, _explain_hand(rows[at]))


def _speeds(rows: Array) -> Array:
    """(n,) speed along X' [m/s]; 0 for a single row."""
    if len(rows) < 2:
        return np.zeros(len(rows))
    t, x = rows[:, _T], rows[:, _PEAKS_X]
    step = np.gradient(t)
    return np.divide(np.gradient(x), step, out=np.zeros(len(rows)), where=step > 0)


def _explain_place(x: float, peak_at: float, reached: float, sign: float) -> str:
    if sign * reached < sign * peak_at - 1e-4:
        return f"the part reached X' = {1e3 * reached:.1f} mm, the peak is at {1e3 * peak_at:.1f} mm:"
    return f"felt at X' = {1e3 * x:.1f} mm, the peak is at {1e3 * peak_at:.1f} mm:"


def _explain_aside(row: Array) -> str:
    aside = float(np.hypot(row[_PEAKS_X + 1], row[_PEAKS_X + 2]))
    turn = 2.0 * np.degrees(np.arccos(np.clip(abs(row[COLUMNS.index("qw")]), 0.0, 1.0)))
    if aside < _CENTRED_M and turn < _STRAIGHT_DEG:
        return "the loop's own estimate of the speed in this tick:"
    return f"off centre ({1e3 * aside:.1f} mm sideways, turned by {turn:.1f}°):"


def _explain_hand(row: Array) -> str:
    """Force that did not reach the handle, as text; empty if none or unknown."""
    asked, given, gain, saturated = (float(row[k]) for k in (_ASKED, _GIVEN, _GAIN, _SATURATED))
    if np.isnan(asked) or asked <= 0.0:
        return ""
    if gain < 1.0 - PEAK_TOLERANCE:
        return (
            f"the guard passed {100 * gain:.0f} % of it: the force was still ramping up after a start, or a coil "
            "was warm"
        )
    if abs(given - asked) <= PEAK_TOLERANCE * asked:
        return ""
    limit = Saturation(int(saturated)) if saturated in tuple(Saturation) else Saturation.NONE
    why = f"the device was at its limit, {limit.text}" if limit else "currents rise with the coils' time constant"
    return f"{1e3 * asked:.0f} mN·m were asked, {1e3 * given:.0f} mN·m given: {why}"


# --------------------------------------------------------------------------------------------------
# Comparison of the candidates: computed and measured force over displacement, quantities, ratings, choice.


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
        if now.get(feeling.design) == feeling.digest and (session.folder / feeling.trace).is_file():
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
            figure.savefig(part, format=target.suffix.lstrip(".") or "png", dpi=150)
    except (OSError, ValueError) as cause:
        raise RecordingError(f"{target}: cannot be drawn ({cause})") from cause
    return target


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
    figure.savefig(data, format="svg", dpi=150)
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
