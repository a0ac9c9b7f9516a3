"""Report of an error budget: bands, shares and figure; `haptorb inspect DEVICE --errors`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from rich.console import Console

from haptorb.analysis.error_budget import COVERAGE, ErrorBudget, Report, WrenchBand, error_budget
from haptorb.analysis.error_models import error_model
from haptorb.devices.base import Device
from haptorb.devices.loader import find_device
from haptorb.estimation.calibration_file import Calibration
from haptorb.notebook import NotebookReport
from haptorb.terminal import Column, TextTable, print_facts, print_table, print_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ErrorReport", "report_errors"]


# --------------------------------------------------------------------------------------------------
# `haptorb inspect DEVICE --errors`: error band of the delivered wrench, and its largest contributions.


_KEYS = {"N": "n", "N·m": "nm"}
_ROUNDING_LIMIT = 1e-6  #: magnitude below which an error is rounding [mN or mN·m]
_MIN_DRAWN_SHARE = 5e-4  #: share of the variance below which no bar is drawn


@final
class ErrorReport(NotebookReport):
    """An error budget as text, as JSON and as a figure."""

    def __init__(self, device: Device, budget: ErrorBudget) -> None:
        self.device, self.budget = device, budget

    def numbers(self) -> dict[str, Any]:
        """Return everything as plain JSON types, SI units in the keys."""
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
                    "first_order_interval": list(share.first_order_interval),
                    "total": share.total,
                    "total_interval": list(share.total_interval),
                }
                for share in budget.shares
            ],
            "left_out": budget.left_out,
        }

    def show(self, console: Console) -> None:
        """Print the budget on `console`."""
        budget, unit = self.budget, f"m{self.budget.unit}"
        print_text(console, f"Error budget of {self.device.title}", "bold")
        facts = [
            ("asked", f"{1e3 * budget.asked:g} {unit} in any direction, {budget.motion}, anywhere in the workspace"),
            ("source of the pose", budget.estimator),
            ("propagation", f"Monte Carlo over {budget.samples} devices, seed {budget.seed}"),
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
            console, f"size: length of the error vector. JND: {100 * budget.jnd:.3g} % of the commanded wrench\n", "dim"
        )
        sources = TextTable(
            (
                Column("source", kind="text"), Column("standard uncertainty", kind="short"),
                Column("from", kind="short"), Column("alone", unit), Column("share", "%", "short"),
                Column("total", "%", "short"),
            ),
            "Sources of error",
        )  # fmt: skip
        for share in budget.shares:
            sources.add_row(
                share.name, share.standard, share.origin, _format_size(1e3 * share.alone),
                _format_share(share.first_order, share.first_order_interval),
                _format_share(share.total, share.total_interval),
            )  # fmt: skip
        print_table(console, sources)
        print_text(
            console,
            "alone: 95 % of the errors if all else is exact. share: first-order Sobol index, of the variance. total: "
            f"total Sobol index, with interactions. ±: {100 * COVERAGE:.0f} % interval with these samples, in which "
            "a share may lie below zero or above the total. An error that all devices have in common is in the column "
            "alone and has no share",
            "dim",
        )
        if budget.left_out:
            print_text(console, f"\nNot in the budget: {budget.left_out}")

    def draw(self) -> Figure:
        """Draw the bands over the regions, and the sources' shares."""
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
        # Below the axes, because the bands fill them.
        left.legend(
            frameon=False, fontsize=8, ncols=count + 1, loc="upper center", bbox_to_anchor=(0.5, -0.12), markerscale=0.5
        )
        scale = 1e3 * budget.jnd * budget.asked
        jnd = left.secondary_yaxis("right", functions=(lambda x: x / scale, lambda x: x * scale))
        jnd.set_ylabel("just-noticeable differences")
        shares = [share for share in budget.shares if share.total >= _MIN_DRAWN_SHARE][::-1]
        right.barh(
            [share.name for share in shares], [100 * share.total for share in shares], color="0.8", label="total"
        )
        right.barh(
            [share.name for share in shares],
            [100 * share.first_order for share in shares],
            height=0.45,
            color="C0",
            label="first order",
        )
        for color, name in (("0.5", "total"), ("C1", "first_order")):
            for n, share in enumerate(shares):
                low, high = getattr(share, f"{name}_interval")
                right.plot([100 * low, 100 * high], [n, n], color=color, lw=2 if name == "total" else 1)  # fmt: skip
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
    device: Device | str | Path,
    *,
    asked: float | None = None,
    estimator: str | None = None,
    calibration: Calibration | None = None,
    samples: int = 2000,
    seed: int = 0,
    report: Report | None = None,
) -> ErrorReport:
    """Compute the error budget of the wrench that a device delivers, as `haptorb inspect --errors` does.

    Parameters
    ----------
    device : Device, str or Path
        Device, or its name in the catalogue, or path of its file.
    asked : float, optional
        Magnitude of the commanded wrench [N or N·m]; None: half of the smallest peak.
    estimator : str, optional
        Name of the estimator; None: the choice of the kind of device.
    calibration : Calibration, optional
        Calibration that the controller uses.
    samples : int
        Number of sampled devices in each region of the workspace.
    seed : int
        Seed of the samples.
    report : callable, optional
        Receives the share that is done, 0 to 1.

    Returns
    -------
    ErrorReport
        95 % bands by component and region, and the share of each source, in `budget`.

    Raises
    ------
    InputError
        If the kind of device has no error model.

    Notes
    -----
    Propagation of distributions by Monte Carlo (JCGM 101:2008); shares are first-order Sobol indices.
    """
    known = find_device(device)
    model = error_model(known, asked, estimator, calibration)
    return ErrorReport(known, error_budget(model, samples, seed, report))


def _format_size(size: float) -> str:
    """Format a magnitude with two digits; rounding errors are 0."""
    return f"{size:.2g}" if size >= _ROUNDING_LIMIT else "0"


def _format_share(share: float, interval: tuple[float, float]) -> str:
    """Format a share of the variance [%] with the longer half of its interval."""
    return f"{100 * share:.1f} ± {100 * max(interval[1] - share, share - interval[0]):.1f}"


def _draw_sizes(place: Any, bands: tuple[WrenchBand, ...], across: Any) -> None:
    """Draw the magnitude of the error symmetrically about zero."""
    for sign in (1, -1):
        sizes = [1e3 * sign * band.size for band in bands]
        place.plot(across, sizes, "k_", ms=40, label="size" if sign > 0 else None)
