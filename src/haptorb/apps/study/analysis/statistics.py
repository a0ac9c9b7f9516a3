"""Counts and curves with their uncertainty: Wilson, exact chance, bootstrap over people, psychometric fits."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, check_finite

__all__ = ["PsychometricCurve", "binomial_tail", "bootstrap", "psychometric_fit", "sign_flip", "wilson"]


def wilson(right: int, of: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson's interval for a proportion (Wilson 1927).

    >>> [round(x, 4) for x in wilson(0, 10)]
    [0.0, 0.2775]
    """
    from scipy.special import ndtri

    if not 0 <= right <= of or of < 1:
        raise InputError(f"needs 0 ≤ right ≤ of and of ≥ 1; got {right} of {of}")
    z = float(ndtri((1 + confidence) / 2))
    p, scale = right / of, 1 + z * z / of
    middle = (p + z * z / (2 * of)) / scale
    half = z / scale * np.sqrt(p * (1 - p) / of + z * z / (4 * of * of))
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def binomial_tail(right: int, of: int, chance: float) -> float:
    """Probability of at least so many right answers by guessing: the binomial tail, exactly.

    >>> round(binomial_tail(3, 3, 0.5), 3)
    0.125
    """
    from scipy.special import bdtrc

    return 1.0 if right <= 0 else float(bdtrc(right - 1, of, chance))


def bootstrap(values: ArrayLike, *, seed: int = 0, samples: int = 2000) -> tuple[Array, Array]:
    """(low, high), shape (...), 95 % percentile interval of the mean over people; values (people, ...), NaN left out.

    With a single person there is no spread to draw from: NaN.
    """
    x = np.asarray(values, dtype=float)
    flat = x.reshape(len(x), -1)
    if len(x) < 2:
        nothing = np.full(x.shape[1:], np.nan)
        return nothing, nothing
    drawn = np.random.default_rng(seed).multinomial(len(x), np.full(len(x), 1 / len(x)), samples).astype(float)
    known = np.isfinite(flat)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = (drawn @ np.where(known, flat, 0.0)) / (drawn @ known)
    means = np.where(np.isfinite(means), means, np.where(known.any(axis=0), flat[0] * 0, np.nan))
    low, high = np.percentile(means, (2.5, 97.5), axis=0)
    return low.reshape(x.shape[1:]), high.reshape(x.shape[1:])


def sign_flip(differences: ArrayLike, *, seed: int = 0) -> float:
    """Two-sided p that paired differences are zero on average, over all signs (up to 14 people) or 20 000 drawn ones.

    >>> sign_flip([1.0, 2.0, 3.0, 4.0])
    0.125
    """
    d = check_finite(differences, "differences")
    if d.ndim != 1 or not len(d):
        raise InputError(f"needs one difference per person; got shape {d.shape}")
    if len(d) <= 14:
        signs = np.array(list(product((-1.0, 1.0), repeat=len(d))))
    else:
        signs = np.random.default_rng(seed).choice((-1.0, 1.0), (20_000, len(d)))
    sums = np.abs(signs @ d)
    return float(np.mean(sums >= abs(d.sum()) - 1e-12 * np.abs(d).sum()))


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
