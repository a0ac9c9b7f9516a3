"""The greatest force that was felt beside the one that was computed, and what makes the difference, in newtons.

At the place where it was felt the world is asked again, one condition after another taken away: as it was; straight and
in the middle; slid quickly, with all of its friction. What is left to the computed peak is the way that was not gone.
The steps add up to the difference exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from haptorb.apps.feel.candidates import Candidate
from haptorb.apps.feel.course import InsertionForces, force_along
from haptorb.apps.feel.trace import COLUMNS, HAND
from haptorb.control.allocation.allocator import Saturation
from haptorb.numerics.arrays import Array

__all__ = ["AGREE", "PeakComparison", "compare_peaks"]

AGREE = 0.05  #: share of the computed peak within which the felt one agrees
_QUICK = 0.1  #: speed at which all friction is there [m/s], as in `course`
_STILL = 1e-4  #: slower than this is no motion [m/s]
_MIDDLE, _STRAIGHT = 5e-5, 0.3  #: within which a part is in the middle [m], and straight [°]
_SHARE = 0.01  #: of the computed peak: smaller causes are left out
_T, _X, _FX = (COLUMNS.index(name) for name in ("t_s", "x_m", "fx_n"))
_ASKED, _GIVEN, _GAIN, _SATURATED = (len(COLUMNS) + HAND.index(name) for name in HAND)


@dataclass(frozen=True)
class PeakComparison:
    """One way, "insertion" or "pull_out": computed and felt peak [N], and the causes of the difference."""

    way: str
    computed: float
    felt: float | None  #: None: the part was never moved this way
    causes: tuple[tuple[str, float], ...] = ()  #: what, and how much it adds to the felt peak [N]; they add up
    hand: str = ""  #: the part of it that did not reach the hand, and why; empty if all of it did

    @property
    def agrees(self) -> bool:
        """Whether both are the same within AGREE."""
        return self.felt is not None and abs(self.felt - self.computed) <= AGREE * self.computed

    @property
    def sentences(self) -> tuple[str, ...]:
        """In words: agreement, or every cause with its amount."""
        name = self.way.replace("_", "-")
        if self.felt is None:
            return (f"{name}: computed {self.computed:.1f} N, not felt: the part was not moved this way",)
        peaks = f"{name}: computed {self.computed:.1f} N, felt {self.felt:.1f} N"
        if self.agrees:
            found = [f"{peaks}; they agree"]
        else:
            causes = [f"{what} {amount:+.1f} N" for what, amount in self.causes]
            found = [f"{peaks}; " + "; ".join(causes)]
        if self.hand:
            found.append(f"{name}, in the hand: {self.hand}")
        return tuple(found)


def compare_peaks(design: Candidate, run: InsertionForces, traces: Sequence[Array]) -> tuple[PeakComparison, ...]:
    """Insertion and pull-out of `design`, felt in `traces` (n, 18), beside the computed `run`; () if never felt."""
    if not traces:
        return ()
    return tuple(_compare(design, run, traces, way) for way in ("insertion", "pull_out"))


def _compare(design: Candidate, run: InsertionForces, traces: Sequence[Array], way: str) -> PeakComparison:
    sign = 1.0 if way == "pull_out" else -1.0  # of the motion along X'
    curve = run.coming_out if sign > 0 else run.going_in
    computed = float(curve.max())
    best: tuple[float, Array, int, float] | None = None
    for rows in traces:
        speeds = _speeds(rows)
        moving = np.flatnonzero(sign * speeds > _STILL)
        if len(moving):
            force = -sign * rows[moving, _FX]
            at = int(moving[np.argmax(force)])
            if best is None or force.max() > best[0]:
                best = float(force.max()), rows, at, float(speeds[at])
    if best is None:
        return PeakComparison(way, computed, None)
    felt, rows, at, speed = best
    x = float(rows[at, _X])
    slow = -sign * force_along(design, x, speed)
    quick = -sign * force_along(design, x, sign * _QUICK)
    reached = float((sign * rows[:, _X]).max()) * sign
    peak_at = float(run.place[int(curve.argmax())])
    steps = (
        (_explain_place(x, peak_at, reached, sign), quick - computed),
        (f"slow motion ({1e3 * abs(speed):.1f} mm/s), without full friction:", slow - quick),
        (_explain_aside(rows[at]), felt - slow),
    )
    causes = tuple((what, amount) for what, amount in steps if abs(amount) >= _SHARE * computed)
    return PeakComparison(way, computed, felt, causes, _explain_hand(rows[at]))


def _speeds(rows: Array) -> Array:
    """(n,) speed along X' [m/s]; 0 for a single row."""
    if len(rows) < 2:
        return np.zeros(len(rows))
    t, x = rows[:, _T], rows[:, _X]
    step = np.gradient(t)
    return np.divide(np.gradient(x), step, out=np.zeros(len(rows)), where=step > 0)


def _explain_place(x: float, peak_at: float, reached: float, sign: float) -> str:
    if sign * reached < sign * peak_at - 1e-4:
        return f"the part reached X' = {1e3 * reached:.1f} mm, the peak is at {1e3 * peak_at:.1f} mm:"
    return f"felt at X' = {1e3 * x:.1f} mm, the peak is at {1e3 * peak_at:.1f} mm:"


def _explain_aside(row: Array) -> str:
    aside = float(np.hypot(row[_X + 1], row[_X + 2]))
    turn = 2.0 * np.degrees(np.arccos(np.clip(abs(row[COLUMNS.index("qw")]), 0.0, 1.0)))
    if aside < _MIDDLE and turn < _STRAIGHT:
        return "the loop's own estimate of the speed in this tick:"
    return f"off centre ({1e3 * aside:.1f} mm sideways, turned by {turn:.1f}°):"


def _explain_hand(row: Array) -> str:
    """The part of the force that did not reach the handle; empty if all of it did, or if unknown."""
    asked, given, gain, saturated = (float(row[k]) for k in (_ASKED, _GIVEN, _GAIN, _SATURATED))
    if np.isnan(asked) or asked <= 0.0:
        return ""
    if gain < 1.0 - AGREE:
        return (
            f"the guard passed {100 * gain:.0f} % of it: the force was still ramping up after a start, or a coil "
            "was warm"
        )
    if abs(given - asked) <= AGREE * asked:
        return ""
    limit = Saturation(int(saturated)) if saturated in tuple(Saturation) else Saturation.NONE
    why = f"the device was at its limit, {limit.text}" if limit else "currents rise with the coils' time constant"
    return f"{1e3 * asked:.0f} mN·m were asked, {1e3 * given:.0f} mN·m given: {why}"
