"""Assertions on the forces and torques of a recording, whose messages say when, where and by how much they differ."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptorb.arrays import Array
from haptorb.control.saturation import Saturation
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.base import State
from haptorb.errors import InputError, quote
from haptorb.figure_file import show_text_as_is
from haptorb.recording.recording import Recording
from haptorb.recording.row import resolve_name
from haptorb.testing.run import TEMPORARY
from haptorb.worlds import find_world
from haptorb.worlds.base import World
from haptorb.worlds.dynamic import DynamicWorld

__all__ = ["Reference", "assert_force_within", "assert_no_trip", "assert_torque_within"]

#: a force or torque (3,), one for each row (n, 3), a world or its name, a function of a State, or a recording
Reference: TypeAlias = ArrayLike | str | World | Callable[[State], Any] | Recording

Rows: TypeAlias = NDArray[np.intp]  #: row indices

_SHOWN = "wrench_actual", "wrench_model", "wrench_commanded", "object_wrench"


@dataclass(frozen=True)
class _Quantity:
    """Force or torque: its part of a wrench, and how it is written."""

    name: str
    part: slice
    unit: str


_FORCE, _TORQUE = _Quantity("force", slice(0, 3), "N"), _Quantity("torque", slice(3, 6), "N·m")


def assert_force_within(
    recording: Recording | str | Path,
    reference: Reference,
    *,
    newtons: float,
    share: float = 0.0,
    between: tuple[float, float] | None = None,
    wrench: str = "wrench_actual",
) -> None:
    """Assert that the force on the mover is that of a reference, in every tick.

    Parameters
    ----------
    recording : Recording, str or Path
        Recording, or the path of its file.
    reference : array_like, shape (3,) or (n, 3), World, str, callable or Recording
        A force, or one for each tick [N]; a world without memory, or its name, asked at the recorded poses;
        a function of a State that returns a force (3,) [N] or wrench (6,) [N, N·m]; or another recording, compared at
        the same times.
    newtons : float
        Greatest allowed distance of the two force vectors [N].
    share : float
        Share of the reference that is allowed in addition, 0.02 for 2 % [1].
    between : tuple of float, optional
        First and last time on the loop's clock [s]; None: all ticks.
    wrench : str
        Field of the recording: "wrench_actual" (of coils and core on the mover; where unknown, as on a real device,
        "wrench_model" is used), "wrench_model", "wrench_commanded" (after the guard's limits) or "object_wrench" (of
        the world).

    Raises
    ------
    AssertionError
        With the time, the place, both forces and the number of ticks; a figure and a table of the differences are
        written beside the recording.
    InputError
        If there is no tick in that time, or the reference has another shape.
    RecordingError
        If the recording cannot be read.

    Examples
    --------
    >>> from haptorb.testing import haptic_device, scripted_hand
    >>> with haptic_device("omni", "nothing", hand=scripted_hand("start 0 0 70 mm")) as run:
    ...     run.play(0.1)
    >>> assert_force_within(run.recording, (0, 0, 0), newtons=0.05)
    """
    _assert_within(recording, reference, newtons, share, between, wrench, _FORCE)


def assert_torque_within(
    recording: Recording | str | Path,
    reference: Reference,
    *,
    newton_metres: float,
    share: float = 0.0,
    between: tuple[float, float] | None = None,
    wrench: str = "wrench_actual",
) -> None:
    """Assert that the torque on the mover is that of a reference, in every tick.

    Parameters
    ----------
    recording : Recording, str or Path
        Recording, or the path of its file.
    reference : array_like, shape (3,) or (n, 3), World, str, callable or Recording
        As for `assert_force_within`, a torque [N·m].
    newton_metres : float
        Greatest allowed distance of the two torque vectors [N·m].
    share : float
        Share of the reference that is allowed in addition [1].
    between : tuple of float, optional
        First and last time on the loop's clock [s]; None: all ticks.
    wrench : str
        As for `assert_force_within`.

    Raises
    ------
    AssertionError
        As `assert_force_within`, with its other errors.
    """
    _assert_within(recording, reference, newton_metres, share, between, wrench, _TORQUE)


def assert_no_trip(recording: Recording | str | Path, between: tuple[float, float] | None = None) -> None:
    """Assert that the guard did not switch the coils off.

    Parameters
    ----------
    recording : Recording, str or Path
        Recording, or the path of its file.
    between : tuple of float, optional
        First and last time on the loop's clock [s]; None: all ticks.

    Raises
    ------
    AssertionError
        With the time and the reason of the first trip.
    """
    run = _open(recording)
    rows = _find_rows(run, between)
    off = rows[np.asarray(run["guard"])[rows] == GuardState.TRIPPED]
    if off.size:
        t, reason = float(run["t"][int(off[0])]), Trip(int(run["trip"][int(off[0])]))
        raise AssertionError(f"the guard switched off at {t:.4g} s: {reason.text}")


def _open(recording: Recording | str | Path) -> Recording:
    return recording if isinstance(recording, Recording) else Recording(recording)


def _find_rows(run: Recording, between: tuple[float, float] | None) -> Rows:
    """Row indices of the ticks in `between`, without the closing row, which is not a tick."""
    t = np.asarray(run["t"])
    inside = np.isfinite(t)
    if "commands" in {field.name for field in run.fields}:
        inside &= ~(np.asarray(run["commands"]) < 0.0)
    if between is not None:
        first, last = between
        inside &= (t >= first - 1e-9) & (t <= last + 1e-9)
    rows = np.flatnonzero(inside)
    if not rows.size:
        span = f"{t[0]:.4g} s to {t[-1]:.4g} s" if len(t) else "no tick"
        raise InputError(f"{run.path} has no tick between {between} s; it has {span}")
    return rows


def _assert_within(
    recording: Recording | str | Path, reference: Reference, most: float, share: float,
    between: tuple[float, float] | None, wrench: str, quantity: _Quantity,
) -> None:  # fmt: skip
    """Compare a part of the wrenches; raise AssertionError with what a reader needs to find the cause."""
    if wrench not in _SHOWN:
        raise InputError(f"wrench must be one of {', '.join(_SHOWN)}; got {quote(wrench)}")
    if not (most >= 0.0 and share >= 0.0):
        raise InputError(f"tolerances must be numbers of 0 or more; got {most!r} and {share!r}")
    run = _open(recording)
    rows = _find_rows(run, between)
    there = _read_part(run, rows, wrench, quantity)
    wanted = _find_reference(reference, run, rows, wrench, quantity)
    distance = np.linalg.norm(there - wanted, axis=1)
    allowed = most + share * np.linalg.norm(wanted, axis=1)
    wrong = ~(distance <= allowed)  # NaN counts as a violation
    if not wrong.any():
        return
    excess = np.where(np.isfinite(distance), distance - allowed, np.inf)
    worst = int(np.argmax(excess))
    lines = _describe(run, rows, there, wanted, wrong, worst, most, share, quantity, wrench)
    lines += _save(run, rows, there, wanted, allowed, quantity)
    raise AssertionError("\n".join(lines))


def _read_part(run: Recording, rows: Rows, wrench: str, quantity: _Quantity) -> Array:
    """(n, 3) part of the recorded wrench; `wrench_model` where `wrench_actual` is unknown."""
    wrench = resolve_name(wrench)
    there: Array = np.asarray(run[wrench])[rows][:, quantity.part]
    unknown = ~np.isfinite(there).all(axis=1)
    if wrench == "wrench_actual" and unknown.any():
        there = there.copy()
        there[unknown] = np.asarray(run["wrench_model"])[rows][unknown][:, quantity.part]
    return there


def _find_reference(reference: Reference, run: Recording, rows: Rows, wrench: str, quantity: _Quantity) -> Array:
    """(n, 3) reference at each of `rows`."""
    if isinstance(reference, Recording):
        others = _find_rows(reference, None)
        there, t = _read_part(reference, others, wrench, quantity), np.asarray(reference["t"])[others]
        now = np.asarray(run["t"])[rows]
        if now[0] < t[0] - 1e-9 or now[-1] > t[-1] + 1e-9:
            raise InputError(
                f"{reference.path} covers {t[0]:.4g} s to {t[-1]:.4g} s, but {now[0]:.4g} s to {now[-1]:.4g} s are "
                "compared: state the common time with between=…"
            )
        return np.column_stack([np.interp(now, t, column) for column in there.T])
    if isinstance(reference, str):
        reference = find_world(reference)()
    if isinstance(reference, World):
        if isinstance(reference, DynamicWorld):
            raise InputError(
                f"world '{reference.name}' has a memory: what it would have asked cannot be told from poses alone; "
                "compare with a recording of it"
            )
        reference = reference.wrench
    if callable(reference):
        found = np.array([np.asarray(reference(state), dtype=np.float64) for state in _list_states(run, rows)])
        if found.shape == (len(rows), 6):
            found = found[:, quantity.part]
    else:
        found = np.asarray(reference, dtype=np.float64)
        if found.shape == (3,):
            return np.tile(found, (len(rows), 1))
        if found.shape == (len(run), 3):
            return found[rows]
    if found.shape != (len(rows), 3):
        raise InputError(
            f"the reference must be a {quantity.name} (3,) [{quantity.unit}], or one for each tick ({len(rows)}, 3); "
            f"got shape {found.shape}"
        )
    return found


def _list_states(run: Recording, rows: Rows) -> Iterable[State]:
    """The estimated state of the world's object in each of `rows`: the mover, or what a motor moves."""
    direct = "object" not in {field.name for field in run.fields}
    place, turn = ("p", "q") if direct else ("object", "object_q")
    columns = {name: np.asarray(run[name])[rows] for name in ("t", place, turn, "v", "w")}
    for t, p, q, v, w in zip(*columns.values(), strict=True):
        x, y, z, s = q
        R = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * s), 2 * (x * z + y * s)],
                [2 * (x * y + z * s), 1 - 2 * (x * x + z * z), 2 * (y * z - x * s)],
                [2 * (x * z - y * s), 2 * (y * z + x * s), 1 - 2 * (x * x + y * y)],
            ]
        )
        yield State(float(t), R, p, w, v)


def _describe(
    run: Recording, rows: Rows, there: Array, wanted: Array, wrong: Array, worst: int, most: float, share: float,
    quantity: _Quantity, wrench: str,
) -> list[str]:  # fmt: skip
    """Lines of the failure message: how often, when, where, by how much, and what limited the device."""
    t, unit, name = np.asarray(run["t"])[rows], quantity.unit, quantity.name
    row = int(rows[worst])
    gap = there[worst] - wanted[worst]
    at = "xyz"[int(np.argmax(np.abs(np.nan_to_num(gap))))]
    first, last = t[wrong][0], t[wrong][-1]
    limit = f"{most:g} {unit}" + (f" and {100 * share:g} % of the reference" if share else "")
    rms = float(np.sqrt(np.nanmean((there - wanted) ** 2) * 3))
    size = float(np.linalg.norm(gap))
    known = {field.name for field in run.fields}
    guard = GuardState(int(run["guard"][row])).name.lower()
    limited = ""
    if "saturated" in known and np.isfinite(run["saturated"][row]) and run["saturated"][row]:
        limited = f", limited by {Saturation(int(run['saturated'][row])).text}"
    if guard in ("tripped", "off"):
        limited += f". {Trip(int(run['trip'][row])).text}".rstrip(". ") if run["trip"][row] else ""
    place = ", ".join(f"{1e3 * x:.4g}" for x in np.asarray(run["p"][row]))
    return [
        f"the {name} is off the reference by more than {limit} in {int(wrong.sum())} of {len(rows)} ticks, from "
        f"{first:.4g} s to {last:.4g} s",
        f"  worst at {t[worst]:.4g} s (tick {row}): {size:.4g} {unit}, most of it along {at}",
        f"  {wrench} {_format(there[worst], unit)}, reference {_format(wanted[worst], unit)}",
        f"  at p = ({place}) mm; guard {guard}{limited}",
        f"  root mean square over all compared ticks: {rms:.4g} {unit}",
    ]


def _format(vector: Array, unit: str) -> str:
    return f"({', '.join(f'{x:.4g}' for x in vector)}) {unit}"


def _save(run: Recording, rows: Rows, there: Array, wanted: Array, allowed: Array, quantity: _Quantity) -> list[str]:
    """Write a table and a figure beside the recording unless it is temporary; return message lines with their paths."""
    if run.path.parent.name.startswith(TEMPORARY):
        return ["  record=FILE, or the fixture of pytest, keeps the recording, a table and a figure of the difference"]
    t, unit = np.asarray(run["t"])[rows], quantity.unit
    table, figure = (run.path.with_name(f"{run.path.stem}-{quantity.name}.{end}") for end in ("csv", "png"))
    vectors = [f"{what} {axis} [{unit}]" for what in ("recorded", "reference") for axis in "xyz"]
    head = ["t [s]", *vectors, f"allowed [{unit}]"]
    said = [f"  recording {run.path}"]
    try:
        np.savetxt(table, np.column_stack([t, there, wanted, allowed]), "%.9g", ",", header=",".join(head), comments="",
                   encoding="utf-8")  # fmt: skip
        said.append(f"  table {table}")
        _draw(figure, t, there, wanted, allowed, quantity)
        said.append(f"  figure {figure}")
    except OSError as cause:
        said.append(f"  no table or figure: {cause}")
    return said


def _draw(path: Path, t: Array, there: Array, wanted: Array, allowed: Array, quantity: _Quantity) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(4, 1, sharex=True)
    for one, axis, recorded, reference in zip(axes[:3], "xyz", there.T, wanted.T, strict=True):
        one.plot(t, reference, color="#d55e00", label="reference")
        one.plot(t, recorded, color="#0072b2", label="recorded", lw=1)
        one.set_ylabel(f"{axis} [{quantity.unit}]")
    axes[0].legend(frameon=False, ncols=2, fontsize=8)
    axes[3].plot(t, np.linalg.norm(there - wanted, axis=1), color="#222222")
    axes[3].plot(t, allowed, "k:")
    axes[3].set(ylabel=f"difference [{quantity.unit}]", xlabel="time on the loop's clock [s]")
    show_text_as_is(figure).savefig(path, dpi=100)
