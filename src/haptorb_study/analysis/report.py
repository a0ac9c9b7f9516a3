"""Report of a study: one self-contained HTML file with its figures, which are also written as SVG or PNG."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Callable
from html import escape
from io import BytesIO
from pathlib import Path
from shlex import quote

from haptorb.display import Link, scroll_table_html
from haptorb.errors import InputError, RecordingError
from haptorb.figure_file import show_text_as_is
from haptorb.files import replace_files
from haptorb.terminal import TextTable
from haptorb_study.analysis.analysis import Analysis
from haptorb_study.analysis.condition_means import make_condition_table
from haptorb_study.analysis.confusion import describe_accuracy, list_wrong_answers
from haptorb_study.analysis.error_by_latitude import name_error
from haptorb_study.analysis.figures import figures
from haptorb_study.analysis.magnitude import make_magnitude_tables
from haptorb_study.analysis.number_format import format_p, format_percent, format_range, format_value
from haptorb_study.analysis.response_times import make_response_table
from haptorb_study.analysis.tables import (
    list_group_tables,
    list_notes,
    list_psychometric_notes,
    list_psychometric_tables,
)
from haptorb_study.incidents import count_incidents

__all__ = ["page", "write_report"]

_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#22303c;max-width:60rem;margin:2rem auto;padding:0 1rem}
h1{margin-bottom:.2rem}h2{margin-top:2.2rem;border-bottom:1px solid #d5dde4}
.simulated{position:sticky;top:0;background:#fdecea;color:#8c1d14;border-left:5px solid #c0392b;padding:.7rem 1rem;
font-weight:600}
table{border-collapse:collapse;margin:.8rem 0}.wide{overflow-x:auto}
th,td{padding:.25rem .8rem;text-align:right;border-bottom:1px solid #e3e9ee}
th:first-child,td:first-child{text-align:left}th{color:#4d5f6e;font-weight:600}img{max-width:100%;height:auto}
@media print{@page{margin-top:2.4cm}.simulated{position:fixed;top:-1.6cm;left:0;right:0;margin:0}}
pre{white-space:pre-wrap;background:#f4f7f9;padding:1rem;font-size:13px}.quiet{color:#5b6b78;font-size:14px}
"""


def page(analysis: Analysis, images: dict[str, bytes] | None = None, *, served: bool = False) -> str:
    """The report as self-contained HTML; `images` are its figures as PNG or SVG, drawn here if not given.

    served: with links `play/N` for a server that plays the recordings; else with the commands
    """
    drawn = {name: _image(data, name) for name, data in (images or _draw_figures(analysis, "png")).items()}
    body = [
        f"<h1>{escape(analysis.study.name)}</h1>",
        f"<p class='{'simulated' if analysis.marked else 'quiet'}'>{escape(analysis.origin)}</p>",
        f"<p>Procedure: {analysis.study.procedure}. {analysis.trials} trials answered, {analysis.practice} practice "
        f"trials excluded; the device tripped in {analysis.trips} trials; {analysis.repeated} trials were restarted "
        "before they were answered.</p>",
    ]
    if analysis.left_out:
        body.append(f"<p><b>Left out</b>, of another kind than these: {escape(analysis.left_out)}.</p>")
    if analysis.plan is not None:
        body.append(f"<p>Planned analysis: {escape(analysis.plan.sentence)}.</p>")
        body += [f"<p class='simulated'>{escape(remark)}</p>" for remark in analysis.plan.remarks]
    if (c := analysis.confusion) is not None:
        body += [
            "<h2>Identification</h2>",
            f"<p>Correct answers: <b>{format_percent(c.accuracy)}</b>, averaged over participants "
            f"({describe_accuracy(c)}). Chance is {format_percent(c.chance)}; "
            f"probability of so many correct answers by guessing: {escape(format_p(c.p_chance))} (exact binomial).</p>",
            drawn["confusion"],
            drawn["answers"],
            scroll_table_html(
                ["set-point", "θ [deg]", "φ [deg]", "correct", "95 % [%]", "wrong answers to"],
                [
                    [
                        n, f"{analysis.study.point(n).theta_deg:g}", f"{analysis.study.point(n).phi_deg:g}",
                        format_percent(c.matrix[i, i]), format_range(tuple(c.right_95[i]), ".1f", 100),
                        list_wrong_answers(analysis.arrows, n),
                    ]
                    for i, n in enumerate(c.numbers)
                ],
            ),
        ]  # fmt: skip
    if analysis.means:
        table = make_condition_table(analysis.means)
        body += [f"<h2>{escape(table.title)}</h2>", _convert_table(table)]
    if analysis.rings:
        rows = [
            [
                f"{r.theta_deg:g}",
                r.trials,
                f"{r.mean:.2f}",
                format_value(r.sd, ".2f"),
                format_range((r.low, r.high), ".2f"),
            ]
            for r in analysis.rings
        ]
        body += [
            f"<h2>Error over θ: {name_error(analysis.study.procedure)}</h2>",
            drawn["error"],
            scroll_table_html(["θ [deg]", "trials", "mean [mm]", "SD [mm]", "95 % of the mean"], rows),
            "<p class='quiet'>Zárate et al. 2020 do not state whether they mean the tool's magnet or its tip; "
            "distances of the tip are three fifths of these.</p>",
        ]
    if analysis.curves:
        body += ["<h2>Psychometric curves</h2>", drawn["curves"]]
    for table in list_psychometric_tables(analysis):
        body += [f"<h3>{escape(table.title)}</h3>", _convert_table(table)]
    body += [f"<p class='quiet'>{escape(note)}</p>" for note in (*list_psychometric_notes(analysis), *analysis.notes)]
    if analysis.scores:
        rows = [
            [name, f"{x.mean:.2f}", format_range((x.low, x.high), ".2f"), format_value(x.sd, ".2f"), x.ratings]
            for name, x in analysis.scores.items()
        ]
        body += [
            "<h2>Ratings</h2>",
            scroll_table_html(["condition", "mean", "95 % of the mean", "SD", "ratings"], rows),
        ]
    if analysis.chosen:
        rows = [
            [f"{a} over {b}", f"{k} of {n}", format_range(w, ".1f", 100)]
            for (a, b), (k, n, w) in analysis.chosen.items()
        ]
        body += ["<h2>Choices</h2>", scroll_table_html(["chosen", "times", "95 % [%]"], rows)]
    for table in make_magnitude_tables(analysis.magnitudes, analysis.study.level_unit):
        body += [f"<h2>{escape(table.title)}</h2>", _convert_table(table)]
    if analysis.times:
        table = make_response_table(analysis.times)
        body += [
            f"<h2>{escape(table.title)}</h2>", _convert_table(table),
            "<p class='quiet'>From prompt to answer, without pauses; mean over people of each person's median, and "
            "the geometric mean; Student's intervals over people, of the geometric mean in the logarithm.</p>",
        ]  # fmt: skip
    for table in list_group_tables(analysis):
        body += [f"<h2>{escape(table.title)}</h2>", _convert_table(table)]
    body += [f"<p class='quiet'>{escape(note)}</p>" for note in list_notes(analysis)]
    body += _list_incidents(analysis)
    body += _list_recordings(analysis, served=served)
    body += ["<h2>Study file</h2>", f"<pre>{escape(analysis.study.text)}</pre>"]
    title = f"{analysis.study.name}{' (simulated)' if analysis.marked else ''}"
    return (
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{escape(title)}</title>"
        f"<meta name='viewport' content='width=device-width'><style>{_STYLE}</style></head><body>"
        + "\n".join(body)
        + "</body></html>"
    )


def _list_incidents(analysis: Analysis) -> list[str]:
    """Section on stops, repeats, safety events and early ends; present also if there were none."""
    body = ["<h2>Stops, repeats and safety events</h2>"]
    if not analysis.incidents:
        return [*body, "<p>None.</p>"]
    counts = ", ".join(f"{name}: {count}" for name, count in count_incidents(analysis.incidents).items() if count)
    rows = [
        [one.participant, one.session, one.trial, one.event, one.reason or "–", one.time[:19].replace("T", " ")]
        for one in analysis.incidents
    ]
    return [
        *body,
        f"<p>{escape(counts)}.</p>",
        scroll_table_html(["participant", "session", "trial", "event", "reason", "time (UTC)"], rows),
    ]


def _list_recordings(analysis: Analysis, *, served: bool) -> list[str]:
    """Section on recorded trials: a link to play each, or the command where the page has no server."""
    if not analysis.recorded:
        return []
    rows = []
    for number, (code, trial, safety, part) in enumerate(analysis.recorded):
        play = Link("▶ play", f"play/{number}") if served else f"haptorb view {quote(part)}"
        rows.append([code, trial, safety.replace("|", ", "), play])
    how = "Each link plays one trial."
    if not served:
        how = (
            "Each command plays one trial. Run it in the folder of the database and recordings. "
            "<code>haptorb study analyse DATABASE --serve</code> shows this page with links instead."
        )
    return [
        "<h2>Recordings</h2>",
        f"<p class='quiet'>{how}</p>",
        f"<details><summary>{len(rows)} trials</summary>",
        scroll_table_html(["participant", "trial", "safety", "recording" if served else "command"], rows),
        "</details>",
    ]


def write_report(
    analysis: Analysis, folder: str | Path, *, kind: str = "svg", serve: Callable[[str], None] | None = None
) -> Path:
    """Write report.html, numbers.json and the figures (`kind` svg or png) into `folder`; returns the report's path.

    serve: receives the page with links to the recordings
    """
    if kind not in ("svg", "png"):
        raise InputError(f"figures can be svg or png; got '{kind}'")
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        images = _draw_figures(analysis, kind)
        numbers = json.dumps(analysis.numbers(), indent=2, ensure_ascii=False) + "\n"
        files = {f"{name}.{kind}": data for name, data in images.items()}
        files |= {"numbers.json": numbers.encode(), "report.html": page(analysis, images).encode()}
        # Beside their destinations, then moved there: a link of that name, in a stranger's folder, is not followed.
        with replace_files([folder / name for name in files]) as parts:
            for part, data in zip(parts, files.values(), strict=True):
                part.write_bytes(data)
    except OSError as cause:
        raise RecordingError(f"{folder}: the report cannot be written ({cause.strerror})") from cause
    if serve is not None:
        serve(page(analysis, images, served=True))
    return folder / "report.html"


def _draw_figures(analysis: Analysis, kind: str) -> dict[str, bytes]:
    """Name → figure file; drawing dominates the time, so each is drawn once."""
    found = {}
    for name, figure in figures(analysis).items():
        data = BytesIO()
        show_text_as_is(figure).savefig(data, format=kind, dpi=150)
        found[name] = data.getvalue()
    return found


def _image(data: bytes, name: str) -> str:
    kind = "png" if data.startswith(b"\x89PNG") else "svg+xml"
    return f"<p><img alt='{name}' src='data:image/{kind};base64,{b64encode(data).decode()}'></p>"


def _convert_table(table: TextTable) -> str:
    return scroll_table_html(
        [f"{one.head} [{one.unit}]" if one.unit else one.head for one in table.columns], table.rows
    )
