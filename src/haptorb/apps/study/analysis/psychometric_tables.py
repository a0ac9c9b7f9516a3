"""Psychometric curves and thresholds as tables, the same at the terminal and in the report."""

from __future__ import annotations

import math
from collections.abc import Iterator

from haptorb.apps.study.analysis.analysis import Analysis
from haptorb.apps.study.analysis.curves import JND
from haptorb.apps.study.analysis.wording import format_range, format_value
from haptorb.apps.terminal import Column, TextTable

__all__ = ["list_psychometric_notes", "list_psychometric_tables"]


def list_psychometric_tables(analysis: Analysis) -> Iterator[TextTable]:
    """Those that the procedure has, the group's before each person's."""
    unit = analysis.study.level_unit
    if analysis.curves:
        if any(one.group for one in analysis.curves.values()):
            yield _tabulate_groups(analysis, unit)
        yield _tabulate_people(analysis, unit)
    if analysis.tracks:
        if any(one.group for one in analysis.tracks.values()):
            yield _tabulate_group_tracks(analysis, unit)
        yield _tabulate_tracks(analysis, unit)


def list_psychometric_notes(analysis: Analysis) -> list[str]:
    """What the tables are, and what single people's trials cannot tell."""
    found = []
    if analysis.curves:
        found.append(
            "Fit of each person: cumulative normal, equal lapse rate in both tails, up to 13 %; greatest likelihood, "
            "and 95 % by likelihood ratio. ≥ and ≤: the interval has one end only; the answers are compatible with any "
            "value beyond it. "
            "Threshold: the comparison is called stronger in 50 %; JND: from there to 75 %. fit p: share of "
            "simulated repetitions with at least this deviance. Group: hierarchical model of all answers; an SD "
            "between people that begins with × is a factor."
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


def _tabulate_groups(analysis: Analysis, unit: str) -> TextTable:
    table = TextTable(
        (Column("condition", kind="key"), Column("of the group", kind="key"), Column("mean"), Column("95 %"),
         Column("SD between people"), Column("95 %")), "Psychometric curve of the group",
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
            f"× {math.exp(spread.sd):.2f}" if math.isfinite(spread.sd) else "–", _factors(spread.sd_95, math.e),
        )  # fmt: skip
        table.add_row(name, "lapses [%]", f"{100 * group.lapse:.1f}", "", "", "")
    return table


def _tabulate_people(analysis: Analysis, unit: str) -> TextTable:
    table = TextTable(
        (Column("condition", kind="key"), Column("participant", kind="key"), Column("trials"),
         Column("threshold", unit), Column("95 %", unit), Column("JND (75 %)", unit), Column("95 %", unit),
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


def _tabulate_group_tracks(analysis: Analysis, unit: str) -> TextTable:
    table = TextTable(
        (Column("condition", kind="key"), Column("threshold", unit), Column("95 %", unit),
         Column("SD between people"), Column("95 %")), "Threshold of the group",
    )  # fmt: skip
    for name, one in analysis.tracks.items():
        if (group := one.group) is not None:
            low, high = (2**end if math.isfinite(end) else end for end in group.mean_95)
            table.add_row(
                name, _closed(2**group.mean, group.mean_95), format_range((low, high), ".4g"),
                f"× {2**group.sd:.2f}" if math.isfinite(group.sd) else "–", _factors(group.sd_95, 2.0),
            )  # fmt: skip
    return table


def _tabulate_tracks(analysis: Analysis, unit: str) -> TextTable:
    reverses = analysis.study.procedure == "staircase"
    table = TextTable(
        (Column("condition", kind="key"), Column("participant", kind="key"), Column("trials"),
         *([Column("of the reversals", unit)] if reverses else []), Column("threshold", unit), Column("95 %", unit)),
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
    """A dash where an end is open: then the value is anybody's guess."""
    return _digits(value) if all(map(math.isfinite, limits)) else "–"


def _digits(value: float) -> str:
    return format_value(value, ".4g")


def _factors(limits: tuple[float, float], base: float) -> str:
    low, high = (base**end for end in limits)
    if math.isnan(low) or math.isnan(high):
        return "–"
    return f"{low:.2f} to {high:.2f}" if math.isfinite(high) else f"≥ {low:.2f}"
