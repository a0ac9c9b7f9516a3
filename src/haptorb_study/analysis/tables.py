"""Tables of the population results: plan, comparisons, effect sizes, spherical errors; for terminal and report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from rich.console import Console

from haptorb.terminal import Column, TextTable, make_console, print_table, print_text
from haptorb_study.analysis.comparison import ConditionComparison
from haptorb_study.analysis.condition_means import make_condition_table
from haptorb_study.analysis.confusion import describe_accuracy, list_wrong_answers
from haptorb_study.analysis.curves import JND
from haptorb_study.analysis.error_by_latitude import ERROR_MEANING, name_error
from haptorb_study.analysis.localisation import Localisation
from haptorb_study.analysis.magnitude import make_magnitude_tables
from haptorb_study.analysis.number_format import format_p, format_range, format_value
from haptorb_study.analysis.plan_report import PlanReport
from haptorb_study.analysis.response_times import make_response_table
from haptorb_study.analysis.results import StudyResults
from haptorb_study.incidents import count_incidents
from haptorb_study.statistics.significance import CORRECTIONS

__all__ = ["list_group_tables", "list_notes", "list_psychometric_notes", "list_psychometric_tables", "print_summary"]


_TESTS = {"t": "Student's t test over participants", "sign-flip": "sign-flip test over participants"}


def list_group_tables(analysis: StudyResults) -> Iterator[TextTable]:
    """The study's tables, in reading order."""
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


def list_notes(analysis: StudyResults) -> Iterator[str]:
    """Notes on the methods behind the tables."""
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
        correction = CORRECTIONS[(analysis.plan and analysis.plan.correction) or "holm"]
        alike = "; if all values are equal, a sign-flip test" if row.test == "t" else ""
        yield (
            f"p: two-sided {_TESTS[row.test]}, one value per participant{alike}. With {correction}, separately "
            "for planned tests, tests over all conditions, and pairs of conditions. Intervals: Student's t over "
            "participants; of the effect sizes d_z and Hedges' g_av, noncentral t."
        )


def _localisation(found: Localisation) -> Iterator[TextTable]:
    yield _table(
        f"Errors on the sphere: {found.answers}",
        (Column("along", kind="key"), Column("answers"), Column("constant", "°"), Column("95 % CI", "°"), Column("p"),
         Column("variable", "°")),
        ((axis.axis, str(axis.trials), format_value(axis.constant.mean, ".2f"),
          format_range((axis.constant.low, axis.constant.high), ".2f"), format_value(axis.constant.p, ".3g"),
          format_value(axis.variable, ".2f")) for axis in found.axes),
    )  # fmt: skip
    if (slope := found.slope) is not None and math.isfinite(slope.mean):
        yield _table(
            "Error over θ as a line",
            (Column("slope", "mm/°"), Column("95 % CI", "mm/°"), Column("p"), Column("at θ = 0", "mm"),
             Column("people")),
            [(format_value(slope.mean, ".4f"), format_range((slope.low, slope.high), ".4f"),
              format_value(slope.p, ".3g"), format_value(found.intercept, ".2f"), str(slope.people))],
        )  # fmt: skip
    yield _table(
        "Answers around each set-point",
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
            (Column("condition", kind="key"), Column("T", "bit"), Column("95 % CI", "bit"),
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


def _comparisons(title: str, rows: Iterable[ConditionComparison], analysis: StudyResults) -> TextTable:
    return _table(
        title,
        (Column("test", kind="text"), Column("mean"), Column("95 % CI"), Column("people"), Column("p"),
         Column("p corrected")),
        ((_test(x), f"{x.difference:.3g}", format_range((x.low, x.high), ".3g"), str(x.people),
          f"{x.p:.3g}", format_value(x.p_corrected, ".3g")) for x in rows),
    )  # fmt: skip


def _effects(rows: Iterable[ConditionComparison]) -> TextTable:
    return _table(
        "Effect sizes",
        (Column("test", kind="text"), Column("d_z"), Column("95 % CI"), Column("g_av"), Column("95 % CI")),
        ((_test(x), format_value(e.d_z, ".2f"), format_range(e.d_z_95, ".2f"), format_value(e.g_av, ".2f"),
          format_range(e.g_av_95, ".2f")) for x in rows if (e := x.effect) is not None),
    )  # fmt: skip


def _test(row: ConditionComparison) -> str:
    """Measure with unit, and the conditions or the hypothesis."""
    unit = row.unit.replace("deg", "°")
    return f"{row.what} [{unit}], {row.name}" if unit else f"{row.what}, {row.name}"


def _table(title: str, columns: tuple[Column, ...], rows: Iterable[tuple[str, ...]]) -> TextTable:
    return TextTable(columns, title, list(rows))


# --------------------------------------------------------------------------------------------------
# Tables of psychometric curves and thresholds, for terminal and report.


def list_psychometric_tables(analysis: StudyResults) -> Iterator[TextTable]:
    """The tables that the procedure has, population before participants."""
    unit = analysis.study.level_unit
    if analysis.curves:
        if any(one.group for one in analysis.curves.values()):
            yield _tabulate_groups(analysis, unit)
        yield _tabulate_people(analysis, unit)
    if analysis.tracks:
        if any(one.group for one in analysis.tracks.values()):
            yield _tabulate_group_tracks(analysis, unit)
        yield _tabulate_tracks(analysis, unit)


def list_psychometric_notes(analysis: StudyResults) -> list[str]:
    """Notes on the tables, and on what single participants' trials do not determine."""
    found = []
    if analysis.curves:
        found.append(
            "Fit of each person: cumulative normal, equal lapse rate in both tails, up to 13 %; greatest likelihood, "
            "and 95 % by likelihood ratio. ≥ and ≤: the interval has one end only; the answers are compatible with any "
            "value beyond it. "
            "Threshold: the comparison is called stronger in 50 %; JND: from there to 75 %. fit p: share of "
            "simulated repetitions with at least this deviance. Group: hierarchical model of all answers."
        )
    if analysis.tracks:
        share = "70.7 %" if analysis.study.procedure == "staircase" else "75 %"
        found.append(
            f"Difference with {share} correct answers, and each person's central 95 % of the posterior. Group: "
            "geometric mean of the procedure's own thresholds, Student's interval; SD between people as a factor. "
            "≥ and ≤: the interval has one end only."
        )
    found += [f"{name}, {note}" for name, one in analysis.curves.items() for note in one.group_notes]
    for parts in (analysis.curves, analysis.tracks):
        for name, one in parts.items():
            found += [f"{name}, {code}: {note}" for code, fit in one.people.items() for note in fit.notes]
    return found


def _tabulate_groups(analysis: StudyResults, unit: str) -> TextTable:
    table = TextTable(
        (Column("condition", kind="key"), Column("of the group", kind="key"), Column("mean"), Column("95 % CI"),
         Column("SD between people"), Column("95 % CI")), "Psychometric curve of the group",
    )  # fmt: skip
    of = f" [{unit}]" if unit else ""
    for name, one in analysis.curves.items():
        if (group := one.group) is None:
            continue
        effect, spread = group.threshold, group.log_spread
        table.add_row(
            name, f"threshold{of}", _closed(effect.mean, effect.mean_95), format_range(effect.mean_95, ".4g"),
            format_value(effect.sd, ".3g"), format_range(effect.sd_95, ".3g"),
        )  # fmt: skip
        low, high = one.group_jnd_95
        table.add_row(
            name, f"JND (75 %){of}", _closed(JND * one.group_spread, (low, high)), format_range((low, high), ".3g"),
            f"factor {math.exp(spread.sd):.2f}" if math.isfinite(spread.sd) else "–", _factors(spread.sd_95, math.e),
        )  # fmt: skip
        table.add_row(name, "lapses [%]", f"{100 * group.lapse:.1f}", "", "", "")
    return table


def _tabulate_people(analysis: StudyResults, unit: str) -> TextTable:
    table = TextTable(
        (Column("condition", kind="key"), Column("participant", kind="key"), Column("trials"),
         Column("threshold", unit), Column("95 % CI", unit), Column("JND (75 %)", unit), Column("95 % CI", unit),
         Column("lapses", "%"), Column("fit p")), "Psychometric curve of each participant",
    )  # fmt: skip
    for name, one in analysis.curves.items():
        for code, fit in one.people.items():
            low, high = (JND * end for end in fit.spread_95)
            table.add_row(
                name, code, str(fit.trials), _digits(fit.middle), format_range(fit.middle_95, ".4g"),
                format_value(JND * fit.spread, ".3g"), format_range((low if low else -math.inf, high), ".3g"),
                format_value(fit.curve.lapse, ".1f", 100),
                format_value(fit.p_fit, ".2f"),
            )  # fmt: skip
    return table


def _tabulate_group_tracks(analysis: StudyResults, unit: str) -> TextTable:
    table = TextTable(
        (Column("condition", kind="key"), Column("threshold", unit), Column("95 % CI", unit),
         Column("SD between people"), Column("95 % CI")), "Threshold of the group",
    )  # fmt: skip
    for name, one in analysis.tracks.items():
        if (group := one.group) is not None:
            low, high = (2**end if math.isfinite(end) else end for end in group.mean_95)
            table.add_row(
                name, _closed(2**group.mean, group.mean_95), format_range((low, high), ".4g"),
                f"factor {2**group.sd:.2f}" if math.isfinite(group.sd) else "–", _factors(group.sd_95, 2.0),
            )  # fmt: skip
    return table


def _tabulate_tracks(analysis: StudyResults, unit: str) -> TextTable:
    reverses = analysis.study.procedure == "staircase"
    table = TextTable(
        (Column("condition", kind="key"), Column("participant", kind="key"), Column("trials"),
         *([Column("of the reversals", unit)] if reverses else []), Column("threshold", unit), Column("95 % CI", unit)),
        "Threshold of each participant",
    )  # fmt: skip
    for name, one in analysis.tracks.items():
        for code, fit in one.people.items():
            own = [format_value(fit.threshold, ".4g")] if reverses else []
            low, high = fit.fitted_95
            fitted = _digits(fit.fitted) if fit.closed else "–", format_range((low or -math.inf, high), ".4g")
            table.add_row(name, code, str(fit.trials), *own, *fitted)
    return table


def _closed(value: float, limits: tuple[float, float]) -> str:
    """Format a value, or a dash where its interval is open and the value is not determined."""
    return _digits(value) if all(map(math.isfinite, limits)) else "–"


def _digits(value: float) -> str:
    return format_value(value, ".4g")


def _factors(limits: tuple[float, float], base: float) -> str:
    low, high = (base**end for end in limits)
    if math.isnan(low) or math.isnan(high):
        return "–"
    return f"{low:.2f} to {high:.2f}" if math.isfinite(high) else f"≥ {low:.2f}"


# --------------------------------------------------------------------------------------------------
# The analysis as printed at the terminal: the report without figures.


def print_summary(analysis: StudyResults, console: Console | None = None) -> None:
    """Print all tables and notes of the analysis."""
    out = console or make_console()
    print_text(out, f"{analysis.study.name}: {analysis.trials} trials, {analysis.practice} practice trials excluded")
    if analysis.repeated:
        print_text(
            out, f"{analysis.repeated} trials were restarted: the device was off, or the experimenter repeated them"
        )
    print_text(out, analysis.origin, "bold red" if analysis.marked else "dim")
    if analysis.left_out:
        print_text(out, f"left out, of another kind: {analysis.left_out}", "bold red")
    counts = ", ".join(f"{name}: {count}" for name, count in count_incidents(analysis.incidents).items() if count)
    if counts:
        print_text(out, f"stops, repeats and safety events: {counts}; the report lists them with reason and time")
    if analysis.plan is not None:
        print_text(out, analysis.plan.sentence)
        for remark in analysis.plan.remarks:
            print_text(out, remark, "bold red")
    if (c := analysis.confusion) is not None:
        print_text(
            out,
            f"\ncorrect {100 * c.accuracy:.1f} % ({describe_accuracy(c)}), chance {100 * c.chance:.1f} %; by guessing: "
            f"{format_p(c.p_chance)} (exact binomial)",
        )
    for table in _tables(analysis):
        print_text(out)
        print_table(out, table)
    for note in (*list_psychometric_notes(analysis), *analysis.notes, *list_notes(analysis)):
        print_text(out, note, "dim")


def _tables(analysis: StudyResults) -> Iterator[TextTable]:
    """The tables that the procedure has."""
    if analysis.confusion is not None:
        yield _identification(analysis)
    if analysis.means:
        yield make_condition_table(analysis.means)
    if analysis.rings:
        yield _table(
            f"Error over θ: {name_error(analysis.study.procedure)}",
            (Column("θ", "°", "key"), Column("trials"), Column("mean", "mm"), Column("95 % CI", "mm"),
             Column("SD", "mm")),
            ((f"{r.theta_deg:g}", str(r.trials), f"{r.mean:.2f}", format_range((r.low, r.high), ".2f"),
              format_value(r.sd, ".2f")) for r in analysis.rings),
        )  # fmt: skip
    yield from list_psychometric_tables(analysis)
    if analysis.scores:
        yield _table(
            "Ratings",
            (Column("condition", kind="key"), Column("mean"), Column("95 % CI"), Column("SD"), Column("ratings")),
            ((name, f"{x.mean:.2f}", format_range((x.low, x.high), ".2f"), format_value(x.sd, ".2f"), str(x.ratings))
             for name, x in analysis.scores.items()),
        )  # fmt: skip
    yield from make_magnitude_tables(analysis.magnitudes, analysis.study.level_unit)
    if analysis.times:
        yield make_response_table(analysis.times)
    if analysis.chosen:
        yield _table(
            "Choices",
            (Column("chosen", kind="text"), Column("times"), Column("95 % CI", "%")),
            ((f"{a} over {b}", f"{k} of {n}", format_range(limits, ".1f", 100))
             for (a, b), (k, n, limits) in analysis.chosen.items()),
        )  # fmt: skip
    yield from list_group_tables(analysis)


def _identification(analysis: StudyResults) -> TextTable:
    c = analysis.confusion
    assert c is not None
    rows = []
    for i, n in enumerate(c.numbers):
        point = analysis.study.point(n)
        wrong = list_wrong_answers(analysis.arrows, n)
        limits = format_range(tuple(c.right_95[i]), ".1f", 100)
        right = format_value(c.matrix[i, i], ".1f", 100)
        rows.append((str(n), f"{point.theta_deg:g}", f"{point.phi_deg:g}", right, limits, wrong))
    columns = (
        Column("set-point", kind="key"), Column("θ", "°"), Column("φ", "°"), Column("correct", "%"),
        Column("95 % CI", "%"), Column("wrong answers to", kind="text"),
    )  # fmt: skip
    return _table("Accuracy by set-point", columns, rows)
