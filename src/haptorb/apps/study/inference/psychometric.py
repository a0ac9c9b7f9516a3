"""The psychometric function: share of answers over the level of a stimulus, fitted with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, check_finite

__all__ = ["PsychometricCurve", "psychometric_fit"]


@dataclass(frozen=True)
class PsychometricCurve:
    """p(x) = γ + (1 − γ − λ) Φ((x − middle)/spread), with 95 % intervals by parametric bootstrap."""

    middle: float
    spread: float
    guess: float  #: γ
    lapse: float  #: λ
    middle_95: tuple[float, float]
    spread_95: tuple[float, float]

    def __call__(self, x: ArrayLike) -> Array:
        """p at `x`."""
        from scipy.special import ndtr

        at = np.asarray(x, dtype=float)
        p: Array = self.guess + (1 - self.guess - self.lapse) * ndtr((at - self.middle) / self.spread)
        return p


def psychometric_fit(
    levels: ArrayLike, yes: ArrayLike, of: ArrayLike, *, guess: float = 0.0, lapse: float = 0.02, seed: int = 0,
    samples: int = 200,
) -> PsychometricCurve:  # fmt: skip
    """Greatest likelihood of `yes` (n,) out of `of` (n,) at `levels` (n,). InputError with fewer than two levels.

    With guess = 0 both tails lapse alike. The spread is kept between a hundredth and ten times the levels' range.
    """
    x, k, n = check_finite(levels, "levels"), check_finite(yes, "yes"), check_finite(of, "of")
    if len(set(x.tolist())) < 2 or not (x.shape == k.shape == n.shape) or (k > n).any() or (n <= 0).any():
        raise InputError("a psychometric fit needs at least two different levels, each with 0 ≤ yes ≤ of and of ≥ 1")
    low = lapse if guess == 0.0 else guess
    middle, spread = _fit_grid(x, k, n, low, lapse)
    curve = PsychometricCurve(middle, spread, low, lapse, (middle, middle), (spread, spread))
    draw = np.random.default_rng(seed)
    p = curve(x)
    again = np.array(
        [_fit_grid(x, draw.binomial(n.astype(int), p).astype(float), n, low, lapse) for _ in range(samples)]
    )
    (a, c), (b, d) = np.percentile(again, (2.5, 97.5), axis=0)
    return PsychometricCurve(middle, spread, low, lapse, (float(a), float(b)), (float(c), float(d)))


def _fit_grid(x: Array, k: Array, n: Array, low: float, lapse: float) -> tuple[float, float]:
    """Best (middle, spread) on a grid that is refined about its best point: no start to choose, no failure to meet."""
    from scipy.special import ndtr

    span = float(np.ptp(x))
    middles = np.linspace(x.min() - span / 2, x.max() + span / 2, 25)
    spreads = np.geomspace(span / 100, span * 10, 25)
    for _ in range(5):
        z = (x - middles[:, None, None]) / spreads[None, :, None]
        p = np.clip(low + (1 - low - lapse) * ndtr(z), 1e-9, 1 - 1e-9)
        i, j = np.unravel_index(int(np.argmax(np.log(p) @ k + np.log1p(-p) @ (n - k))), (25, 25))
        step, ratio = middles[1] - middles[0], spreads[1] / spreads[0]
        best = float(middles[i]), float(spreads[j])
        middles = np.linspace(best[0] - 1.5 * step, best[0] + 1.5 * step, 25)
        spreads = np.clip(np.geomspace(best[1] / ratio**1.5, best[1] * ratio**1.5, 25), span / 100, span * 10)
        if spreads[1] <= spreads[0]:
            break
    return best
