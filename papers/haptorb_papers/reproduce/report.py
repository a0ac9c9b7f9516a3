"""Results of one part of a paper, and the number of statements in each class."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from haptorb.display import Presentable
from haptorb_papers.reproduce.item import CLASSES, Item
from haptorb_papers.reproduce.registry import Drawing, Reproduction
from haptorb_papers.reproduce.statement_table import statement_table

__all__ = ["ReproductionResult", "summary"]


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
        return statement_table(self.items)


def summary(items: Iterable[Item]) -> dict[str, int]:
    """Number of items in each class."""
    counts = Counter(item.verdict for item in items)
    return {verdict: counts[verdict] for verdict in CLASSES}
