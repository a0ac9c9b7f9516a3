"""Tables of what holds over people: plan, comparisons, effect sizes, errors on the sphere; for terminal and report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from haptorb.apps.study.analysis.analysis import Analysis
from haptorb.apps.study.analysis.conditions import ConditionComparison
from haptorb.apps.study.analysis.error_by_latitude import ERROR_MEANING
from haptorb.apps.study.analysis.over_people.localisation import Localisation
from haptorb.apps.study.analysis.plan_report import PlanReport
from haptorb.apps.study.analysis.wording import format_range, format_value
from haptorb.apps.terminal import Column, TextTable

__all__ = ["list_group_tables", "list_notes"]

_TESTS = {"t": "Student's t test over people", "sign-flip": "sign-flip test over people"}
_CORRECTIONS = {"holm": "Holm", "bonferroni": "Bonferroni", "none": "no correction"}


def list_group_tables(analysis: Analysis) -> Iterator[TextTable]:
    """Those that the study has, in the order in which they are read."""
    if analysis.localisation is not None:
        yield from _localisation(analysis.localisation)
    planned = [row for row in analysis.comparisons if row.planned]
    others = [row for row in analysis.comparisons if not row.planned]
    if analysis.plan is not None and analysis.plan.outcomes:
        yield _outcomes(analysis.plan)
    for title, rows in (
        ("Planned tests", planned),
        ("Not planned: exploratory" if analysis.plan is not None else "Tests over people", others),
    ):
        if rows:
            yield _comparisons(title, rows, analysis)
    if analysis.comparisons:
        yield _effects([*planned, *others])


def list_notes(analysis: Analysis) -> Iterator[str]:
    """What the tables rest on, a sentence or two each."""
    if analysis.rings:
        yield ERROR_MEANING[analysis.study.procedure]
    if analysis.arrows:
        yield (
            "Wrong answers to: set-points that received a third or more of the wrong answers, how many of how many; "
            "all conditions together."
        )
    if (found := analysis.localisation) is not None:
        yield (
            f"Errors on the sphere: {found.answers}, as vectors in the tangent plane at the set-point; up: along the "
            "meridian towards the top; around: towards larger φ. The top has no meridian; set-points on the "
            "outermost ring of an identification, below which there are no answers, are left out of up. "
            "Variable error: about each person's mean at each set-point. κ: Fisher's concentration; SD: 1/√κ."
        )
        if any(one.chance > 0 for one in found.information.values()):
            yield (
                "Information transferred, T: pooled over people as in Miller & Nicely 1955, corrected for few answers; "
                "95 % by jackknife over people. Plug-in: not corrected; chance: with shuffled answers."
            )
    if analysis.comparisons:
        row = analysis.comparisons[0]
        correction = _CORRECTIONS[(analysis.plan and analysis.plan.correction) or "holm"]
        alike = "; if all values are equal, a sign-flip test" if row.test == "t" else ""
        yield (
            f"p: two-sided {_TESTS[row.test]}, one value per person{alike}. Corrected: {correction}, separately for "
            "planned tests, tests over all conditions, and pairs of conditions. Intervals: Student's t over people; of "
            "the effect sizes d_z and Hedges' g_av, noncentral t."
        )


def _localisation(found: Localisation) -> Iterator[TextTable]:
    yield _table(
        f"Errors on the sphere: {found.answers}",
        (Column("along", kind="key"), Column("answers"), Column("constant", "°"), Column("95 %", "°"), Column("p"),
         Column("variable", "°")),
        ((axis.axis, str(axis.trials), format_value(axis.constant.mean, ".2f"),
          format_range((axis.constant.low, axis.constant.high), ".2f"), format_value(axis.constant.p, ".3g"),
          format_value(axis.variable, ".2f")) for axis in found.axes),
    )  # fmt: skip
    if (slope := found.slope) is not None and math.isfinite(slope.mean):
        yield _table(
            "Error over θ as a line",
            (Column("slope", "mm/°"), Column("95 %", "mm/°"), Column("p"), Column("at θ = 0", "mm"), Column("people")),
            [(format_value(slope.mean, ".4f"), format_range((slope.low, slope.high), ".4f"),
              format_value(slope.p, ".3g"), format_value(found.intercept, ".2f"), str(slope.people))],
        )  # fmt: skip
    yield _table(
        "Answers about each set-point",
        (Column("set-point", kind="key"), Column("answers"), Column("up", "°"), Column("around", "°"),
         Column("mean θ", "°"), Column("mean φ", "°"), Column("resultant"), Column("κ"), Column("SD", "°")),
        ((str(x.set_point), str(x.spread.count), format_value(x.up, ".1f"), format_value(x.around, ".1f"),
          format_value(x.spread.theta_deg, ".1f"), format_value(x.spread.phi_deg, ".1f"),
          format_value(x.spread.resultant, ".3f"), "∞" if math.isinf(x.spread.kappa) else
          format_value(x.spread.kappa, ".3g"), format_value(x.spread.spread_deg, ".1f")) for x in found.places),
    )  # fmt: skip
    if found.information:
        yield _table(
            "Information transferred",
            (Column("condition", kind="key"), Column("T", "bit"), Column("95 %", "bit"),
             Column("maximum", "bit"), Column("plug-in", "bit"), Column("Miller–Madow", "bit"), Column("chance", "bit"),
             Column("p")),
            ((name, format_value(x.bits, ".2f"), format_range((x.low, x.high), ".2f"),
              format_value(x.most, ".2f"), format_value(x.plug_in, ".2f"), format_value(x.miller_madow, ".2f"),
              format_value(x.chance, ".2f"), format_value(x.p, ".2g")) for name, x in found.information.items()),
        )  # fmt: skip


def _outcomes(plan: PlanReport) -> TextTable:
    return _table(
        "The plan",
        (Column("planned", kind="text"), Column("p corrected"), Column("below α", kind="short"),
         Column("smallest effect"), Column("which is", kind="text")),
        ((one.name, "–" if one.found is None else format_value(one.found.p_corrected, ".3g"),
          "yes" if one.significant else "no",
          "–" if one.test.smallest_effect is None else f"{one.test.smallest_effect:g}", one.verdict)
         for one in plan.outcomes),
    )  # fmt: skip


def _comparisons(title: str, rows: Iterable[ConditionComparison], analysis: Analysis) -> TextTable:
    return _table(
        title,
        (Column("test", kind="text"), Column("mean"), Column("95 %"), Column("people"), Column("p"),
         Column("p corrected")),
        ((_test(x), f"{x.difference:.3g}", format_range((x.low, x.high), ".3g"), str(x.people),
          f"{x.p:.3g}", format_value(x.p_corrected, ".3g")) for x in rows),
    )  # fmt: skip


def _effects(rows: Iterable[ConditionComparison]) -> TextTable:
    return _table(
        "Effect sizes",
        (Column("test", kind="text"), Column("d_z"), Column("95 %"), Column("g_av"), Column("95 %")),
        ((_test(x), format_value(e.d_z, ".2f"), format_range(e.d_z_95, ".2f"), format_value(e.g_av, ".2f"),
          format_range(e.g_av_95, ".2f")) for x in rows if (e := x.effect) is not None),
    )  # fmt: skip


def _test(row: ConditionComparison) -> str:
    """Measure, its unit, and the conditions or the claim."""
    unit = row.unit.replace("deg", "°")
    return f"{row.what} [{unit}], {row.name}" if unit else f"{row.what}, {row.name}"


def _table(title: str, columns: tuple[Column, ...], rows: Iterable[tuple[str, ...]]) -> TextTable:
    return TextTable(columns, title, list(rows))
