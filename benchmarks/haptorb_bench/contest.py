"""Alternating timing and its results: one row per contestant, with its error against a common reference."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from haptorb.terminal import Column, TextTable, print_table, print_text

__all__ = ["Contest", "Result", "measure_fastest"]


@dataclass(frozen=True)
class Result:
    """How long one contestant took for one orientation of the rotor, and how wrong it was."""

    task: str
    who: str
    how: str
    seconds: float | None  #: None where the contestant is not installed
    error: float | None  #: greatest difference over the reference's greatest magnitude


@dataclass(frozen=True)
class Contest:
    """All rows of a run, and the machine they are for."""

    title: str
    results: tuple[Result, ...]
    machine: dict[str, str]

    def ratios(self) -> dict[str, dict[str, float]]:
        """Task → "who: how" → how many times longer it took than this library's fastest row of that task."""
        out: dict[str, dict[str, float]] = {}
        for task in dict.fromkeys(result.task for result in self.results):
            rows = [result for result in self.results if result.task == task and result.seconds is not None]
            ours = min((row.seconds for row in rows if row.who == "haptorb" and row.seconds), default=None)
            if ours is not None:
                out[task] = {
                    f"{row.who}: {row.how}": row.seconds / ours for row in rows if row.who != "haptorb" and row.seconds
                }
        return out

    def numbers(self) -> dict[str, Any]:
        """Everything as plain JSON types."""
        return {
            "title": self.title,
            "machine": self.machine,
            "results": [asdict(result) for result in self.results],
            "times_slower_than_haptorb": self.ratios(),
        }

    def show(self, console: Console) -> None:
        """Print it for people."""
        print_text(console, self.title, "bold")
        print_text(console, ", ".join(f"{key} {value}" for key, value in self.machine.items()), "dim")
        ratios = self.ratios()
        for task in dict.fromkeys(result.task for result in self.results):
            table = TextTable(
                (
                    Column("who", kind="key"), Column("how", kind="text"), Column("time"),
                    Column("error"), Column("times slower"),
                ),
                f"\n{task}",
            )  # fmt: skip
            for row in (result for result in self.results if result.task == task):
                if row.seconds is None:
                    table.add_row(row.who, row.how, "not installed", "", "")
                    continue
                ratio = ratios.get(task, {}).get(f"{row.who}: {row.how}")
                error = "" if row.error is None else f"{row.error:.1e}"
                table.add_row(
                    row.who, row.how, spell_time(row.seconds), error, "" if ratio is None else f"{ratio:,.0f}"
                )
            print_table(console, table)

    def plot(self, path: Path) -> None:
        """Draw the times as bars, logarithmic, the errors beside them, into the PNG or SVG file at `path`."""
        from matplotlib.figure import Figure

        tasks = list(dict.fromkeys(result.task for result in self.results))
        figure = Figure(figsize=(10, 1 + 3.2 * len(tasks)), layout="constrained")
        for place, task in zip(figure.subplots(len(tasks), 1, squeeze=False)[:, 0], tasks, strict=True):
            rows = [row for row in self.results if row.task == task and row.seconds is not None]
            rows.sort(key=lambda row: -(row.seconds or 0.0))
            seconds = [row.seconds or 0.0 for row in rows]
            colours = ["C0" if row.who == "haptorb" else "C1" for row in rows]
            bars = place.barh([f"{row.who}: {row.how}" for row in rows], seconds, color=colours)
            labels = [f"{spell_time(row.seconds or 0.0)}, error {row.error or 0.0:.0e}" for row in rows]
            place.bar_label(bars, labels, padding=4, fontsize=8)
            place.set(xscale="log", xlabel="time per orientation [s]", xlim=(None, 60 * max(seconds)))
            place.set_title(task, loc="left", fontsize=10)
            place.grid(axis="x", alpha=0.3)
        figure.suptitle(self.title, x=0.01, ha="left", fontweight="bold")
        figure.savefig(path, dpi=150)


def measure_fastest(work: Callable[[], object], per_call: int = 1, budget: float = 0.5) -> float:
    """Seconds per item of the fastest of several runs; `work` does `per_call` items. The first call does not count.

    Garbage collection waits, as it does in the loop. Three runs at least, unless one takes longer than `budget` [s].
    """
    work()
    start = time.perf_counter()
    work()
    once = time.perf_counter() - start
    if once > budget:
        return once / per_call
    repeat = max(1, int(0.02 * budget / max(once, 1e-9)))
    best = once
    collecting = gc.isenabled()
    gc.disable()
    try:
        end = time.perf_counter() + budget
        runs = 0
        while runs < 3 or time.perf_counter() < end:
            start = time.perf_counter()
            for _ in range(repeat):
                work()
            best = min(best, (time.perf_counter() - start) / repeat)
            runs += 1
    finally:
        if collecting:
            gc.enable()
    return best / per_call


def spell_time(seconds: float) -> str:
    """A time in the unit that suits it.

    >>> spell_time(2.5e-6), spell_time(0.0313)
    ('2.50 µs', '31.3 ms')
    """
    for unit, scale in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        if seconds * scale >= 1:
            return f"{seconds * scale:.3g} {unit}" if seconds * scale >= 10 else f"{seconds * scale:.2f} {unit}"
    return f"{seconds * 1e9:.0f} ns"
