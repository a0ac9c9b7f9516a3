"""The front of two objectives in results of `haptorb design optimise`: as a table, and as a figure.

    haptorb design optimise examples/design/omni-core.toml --population 100 --generations 80 --into core.sqlite
    python benchmarks/design/front.py core.sqlite [MORE.sqlite ...] [--rows 8] [--figure front.svg] [--json]

For every file: the best first objective among the designs that are no worse than the base device in the second, and
designs from one end of the front to the other, each with its share of the base device's numbers. All files must have
the same objectives.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from haptorb.display import format_number
from haptorb_design.results_table import ResultsColumn, ResultsTable
from haptorb_design.store import read_results


@dataclass(frozen=True)
class Front:
    """The front of one results file, from the least first objective to the greatest.

    goals   the two objectives
    rows    of the table, on the front
    best    the row with the best first objective that is no worse than the base device in the second; None: no such
    """

    table: ResultsTable
    goals: tuple[ResultsColumn, ResultsColumn]
    rows: tuple[int, ...]
    best: int | None

    @classmethod
    def of(cls, path: Path) -> Front:
        """The front of the results at `path`."""
        table = ResultsTable.of(read_results(path))
        first, second = table.select("objective")
        rows = sorted(table.front, key=lambda row: float(first.values[row]))
        no_worse = [row for row in rows if second.sense * (second.values[row] - second.base) >= 0]
        best = max(no_worse, key=lambda row: first.sense * float(first.values[row]), default=None)
        return cls(table, (first, second), tuple(rows), best)

    def spread(self, count: int) -> list[int]:
        """At most `count` rows along the front, about equally far apart in the first objective, and `best`."""
        values = self.goals[0].values[list(self.rows)]
        wanted = np.linspace(values[0], values[-1], count)
        found = {self.rows[int(np.argmin(np.abs(values - one)))] for one in wanted}
        return [row for row in self.rows if row in found or row == self.best]

    def describe(self, row: int) -> dict[str, Any]:
        """The design's name, objectives with their shares of the base device's, and parameters."""
        numbers = {one.name: [float(one.values[row]), float(one.values[row]) / one.base] for one in self.goals}
        return {"name": self.table.name(row), **numbers, "values": dict(self.table.found[row][1].values)}


def draw(fronts: list[Front], path: Path) -> None:
    """All fronts and the base device over the two objectives."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    first, second = fronts[0].goals
    for front in fronts:
        x, y = ([float(one.values[row]) for row in front.rows] for one in front.goals)
        axes.plot(x, y, ".-", markersize=4, linewidth=1, label=front.table.design.title)
    axes.plot([first.base], [second.base], "D", color="tab:red", label=f"base device {fronts[0].table.design.base}")
    axes.axvline(0.5 * first.base, color="0.6", linestyle=":", linewidth=1)
    axes.axhline(second.base, color="0.6", linestyle=":", linewidth=1)
    axes.set_xlabel(f"{first.title} [{first.unit}]")
    axes.set_ylabel(f"{second.title} [{second.unit}]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=120, metadata={"Date": None} if path.suffix == ".svg" else None)


def tell(front: Front, count: int) -> None:
    """Print a table, for a page of Markdown."""
    base = front.table.design.base
    print(f"{front.table.design.title}: {front.table.total} designs, {len(front.table.found)} valid, "
          f"{len(front.rows)} on the front")  # fmt: skip
    print("| | " + " | ".join(f"{one.title} [{one.unit}] | of {base}'s" for one in front.goals) + " |")
    print("|---" * (1 + 2 * len(front.goals)) + "|")
    for row in front.spread(count):
        shown = (f"{format_number(one.values[row], 4)} | × {one.values[row] / one.base:.2f}" for one in front.goals)
        print(f"| {front.table.name(row)}{' (best)' if row == front.best else ''} | " + " | ".join(shown) + " |")
    if front.best is None:
        print(f"No design of the front is as good as {base} in {front.goals[1].title}.")
    else:
        print(f"best: {front.describe(front.best)}")


def main() -> None:
    """Print the tables, and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", nargs="+", type=Path)
    parser.add_argument("--rows", type=int, default=8)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    fronts = [Front.of(path) for path in options.results]
    if options.figure:
        draw(fronts, options.figure)
    if options.json:
        numbers = {
            front.table.design.name: {
                "designs": front.table.total, "valid": len(front.table.found),
                "best": None if front.best is None else front.describe(front.best),
                "front": [front.describe(row) for row in front.spread(options.rows)],
            }
            for front in fronts
        }  # fmt: skip
        print(json.dumps(numbers))
        return
    for front in fronts:
        tell(front, options.rows)


if __name__ == "__main__":
    main()
