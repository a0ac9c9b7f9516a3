"""Registry of reproductions: a figure or table of a paper is one line here, and one file beside this one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from haptorb.errors import UnknownName
from haptorb_papers.reproduce.item import Item

__all__ = ["PAPERS", "Drawing", "Report", "Reproduction", "find_reproduction", "reproductions"]

PAPERS = ("bai2012", "zarate2020")

#: called with (share done, from 0 to 1)
Report = Callable[[float], None]
#: called with a path that ends in .png or .svg; returns it
Drawing = Callable[[Path], Path]


@dataclass(frozen=True)
class Reproduction:
    """One figure, table, appendix or section; its module is called after paper and name, and loaded when asked for.

    paper    key in references.bib
    name     "figure 8", "table A.1", "section III", ...
    title    one line
    slow     takes more than a few seconds
    """

    paper: str
    name: str
    title: str
    slow: bool = False

    def make(self, report: Report = lambda share: None) -> tuple[tuple[Item, ...], Drawing | None]:
        """The items, and what draws the figure into a PNG or SVG file, where there is one."""
        items, draw = import_module(self.module).items(report)
        return items, draw

    @property
    def module(self) -> str:
        """Module that computes it: has `items(report) -> (items, drawing or None)`."""
        name = self.name.lower().replace(" to ", " ").replace(" and ", " ").replace(".", "").replace(" ", "_")
        return f"haptorb_papers.reproduce.{self.paper}.{name}"


# In the order of the papers; a figure or table of your own is one line here.
_ALL = (
    Reproduction("bai2012", "text", "Statements of the text about the motor"),
    Reproduction("bai2012", "equations 1 to 6", "Linear torque, least power, two modes"),
    Reproduction("bai2012", "table 1", "Magnets, coils and their multipole models"),
    Reproduction("bai2012", "equations 7 to 9", "Multipoles, their field and torque"),
    Reproduction("bai2012", "table 2", "Twelve pairs of coils"),
    Reproduction("bai2012", "figure 5", "Design loop and support of the rotor"),
    Reproduction("bai2012", "table A.1", "Positions of magnets, coils and sensors"),
    Reproduction("bai2012", "figure 4", "From field to torque per ampere: network, linear map, least squares",
                 slow=True),
    Reproduction("bai2012", "figure 6", "Hook and friction on its faces"),
    Reproduction("bai2012", "table 3", "Dimensions and materials of the outlet"),
    Reproduction("bai2012", "figure 7", "A tilted plug between two hooks"),
    Reproduction("bai2012", "appendix B", "Compliances in closed form"),
    Reproduction("bai2012", "figure 8", "Two phases of pulling a plug, through the complete simulation", slow=True),
    Reproduction("zarate2020", "equations 1 and 2", "Two dipoles and their force over distance"),
    Reproduction("zarate2020", "figure 2", "Force maps: magnet, adjustable, surface"),
    Reproduction("zarate2020", "figure 3", "Code of force map and inverse"),
    Reproduction("zarate2020", "hardware", "Parts of the prototype and response of the core"),
    Reproduction("zarate2020", "equations 3 to 6", "From moment to duty; calibration"),
    Reproduction("zarate2020", "forces", "Power, current, force and heat"),
    Reproduction("zarate2020", "figure 6", "Heating and cooling of a coil, and its endurance"),
    Reproduction("zarate2020", "figure 7", "The core's moment against the currents, from the Hall sensors"),
    Reproduction("zarate2020", "drive", "Currents in a winding 60 K warmer"),
    Reproduction("zarate2020", "inverse error", "Forces of the dipole inverse and the exact inverse over the shell"),
    Reproduction("zarate2020", "hall position", "Tool position from the Hall sensors, without a tracker",
                 slow=True),
    Reproduction("zarate2020", "study", "Set-points and order of the study"),
)  # fmt: skip


def reproductions(paper: str | None = None) -> tuple[Reproduction, ...]:
    """All of one paper, or of both."""
    if paper is not None and paper not in PAPERS:
        raise UnknownName("paper", paper, PAPERS)
    return tuple(one for one in _ALL if paper is None or one.paper == paper)


def find_reproduction(paper: str, name: str) -> Reproduction:
    """The one called `name` ("figure 8"); UnknownName with those that there are."""
    known = {one.name: one for one in reproductions(paper)}
    if name not in known:
        raise UnknownName(f"figure or table of {paper}", name, known)
    return known[name]
