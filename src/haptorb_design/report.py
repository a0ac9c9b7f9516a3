"""Report of a results file: an HTML page, and the best designs as device files."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haptorb.cli.cards import card
from haptorb.cli.progress import build_tables
from haptorb.devices.base import Device, require_geometry
from haptorb.devices.drawing import SectionPlane, draw_section, draw_space
from haptorb.display import format_number
from haptorb.errors import InputError
from haptorb.figure_file import show_text_as_is
from haptorb.files import open_regular, replace_files
from haptorb.version import __version__
from haptorb_design.evaluate import find_base
from haptorb_design.pareto_front import RULES
from haptorb_design.problem import build_device, write_device_text
from haptorb_design.results_table import ResultsColumn, ResultsTable
from haptorb_design.sampling import METHODS
from haptorb_design.sensitivity import MIN_DESIGNS, Sensitivity, estimate_sensitivity
from haptorb_design.store import read_results

__all__ = [
    "MAX_BEST_DESIGNS",
    "BestDesign",
    "draw_beside",
    "make_best",
    "make_best_section",
    "make_page",
    "make_sensitivity_section",
    "write_report",
]


# --------------------------------------------------------------------------------------------------
# Section drawings of a design and the base device, side by side to one scale.


_FIGURE_WIDTH_IN, _FIGURE_HEIGHT_IN, _LEGEND_HEIGHT_IN = 12.0, 10.6, 0.9  #: of the figure, and of its legend [inch]
_FIGURE_DPI = 90  #: resolution [dots per inch]


def draw_beside(device: Device, base: Device) -> bytes:
    """PNG image: sections above, views in three dimensions below, `device` on the left, `base` on the right.

    Both have the same scale. InputError for a kind of device without geometry.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_FIGURE_WIDTH_IN, _FIGURE_HEIGHT_IN))
    places = figure.add_gridspec(
        2, 2, left=0.06, right=0.98, top=0.95, bottom=_LEGEND_HEIGHT_IN / _FIGURE_HEIGHT_IN, wspace=0.14, hspace=0.16
    )
    sections: list[Any] = []
    spaces: list[Any] = []
    entries: dict[str, Any] = {}
    for column, (name, one) in enumerate((("this design", device), (f"base device: {base.name}", base))):
        geometry = require_geometry(one, "`haptorb design report`")
        section = figure.add_subplot(places[0, column])
        entries |= draw_section(section, geometry, SectionPlane())
        section.set_title(f"Section, {name}", loc="left", fontsize=11)
        space = figure.add_subplot(places[1, column], projection="3d")
        draw_space(space, geometry)
        space.set_title(f"From the front, {name}", loc="left", fontsize=11)
        sections.append(section)
        spaces.append(space)
    _unite(sections, ("xlim", "ylim"))
    _unite(spaces, ("xlim", "ylim", "zlim"))
    for space in spaces:
        space.set_box_aspect([high - low for low, high in (space.get_xlim(), space.get_ylim(), space.get_zlim())])
    figure.legend(list(entries.values()), list(entries), loc="lower center", ncols=5, fontsize=8, frameon=False)
    file = BytesIO()
    show_text_as_is(figure).savefig(file, format="png", dpi=_FIGURE_DPI)
    return file.getvalue()


def _unite(axes: list[Any], limits: tuple[str, ...]) -> None:
    """Set the same limits for all `axes`, containing all contents."""
    for limit in limits:
        ends = [getattr(one, f"get_{limit}")() for one in axes]
        whole = min(low for low, _ in ends), max(high for _, high in ends)
        for one in axes:
            getattr(one, f"set_{limit}")(*whole)


# --------------------------------------------------------------------------------------------------
# A picked design as shown in the report: device file, device, card and drawing.


_CARD_COLUMNS = 110  #: characters of a card's line


@dataclass(frozen=True)
class BestDesign:
    """A design with its device, card and drawing.

    row      of the results table
    text     the device file, for `haptorb run` and every other command
    card     output of `haptorb inspect`, or the reason why there is none
    drawing  PNG, with the base device; empty for a kind of device without geometry
    """

    row: int
    name: str
    reason: str
    text: str
    card: str
    drawing: bytes


def make_best(table: ResultsTable, row: int, reason: str) -> BestDesign:
    """Everything that the report shows of the design in `row`; a motor's tables are computed for its card."""
    _, found = table.found[row]
    name = table.name(row)
    device = build_device(table.design, found.values, name, override=True)
    base = find_base(table.design)
    drawn = device.geometry() is not None and base.geometry() is not None
    return BestDesign(
        row, name, reason, write_device_text(table.design, found.values, name), _print_card(device),
        draw_beside(device, base) if drawn else b"",
    )  # fmt: skip


def _print_card(device: Device) -> str:
    try:
        build_tables(device)
        return card(device).render_text(_CARD_COLUMNS)
    except InputError as cause:
        return f"no card: {cause}"


# --------------------------------------------------------------------------------------------------
# Section on the picked designs: rule, changes, and each with device file, drawing and card.


def make_best_section(table: ResultsTable, best: Sequence[BestDesign]) -> str:
    """HTML of all of `best`."""
    if not best:
        return (
            "<p>There is no valid design within the ranges and constraints. The rejected designs are counted below.</p>"
        )
    rule = RULES[len(table.select("objective")) > 1]
    return f"<p class='soft'>Selection: {escape(rule)}</p>" + "".join(
        _make_one(table, number, one) for number, one in enumerate(best, 1)
    )


def _make_one(table: ResultsTable, number: int, one: BestDesign) -> str:
    file = f"{one.name}.toml"
    shown = f"Sections and views of {escape(one.name)} and of the base device, to one scale"
    picture = (
        f"<figure tabindex='0'><img loading='lazy' width='1080' height='954' alt='{shown}' "
        f"src='{_encode_data(one.drawing, 'image/png')}'>"
        "<figcaption>Both columns have the same scale.</figcaption></figure>"
        if one.drawing
        else ""
    )
    return (
        f"<article class='best' id='best-{number}'><h3>{number}: {escape(one.name)} "
        f"<span class='soft'>{escape(one.reason)}</span></h3>"
        f"<p><a class='button' download='{escape(file)}' href='{_encode_data(one.text.encode(), 'application/toml')}'>"
        f"Device file {escape(file)}</a> <code>haptorb run {escape(file)}</code></p>"
        f"<div class='side'>{_make_numbers(table, one.row)}{picture}</div>"
        f"<details><summary>Capability card (<code>haptorb inspect {escape(file)}</code>)</summary>"
        f"<pre tabindex='0'>{escape(one.card)}</pre></details>"
        f"<details><summary>Device file</summary><pre tabindex='0'>{escape(one.text)}</pre></details></article>"
    )


def _make_numbers(table: ResultsTable, row: int) -> str:
    lines = "".join(
        f"<tr><th scope='row'>{escape(one.title)}{f' [{escape(one.unit)}]' if one.unit else ''}</th>"
        f"<td class='n'>{_format_value(one, float(one.values[row]))}</td>"
        f"<td class='n'>{_format_value(one, one.base)}</td>"
        f"<td class='n'>{_compare(one, row)}</td></tr>"
        for kind in ("objective", "parameter", "constraint")
        for one in table.select(kind)
    )
    base = escape(table.design.base.rpartition("/")[2]) + (" *" if table.remark else "")
    note = f"<p class='soft'>* {escape(table.remark)}.</p>" if table.remark else ""
    return (
        "<div class='wide' tabindex='0'><table class='table'><thead><tr><th></th>"
        f"<th scope='col' class='n'>this design</th><th scope='col' class='n'>{base}</th>"
        f"<th scope='col' class='n'>ratio</th></tr></thead><tbody>{lines}</tbody></table>{note}</div>"
    )


def _format_value(column: ResultsColumn, value: float) -> str:
    if value != value:
        return "–"
    return escape(column.labels[int(value)] if column.labels else format_number(value, 4).replace("-", "−"))


def _compare(column: ResultsColumn, row: int) -> str:
    """An objective relative to the base device's, as text."""
    if column.kind != "objective" or not column.base * column.values[row] > 0:
        return ""
    return f"{column.values[row] / column.base:.3g}"


def _encode_data(content: bytes, kind: str) -> str:
    """`content` of media type `kind` as a data URL."""
    return f"data:{kind};base64,{b64encode(content).decode('ascii')}"


# --------------------------------------------------------------------------------------------------
# Section on sensitivities: tables with bars, without scripts.


_BAR_WIDTH_PX, _BAR_HEIGHT_PX = 240, 22  #: of a bar's picture [px]

_LEAD = (
    "Share: of the variance of the objective (of its ranks), the part that this parameter alone explains; what the "
    "shares together lack of 100 % comes from parameters that act together. Direction: rank correlation, +1 if the "
    "objective grows with the parameter, −1 if it falls; near 0 beside a large share, the best value is within the "
    "range. Lines and brackets are 95 % intervals. Both hold for the valid designs within the ranges that were tried: "
    "where constraints reject designs, parameters become dependent, and one can carry another’s share."
)


def make_sensitivity_section(table: ResultsTable) -> str:
    """HTML: one table per objective, and the designs it was estimated from."""
    rows, source = _choose_rows(table)
    head = f"<p class='soft'>{escape(_LEAD)}</p><p>{escape(source)}</p>"
    if rows.size < MIN_DESIGNS:
        return head
    tables = (
        _make_table(objective, [(one, _estimate(one, objective, rows)) for one in table.select("parameter")])
        for objective in table.select("objective")
    )
    return head + "".join(tables)


def _choose_rows(table: ResultsTable) -> tuple[NDArray[np.int_], str]:
    """Rows used, and a sentence on them: those of sweeps, if there are enough."""
    every = np.arange(len(table.found))
    swept = np.array([run.method in METHODS for run, _ in table.found], dtype=bool)
    if swept.sum() >= MIN_DESIGNS:
        others = (
            "" if swept.all() else "; those of the optimiser, which are concentrated where it searched, are left out"
        )
        return every[swept], f"From the {swept.sum()} valid designs of sweeps{others}."
    if every.size >= MIN_DESIGNS:
        return every, (
            f"From all {every.size} valid designs. An optimiser chose them, so they are concentrated where it "
            "searched and the numbers are rough. A sweep into the same file gives better ones."
        )
    return every, f"{every.size} valid designs are not enough: at least {MIN_DESIGNS} are needed. Compute more."


def _estimate(parameter: ResultsColumn, objective: ResultsColumn, rows: NDArray[np.int_]) -> Sensitivity:
    return estimate_sensitivity(parameter.values[rows], objective.values[rows], ordered=not parameter.labels)


def _make_table(objective: ResultsColumn, found: list[tuple[ResultsColumn, Sensitivity]]) -> str:
    found = sorted(found, key=lambda pair: -pair[1].share)
    lines = "".join(
        f"<tr><th scope='row'>{escape(parameter.title)}</th><td>{_draw_bar(one)}</td>"
        f"<td class='n'>{one.share:.0%} <small class='soft'>[{one.share_interval[0]:.0%}, "
        f"{one.share_interval[1]:.0%}]</small></td><td class='n'>{_format_direction(one)}</td></tr>"
        for parameter, one in found
    )
    together = sum(one.share for _, one in found)
    rest = f"Sum {together:.0%}." if together < 1 else "Sum above 100 %: the parameters are dependent."
    return (
        f"<div class='wide' tabindex='0'><table class='table'><caption>{escape(objective.title)} "
        f"<span class='soft'>({rest})</span></caption><thead><tr><th scope='col'>parameter</th>"
        "<th scope='col'><span class='soft'>0 to 100 %</span></th><th scope='col' class='n'>share [95 %]</th>"
        f"<th scope='col' class='n'>direction [95 %]</th></tr></thead><tbody>{lines}</tbody></table></div>"
    )


def _format_direction(one: Sensitivity) -> str:
    if one.direction is None or one.direction_interval is None:
        return "<span class='soft'>a choice</span>"
    low, high = one.direction_interval
    text = f"{one.direction:+.2f} <small class='soft'>[{low:+.2f}, {high:+.2f}]</small>"
    return text.replace("-", "−")


def _draw_bar(one: Sensitivity) -> str:
    low, high = (share * _BAR_WIDTH_PX for share in one.share_interval)
    middle = _BAR_HEIGHT_PX / 2
    return (
        f"<svg class='bar' viewBox='0 0 {_BAR_WIDTH_PX} {_BAR_HEIGHT_PX}' preserveAspectRatio='none' "
        "aria-hidden='true'>"
        f"<line class='scale' x1='0' x2='{_BAR_WIDTH_PX}' y1='{_BAR_HEIGHT_PX - 1}' y2='{_BAR_HEIGHT_PX - 1}'/>"
        f"<rect x='0' y='5' width='{one.share * _BAR_WIDTH_PX:.1f}' height='{_BAR_HEIGHT_PX - 10}'/>"
        f"<line x1='{low:.1f}' x2='{high:.1f}' y1='{middle}' y2='{middle}'/>"
        f"<line x1='{low:.1f}' x2='{low:.1f}' y1='6' y2='{_BAR_HEIGHT_PX - 6}'/>"
        f"<line x1='{high:.1f}' x2='{high:.1f}' y1='6' y2='{_BAR_HEIGHT_PX - 6}'/></svg>"
    )


# --------------------------------------------------------------------------------------------------
# Page of `haptorb design report`: one self-contained file.


#: output of the web build: script and style
_STATIC = Path(__file__).parent / "static"
#: no external content is ever loaded
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"


def make_page(table: ResultsTable, best: Sequence[BestDesign]) -> str:
    """The page as HTML. InputError if script and style have not been built."""
    script, style = (_read_static(name) for name in ("report.js", "report.css"))
    title = escape(table.design.title)
    several = len(table.select("objective")) > 1
    sections = [
        ("front", "Pareto front" if several else "Designs", _make_front(table, several)),
        ("lines", "Parallel coordinates", _LINES if table.found else _NO_VALID_DESIGN),
        ("sensitivity", "Sensitivity", make_sensitivity_section(table) if table.found else _NO_VALID_DESIGN),
        ("best", f"The {len(best)} best" if len(best) > 1 else "The best", make_best_section(table, best)),
        ("rejected", "Rejected designs", _make_refusals(table)),
        ("origin", "Design file and runs", _make_origin(table)),
    ]
    contents = "".join(f"<li><a href='#{name}'>{escape(head)}</a></li>" for name, head, _ in sections)
    return "\n".join([
        "<!doctype html>", "<html lang='en'><head><meta charset='utf-8'>",
        f"<meta http-equiv='Content-Security-Policy' content=\"{_POLICY}\">",
        "<meta name='viewport' content='width=device-width, initial-scale=1'>",
        "<meta name='color-scheme' content='light dark'>",
        f"<title>{title}</title><link rel='icon' href='data:,'><style>{style}</style></head><body>",
        f"<header><h1>{title}</h1>{_make_summary(table)}</header>",
        f"<nav aria-label='Contents'><ul>{contents}</ul></nav><main>",
        *(f"<section id='{name}' aria-labelledby='{name}-head'><h2 id='{name}-head'>{escape(head)}</h2>{body}</section>"
          for name, head, body in sections),
        f"</main><script type='application/json' id='designs'>{_encode(table)}</script>",
        f"<script type='module'>{script}</script></body></html>", "",
    ])  # fmt: skip


_LINES = (
    "<p class='soft'>One line per valid design; designs on the Pareto front are coloured, the selected one is "
    "thick. A line that leaves the visible range of an axis continues along its end.</p><div id='parallel'></div>"
)
_NO_VALID_DESIGN = "<p>There is no valid design.</p>"


def _make_front(table: ResultsTable, several: bool) -> str:
    if not table.found:
        return _NO_VALID_DESIGN
    caption = (
        "Every point is a valid design. The larger points are the Pareto front: no design is better in one objective "
        "without being worse in another."
        if several
        else "Every point is a valid design; the larger point is the best."
    )
    mark = f"It is hollow, and marked *, because {escape(table.remark)}. " if table.remark else ""
    return (
        f"<p class='soft'>{caption} The diamond is the base device. {mark}The numbers are the best designs below. "
        "Point at a design, or use the arrow keys; a click, or Enter, goes to the device of a numbered design.</p>"
        "<noscript><p>The picture needs a script; tables and devices are below without it.</p></noscript>"
        "<div id='scatter'></div>"
    )


def _make_summary(table: ResultsTable) -> str:
    counts = {
        "designs computed": table.total, "valid": len(table.found), "rejected": table.total - len(table.found),
        "on the front": len(table.front),
    }  # fmt: skip
    cells = "".join(f"<li><b>{count:,}</b>{escape(name)}</li>" for name, count in counts.items())
    design = table.design
    goals = ", ".join(f"{goal.sense} {goal.name.replace('_', ' ')}" for goal in design.goals)
    free = ", ".join(one.name.replace("_", " ") for one in design.parameters)
    return (
        f"<p>Design ‘{escape(design.name)}’, based on ‘{escape(design.base)}’: {escape(goals)}. "
        f"Free: {escape(free)}. haptorb {escape(__version__)}.</p><ul class='counts'>{cells}</ul>"
    )


def _make_refusals(table: ResultsTable) -> str:
    if not table.refusals:
        return "<p>No design was rejected.</p>"
    names = {"device": "device (values that form no valid device)", "objective": "objective (not a finite number)"}
    lines = "".join(
        f"<tr><th scope='row'>{escape(names.get(one.by, one.by.replace('_', ' ')))}</th>"
        f"<td class='n'>{one.count:,}</td><td class='n'>{one.count / table.total:.0%}</td>"
        f"<td>{escape(one.example)}</td></tr>"
        for one in table.refusals
    )
    return (
        "<p class='soft'>Constraints are evaluated in the order of the design file; a design counts for the first "
        "one that it violates.</p><div class='wide' tabindex='0'><table class='table'><thead><tr><th "
        "scope='col'>rejected by</th>"
        "<th scope='col' class='n'>designs</th><th scope='col' class='n'>share</th><th scope='col'>example</th>"
        f"</tr></thead><tbody>{lines}</tbody></table></div>"
    )


def _make_origin(table: ResultsTable) -> str:
    lines = "".join(
        f"<tr><td class='n'>{run.id}</td><td>{escape(run.method)}</td><td class='n'>{run.seed}</td>"
        f"<td>{escape(json.dumps(dict(run.settings)) if run.settings else '')}</td>"
        f"<td class='n'>{len(run.evaluations):,}</td><td>{escape(run.started)}</td><td>{escape(run.version)}</td></tr>"
        for run in table.runs
    )
    heads = "".join(
        f"<th scope='col'>{name}</th>"
        for name in ("run", "method", "seed", "settings", "designs", "started (UTC)", "haptorb")
    )
    return (
        f"<div class='wide' tabindex='0'><table class='table'><thead><tr>{heads}</tr></thead><tbody>{lines}</tbody>"
        f"</table></div><details><summary>Design file</summary><pre tabindex='0'>{escape(table.design.text)}</pre>"
        "</details>"
    )


def _encode(table: ResultsTable) -> str:
    """JSON that is safe within a script element."""
    return json.dumps(table.describe(), separators=(",", ":")).replace("<", "\\u003c")


def _read_static(name: str) -> str:
    try:
        return (_STATIC / name).read_text(encoding="utf-8")
    except FileNotFoundError as cause:
        raise InputError(
            "the report's page has not been built: run `cd web && npm ci && npm run build`, or `make run`"
        ) from cause


MAX_BEST_DESIGNS = 20  #: best designs in a report at most
_DEVICE_FILE_HEADER = "# Found by design '"  #: first line of a report's device file


def write_report(
    results: str | Path,
    output: str | Path,
    report: Callable[[str, int, int], None] = lambda text, done, total: None,
    *,
    count: int = 5,
) -> list[Path]:
    """Write the report of `results`, a file or database, to the HTML file `output`; returns all paths written.

    The `count` best designs are written beside it, as NAME.toml for `haptorb run`; all files or none. `report` is
    called with the current step, the number of steps done, and their total.

    Raises RecordingError for results that cannot be read, InputError for an output that cannot be written: a foreign
    device file is not replaced.
    """
    if not 1 <= count <= MAX_BEST_DESIGNS:
        raise InputError(f"the number of best designs must be from 1 to {MAX_BEST_DESIGNS}; got {count}")
    page = Path(output).expanduser()
    if not page.absolute().parent.is_dir():
        raise InputError(f"{page}: there is no folder {page.parent}; create it first")
    if page.is_dir():
        raise InputError(f"{page} is a folder: name a file, such as report.html")
    report("reading the results", 0, 1)
    table = ResultsTable.of(read_results(results), count)
    paths = [page, *(page.with_name(f"{table.name(one.row)}.toml") for one in table.picks)]
    for path in paths[1:]:
        _check_device_file(path)
    best = []
    for number, pick in enumerate(table.picks):
        report(f"card and drawing of {table.name(pick.row)}", number, len(table.picks) + 1)
        best.append(make_best(table, pick.row, pick.reason))
    report("writing the page", len(table.picks), len(table.picks) + 1)
    texts = [make_page(table, best), *(one.text for one in best)]
    try:
        with replace_files(paths) as parts:
            for part, text in zip(parts, texts, strict=True):
                part.write_text(text, encoding="utf-8")
    except PermissionError as cause:
        raise InputError(f"{page} and the files beside it cannot be written: {cause.strerror}") from cause
    return paths


def _check_device_file(path: Path) -> None:
    """Raise InputError if the file at `path` is not a device file of an earlier report."""
    try:
        if not path.exists():
            return
        with open_regular(path, "device file", InputError) as file:
            ours = file.read(len(_DEVICE_FILE_HEADER.encode())) == _DEVICE_FILE_HEADER.encode()
    except (OSError, InputError) as cause:
        raise InputError(f"{path} cannot be replaced: {cause}; choose another --output") from cause
    if not ours:
        raise InputError(f"{path} was not written by `haptorb design report`: move it, or choose another --output")
