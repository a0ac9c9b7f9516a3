"""The page of `haptorb design report`: one file that fetches nothing."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from pathlib import Path

from haptorb.apps.design.report.best_design import BestDesign
from haptorb.apps.design.report.best_section import make_best_section
from haptorb.apps.design.report.sensitivity_section import make_sensitivity_section
from haptorb.apps.design.results_table import ResultsTable
from haptorb.errors import InputError
from haptorb.version import __version__

__all__ = ["make_page"]

#: where the build hook puts script and style
_STATIC = Path(__file__).parents[1] / "static"
#: nothing from elsewhere is ever loaded
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"


def make_page(table: ResultsTable, best: Sequence[BestDesign]) -> str:
    """The page as text. InputError if script and style have not been built."""
    script, style = (_read_static(name) for name in ("report.js", "report.css"))
    title = escape(table.design.title)
    several = len(table.select("objective")) > 1
    sections = [
        ("front", "Pareto front" if several else "Designs", _make_front(table, several)),
        ("lines", "Parallel coordinates", _LINES if table.found else _NONE),
        ("sensitivity", "Sensitivity", make_sensitivity_section(table) if table.found else _NONE),
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
_NONE = "<p>There is no valid design.</p>"


def _make_front(table: ResultsTable, several: bool) -> str:
    if not table.found:
        return _NONE
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
    """JSON that cannot end the element that it stands in."""
    return json.dumps(table.describe(), separators=(",", ":")).replace("<", "\\u003c")


def _read_static(name: str) -> str:
    try:
        return (_STATIC / name).read_text(encoding="utf-8")
    except FileNotFoundError as cause:
        raise InputError(
            "the report's page has not been built: run `cd web && npm ci && npm run build`, or `make run`"
        ) from cause
