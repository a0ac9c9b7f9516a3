"""Effect sizes of paired differences: d_z and Hedges' g_av, with confidence intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import check_finite
from haptorb.errors import InputError

__all__ = ["EffectSize", "effect_size"]


@dataclass(frozen=True)
class EffectSize:
    """Standardised mean difference of pairs (Lakens 2013); NaN without spread."""

    d_z: float  #: mean difference over the standard deviation of the differences
    d_z_95: tuple[float, float]  #: exact for normal differences: noncentral t
    g_av: float  #: over the root mean variance of both conditions, with Hedges' correction for small samples
    g_av_95: tuple[float, float]  #: noncentral t, after Algina & Keselman 2003; approximate


_NO_INTERVAL = (math.nan, math.nan)


def effect_size(differences: ArrayLike, spread: float | None = None, confidence: float = 0.95) -> EffectSize:
    """Effect size of paired `differences` (people,); `spread` is √((s_a² + s_b²)/2), without it there is no g_av.

    d_z = m/s has the noncentral t distribution with δ √n: its interval holds the δ for which m √n/s lies between the
    quantiles (Morey; Steiger & Fouladi 1997). g_av = J(n − 1) m/spread, J(f) = Γ(f/2)/(√(f/2) Γ((f − 1)/2)).

    >>> size = effect_size([1.0, 2.0, 3.0, 4.0])
    >>> round(size.d_z, 3), [round(end, 3) for end in size.d_z_95]
    (1.936, [0.146, 3.672])
    """
    from scipy.special import gammaln

    d = check_finite(differences, "differences")
    if d.ndim != 1 or len(d) < 2:
        raise InputError(f"an effect size needs at least two people; got shape {d.shape}")
    n, mean, sd = len(d), float(d.mean()), float(d.std(ddof=1))
    if sd <= 1e-12 * float(np.abs(d).max()):
        return EffectSize(math.nan, _NO_INTERVAL, math.nan, _NO_INTERVAL)
    ends = _shift_interval(mean / sd * math.sqrt(n), n - 1, confidence)
    low, high = (end / math.sqrt(n) for end in ends)
    if spread is None or not spread > 0:
        return EffectSize(mean / sd, (low, high), math.nan, _NO_INTERVAL)
    f = n - 1
    # With one degree of freedom the correction is zero: Γ has a pole, and the mean of d does not exist.
    correction = 0.0 if f < 2 else math.exp(gammaln(f / 2) - gammaln((f - 1) / 2)) / math.sqrt(f / 2)
    scale = sd / spread
    return EffectSize(mean / sd, (low, high), correction * mean / spread, (low * scale, high * scale))


def _shift_interval(t: float, freedom: int, confidence: float) -> tuple[float, float]:
    """Noncentralities for which `t` is the upper and the lower quantile."""
    from scipy.optimize import brentq
    from scipy.special import nctdtr

    def find_shift(share: float) -> float:
        """P(T < t) − `share`, which decreases with the noncentrality."""
        step = 2.0 + abs(t)
        low, high = t - step, t + step
        while nctdtr(freedom, low, t) < share:
            low -= step
        while nctdtr(freedom, high, t) > share:
            high += step
        return float(brentq(lambda shift: float(nctdtr(freedom, shift, t)) - share, low, high, xtol=1e-10))

    return find_shift((1 + confidence) / 2), find_shift((1 - confidence) / 2)
