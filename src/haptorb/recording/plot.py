"""Plot of a recording: commanded and actual force (or torque), energy, currents, temperatures, lateness."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import RecordingError
from haptorb.figure_file import show_text_as_is
from haptorb.recording.export import coil_names
from haptorb.recording.row import Field, FieldColumn

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot", "thin_curve"]

#: Okabe-Ito palette, distinguishable with colour-vision deficiencies
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_INK, _FAINT = "#222222", "#888888"
_KELVIN = 273.15
_FIELDS = (
    "t",
    "wrench_actual",
    "wrench_model",
    "wrench_commanded",
    "current_measured",
    "boundary",
    "winding",
    "lateness",
    "missed",
    "guard",
)
_POINTS = 4000  #: per curve; `thin_curve` reduces longer curves and preserves their peaks


class Fields(Protocol):
    """Interface to a recording that is plotted."""

    path: Path
    fields: tuple[Field, ...]
    truncated: bool

    @property
    def t(self) -> FieldColumn:
        """(n,) time on the loop's clock [s]."""

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name: device, run, versions and others."""

    def require(self, *names: str) -> None:
        """Raise RecordingError unless all these fields exist with their present widths."""

    def __getitem__(self, name: str) -> FieldColumn:
        """The field `name` over all ticks, shape (n, width), or (n,) if the width is 1, in its unit [SI]."""

    def __len__(self) -> int:
        """Number of recorded rows."""


def plot(recording: Fields, path: str | Path | None = None) -> Figure:
    """Plot a recording; the figure is also written to `path` if one is given.

    Raises RecordingError if the recording has no rows, or if the figure cannot be written.
    """
    if not len(recording):
        raise RecordingError(f"{recording.path} holds no rows to plot")
    known = {field.name for field in recording.fields}
    recording.require(*_FIELDS, *(name for name in ("energy", "injected") if name in known))
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 11.0), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)  # no window, no global state: also usable in a server
    force, energy, currents, heat, late = figure.subplots(5, 1, sharex=True, height_ratios=(3, 1.6, 2, 2, 1.6))
    t = np.asarray(recording.t)
    _wrench(force, recording, t)
    _energy(energy, recording, t)
    _currents(currents, recording, t)
    _temperatures(heat, recording, t)
    _lateness(late, recording, t)
    for axes in (force, energy, currents, heat, late):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(visible=True, color="#e6e6e6", linewidth=0.7)
        axes.margins(x=0)
        _legend(axes)
        _draw_trips(axes, recording, t)
    late.set_xlabel("time [s]")
    run, device = recording.metadata.get("run", {}), recording.metadata.get("device", {})
    kind = " (simulated)" if run.get("driver") == "sim" else ""
    cut = ", cut short" if recording.truncated else ""
    figure.suptitle(f"{device.get('title') or device.get('name', '')}{kind}{cut}", fontsize=12, color=_INK)
    show_text_as_is(figure)
    if path is not None:
        try:
            show_text_as_is(figure).savefig(Path(path), dpi=150)
        except (OSError, ValueError) as cause:
            raise RecordingError(f"cannot write the figure {path}: {cause}") from cause
    return figure


def _wrench(axes: Axes, recording: Fields, t: Array) -> None:
    """Plot the commanded force (dashed) and the actual one (solid), by the controller model if the latter is unknown.

    Plots the torque instead if both forces are always zero and a torque was commanded.
    """
    given, label = recording["wrench_actual"], "actual"
    if not np.isfinite(given).any():
        given, label = recording["wrench_model"], "by the controller model"
    asked = recording["wrench_commanded"]
    turning = not (np.nan_to_num(given[:, :3]).any() or asked[:, :3].any()) and asked[:, 3:].any()
    first, letter = (3, "T") if turning else (0, "F")
    for i, name in enumerate("xyz"):
        axes.plot(*thin_curve(t, given[:, first + i]), color=_COLOURS[i], linewidth=1.1, label=f"${letter}_{name}$")
        axes.plot(*thin_curve(t, asked[:, first + i]), color=_COLOURS[i], linewidth=1.1, linestyle=(0, (4, 2)))
    axes.plot([], [], color=_INK, linewidth=1.1, label=label)
    axes.plot([], [], color=_INK, linewidth=1.1, linestyle=(0, (4, 2)), label="commanded")
    axes.set_ylabel("torque [N·m]" if turning else "force [N]")


def _energy(axes: Axes, recording: Fields, t: Array) -> None:
    """Plot the energy delivered to the hand; mark ticks with injected damping and ticks with a softened world.

    Damping is injected where sampling and delay have generated energy.
    """
    if not {"energy", "injected"} <= {field.name for field in recording.fields}:  # an older recording
        return
    axes.plot(*thin_curve(t, 1e3 * recording["energy"]), color=_COLOURS[0], linewidth=1.1, label="given to the hand")
    damped = recording["injected"] > 0
    if damped.any():
        lowest = axes.get_ylim()[0]
        axes.plot(t[damped], np.full(int(damped.sum()), lowest), "|", color=_COLOURS[1], label="damping injected")
    if "softened" in {field.name for field in recording.fields} and (softened := recording["softened"] > 0).any():
        lowest = axes.get_ylim()[0]
        axes.plot(t[softened], np.full(int(softened.sum()), lowest), "_", color=_COLOURS[3], label="world softened")
    axes.set_ylabel("energy [mJ]")


def _currents(axes: Axes, recording: Fields, t: Array) -> None:
    columns = _columns(np.asarray(recording["current_measured"]))
    for i, (values, name) in enumerate(zip(columns, coil_names(recording.metadata, len(columns)), strict=True)):
        axes.plot(*thin_curve(t, values), color=_COLOURS[i % 6], linewidth=1.0, label=f"coil {name}")
    axes.set_ylabel("current [A]")


def _temperatures(axes: Axes, recording: Fields, t: Array) -> None:
    """Plot winding temperatures (solid, estimated) and boundary temperatures (dotted, measured)."""
    for i, values in enumerate(
        _columns(np.asarray(recording["boundary"]))
    ):  # drawn first, so that their noise does not hide the windings
        axes.plot(*thin_curve(t, values - _KELVIN), color=_COLOURS[i % 6], linewidth=0.7, linestyle=":", alpha=0.4)
    columns = _columns(np.asarray(recording["winding"]))
    for i, (values, name) in enumerate(zip(columns, coil_names(recording.metadata, len(columns)), strict=True)):
        axes.plot(*thin_curve(t, values - _KELVIN), color=_COLOURS[i % 6], linewidth=1.1, label=f"winding {name}")
    axes.plot([], [], color=_INK, linewidth=0.9, linestyle=":", label="boundary")
    axes.set_ylabel("temperature [°C]")


def _lateness(axes: Axes, recording: Fields, t: Array) -> None:
    late = np.maximum(1e6 * recording["lateness"], 0.1)
    axes.plot(t, late, ".", markersize=1.5, color=_FAINT, rasterized=True)
    skipped = recording["missed"] > 0
    if skipped.any():
        axes.plot(t[skipped], late[skipped], "x", markersize=4, color=_COLOURS[1], label="after a missed deadline")
    p99 = float(np.percentile(late, 99))
    axes.axhline(p99, color=_INK, linewidth=0.9, label=f"99 % below {p99:.0f} µs")
    axes.set_yscale("log")
    axes.set_ylabel("lateness [µs]")


def _draw_trips(axes: Axes, recording: Fields, t: Array) -> None:
    """Draw a vertical line at each trip of the guard."""
    tripped = recording["guard"] == 4
    begins = np.flatnonzero(tripped & ~np.concatenate(([False], tripped[:-1])))
    for at in t[begins[:50]]:
        axes.axvline(float(at), color=_COLOURS[1], linewidth=0.9, alpha=0.8)


def _legend(axes: Axes) -> None:
    if entries := len(axes.get_legend_handles_labels()[0]):
        axes.legend(
            loc="upper left", bbox_to_anchor=(1.005, 1.02), frameon=False, fontsize=8.5, handlelength=1.8,
            ncols=1 if entries < 8 else 2, columnspacing=1.0,
        )  # fmt: skip


def _columns(values: Array) -> Array:
    """Transpose (n, m) to (m, n); (n,) of a single channel becomes (1, n)."""
    columns: Array = np.atleast_2d(values.T)
    return columns


def thin_curve(t: Array, values: Array) -> tuple[Array, Array]:
    """Reduce the curve `values` (n,) over `t` (n,) [s] to the minimum and maximum of each interval, in its unit [SI].

    A curve that is short enough for the figure is returned unchanged.
    """
    stretch = -(-len(t) // (_POINTS // 2))
    if stretch < 2:
        return t, values
    n = len(t) // stretch * stretch
    blocks = values[:n].reshape(-1, stretch)
    pairs = np.stack((blocks.min(axis=1), blocks.max(axis=1)), axis=1).ravel()
    return np.repeat(t[:n:stretch], 2), pairs
