"""The analysis at the terminal: the report without its figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from rich.console import Console

from haptorb.apps.study.analysis.accuracy import describe_accuracy, list_wrong_answers
from haptorb.apps.study.analysis.analysis import Analysis
from haptorb.apps.study.analysis.by_condition.condition_means import make_condition_table
from haptorb.apps.study.analysis.by_condition.magnitude import make_magnitude_tables
from haptorb.apps.study.analysis.by_condition.response_times import make_response_table
from haptorb.apps.study.analysis.error_by_latitude import name_error
from haptorb.apps.study.analysis.group_tables import list_group_tables, list_notes
from haptorb.apps.study.analysis.psychometric_tables import list_psychometric_notes, list_psychometric_tables
from haptorb.apps.study.analysis.wording import format_p, format_range, format_value
from haptorb.apps.study.store.incidents import count_incidents
from haptorb.apps.terminal import Column, TextTable, make_console, print_table, print_text

__all__ = ["print_summary"]


def print_summary(analysis: Analysis, console: Console | None = None) -> None:
    """Print it for people."""
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


def _tables(analysis: Analysis) -> Iterator[TextTable]:
    """Those parts that the procedure has."""
    if analysis.confusion is not None:
        yield _identification(analysis)
    if analysis.means:
        yield make_condition_table(analysis.means)
    if analysis.rings:
        yield _table(
            f"Error over θ: {name_error(analysis.study.procedure)}",
            (Column("θ", "°", "key"), Column("trials"), Column("mean", "mm"), Column("95 %", "mm"), Column("SD", "mm")),
            ((f"{r.theta_deg:g}", str(r.trials), f"{r.mean:.2f}", format_range((r.low, r.high), ".2f"),
              format_value(r.sd, ".2f")) for r in analysis.rings),
        )  # fmt: skip
    yield from list_psychometric_tables(analysis)
    if analysis.scores:
        yield _table(
            "Ratings",
            (Column("condition", kind="key"), Column("mean"), Column("95 %"), Column("SD"), Column("ratings")),
            ((name, f"{x.mean:.2f}", format_range((x.low, x.high), ".2f"), format_value(x.sd, ".2f"), str(x.ratings))
             for name, x in analysis.scores.items()),
        )  # fmt: skip
    yield from make_magnitude_tables(analysis.magnitudes, analysis.study.level_unit)
    if analysis.times:
        yield make_response_table(analysis.times)
    if analysis.chosen:
        yield _table(
            "Choices",
            (Column("chosen", kind="text"), Column("times"), Column("95 %", "%")),
            ((f"{a} over {b}", f"{k} of {n}", format_range(limits, ".1f", 100))
             for (a, b), (k, n, limits) in analysis.chosen.items()),
        )  # fmt: skip
    yield from list_group_tables(analysis)


def _identification(analysis: Analysis) -> TextTable:
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
        Column("95 %", "%"), Column("wrong answers to", kind="text"),
    )  # fmt: skip
    return _table("Accuracy by set-point", columns, rows)


def _table(title: str, columns: tuple[Column, ...], rows: Iterable[tuple[str, ...]]) -> TextTable:
    return TextTable(columns, title, list(rows))
