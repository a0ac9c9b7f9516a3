"""What can be reproduced: a figure or a table of a paper is one line here and one file beside this one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from haptorb.apps.reproduce.item import Item
from haptorb.errors import UnknownName

__all__ = ["PAPERS", "Report", "Reproduction", "reproduced", "reproductions"]

PAPERS = ("bai2012", "zarate2020")

#: called with (share done, from 0 to 1)
Report = Callable[[float], None]


@dataclass(frozen=True)
class Reproduction:
    """One figure or table.

    paper    key in references.bib
    name     "figure 8", "table 1", ...
    title    one line
    module   that has `items(report) -> (items, draw)`; loaded only when it is asked for
    """

    paper: str
    name: str
    title: str
    module: str

    def made(self, report: Report = lambda share: None) -> tuple[tuple[Item, ...], Callable[[Path], Path]]:
        """The items, and what draws the figure into a PNG or SVG file."""
        items, draw = import_module(self.module).items(report)
        return items, draw


_ALL = (
    Reproduction(
        "bai2012", "figure 4", "From field to torque per ampere: network, linear map, least squares",
        "haptorb.apps.reproduce.bai2012_figure_4",
    ),
    Reproduction(
        "bai2012", "figure 8", "Two phases of pulling a plug, felt through the chain",
        "haptorb.apps.reproduce.bai2012_figure_8",
    ),
    Reproduction(
        "zarate2020", "figure 6", "A coil heated and cooled, and the endurances that follow",
        "haptorb.apps.reproduce.zarate2020_figure_6",
    ),
    Reproduction(
        "zarate2020", "drive", "Currents in a winding that has become 60 K warmer",
        "haptorb.apps.reproduce.zarate2020_drive",
    ),
    Reproduction(
        "zarate2020", "inverse error", "What the dipole inverse and the exact one deliver over the shell",
        "haptorb.apps.reproduce.zarate2020_inverse_error",
    ),
    Reproduction(
        "zarate2020", "hall position", "The tool's place from the Hall sensors, without a tracker",
        "haptorb.apps.reproduce.zarate2020_hall_position",
    ),
)  # fmt: skip


def reproductions(paper: str | None = None) -> tuple[Reproduction, ...]:
    """All of one paper, or of both."""
    if paper is not None and paper not in PAPERS:
        raise UnknownName("paper", paper, PAPERS)
    return tuple(one for one in _ALL if paper is None or one.paper == paper)


def reproduced(paper: str, name: str) -> Reproduction:
    """The one called `name` ("figure 8"); UnknownName with those that there are."""
    known = {one.name: one for one in reproductions(paper)}
    if name not in known:
        raise UnknownName(f"figure or table of {paper}", name, known)
    return known[name]
