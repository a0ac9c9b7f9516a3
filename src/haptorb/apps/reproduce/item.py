"""One published statement, and what is computed here in its place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

__all__ = ["Item"]


@dataclass(frozen=True)
class Item:
    """A number of a paper against ours.

    id          short and unique within its paper
    paper       key in references.bib
    where       figure, table or equation
    what        the quantity, in words
    published   as printed or as the text says; None where the paper gives no number
    computed    here, in `unit`
    tolerance   greatest difference that still agrees, in `unit`; None where there is nothing to compare with
    erratum     of ours that explains a difference, such as "E7"; empty for none
    """

    id: str
    paper: str
    where: str
    what: str
    published: float | None
    computed: float
    unit: str
    tolerance: float | None
    erratum: str = ""

    @property
    def verdict(self) -> str:
        """ "agrees", "differs", "differs as erratum E… says", or "no number printed"; NaN always differs.

        >>> Item("x", "bai2012", "Fig. 8", "a force", 1.0, 1.02, "N", 0.05).verdict
        'agrees'
        """
        if not math.isfinite(self.computed):
            return "differs"
        if self.published is None or self.tolerance is None:
            return "no number printed"
        if abs(self.computed - self.published) <= self.tolerance:
            return "agrees"
        return f"differs as erratum {self.erratum} says" if self.erratum else "differs"

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {**self.__dict__, "verdict": self.verdict}
