"""Comparison of measured and computed peak force, with the causes of the difference [N].

The world is evaluated at the position of the measured peak while one deviation after another is removed: as
measured; straight and centred; at full sliding speed, with all friction. The rest of the difference to the computed
peak is displacement that was not travelled. The contributions sum to the difference exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from haptorb.arrays import Array
from haptorb.control.saturation import Saturation
from haptorb_study.feel.designs import Candidate
from haptorb_study.feel.insertion_forces import InsertionForces, force_along
from haptorb_study.feel.trace import COLUMNS, HAND

__all__ = ["PEAK_TOLERANCE", "PeakComparison", "compare_peaks"]


PEAK_TOLERANCE = 0.05  #: relative tolerance between measured and computed peak
_SLIDING_SPEED_M_PER_S = 0.1  #: sliding speed with full friction [m/s], as in `course`
_STANDSTILL_M_PER_S = 1e-4  #: standstill below this speed [m/s]
_CENTRED_M, _STRAIGHT_DEG = 5e-5, 0.3  #: tolerances of centred [m] and straight [°] motion
_MIN_CAUSE_SHARE = 0.01  #: smallest cause that is listed, relative to the computed peak
_T, _PEAKS_X, _PEAKS_FX = (COLUMNS.index(name) for name in ("t_s", "x_m", "fx_n"))
_ASKED, _GIVEN, _GAIN, _SATURATED = (len(COLUMNS) + HAND.index(name) for name in HAND)


@dataclass(frozen=True)
class PeakComparison:
    """Computed and measured peak [N] in one direction, "insertion" or "pull_out", and causes of the difference."""

    way: str
    computed: float
    felt: float | None  #: None: the part was never moved in this direction
    causes: tuple[tuple[str, float], ...] = ()  #: cause and its contribution [N]; their sum is the difference
    hand: str = ""  #: force that did not reach the hand, and why; empty if none

    @property
    def agrees(self) -> bool:
        """Whether both agree within PEAK_TOLERANCE."""
        return self.felt is not None and abs(self.felt - self.computed) <= PEAK_TOLERANCE * self.computed

    @property
    def sentences(self) -> tuple[str, ...]:
        """Agreement, or every cause with its contribution, as text."""
        name = self.way.replace("_", "-")
        if self.felt is None:
            return (f"{name}: computed {self.computed:.1f} N, not measured: the part was not moved in this direction",)
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
    """Compare insertion and pull-out of `design` in `traces` (n, 18) with the computed `run`; () without traces."""
    if not traces:
        return ()
    return tuple(_peaks_compare(design, run, traces, way) for way in ("insertion", "pull_out"))


def _peaks_compare(design: Candidate, run: InsertionForces, traces: Sequence[Array], way: str) -> PeakComparison:
    sign = 1.0 if way == "pull_out" else -1.0  # of the motion along X'
    curve = run.coming_out if sign > 0 else run.going_in
    computed = float(curve.max())
    best: tuple[float, Array, int, float] | None = None
    for rows in traces:
        speeds = _speeds(rows)
        moving = np.flatnonzero(sign * speeds > _STANDSTILL_M_PER_S)
        if len(moving):
            force = -sign * rows[moving, _PEAKS_FX]
            at = int(moving[np.argmax(force)])
            if best is None or force.max() > best[0]:
                best = float(force.max()), rows, at, float(speeds[at])
    if best is None:
        return PeakComparison(way, computed, None)
    felt, rows, at, speed = best
    x = float(rows[at, _PEAKS_X])
    slow = -sign * force_along(design, x, speed)
    quick = -sign * force_along(design, x, sign * _SLIDING_SPEED_M_PER_S)
    reached = float((sign * rows[:, _PEAKS_X]).max()) * sign
    peak_at = float(run.place[int(curve.argmax())])
    steps = (
        (_explain_place(x, peak_at, reached, sign), quick - computed),
        (f"slow motion ({1e3 * abs(speed):.1f} mm/s), without full friction:", slow - quick),
        (_explain_aside(rows[at]), felt - slow),
    )
    causes = tuple((what, amount) for what, amount in steps if abs(amount) >= _MIN_CAUSE_SHARE * computed)
    return PeakComparison(way, computed, felt, causes, _explain_hand(rows[at]))


def _speeds(rows: Array) -> Array:
    """(n,) speed along X' [m/s]; 0 for a single row."""
    if len(rows) < 2:
        return np.zeros(len(rows))
    t, x = rows[:, _T], rows[:, _PEAKS_X]
    step = np.gradient(t)
    return np.divide(np.gradient(x), step, out=np.zeros(len(rows)), where=step > 0)


def _explain_place(x: float, peak_at: float, reached: float, sign: float) -> str:
    if sign * reached < sign * peak_at - 1e-4:
        return f"the part reached X' = {1e3 * reached:.1f} mm, the peak is at {1e3 * peak_at:.1f} mm:"
    return f"felt at X' = {1e3 * x:.1f} mm, the peak is at {1e3 * peak_at:.1f} mm:"


def _explain_aside(row: Array) -> str:
    aside = float(np.hypot(row[_PEAKS_X + 1], row[_PEAKS_X + 2]))
    turn = 2.0 * np.degrees(np.arccos(np.clip(abs(row[COLUMNS.index("qw")]), 0.0, 1.0)))
    if aside < _CENTRED_M and turn < _STRAIGHT_DEG:
        return "the loop's own estimate of the speed in this tick:"
    return f"off centre ({1e3 * aside:.1f} mm sideways, turned by {turn:.1f}°):"


def _explain_hand(row: Array) -> str:
    """Force that did not reach the handle, as text; empty if none or unknown."""
    asked, given, gain, saturated = (float(row[k]) for k in (_ASKED, _GIVEN, _GAIN, _SATURATED))
    if np.isnan(asked) or asked <= 0.0:
        return ""
    if gain < 1.0 - PEAK_TOLERANCE:
        return (
            f"the guard passed {100 * gain:.0f} % of it: the force was still ramping up after a start, or a coil "
            "was warm"
        )
    if abs(given - asked) <= PEAK_TOLERANCE * asked:
        return ""
    limit = Saturation(int(saturated)) if saturated in tuple(Saturation) else Saturation.NONE
    why = f"the device was at its limit, {limit.text}" if limit else "currents rise with the coils' time constant"
    return f"{1e3 * asked:.0f} mN·m were asked, {1e3 * given:.0f} mN·m given: {why}"
