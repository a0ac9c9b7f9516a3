"""Report of a replay as text and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.display import format_number
from haptorb.recording.plot import thin_curve
from haptorb.recording.row import RowLayout
from haptorb.terminal import Column, TextTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from haptorb.replay.replay import Difference, Replay, RunComparison

__all__ = [
    "SHOWN",
    "Curves",
    "difference_table",
    "draw_comparison",
    "format_verdict",
    "list_numbers",
    "list_replay_facts",
]


def format_verdict(replay: Replay) -> str:
    """Describe whether all values agree, or where the first one differs."""
    found = replay.comparison
    ticks = f"{found.compared} ticks"
    if replay.replaced:
        return f"replayed with another {' and another '.join(replay.replaced)}: {_format_differing(found)}"
    if found.identical and not replay.approximate:
        return f"identical: every number of {ticks} is the same, bit for bit"
    if replay.missing:
        return f"near, because this older recording does not contain the samples: {_format_differing(found)}"
    if replay.approximate:
        return f"near, because the recording does not contain the loop's initial state: {_format_differing(found)}"
    return f"different: {_format_differing(found)}"


def _format_differing(found: RunComparison) -> str:
    if found.first is None:
        return f"all {found.compared} ticks are the same, bit for bit"
    return f"{found.differing} of {found.compared} ticks differ, first tick {found.first.tick} at {found.first.t:.4g} s"


def list_replay_facts(replay: Replay) -> list[tuple[str, str]]:
    """List names and texts: what was replayed, the first difference, and substituted parts."""
    facts = [("verdict", format_verdict(replay))]
    first = replay.comparison.first
    if first is not None:
        facts.append(("first difference", _describe(first)))
    if not replay.recorded.same_software:
        facts.append(("made by", replay.recorded.describe_software()))
    facts += [("ran code", code) for code in replay.recorded.code.values()]
    facts += [("remark", remark) for remark in replay.remarks]
    return facts


def _describe(first: Difference) -> str:
    unit = f" {first.unit}" if first.unit not in ("", "1") else ""
    return (
        f"{first.field}[{first.number}]: recorded {first.recorded!r}, replayed {first.replayed!r}{unit}; "
        f"{format_number(first.size)} apart"
    )


def difference_table(replay: Replay) -> TextTable:
    """Return the table of fields that differ: number of ticks, largest difference, and magnitude."""
    table = TextTable(
        (
            Column("field", kind="key"), Column("from tick", kind="short"), Column("ticks", kind="short"),
            Column("at most", kind="short"), Column("of up to", kind="short"), Column("unit", kind="short"),
        )
    )  # fmt: skip
    for one in replay.comparison.bounds:
        table.add_row(
            one.field, str(one.first), str(one.ticks), f"{one.largest:.3g}", f"{one.greatest:.3g}",
            one.unit.removeprefix("1"),
        )  # fmt: skip
    return table


def list_numbers(replay: Replay, seconds: float, took: float) -> dict[str, Any]:
    """Return the same as plain JSON types; `seconds` is the length of the run, `took` the computing time [s]."""
    found, first = replay.comparison, replay.comparison.first
    return {
        "identical": found.identical and not replay.approximate,
        "approximate": replay.approximate,
        "replaced": list(replay.replaced),
        "ticks": len(replay),
        "ticks_compared": found.compared,
        "ticks_different": found.differing,
        "numbers_compared": found.numbers,
        "first": None
        if first is None
        else {
            "tick": first.tick,
            "t_s": first.t,
            "field": first.field,
            "number": first.number,
            "unit": first.unit,
            "recorded": first.recorded,
            "replayed": first.replayed,
            "difference": first.size,
        },
        "fields": [
            {
                "name": one.field,
                "unit": one.unit,
                "first_tick": one.first,
                "ticks": one.ticks,
                "largest_difference": one.largest,
                "largest_recorded": one.greatest,
            }
            for one in found.bounds
        ],
        "missing_fields": list(replay.missing),
        "same_software": replay.recorded.same_software,
        "software": dict(replay.recorded.software),
        "ran_code": list(replay.recorded.code.values()),
        "remarks": list(replay.remarks),
        "duration_s": seconds,
        "took_s": took,
        "times_real_time": seconds / took if took > 0 else None,
    }


# --------------------------------------------------------------------------------------------------
# Figure of a recorded run and its replay: commanded wrench, model wrench, commanded currents.


_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  #: Okabe and Ito's
SHOWN = ("t", "wrench_commanded", "current_commanded", "p", "w")  #: fields that are drawn


@final
class Curves:
    """Collects the drawn fields from blocks of rows of `layout`."""

    def __init__(self, layout: RowLayout) -> None:
        self._layout = layout
        self._parts: dict[str, list[Array]] = {name: [] for name in SHOWN}

    def add(self, rows: Array) -> None:
        """Append rows (n, width), each value in the unit of its field."""
        for name in SHOWN:
            self._parts[name].append(rows[:, self._layout[name]].copy())

    def fields(self) -> dict[str, Array]:
        """Return field → values (n, width) [SI]."""
        return {name: np.concatenate(parts) for name, parts in self._parts.items()}


def draw_comparison(
    recorded: Mapping[str, Array], replayed: Mapping[str, Array], coils: Sequence[str], title: str
) -> Figure:
    """Draw recorded (pale) and replayed (dashed) runs: force or torque, its difference, currents, and motion.

    Both: field → (n, width) in SI, with their own times "t" [s]. coils: their names.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 10.0), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)  # no window, no global state
    asked, apart, wanted, way = figure.subplots(4, 1, sharex=True, height_ratios=(3, 1.6, 2.4, 2.4))
    turning = not any(np.nan_to_num(one["wrench_commanded"][:, :3]).any() for one in (recorded, replayed))
    part, letter, unit = (slice(3, 6), "T", "N·m") if turning else (slice(0, 3), "F", "N")
    names = [f"${letter}_{axis}$" for axis in "xyz"]
    _draw_both(asked, recorded, replayed, "wrench_commanded", part, names)
    asked.set_ylabel(f"commanded [{unit}]")
    t, difference = _subtract(recorded, replayed, part)
    for i, values in enumerate(difference.T):
        apart.plot(*thin_curve(t, values), color=_COLOURS[i], linewidth=1.0)
    apart.set_ylabel(f"replayed − recorded\n[{unit}]")
    names = [f"coil {name}" for name in coils]
    _draw_both(wanted, recorded, replayed, "current_commanded", slice(0, len(coils)), names)
    wanted.set_ylabel("commanded current [A]")
    moved, label = ("w", "angular velocity [rad/s]") if turning else ("p", "position [m]")
    _draw_both(way, recorded, replayed, moved, slice(0, 3), list("xyz"))
    way.set_ylabel(label)
    way.set_xlabel("time [s]")
    for axes in (asked, apart, wanted, way):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(visible=True, color="#e6e6e6", linewidth=0.7)
        axes.margins(x=0)
    figure.suptitle(f"{title}: recorded faint, replayed dashed", fontsize=12, color="#222222")
    return figure


def _draw_both(
    axes: Axes, recorded: Mapping[str, Array], replayed: Mapping[str, Array], name: str, part: slice, names: list[str]
) -> None:
    for i, label in enumerate(names):
        colour = _COLOURS[i % len(_COLOURS)]
        at = part.start + i
        axes.plot(
            *thin_curve(recorded["t"][:, 0], recorded[name][:, at]), color=colour, linewidth=2.2, alpha=0.4, label=label
        )
        then = thin_curve(replayed["t"][:, 0], replayed[name][:, at])
        axes.plot(*then, color=colour, linewidth=1.1, linestyle=(0, (4, 2)))
    if len(names) <= 8:
        axes.legend(loc="upper left", bbox_to_anchor=(1.005, 1.02), frameon=False, fontsize=8.5)


def _subtract(recorded: Mapping[str, Array], replayed: Mapping[str, Array], part: slice) -> tuple[Array, Array]:
    """Return the replay's times (n,) [s] and its wrench minus the latest recorded one (n, 3) [N or N·m]."""
    t, then = replayed["t"][:, 0], recorded["t"][:, 0]
    at = np.clip(np.searchsorted(then, t + 1e-7, side="right") - 1, 0, len(then) - 1)
    return t, replayed["wrench_commanded"][:, part] - recorded["wrench_commanded"][at, part]
