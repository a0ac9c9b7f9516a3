"""Page of `haptorb reproduce`: counts, contents, and collapsible parts with figures; self-contained."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory

from haptorb.version import __version__
from haptorb_papers.reproduce.item import MEANINGS, Item
from haptorb_papers.reproduce.registry import Drawing, Reproduction
from haptorb_papers.reproduce.report import ReproductionResult, summary
from haptorb_papers.reproduce.statement_table import css_class, item_anchor, statement_table

__all__ = ["SCRIPT", "STYLE", "report_page"]


# --------------------------------------------------------------------------------------------------
# How the page of `haptorb reproduce` looks, on screens from a telephone to a projector, in the dark and on paper.


STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --soft: #57606a; --paper: #ffffff; --line: #d8dee4; --band: #f6f8fa;
  --good: #1a6e34; --erratum: #7a4b00; --open: #57606a; --bad: #b3160f; --link: #0a4fa8; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ed; --soft: #9aa4ae; --paper: #14171b; --line: #333a42;
  --band: #1c2127; --good: #6fd08b; --erratum: #f0b45a; --open: #9aa4ae; --bad: #ff8a80; --link: #8ab8ff; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 74rem; padding: 1.5rem 1.25rem 4rem; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, sans-serif; overflow-wrap: break-word; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: .5rem 0; } h2 { margin: 2.4rem 0 .6rem; font-size: 1.4rem; }
h3 { margin: 0; font-size: 1.08rem; } h3 span { color: var(--soft); font-weight: 400; }
header p { max-width: 46rem; } a { color: var(--link); } .soft, small { color: var(--soft); }
small { font-size: .86rem; }
.counts { display: grid; grid-template-columns: repeat(auto-fit, minmax(11.5rem, 1fr)); gap: .75rem; padding: 0;
  margin: 1.2rem 0; list-style: none; }
.counts li { border: 1px solid var(--line); border-radius: .5rem; padding: .5rem .9rem; }
.counts small { display: block; line-height: 1.35; }
.counts b { display: block; font-size: 1.7rem; line-height: 1.2; font-variant-numeric: tabular-nums; }
.differing { border-left: 4px solid var(--bad); padding-left: 1rem; } .differing h2 { margin: 1.2rem 0 .3rem; }
.differing ul { margin: 0; padding-left: 1.1rem; }
nav h3 { margin: 1rem 0 .3rem; font-size: 1rem; }
nav ul { columns: 20rem; column-gap: 2.2rem; padding-left: 1.1rem; margin: 0; }
nav li { break-inside: avoid; }
nav button { font: inherit; color: var(--link); background: var(--band); border: 1px solid var(--line);
  border-radius: .4rem; padding: .3rem .8rem; margin-right: .6rem; min-height: 2.4rem; cursor: pointer; }
details { border: 1px solid var(--line); border-radius: .5rem; margin: .5rem 0; scroll-margin-top: .5rem; }
summary { padding: .55rem .9rem; cursor: pointer; border-radius: .5rem; }
summary:hover { background: var(--band); }
summary h3 { display: inline; } .tally { margin: .1rem 0 0 1.05rem; font-size: .88rem; color: var(--soft); }
details[open] > summary { border-bottom: 1px solid var(--line); border-radius: .5rem .5rem 0 0; }
details > .wide, details > figure { margin: .9rem; }
:focus-visible { outline: 3px solid var(--link); outline-offset: 2px; }
tr:target { background: var(--band); box-shadow: inset 4px 0 var(--link); }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .94rem; }
th { text-align: left; font-weight: 600; border-bottom: 2px solid var(--line); padding: .3rem .55rem; }
td { border-bottom: 1px solid var(--line); padding: .35rem .55rem; vertical-align: top; }
th.n, td.n { text-align: right; font-variant-numeric: tabular-nums; }
td[data-is=where] { color: var(--soft); min-width: 6.5rem; } td[data-is=what] { min-width: 18rem; }
td[data-is=printed], td[data-is=here] { white-space: nowrap; } td[data-is="agrees within"] { min-width: 8rem; }
td.v { font-weight: 600; min-width: 8.5rem; } .good { color: var(--good); } .erratum { color: var(--erratum); }
td.open { font-weight: 400; } .open { color: var(--open); } .bad { color: var(--bad); }
@media (max-width: 62rem) { td[data-is=where] { min-width: 4.2rem; } td[data-is=what] { min-width: 12rem; }
  td[data-is="agrees within"] { min-width: 6rem; } td.v { min-width: 0; } td, th { padding: .3rem; } }
figure { overflow-x: auto; }
figure img { display: block; max-width: 100%; height: auto; background: #fff; border-radius: .4rem;
  border: 1px solid var(--line); padding: .4rem; }
@media (max-width: 46rem) {
  body { padding: 1rem .75rem 3rem; } .counts { grid-template-columns: repeat(auto-fit, minmax(9.5rem, 1fr)); }
  nav ul { columns: 1; } nav li { padding: .15rem 0; }
  figure img { max-width: none; width: 44rem; }
  thead { position: absolute; clip-path: inset(50%); width: 1px; height: 1px; overflow: hidden; }
  table, tbody, tr, td { display: block; } tr { padding: .5rem .2rem; border-bottom: 1px solid var(--line); }
  td, td.n, td[data-is=what] { border: 0; padding: .1rem .3rem; text-align: left; min-width: 0; white-space: normal; }
  td:empty { display: none; }
  td:not([data-is=what])::before { content: attr(data-is) ": "; color: var(--soft); font-weight: 400; }
  td br { display: none; } td[data-is=what] br { display: inline; } td small { margin-left: .4rem; }
  td[data-is=what] small { margin: 0; } }
@media print { :root { color-scheme: light; --ink: #000; --soft: #444; --paper: #fff; --line: #bbb; --good: #0a4d1f;
  --erratum: #5c3900; --open: #444; --bad: #8f0000; --link: #000; }
  body { max-width: none; padding: 0; font-size: 9.5pt; }
  nav { display: none; } tr, figure { break-inside: avoid; } h2, summary { break-after: avoid; }
  thead { display: table-header-group; } .wide, figure { overflow: visible; }
  td[data-is=what], td[data-is=where], td.v { min-width: 0; }
  details { border: 0; } details::details-content { content-visibility: visible; height: auto; }
  summary { list-style: none; padding: .6rem 0; }
  @page { margin: 15mm; } }
"""

#: Everything can be read without it: it adds two buttons, and unfolds what a link leads to and what is printed.
SCRIPT = """
const parts = [...document.querySelectorAll('details')];
const reveal = () => {
  const goal = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
  const part = goal && goal.closest('details');
  if (part) { part.open = true; goal.scrollIntoView(); }
};
addEventListener('hashchange', reveal);
document.addEventListener('click', event => {
  const link = event.target.closest('a');
  if (link && link.hash === location.hash) reveal();
});
let folded = [];
addEventListener('beforeprint', () => {
  folded = parts.filter(part => !part.open);
  folded.forEach(part => { part.open = true; });
});
addEventListener('afterprint', () => folded.forEach(part => { part.open = false; }));
for (const [text, open] of [['Unfold all', true], ['Fold all', false]]) {
  const button = document.createElement('button');
  button.textContent = text;
  button.onclick = () => parts.forEach(part => { part.open = open; });
  document.getElementById('folding').append(button);
}
reveal();
"""


_PAPERS = {
    "bai2012": "Bai et al. 2012: a ball-joint-like spherical motor as a two-mode haptic device",
    "zarate2020": "Zárate et al. 2020: a spherical electromagnet for contact-free haptics",
}
_HEAVY = 300_000  #: bytes of SVG from which a picture is drawn as PNG

_LEAD = (
    "The printed values, the values computed here, the tolerance, and its reason. Only the first two classes are "
    "evidence about the papers: there a computation that does not contain the printed value agrees with it, or with "
    "a correction of it. For each of them, some change of one factor or sign in the code makes it fail. An erratum "
    "(E1, E2, …) is explained, with its evidence, on the errata page of the documentation. “Implied” "
    "marks a number that is not printed but follows from the paper: an equation's value, a ratio, a sign, 1 for “all "
    "of "
    "them”."
)


def report_page(made: Iterable[ReproductionResult]) -> str:
    """The page as text: all of `made`, paper by paper; every part folds, and is whole in print."""
    every = list(made)
    items = [item for one in every for item in one.items]
    parts = [
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>Two papers, number by number</title><style>{STYLE}</style></head><body>",
        f"<header><h1>Two papers, number by number</h1><p class='soft'>haptorb {escape(__version__)}. {_LEAD}</p>",
        _counts(items),
        _differing(items),
        "</header>",
        _contents(every),
        "<main>",
    ]
    for paper in _papers(every):
        parts.append(f"<h2 id='{paper}'>{_title(paper)}</h2>")
        parts += [_part(one) for one in every if one.of.paper == paper]
    return "\n".join([*parts, f"</main><script>{SCRIPT}</script></body></html>\n"])


def _papers(every: list[ReproductionResult]) -> list[str]:
    return list(dict.fromkeys(one.of.paper for one in every))


def _title(paper: str) -> str:
    return escape(_PAPERS.get(paper, paper))


def _counts(items: list[Item]) -> str:
    cells = "".join(
        f"<li><b class='{css_class(verdict) if count else 'open'}'>{count}</b>{escape(verdict)}"
        f"<small>{escape(MEANINGS[verdict])}</small></li>"
        for verdict, count in summary(items).items()
    )
    return f"<ul class='counts'>{cells}</ul>"


def _differing(items: list[Item]) -> str:
    """Section that is always unfolded: the statements that deviate, with links to their rows."""
    rows = "".join(
        f"<li><a href='#{item_anchor(item)}'>{escape(item.where)}</a>: {escape(item.what)}</li>"
        for item in items
        if item.verdict == "differs"
    )
    return f"<section class='differing'><h2>What differs</h2><ul>{rows}</ul></section>" if rows else ""


def _contents(every: list[ReproductionResult]) -> str:
    lists = "".join(
        f"<h3><a href='#{paper}'>{_title(paper)}</a></h3><ul>"
        + "".join(
            f"<li><a href='#{_anchor(one.of)}'>{escape(_capitalize(one.of.name))}</a> "
            f"<small>{escape(one.of.title)}</small></li>"
            for one in every
            if one.of.paper == paper
        )
        + "</ul>"
        for paper in _papers(every)
    )
    return f"<nav aria-labelledby='contents'><h2 id='contents'>Contents</h2>{lists}<p id='folding'></p></nav>"


def _part(one: ReproductionResult) -> str:
    figure = _figure(one.of, one.draw) if one.draw else ""
    title = f"{escape(_capitalize(one.of.name))} <span>· {escape(one.of.title)}</span>"
    tally = " · ".join(
        f"<span class='{css_class(verdict)}'>{count} {escape(verdict)}</span>"
        for verdict, count in summary(one.items).items()
        if count
    )
    return (
        f"<details id='{_anchor(one.of)}'><summary><h3>{title}</h3><p class='tally'>{tally}</p></summary>"
        f"{figure}{statement_table(one.items)}</details>"
    )


def _figure(one: Reproduction, draw: Drawing) -> str:
    with TemporaryDirectory() as folder:
        picture, kind = draw(Path(folder, "figure.svg")).read_bytes(), "svg+xml"
        if len(picture) > _HEAVY:
            picture, kind = draw(Path(folder, "figure.png")).read_bytes(), "png"
    data = b64encode(picture).decode("ascii")
    about = escape(f"{_capitalize(one.name)}: {one.title}", quote=True)
    return (
        f"<figure tabindex='0' aria-label='{about}'><img alt='{about}' decoding='async' "
        f"src='data:image/{kind};base64,{data}'></figure>"
    )


def _capitalize(name: str) -> str:
    return name[0].upper() + name[1:]


def _anchor(one: Reproduction) -> str:
    return f"{one.paper}-{one.name}".replace(" ", "-").replace(".", "")
