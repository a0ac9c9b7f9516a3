"""One published statement, the computed counterpart, and the class of evidence that follows from its method."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from haptorb.errors import InputError, quote

__all__ = ["CLASSES", "MEANINGS", "Basis", "Item", "exempt"]

#: How the number here was obtained: computed without the printed one, held by a file or a table of the package, assumed
#: or fitted so that the printed one comes out, set and then found again by a computation that starts from it, or
#: computed to be compared with another number of this project.
Basis = Literal["computed", "held", "assumed", "set", "own"]

#: The classes, and what each of them says
MEANINGS = {
    "reproduced": "a computation that did not get the printed number as an input agrees with it",
    "implied": "no number is printed; an independent computation agrees with what an equation or sentence implies",
    "set and found": "a value that was set is found again at the other end of the code; not evidence about the paper",
    "contradicted": (
        "the computation contradicts what is printed or implied and agrees with a correction that has evidence: an "
        "erratum"
    ),
    "differs": "the computation agrees neither with the printed value nor with a correction",
    "transcribed": "a device file, a world or a table of haptorb contains the value; nothing is computed",
    "assumed": "the printed value was an input of the model, by an assumption or a fit, so agreement shows nothing",
    "ours": "the paper prints no such value",
    "not checkable": "no computation can verify it",
}
CLASSES = tuple(MEANINGS)

_CLASS_OF: dict[Basis, str] = {"held": "transcribed", "assumed": "assumed", "set": "set and found", "own": "ours"}
_PAPERS = ("bai2012", "zarate2020")


@dataclass(frozen=True)
class Item:
    """A statement of a paper against ours. Build it by a `Citation`, which knows the basis from what it is given.

    Raises InputError for a statement without a source: a known paper, and a place in it.

    id          short and unique within its paper
    paper       key in references.bib
    where       figure, table, equation or section
    what        the quantity, in words
    published   as printed or as the text says; None where the paper gives no number
    implied     `published` is no number in print: it follows from what is printed or said (an equation's value, a
                ratio, "all of them" as 1)
    computed    here, in `unit`; None where nothing can be computed
    unit        of both; "1" for plain numbers
    tolerance   greatest difference that still agrees, in `unit`; None where there is nothing to compare with
    erratum     of ours that stands behind the number, such as "E7"; empty for none
    corrected   what stands in the print's place by that erratum; None where the printed number itself is kept
    why         why this tolerance, or why it cannot be checked
    basis       how `computed` was obtained
    held_at     where the package holds it; empty for what is computed
    known       why it differs and what it would take, where that is known: such a difference stays in its class, but
                is no news
    """

    id: str
    paper: str
    where: str
    what: str
    published: float | None
    computed: float | None
    unit: str
    tolerance: float | None
    erratum: str = ""
    corrected: float | None = None
    why: str = ""
    implied: bool = False
    basis: Basis = "computed"
    held_at: str = ""
    known: str = ""

    def __post_init__(self) -> None:
        if self.paper not in _PAPERS or not self.where.strip():
            raise InputError(
                f"row '{self.id}' has no source: paper {quote(self.paper)}, place {quote(self.where)}; name one of "
                f"{', '.join(_PAPERS)} and the figure, table, equation or section"
            )

    @property
    def verdict(self) -> str:
        """One of CLASSES. NaN differs, and so does a correction missed.

        >>> Item("x", "bai2012", "Fig. 8", "a force", 1.0, 1.02, "N", 0.05).verdict
        'reproduced'
        >>> Item("y", "zarate2020", "§II.B", "current", 24.0, 20.0, "A", 0.1, "E15", corrected=20.0).verdict
        'contradicted'
        >>> Item("z", "zarate2020", "§II.B", "supply", 12.0, 12.0, "V", 0.1, basis="held").verdict
        'transcribed'
        """
        if self.computed is None:
            return "not checkable"
        if not math.isfinite(self.computed):
            return "differs"
        goal = self.published if self.corrected is None else self.corrected
        if goal is None or self.tolerance is None:
            return "ours"
        if not abs(self.computed - goal) <= self.tolerance:
            return "differs"
        if self.basis in _CLASS_OF:
            return _CLASS_OF[self.basis]
        return "contradicted" if self.is_corrected else "implied" if self.implied else "reproduced"

    @property
    def is_corrected(self) -> bool:
        """Whether a correction replaces the printed value, which does not satisfy it."""
        if self.corrected is None or self.published is None or self.tolerance is None:
            return False
        return not abs(self.published - self.corrected) <= self.tolerance

    @property
    def is_surprise(self) -> bool:
        """Whether it deviates without an explanation.

        >>> Item("x", "bai2012", "Fig. 4", "R²", 1.0, 0.8, "1", 0.001, known="ten nodes do no better").is_surprise
        False
        """
        return self.verdict == "differs" and not self.known

    @property
    def checked(self) -> bool:
        """Whether a number was compared with another one."""
        return self.computed is not None and self.tolerance is not None

    @property
    def label(self) -> str:
        """The class, with the erratum behind it.

        >>> Item("y", "zarate2020", "§II.B", "current", 24.0, 20.0, "A", 0.1, "E15", corrected=20.0).label
        'contradicted (E15)'
        """
        return f"{self.verdict} ({self.erratum})" if self.erratum else self.verdict

    @property
    def reason(self) -> str:
        """`why`, or where nothing was said, what the class says of a value that was not computed."""
        if self.known and self.verdict == "differs":
            return self.known
        if self.why or self.verdict in ("reproduced", "implied", "contradicted", "differs", "not checkable"):
            return self.why
        return f"from {self.held_at}" if self.held_at else MEANINGS[self.verdict]

    def numbers(self) -> dict[str, Any]:
        """Convert to plain JSON types."""
        return {**self.__dict__, "why": self.reason, "verdict": self.verdict}


def exempt(id: str, paper: str, where: str, what: str, why: str) -> Item:
    """A statement that no computation can check, and why.

    >>> exempt("photo", "zarate2020", "Fig. 1", "the prototype in use", "a photograph").verdict
    'not checkable'
    """
    return Item(id, paper, where, what, None, None, "", None, why=why)
