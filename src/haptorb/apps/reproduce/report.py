"""One HTML page with every item, its verdict and the figures: nothing is fetched to read it, and it prints."""

from __future__ import annotations

from base64 import b64encode
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory

from haptorb.apps.reproduce.citation import ROUNDING
from haptorb.apps.reproduce.item import CLASSES, MEANINGS, Item
from haptorb.apps.reproduce.registry import Drawing, Reproduction
from haptorb.display.presentable import Presentable
from haptorb.version import __version__

__all__ = ["ReproductionResult", "report_page", "summary"]

_PAPERS = {
    "bai2012": "Bai et al. 2012: a ball-joint-like spherical motor as a two-mode haptic device",
    "zarate2020": "Zárate et al. 2020: a spherical electromagnet for contact-free haptics",
}
_HEAVY = 300_000  #: bytes of SVG from which a picture is drawn as PNG

_STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --soft: #57606a; --paper: #ffffff; --line: #d8dee4; --band: #f6f8fa;
  --good: #1a6e34; --erratum: #7a4b00; --open: #57606a; --bad: #b3160f; --link: #0a4fa8; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ed; --soft: #9aa4ae; --paper: #14171b; --line: #333a42;
  --band: #1c2127; --good: #6fd08b; --erratum: #f0b45a; --open: #9aa4ae; --bad: #ff8a80; --link: #8ab8ff; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 74rem; padding: 1.5rem 1.25rem 4rem; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: .5rem 0; } h2 { margin: 3rem 0 .5rem; font-size: 1.45rem; }
h3 { margin: 2.2rem 0 .4rem; font-size: 1.12rem; } h3 span { color: var(--soft); font-weight: 400; }
p { max-width: 46rem; } a { color: var(--link); } .soft, small { color: var(--soft); } small { font-size: .86rem; }
.counts { display: flex; flex-wrap: wrap; gap: .75rem; padding: 0; margin: 1.2rem 0; list-style: none; }
.counts li { border: 1px solid var(--line); border-radius: .5rem; padding: .5rem 1rem; flex: 1 1 13rem; }
.counts small { display: block; line-height: 1.35; }
.counts b { display: block; font-size: 1.7rem; line-height: 1.2; font-variant-numeric: tabular-nums; }
nav ul { columns: 18rem; column-gap: 2.2rem; padding-left: 1.1rem; }
nav li { break-inside: avoid; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .94rem; }
th { text-align: left; font-weight: 600; border-bottom: 2px solid var(--line); padding: .3rem .55rem; }
td { border-bottom: 1px solid var(--line); padding: .35rem .55rem; vertical-align: top; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td.w { color: var(--soft); min-width: 6.5rem; } td.v { min-width: 15.5rem; } td.what { min-width: 18rem; }
.v { white-space: nowrap; font-weight: 600; } .good { color: var(--good); } .erratum { color: var(--erratum); }
.open { color: var(--open); font-weight: 400; } .bad { color: var(--bad); }
figure { margin: 1rem 0; } figure img { max-width: 100%; height: auto; background: #fff; border-radius: .4rem;
  border: 1px solid var(--line); padding: .4rem; }
@media print { :root { color-scheme: light; --ink: #000; --soft: #444; --paper: #fff; --line: #bbb; --good: #0a4d1f;
  --erratum: #5c3900; --open: #444; --bad: #8f0000; --link: #000; }
  body { max-width: none; padding: 0; font-size: 9.5pt; }
  nav { display: none; } tr, figure { break-inside: avoid; } h2, h3 { break-after: avoid; } thead { display:
  table-header-group; } .wide { overflow: visible; } td.what, td.v, td.w { min-width: 0; }
  .v { white-space: normal; }
  @page { margin: 15mm; } }
"""


@dataclass(frozen=True)
class ReproductionResult(Presentable):
    """One reproduction with its items and what draws its figure, if it has one."""

    of: Reproduction
    items: tuple[Item, ...]
    draw: Drawing | None

    def _summarize(self) -> str:
        counts = ", ".join(f"{count} {verdict}" for verdict, count in summary(self.items).items() if count)
        return f"<ReproductionResult of {self.of.paper}, {self.of.name}: {counts}>"

    def _repr_html_(self) -> str:
        """The table of the report, without the figure."""
        return _section(replace(self, draw=None))


def summary(items: Iterable[Item]) -> dict[str, int]:
    """How many items are of which class."""
    counts = Counter(item.verdict for item in items)
    return {verdict: counts[verdict] for verdict in CLASSES}


def report_page(made: Iterable[ReproductionResult]) -> str:
    """The page as text: all of `made`, paper by paper, figures inside."""
    every = list(made)
    items = [item for one in every for item in one.items]
    parts = [
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>Two papers, number by number</title><style>{_STYLE}</style></head><body>",
        "<h1>Two papers, number by number</h1>",
        f"<p class='soft'>haptorb {escape(__version__)}: the printed values, the values computed here, "
        "the tolerance and its reason. Only the first two classes show something about the papers: there a computation "
        "that does not contain the printed value meets it, or a correction of it. For each of them there is a change "
        "of one factor or sign in the code that turns it red. An erratum (E1, E2, …) is explained, "
        "with its evidence, on the errata page of the documentation. “Implied” is a number that is not "
        "printed but follows from what is: an equation's value, a ratio, a sign, 1 for “all of them”.</p>",
        _counts(items),
        _contents(every),
    ]
    for paper in dict.fromkeys(one.of.paper for one in every):
        parts.append(f"<h2>{escape(_PAPERS.get(paper, paper))}</h2>")
        parts += [_section(one) for one in every if one.of.paper == paper]
    return "\n".join([*parts, "</body></html>\n"])


def _counts(items: list[Item]) -> str:
    cells = "".join(
        f"<li><b class='{_class(verdict) if count else 'open'}'>{count}</b>{escape(verdict)}"
        f"<small>{escape(MEANINGS[verdict])}</small></li>"
        for verdict, count in summary(items).items()
    )
    return f"<ul class='counts'>{cells}</ul>"


def _contents(every: list[ReproductionResult]) -> str:
    rows = "".join(
        f"<li><a href='#{_anchor(one.of)}'>{escape(one.of.paper)}, {escape(one.of.name)}</a> "
        f"<small>{escape(one.of.title)}</small></li>"
        for one in every
    )
    return f"<nav><ul>{rows}</ul></nav>"


def _section(one: ReproductionResult) -> str:
    rows = "".join(_row(item) for item in one.items)
    title = f"{escape(_capitalize(one.of.name))} <span>· {escape(one.of.title)}</span>"
    return (
        f"<section><h3 id='{_anchor(one.of)}'>{title}</h3>"
        + (_figure(one.of, one.draw) if one.draw else "")
        + "<div class='wide'><table><thead><tr><th>where</th><th>what</th><th class='n'>printed</th>"
        "<th class='n'>here</th><th>unit</th><th class='n'>within</th><th>verdict</th></tr></thead>"
        f"<tbody>{rows}</tbody></table></div></section>"
    )


def _row(item: Item) -> str:
    printed = _number(item.published)
    if item.implied:
        printed += "<br><small>implied</small>"
    if item.corrected is not None:
        printed = f"{printed}<br><small>by {escape(item.erratum)}: {_number(item.corrected)}</small>"
    why = f"<br><small>{escape(item.reason)}</small>" if item.reason not in ("", ROUNDING) else ""
    unit = "" if item.unit == "1" else escape(item.unit)
    return (
        f"<tr id='{escape(item.paper)}-{escape(item.id)}'><td class='w'>{escape(item.where)}</td>"
        f"<td class='what'>{escape(item.what)}{why}</td><td class='n'>{printed}</td>"
        f"<td class='n'>{_number(item.computed)}</td><td>{unit}</td><td class='n'>{_describe_tolerance(item)}</td>"
        f"<td class='v {_class(item.verdict)}'>{escape(item.label)}</td></tr>"
    )


def _number(value: float | None) -> str:
    """Five digits, a true minus, and noise around nothing as nothing.

    >>> _number(-0.188419), _number(None), _number(1e-16)
    ('−0.18842', '', '0')
    """
    if value is None:
        return ""
    return f"{0.0 if abs(value) < 1e-13 else value:.5g}".replace("-", "−")


def _capitalize(name: str) -> str:
    return name[0].upper() + name[1:]


def _describe_tolerance(item: Item) -> str:
    return "exact" if item.why == ROUNDING and item.checked else _number(item.tolerance)


def _class(verdict: str) -> str:
    return {"reproduced": "good", "contradicted": "erratum", "differs": "bad"}.get(verdict, "open")


def _anchor(one: Reproduction) -> str:
    return f"{one.paper}-{one.name}".replace(" ", "-").replace(".", "")


def _figure(one: Reproduction, draw: Drawing) -> str:
    with TemporaryDirectory() as folder:
        picture, kind = draw(Path(folder, "figure.svg")).read_bytes(), "svg+xml"
        if len(picture) > _HEAVY:
            picture, kind = draw(Path(folder, "figure.png")).read_bytes(), "png"
    data = b64encode(picture).decode("ascii")
    return f"<figure><img alt='{escape(one.name)}: {escape(one.title)}' src='data:image/{kind};base64,{data}'></figure>"
