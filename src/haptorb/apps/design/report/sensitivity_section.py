"""What each parameter does to each objective, as tables with bars; nothing of it needs a script."""

from __future__ import annotations

from html import escape

import numpy as np
from numpy.typing import NDArray

from haptorb.apps.design.results_table import ResultsColumn, ResultsTable
from haptorb.design.analysis.sensitivity import FEWEST, Sensitivity, estimate_sensitivity
from haptorb.design.sampling import METHODS

__all__ = ["make_sensitivity_section"]

_WIDE, _HIGH = 240, 22  #: of a bar's picture [px]

_LEAD = (
    "Share: of the variance of the objective (of its ranks), the part that this parameter alone explains; what the "
    "shares together lack of 100 % comes from parameters that act together. Direction: rank correlation, +1 if the "
    "objective grows with the parameter, −1 if it falls; near 0 beside a large share, the best value is within the "
    "range. Lines and brackets are 95 % intervals. Both hold for the valid designs within the ranges that were tried: "
    "where constraints reject designs, parameters become dependent, and one can carry another’s share."
)


def make_sensitivity_section(table: ResultsTable) -> str:
    """HTML: one table for each objective, and what it was estimated from."""
    rows, source = _choose_rows(table)
    head = f"<p class='soft'>{escape(_LEAD)}</p><p>{escape(source)}</p>"
    if rows.size < FEWEST:
        return head
    tables = (
        _make_table(objective, [(one, _estimate(one, objective, rows)) for one in table.select("parameter")])
        for objective in table.select("objective")
    )
    return head + "".join(tables)


def _choose_rows(table: ResultsTable) -> tuple[NDArray[np.int_], str]:
    """Rows that are looked at, and a sentence on them: the sweeps', where there are enough."""
    every = np.arange(len(table.found))
    swept = np.array([run.method in METHODS for run, _ in table.found], dtype=bool)
    if swept.sum() >= FEWEST:
        others = (
            "" if swept.all() else "; those of the optimiser, which are concentrated where it searched, are left out"
        )
        return every[swept], f"From the {swept.sum()} valid designs of sweeps{others}."
    if every.size >= FEWEST:
        return every, (
            f"From all {every.size} valid designs. An optimiser chose them, so they are concentrated where it "
            "searched and the numbers are rough. A sweep into the same file gives better ones."
        )
    return every, f"{every.size} valid designs are not enough: at least {FEWEST} are needed. Compute more."


def _estimate(parameter: ResultsColumn, objective: ResultsColumn, rows: NDArray[np.int_]) -> Sensitivity:
    return estimate_sensitivity(parameter.values[rows], objective.values[rows], ordered=not parameter.labels)


def _make_table(objective: ResultsColumn, found: list[tuple[ResultsColumn, Sensitivity]]) -> str:
    found = sorted(found, key=lambda pair: -pair[1].share)
    lines = "".join(
        f"<tr><th scope='row'>{escape(parameter.title)}</th><td>{_draw_bar(one)}</td>"
        f"<td class='n'>{one.share:.0%} <small class='soft'>[{one.share_interval[0]:.0%}, "
        f"{one.share_interval[1]:.0%}]</small></td><td class='n'>{_tell_direction(one)}</td></tr>"
        for parameter, one in found
    )
    together = sum(one.share for _, one in found)
    rest = f"Sum {together:.0%}." if together < 1 else "Sum above 100 %: the parameters are dependent."
    return (
        f"<div class='wide' tabindex='0'><table class='table'><caption>{escape(objective.title)} "
        f"<span class='soft'>({rest})</span></caption><thead><tr><th scope='col'>parameter</th>"
        "<th scope='col'><span class='soft'>0 to 100 %</span></th><th scope='col' class='n'>share [95 %]</th>"
        f"<th scope='col' class='n'>direction [95 %]</th></tr></thead><tbody>{lines}</tbody></table></div>"
    )


def _tell_direction(one: Sensitivity) -> str:
    if one.direction is None or one.direction_interval is None:
        return "<span class='soft'>a choice</span>"
    low, high = one.direction_interval
    text = f"{one.direction:+.2f} <small class='soft'>[{low:+.2f}, {high:+.2f}]</small>"
    return text.replace("-", "−")


def _draw_bar(one: Sensitivity) -> str:
    low, high = (share * _WIDE for share in one.share_interval)
    middle = _HIGH / 2
    return (
        f"<svg class='bar' viewBox='0 0 {_WIDE} {_HIGH}' preserveAspectRatio='none' aria-hidden='true'>"
        f"<line class='scale' x1='0' x2='{_WIDE}' y1='{_HIGH - 1}' y2='{_HIGH - 1}'/>"
        f"<rect x='0' y='5' width='{one.share * _WIDE:.1f}' height='{_HIGH - 10}'/>"
        f"<line x1='{low:.1f}' x2='{high:.1f}' y1='{middle}' y2='{middle}'/>"
        f"<line x1='{low:.1f}' x2='{low:.1f}' y1='6' y2='{_HIGH - 6}'/>"
        f"<line x1='{high:.1f}' x2='{high:.1f}' y1='6' y2='{_HIGH - 6}'/></svg>"
    )
