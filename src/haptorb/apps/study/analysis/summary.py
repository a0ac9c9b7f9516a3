"""The analysis in a few lines at the terminal."""

from __future__ import annotations

from rich.console import Console

from haptorb.apps.study.analysis.analysis import Analysis

__all__ = ["print_summary"]


def print_summary(analysis: Analysis, console: Console | None = None) -> None:
    """Print it for people."""
    out = console or Console(highlight=False)
    out.print(f"{analysis.study.name}: {analysis.trials} trials. [{'bold red' if analysis.simulated else 'dim'}]"
              f"{analysis.origin}[/]")  # fmt: skip
    if (c := analysis.confusion) is not None:
        low, high = c.accuracy_95
        told = f"right {100 * c.accuracy:.1f} % (95 % over people {100 * low:.1f} to {100 * high:.1f})"
        out.print(f"{told}, chance {100 * c.chance:.1f} %, {len(analysis.arrows)} arrows")
    for ring in analysis.rings:
        out.print(f"θ = {ring.theta_deg:g}°: {ring.mean:.1f} ± {ring.sd:.1f} mm ({ring.trials} trials)")
    for name, (_, _, _, fit) in analysis.curves.items():
        low, high = fit.middle_95
        out.print(f"{name}: middle {fit.middle:.4g} [{low:.4g}, {high:.4g}], JND {0.6745 * fit.spread:.3g}")
    for name, people in analysis.thresholds.items():
        out.print(f"{name}: thresholds {', '.join(f'{code} {value:.3g}' for code, value in people.items())}")
    for name, (mean, sd, k) in analysis.scores.items():
        out.print(f"{name}: rated {mean:.2f} ± {sd:.2f} ({k} times)")
    for (a, b), (k, n, _) in analysis.chosen.items():
        out.print(f"{a} over {b}: {k} of {n}")
    for one in analysis.comparisons:
        out.print(
            f"{one.what}: {one.a} − {one.b} = {one.difference:.3g}, p = {one.p:.3g} (sign-flip, {one.people} people)"
        )
