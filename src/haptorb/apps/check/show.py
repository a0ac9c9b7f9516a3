"""The verdict for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from haptorb.apps.check.fitness import Fitness

__all__ = ["print_fitness"]


def print_fitness(fitness: Fitness, console: Console | None = None) -> None:
    """Print verdicts, times, the machine and what to do about it."""
    from rich.console import Console
    from rich.table import Table

    console = console or Console()
    report, machine, took = fitness.report, fitness.machine, fitness.took
    client = "with a client dragging at 60 Hz" if fitness.dragging else "alone"
    console.print(
        f"{report['device']} (simulated), {report['rate_hz']:g} Hz, {fitness.duration:g} s {client}: "
        f"{report['ticks']} ticks, {report['missed']} deadlines skipped"
    )
    verdicts = Table(box=None, pad_edge=False)
    for heading in ("", "measured", "wanted", ""):
        verdicts.add_column(heading)
    for verdict in fitness.verdicts:
        word = "[green]good[/]" if verdict.fit else "[red]not good[/]"
        verdicts.add_row(verdict.what, verdict.measured, verdict.wanted, word)
    console.print(verdicts)
    times = Table(box=None, pad_edge=False)
    for heading in ("µs", "50 %", "99 %", "99.9 %"):
        times.add_column(heading, justify="right" if heading != "µs" else "left")
    for name in ("lateness", "compute"):
        values = report[f"{name}_us"].values()
        times.add_row(name, *("–" if value is None else f"{value:.0f}" for value in values))
    ahead = report["ahead_us"]
    if ahead:
        times.add_row("simulated device, before", f"{ahead['p50']:.0f}", f"{ahead['p99']:.0f}", "")
    console.print(times)
    scheduler = report["scheduler"]
    console.print(
        f"{machine.processor}, {machine.cores} cores{', virtual' if machine.virtual else ''}; kernel {machine.kernel}; "
        f"scheduler {scheduler.get('policy', 'unknown')}"
        f"{', memory locked' if scheduler.get('memory_locked') else ', memory not locked'}"
        f"{', core kept awake' if scheduler.get('awake') else ''}; "
        f"{took.others:.1f} cores busy, {100 * took.stolen:.1f} % stolen by a host, preempted {took.preempted} times",
        highlight=False,
        soft_wrap=True,
    )
    if fitness.fit:
        console.print("[bold green]This computer is fit.[/]")
    else:
        console.print("[bold red]This computer is not fit as it is.[/]")
        for advice in fitness.advice:
            console.print(f"• {advice}", highlight=False, soft_wrap=True)
