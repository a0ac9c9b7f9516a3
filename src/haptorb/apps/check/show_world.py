"""The stability verdict for people: a table, what to change, and the plot of what can be rendered at all."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from haptorb.apps.terminal import Column, TextTable, make_console, print_table, print_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from haptorb.apps.check.world import WorldVerdict

__all__ = ["draw_world", "print_world"]

#: verdict → words and colour
_WORDS = {"inside": ("Inside", "green"), "close": ("Close to the limit", "yellow"), "outside": ("Outside", "red")}


def print_world(verdict: WorldVerdict, console: Console | None = None) -> None:
    """Print the stiffness of the world, the limit of the loop, and advice."""
    console = console or make_console()
    setting, loop, steep = verdict.setting, verdict.loop, verdict.steep
    unit = f"{verdict.place.force}/{verdict.place.length}"
    tracker = "a pose in every tick" if setting.tracker_rate is None else f"tracker {setting.tracker_rate:g} Hz"
    if setting.bandwidth is not None:
        tracker = f"field sensors, filtered to {setting.bandwidth:g} Hz"
    print_text(
        console,
        f"{verdict.device}, world '{verdict.world}': servo {setting.rate:g} Hz, {tracker}, "
        f"latency {1e3 * setting.latency:g} ms; grip {setting.grip} ({setting.hand.mass:g} kg, "
        f"{setting.hand.damping:g} N·s/m, {setting.hand.stiffness:g} N/m)",
    )
    print_text(
        console,
        f"each force is held for {1e3 * loop.period:.2f} ms and is {1e3 * loop.lateness:.2f} ms late, current rise "
        "included\n",
        "dim",
    )
    table = TextTable((Column("stiffness", kind="text"), Column("", unit)))
    b = verdict.hand.damping
    table.add_row("largest stiffness of this world", f"{steep.stiffness:.4g}")
    table.add_row("largest stable with this hand: exact", _value(verdict.largest))
    table.add_row("largest stable by b/(T/2 + t_d)", f"{loop.delay_bound(b):.4g}")
    table.add_row("passive with any hand, without latency: 2b/T", f"{loop.passive_bound(b):.4g}")
    if steep.away > 0.0:
        table.add_row("largest negative (the tool slips off; no fault)", f"{steep.away:.4g}")
    print_table(console, table)
    print_text(console)
    if verdict.turning is not None:
        _print_turning(verdict.turning, console)
    if steep.damping > 0.0:
        damper = f"{verdict.place.force}·s/{verdict.place.length}"
        print_text(console, f"damping of the world: up to {steep.damping:.3g} {damper}")
    if steep.jump > 0.0:
        print_text(
            console,
            f"The force jumps by up to {1e3 * steep.jump:.0f} m{verdict.place.force}: a jump has no slope and no "
            "margin; a hand at rest on the edge may feel chatter.",
        )
    if not verdict.passive:
        print_text(
            console, "Declared active: it may produce energy by design, so the passivity control only monitors it."
        )
    for left_out in verdict.unjudged:
        print_text(console, f"Not judged: {left_out}.")
    margin = "nothing can oscillate" if math.isinf(verdict.margin) else _margin(verdict.margin)
    words, colour = _WORDS[verdict.verdict]
    print_text(console, f"{words}: {margin}.", f"bold {colour}")
    for advice in verdict.advice:
        print_text(console, f"• {advice}", indent="  ")


def _print_turning(verdict: WorldVerdict, console: Console) -> None:
    table = TextTable((Column("stiffness of the torque", kind="text"), Column("", "N·m/rad")))
    table.add_row("largest stiffness of this world", f"{verdict.steep.stiffness:.4g}")
    table.add_row("largest stable with this hand: exact", _value(verdict.largest))
    print_table(console, table)
    print_text(console)


def _margin(margin: float) -> str:
    if margin > 1.0:
        return f"the world could be {margin:.3g} times as strong before it oscillates"
    return f"it is {1 / margin:.3g} times too strong and will oscillate"


def _value(value: float) -> str:
    return "no limit" if math.isinf(value) else f"{value:.4g}"


def draw_world(
    verdict: WorldVerdict, path: Path, tried: Sequence[tuple[float, float]] = (), ages: Sequence[float] = ()
) -> Path:
    """Draw the Z-width into `path`: over the hand's damping, and over the age of poses.

    tried: pairs of damping [N·s/m] and the largest stiffness of the simulated chain; ages [s] for the right panel.
    """
    from dataclasses import replace

    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from haptorb.control.stability.stability import SampledLoop

    loop, hand, setting = verdict.loop, verdict.hand, verdict.setting
    unit = f"{verdict.place.force}/{verdict.place.length}"
    damper = f"{verdict.place.force}·s/{verdict.place.length}"
    scale = hand.damping / setting.hand.damping if setting.hand.damping else 1.0
    figure = Figure(figsize=(12, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    b = np.geomspace(0.3, 30, 31) * scale
    exact = [loop.largest(replace(hand, damping=float(one))) for one in b]
    left.fill_between(b, 1e-9, exact, color="C2", alpha=0.12, lw=0)
    left.loglog(b, exact, "C2-", lw=2, label="stable with this hand, exact")
    left.loglog(b, [loop.delay_bound(one) for one in b], "k--", lw=1, label="b/(T/2 + t_d)")
    left.loglog(b, [loop.passive_bound(one) for one in b], "k:", lw=1, label="passive without latency: 2b/T")
    if tried:
        left.plot(*np.array(tried).T, "C3o", label="simulated chain")
    if verdict.steep.stiffness > 0.0:
        left.plot([hand.damping], [verdict.steep.stiffness], "C0D", ms=8, label=f"world '{verdict.world}', this grip")
    left.set(xlabel=f"damping of the hand [{damper}]", ylabel=f"largest stiffness [{unit}]", xlim=(b[0], b[-1]))
    low = min([exact[0], *([verdict.steep.stiffness] if verdict.steep.stiffness > 0 else [])])
    left.set_ylim(0.4 * low, 3 * max(loop.passive_bound(b[-1]), exact[-1]))
    left.set_title("Largest stiffness that this loop can render", loc="left")
    left.legend(frameon=False, fontsize=8)
    left.grid(alpha=0.3, which="both")
    age = np.linspace(0, 0.03, 31)
    for rate, colour in ((60.0, "C4"), (120.0, "C1"), (240.0, "C0"), (setting.rate, "C2")):
        bounds = [
            SampledLoop.of(setting.rate, rate if rate != setting.rate else None, one, loop.time_constant).largest(hand)
            for one in age.tolist()
        ]
        right.semilogy(1e3 * age, bounds, colour, label=f"{rate:g} Hz")
    if verdict.steep.stiffness > 0.0:
        right.axhline(verdict.steep.stiffness, color="C0", ls=":", lw=1)
        right.annotate(f"'{verdict.world}'", (30, verdict.steep.stiffness), (-2, 3), textcoords="offset points",
                       ha="right")  # fmt: skip
    right.plot([1e3 * setting.latency], [verdict.largest], "kx", ms=9, mew=2, label="your setting")
    right.set(xlabel="latency of a pose [ms]", ylabel=f"largest stiffness [{unit}]", xlim=(0, 30))
    right.set_title(f"Effect of the tracker's rate and latency, grip {setting.grip}", loc="left")
    right.legend(frameon=False, fontsize=8, title="poses")
    right.grid(alpha=0.3, which="both")
    figure.savefig(path, dpi=120)
    return path
