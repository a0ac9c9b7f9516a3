"""One published statement, and what is computed here in its place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

__all__ = ["VERDICTS", "Item", "exempt"]

VERDICTS = ("reproduced", "reproduced with erratum", "cannot be checked", "differs")


@dataclass(frozen=True)
class Item:
    """A statement of a paper against ours.

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

    @property
    def verdict(self) -> str:
        """One of VERDICTS, the second one with its erratum's name. NaN differs, and so does a correction missed.

        >>> Item("x", "bai2012", "Fig. 8", "a force", 1.0, 1.02, "N", 0.05).verdict
        'reproduced'
        >>> Item("y", "zarate2020", "§II.B", "current", 24.0, 20.0, "A", 0.1, "E15", corrected=20.0).verdict
        'reproduced with erratum E15'
        """
        if self.computed is not None and not math.isfinite(self.computed):
            return "differs"
        goal = self.published if self.corrected is None else self.corrected
        if self.computed is None or goal is None or self.tolerance is None:
            return "cannot be checked"
        if not abs(self.computed - goal) <= self.tolerance:
            return "differs"
        return f"reproduced with erratum {self.erratum}" if self.erratum else "reproduced"

    @property
    def checked(self) -> bool:
        """Whether a number of ours was held against one of the paper."""
        return self.verdict != "cannot be checked"

    @property
    def reason(self) -> str:
        """`why`, and where nothing was said, that the paper prints no number."""
        return self.why or ("" if self.checked else "the paper prints no number; this is ours")

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {**self.__dict__, "why": self.reason, "verdict": self.verdict}


def exempt(id: str, paper: str, where: str, what: str, why: str) -> Item:
    """A statement that no computation can check, and why.

    >>> exempt("photo", "zarate2020", "Fig. 1", "the prototype in use", "a photograph").verdict
    'cannot be checked'
    """
    return Item(id, paper, where, what, None, None, "", None, why=why)
