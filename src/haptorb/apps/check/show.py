"""The verdict for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.apps.terminal import Column, TextTable, make_console, print_table, print_text

if TYPE_CHECKING:
    from rich.console import Console

    from haptorb.apps.check.fitness import Fitness

__all__ = ["print_fitness"]


def print_fitness(fitness: Fitness, console: Console | None = None) -> None:
    """Print verdicts, times, the machine and what to do about it."""
    console = console or make_console()
    report, machine, took = fitness.report, fitness.machine, fitness.took
    client = "with a client dragging at 60 Hz" if fitness.dragging else "alone"
    print_text(
        console,
        f"{report['device']} (simulated), {report['rate_hz']:g} Hz, {fitness.duration:g} s {client}: "
        f"{report['ticks']} ticks, {report['missed']} deadlines missed\n",
    )
    verdicts = TextTable((Column("criterion", kind="key"), Column("measured", kind="text"),
                          Column("wanted", kind="text"), Column("verdict", kind="short")))  # fmt: skip
    for verdict in fitness.verdicts:
        verdicts.add_row(verdict.what, verdict.measured, verdict.wanted, "pass" if verdict.fit else "FAIL")
    print_table(console, verdicts)
    print_text(console)
    times = TextTable((Column("time", kind="key"), *(Column(share, "µs") for share in ("50 %", "99 %", "99.9 %"))))
    for name in ("lateness", "compute"):
        values = report[f"{name}_us"].values()
        times.add_row(name, *("–" if value is None else f"{value:.0f}" for value in values))
    ahead = report["ahead_us"]
    if ahead:
        times.add_row("simulated device, before", f"{ahead['p50']:.0f}", f"{ahead['p99']:.0f}", "")
    print_table(console, times)
    scheduler = report["scheduler"]
    print_text(
        console,
        f"\n{machine.processor}, {machine.cores} cores{', virtual' if machine.virtual else ''}; kernel "
        f"{machine.kernel}; scheduler {scheduler.get('policy', 'unknown')}"
        f"{', memory locked' if scheduler.get('memory_locked') else ', memory not locked'}"
        f"{', core kept awake' if scheduler.get('awake') else ''}; "
        f"{took.others:.1f} cores busy, {100 * took.stolen:.1f} % stolen by the host, preempted {took.preempted} times",
    )
    if fitness.fit:
        print_text(console, "This computer is fit for a real-time loop.", "bold green")
    else:
        print_text(console, "This computer is not yet fit for a real-time loop.", "bold red")
        for advice in fitness.advice:
            print_text(console, f"• {advice}", indent="  ")
