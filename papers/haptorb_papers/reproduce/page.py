"""The page of `haptorb reproduce`: counts, contents, and parts that fold, with their figures; nothing is fetched."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory

from haptorb.version import __version__
from haptorb_papers.reproduce.item import MEANINGS, Item
from haptorb_papers.reproduce.page_style import SCRIPT, STYLE
from haptorb_papers.reproduce.registry import Drawing, Reproduction
from haptorb_papers.reproduce.report import ReproductionResult, summary
from haptorb_papers.reproduce.statement_table import css_class, item_anchor, statement_table

__all__ = ["report_page"]

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
    """What a reader must not have to unfold: the statements that differ, with links to their rows."""
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
