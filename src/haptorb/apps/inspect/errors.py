"""`haptorb inspect DEVICE --errors`: in which band the delivered wrench lies, and what contributes most to it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, final

import numpy as np
from rich.console import Console

from haptorb.apps.terminal import Column, TextTable, print_facts, print_table, print_text
from haptorb.apps.terminal.notebook_report import NotebookReport
from haptorb.control.budget.monte_carlo import COVERAGE, ErrorBudget, Report, WrenchBand, error_budget
from haptorb.devices.device import Device
from haptorb.sensing.calibration.calibration import Calibration

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ErrorReport", "report_errors"]

_KEYS = {"N": "n", "N·m": "nm"}
_ROUNDING = 1e-6  #: [mN or mN·m]
_LEAST = 5e-4  #: share of the variance below which a bar is not drawn


@final
class ErrorReport(NotebookReport):
    """An error budget as text, as numbers and as a picture."""

    def __init__(self, device: Device, budget: ErrorBudget) -> None:
        self.device, self.budget = device, budget

    def numbers(self) -> dict[str, Any]:
        """Everything as plain JSON types, SI units in the keys."""
        budget, unit = self.budget, _KEYS[self.budget.unit]
        return {
            "name": budget.device,
            "digest": self.device.digest,
            "estimator": budget.estimator,
            f"asked_{unit}": budget.asked,
            "motion": budget.motion,
            "jnd": budget.jnd,
            "coverage": COVERAGE,
            "samples": budget.samples,
            "seed": budget.seed,
            "regions": [
                {
                    "region": band.region,
                    f"size_{unit}": band.size,
                    "size_jnd": budget.count_jnd(band.size),
                    "components": [
                        {
                            "component": name,
                            f"low_{unit}": float(band.low[n]),
                            f"high_{unit}": float(band.high[n]),
                            f"standard_uncertainty_{unit}": float(band.standard[n]),
                        }
                        for n, name in enumerate(budget.components)
                    ],
                }
                for band in budget.bands
            ],
            "sources": [
                {
                    "source": share.name,
                    "standard_uncertainty": share.standard,
                    "origin": share.origin,
                    f"alone_{unit}": share.alone,
                    "first_order": share.first_order,
                    "total": share.total,
                }
                for share in budget.shares
            ],
        }

    def show(self, console: Console) -> None:
        """Print it for people."""
        budget, unit = self.budget, f"m{self.budget.unit}"
        print_text(console, f"Error budget of {self.device.title}", "bold")
        facts = [
            ("asked", f"{1e3 * budget.asked:g} {unit} in any direction, {budget.motion}, anywhere in the workspace"),
            ("source of the pose", budget.estimator),
            ("propagation", f"Monte Carlo over {budget.samples} devices, seed {budget.seed}; all uncertainties normal"),
        ]
        print_facts(console, facts)
        print_text(console)
        bands = TextTable(
            (
                Column("region", kind="text"),
                *(Column(name, unit, "short") for name in budget.components),
                Column("size", unit), Column("size", "JND"),
            ),
            f"{100 * COVERAGE:.0f} % of the devices deliver the wrench within",
        )  # fmt: skip
        for band in budget.bands:
            spans = (f"{1e3 * band.low[n]:+.2g} … {1e3 * band.high[n]:+.2g}" for n in range(len(budget.components)))
            bands.add_row(band.region, *spans, f"{1e3 * band.size:.3g}", f"{budget.count_jnd(band.size):.2f}")
        print_table(console, bands)
        print_text(
            console, f"size: length of the error vector. JND: {100 * budget.jnd:.3g} % of the wrench asked\n", "dim"
        )
        sources = TextTable(
            (
                Column("source", kind="text"), Column("standard uncertainty", kind="short"),
                Column("from", kind="short"), Column("alone", unit), Column("share", "%"), Column("total", "%"),
            ),
            "Sources of error",
        )  # fmt: skip
        for share in budget.shares:
            sources.add_row(
                share.name, share.standard, share.origin, _format_size(1e3 * share.alone),
                f"{100 * max(share.first_order, 0.0):.1f}", f"{100 * share.total:.1f}",
            )  # fmt: skip
        print_table(console, sources)
        print_text(
            console,
            "alone: 95 % of the errors if all else is exact. share: first-order Sobol index, of the variance. total: "
            "total Sobol index, with interactions",
            "dim",
        )

    def draw(self) -> Figure:
        """The bands over the regions, and the sources' shares."""
        from matplotlib.figure import Figure

        budget, unit = self.budget, f"m{self.budget.unit}"
        figure = Figure(figsize=(13, 5), layout="constrained")
        left, right = figure.subplots(1, 2)
        across = np.arange(len(budget.bands))
        count = len(budget.components)
        for n, name in enumerate(budget.components):
            at = across + (n - 0.5 * (count - 1)) * 0.18
            low, high = (1e3 * np.array([getattr(band, end)[n] for band in budget.bands]) for end in ("low", "high"))
            left.vlines(at, low, high, lw=7, color=f"C{n}", alpha=0.7, label=name)
        _draw_sizes(left, budget.bands, across)
        left.axhline(0.0, color="0.5", lw=0.8)
        left.set_xticks(across, [band.region.replace(" of ", "\nof ") for band in budget.bands], fontsize=8)
        left.set_ylabel(f"error of the delivered wrench [{unit}]")
        left.set_title(f"{100 * COVERAGE:.0f} % bands for {1e3 * budget.asked:g} {unit}", loc="left")
        left.grid(axis="y", alpha=0.3)
        left.legend(frameon=False, fontsize=8)
        scale = 1e3 * budget.jnd * budget.asked
        jnd = left.secondary_yaxis("right", functions=(lambda x: x / scale, lambda x: x * scale))
        jnd.set_ylabel("just-noticeable differences")
        shares = [share for share in budget.shares if share.total >= _LEAST][::-1]
        right.barh(
            [share.name for share in shares], [100 * share.total for share in shares], color="0.8", label="total"
        )
        right.barh(
            [share.name for share in shares], [100 * max(share.first_order, 0.0) for share in shares], height=0.45,
            color="C0", label="first order",
        )  # fmt: skip
        right.set_xlabel("share of the variance [%]")
        right.set_title("Sources of error", loc="left")
        right.legend(frameon=False)
        figure.suptitle(self.device.title, x=0.01, ha="left", fontweight="bold")
        return figure

    def _summarize(self) -> str:
        budget = self.budget
        size = budget.bands[-1].size
        return f"<ErrorReport of {budget.device}: {1e3 * size:.3g} m{budget.unit}, {budget.count_jnd(size):.2f} JND>"


def report_errors(
    device: Device,
    *,
    asked: float | None = None,
    estimator: str | None = None,
    calibration: Calibration | None = None,
    samples: int = 2000,
    seed: int = 0,
    report: Report | None = None,
) -> ErrorReport:
    """The error budget of `device` for wrenches of `asked` [N or N·m]; InputError where its kind has none.

    asked, estimator: None for the kind's own choice. `samples` devices in each region of the workspace, from `seed`;
    `report` receives the share that is done.
    """
    model = device.kind.require_part("errors", device.name, "`haptorb inspect --errors`")(
        device, asked, estimator, calibration
    )
    return ErrorReport(device, error_budget(model, samples, seed, report))


def _format_size(size: float) -> str:
    """Two digits; what is nothing but rounding is 0."""
    return f"{size:.2g}" if size >= _ROUNDING else "0"


def _draw_sizes(place: Any, bands: tuple[WrenchBand, ...], across: Any) -> None:
    """A line for the size of the error, on both sides of zero."""
    for sign in (1, -1):
        sizes = [1e3 * sign * band.size for band in bands]
        place.plot(across, sizes, "k_", ms=40, label="size" if sign > 0 else None)
