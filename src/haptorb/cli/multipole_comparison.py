"""Exact, published and fitted multipole model of one motor part, compared where it meets its counterparts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from haptorb.devices.motor import SphericalMotor
from haptorb.errors import UnknownName
from haptorb.figure_file import show_text_as_is
from haptorb.magnetics.multipole_fit import MultipoleFit, fit_multipole, residual, shell_region
from haptorb.magnetics.source import RoundBody
from haptorb.notebook import NotebookReport
from haptorb.terminal import Column, TextTable, print_table, print_text

__all__ = ["PARTS", "FitComparison", "compare"]

PARTS = ("magnet", "coil")
_HALF_ANGLE_RAD = 1.0  #: evaluated cone about the part's axis [rad]: beyond it the field is negligible
_PUBLISHED_POLE_PAIRS = 41  #: pole pairs of the published magnet model


@dataclass(frozen=True)
class FitComparison(NotebookReport):
    """A fitted model and the one in the device file, both against the exact field in the same region."""

    device: str
    part: str
    body: RoundBody
    fitted: MultipoleFit
    published: MultipoleFit | None
    gap: tuple[float, float]  #: range of distances from the part's centre along its axis that spans the gap [m]

    def _summarize(self) -> str:
        beside = "fitted and published" if self.published else "fitted"
        return f"<FitComparison of the {self.part} of {self.device}: {beside} model against the exact field>"

    def numbers(self) -> dict[str, Any]:
        """Return everything as plain JSON types."""
        return {
            "device": self.device,
            "part": self.part,
            "fitted": _describe_fit(self.fitted),
            "published": None if self.published is None else _describe_fit(self.published),
        }

    def toml(self) -> str:
        """Return the section for a device file."""
        model, section = self.fitted.model, "magnets" if self.part == "magnet" else "electromagnets"
        strengths = ", ".join(f"{value:.6g}" for value in model.loop_strengths)
        return (
            f"[{section}.multipole]\n"
            f"dipoles_per_loop = {model.per_loop}\n"
            f"length_ratio = {model.pole_distance / self.body.length:.6g}\n"
            f"strengths = [{strengths}]\n"
        )

    def show(self, console: Console) -> None:
        """Print the comparison on `console`."""
        print_text(console, f"{self.part} of {self.device}", "bold")
        print_text(console, repr(self.body))
        table = TextTable(
            (
                Column("model", kind="key"), Column("loops k"), Column("per loop n"), Column("dipoles"),
                Column("pole distance over length l̄/l"), Column("rms error", "%"), Column("greatest error", "%"),
            )
        )  # fmt: skip
        rows = [("fitted", self.fitted)]
        if self.published is not None:
            rows.append(("in the file", self.published))
        for name, fit in rows:
            model = fit.model
            table.add_row(
                name,
                str(len(model.loop_strengths) - 1),
                str(model.per_loop),
                str(model.dipoles),
                f"{model.pole_distance / self.body.length:.3f}",
                f"{100 * fit.rms:.3f}",
                f"{100 * fit.greatest:.3f}",
            )
        print_table(console, table)
        print_text(console)
        print_text(console, self.toml())

    def plot(self, path: Path) -> None:
        """Draw the field along the axis and across the gap into the PNG or SVG file at `path`."""
        from matplotlib.figure import Figure

        near, far = self.gap
        along = np.zeros((300, 3))
        along[:, 2] = np.linspace(near, far, 300)
        across = np.zeros((300, 3))
        across[:, 0] = np.linspace(0, 2.5 * self.body.outer_radius, 300)
        across[:, 2] = 0.5 * (near + far)
        models = [("exact", self.body, "k-"), ("fitted", self.fitted.model, "C0--")]
        if self.published is not None:
            models.append(("in the file", self.published.model, "C1:"))
        figure = Figure(figsize=(11, 4.4), layout="constrained")
        left, middle, right = figure.subplots(1, 3)
        for name, source, line in models:
            left.plot(1e3 * along[:, 2], 1e3 * source.field(along)[:, 2], line, label=name)
            field = source.field(across)
            middle.plot(1e3 * across[:, 0], 1e3 * field[:, 2], line, label=name)
            right.plot(1e3 * across[:, 0], 1e3 * field[:, 0], line, label=name)
        unit = "mT" if self.part == "magnet" else "mT/A"
        left.set(xlabel="along the axis [mm]", ylabel=f"axial field [{unit}]")
        middle.set(xlabel="across the middle of the gap [mm]", ylabel=f"axial field [{unit}]")
        right.set(xlabel="across the middle of the gap [mm]", ylabel=f"radial field [{unit}]")
        for place in (left, middle, right):
            place.grid(alpha=0.3)
        left.legend(frameon=False)
        figure.suptitle(f"{self.part} of {self.device}: multipole models", x=0.01, ha="left", fontweight="bold")
        show_text_as_is(figure).savefig(path, dpi=150)


def compare(
    motor: SphericalMotor,
    part: str,
    most_dipoles: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> FitComparison:
    """Fit a model with at most `most_dipoles` pole pairs (None: as many as in the file) to `part` of `motor`."""
    if part not in PARTS:
        raise UnknownName("part of a motor", part, PARTS)
    magnet, coil = motor.magnet, motor.electromagnet
    body: RoundBody
    counterpart: RoundBody
    if part == "magnet":
        body, distance, counterpart, beyond = magnet, motor.magnets.distance, coil, motor.electromagnets.distance
        stored = motor.magnet_model
    else:
        body, distance, counterpart, beyond = coil, motor.electromagnets.distance, magnet, motor.magnets.distance
        stored = motor.coil_model
    half = 0.5 * counterpart.length
    region = shell_region(distance, beyond - half, beyond + half, _HALF_ANGLE_RAD)
    region = region[~body.contains(region)]
    most = most_dipoles or (stored.dipoles if stored is not None else _PUBLISHED_POLE_PAIRS)
    fitted = fit_multipole(body, region, most_dipoles=most, progress=progress)
    face = 0.5 * body.length
    toward = 1.0 if beyond > distance else -1.0
    gap = toward * (face + 0.5e-3), toward * (abs(beyond - distance) + 0.5 * counterpart.length)
    return FitComparison(
        motor.name, part, body, fitted, None if stored is None else residual(body, stored, region), gap
    )


def _describe_fit(fit: MultipoleFit) -> dict[str, Any]:
    model = fit.model
    return {
        "loops": len(model.loop_strengths) - 1,
        "per_loop": model.per_loop,
        "dipoles": model.dipoles,
        "radius_m": model.radius,
        "pole_distance_m": model.pole_distance,
        "strengths": model.loop_strengths.tolist(),
        "rms_error": fit.rms,
        "greatest_error": fit.greatest,
    }
