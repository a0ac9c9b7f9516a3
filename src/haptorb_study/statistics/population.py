"""Hierarchical model: population mean and SD of threshold and log spread from all participants' answers.

Every participant has a threshold μ_i ~ N(M, T²), a log spread log σ_i ~ N(S, U²) and a lapse rate λ_i ~ Beta(1, 1/m −
1). The likelihood of one participant's answers is known on a grid and integrated over these distributions. M, S and m
maximise the product over participants; T and U the same after M or S is integrated out (restricted likelihood).
Intervals of M and S: Student's quantile with n − 1 degrees of freedom times the sandwich standard error from the spread
of the scores, which is valid for any difference between participants; of T and U: likelihood ratio. Identical answers,
such as flawless ones, give scores without spread: then the standard error is that of the likelihood, with the normal
quantile.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import InputError
from haptorb_study.statistics.psychometric_function import LAPSE_EDGES, LevelCounts, PsychometricGrid
from haptorb_study.statistics.psychometric_likelihood import SlopeLikelihood

__all__ = ["NormalEffect", "Population", "fit_group", "fit_normal_effect", "fit_population"]


_LAPSE_PRIOR_MEDIAN, _LAPSE_PRIOR_LOG_SD = 0.02, 1.0  #: prior of the mean lapse rate: median, and SD of its logarithm
#: candidate mean lapse rates, equally probable up to the last, over which the slope's interval is averaged, and
#: shapes a of their distributions Beta(a, a/m − a): many near zero, or equal participants
_MEAN_LAPSES = np.array([0.005, 0.02, 0.04, 0.065, 0.09, 0.12])
_LAPSE_MODELS = [(float(mean), shape) for shape in (1.0, 20.0) for mean in _MEAN_LAPSES]
#: widening of the slope's standard error per unit of mean lapse rate, for the correlation of slope and lapse rate that
#: the information neglects. Chosen on simulated populations, tested on others (documentation)
_LAPSE_WIDENING = 3.2
_HALF_CHI2_95 = 1.9207  #: likelihood ratio at 95 %: half of the χ²₁ quantile
_MAX_SPREAD_RANGES = 2.0  #: in level ranges: populations with larger spreads are averaged as slopes
_MAX_ITERATIONS = 6
_SD_CANDIDATES, _MEAN_CANDIDATES = 24, 25  #: grid of SDs and means before refinement


@dataclass(frozen=True)
class NormalEffect:
    """Population mean and SD of a normal effect."""

    mean: float  #: of the population
    mean_95: tuple[float, float]
    sd: float  #: between participants
    sd_95: tuple[float, float]


@dataclass(frozen=True)
class Population:
    """Psychometric function of the population."""

    people: int
    threshold: NormalEffect
    log_spread: NormalEffect
    lapse: float  #: mean lapse rate
    by_slope: bool = (
        False  #: whether mean slope and intercept are estimated, because a participant's spread is unbounded
    )


def fit_group(likelihood: SlopeLikelihood) -> Population | None:
    """Population of the participants in `likelihood`; None below two whose answers do not fall with the level.

    If every participant's spread is bounded, thresholds and log spreads are modelled as normal. If one is unbounded, or
    its limit exceeds twice the range of the levels, its logarithm is undefined: then slopes and intercepts are
    averaged, with Student's intervals over participants, and the threshold has Fieller's. Open limits are ±∞.
    """
    answered = likelihood.answered
    ends = np.array([likelihood.spread_95(n) for n in range(len(answered.of))])
    used = np.count_nonzero(answered.of, axis=1) > 1
    used &= [likelihood.direction(n) != "falling" for n in range(len(used))]
    if np.count_nonzero(used) < 2:
        return None
    kept = LevelCounts(answered.levels, answered.yes[used], answered.of[used])
    ends = ends[used]
    middle, span = likelihood.scale
    if (ends[:, 1] > _MAX_SPREAD_RANGES * span).any():
        return _average_slopes(kept)
    places = np.array([likelihood.threshold_95(int(n)) for n in np.flatnonzero(used)])
    places = places[np.isfinite(places).all(axis=1)]
    far = np.clip(np.abs(places - middle).max(initial=span), span, 4 * span)
    most = float(np.clip(2 * np.nanmax(ends[:, 1]), 2 * span, 40 * span)) if np.isfinite(ends).any() else 2 * span
    least = max(float(np.diff(answered.levels).min()) / 6, span / 300)
    grid = PsychometricGrid.enclose(kept, limits=(middle - far, middle + far), spreads=(least, most))
    found = fit_population(grid)
    if 2 * np.count_nonzero(ends[:, 0] == 0) > len(ends):  # steeper than the levels of most participants resolve
        spread = found.log_spread
        found = replace(found, log_spread=replace(spread, mean_95=(-np.inf, spread.mean_95[1])))
    return found


def _average_slopes(answered: LevelCounts) -> Population:
    """Function of the mean slope and intercept over participants, with open limits where these may be zero."""
    from scipy.special import stdtrit

    # A shallow function determines only (1 − 2λ) b: the lapse rate is that of the prior above.
    likelihood = SlopeLikelihood(answered, _weigh_lapses(np.log(_LAPSE_PRIOR_MEDIAN)))
    slopes, value, scores, intercepts = likelihood.common
    people = len(scores)
    t = float(stdtrit(people - 1, 0.975))
    # Score test of a common slope with individual intercepts: mean score over its spread between participants.
    at = int(value.sum(axis=0).argmax())
    error = np.sqrt(scores.var(axis=0, ddof=1) / people)
    # If participants differ less than by chance, the spread is that of the likelihood, with the normal quantile.
    expected = np.sqrt(np.maximum(-np.gradient(scores.mean(axis=0), slopes), 1e-12) / people)
    above = _tail(scores.mean(axis=0), error, expected, people)
    # At another mean lapse rate the same (1 − 2λ) b belongs to another b.
    same = (1 - 2 * _MEAN_LAPSES[:, None]) / (1 - 2 * _LAPSE_PRIOR_MEDIAN) * slopes
    above = _share_lapses() @ np.array([np.interp(row, slopes, above) for row in same])
    excluded = (above < 0.025) | (above > 0.975)
    first, last = at, at
    while first > 0 and not excluded[first - 1]:
        first -= 1
    while last < len(slopes) - 1 and not excluded[last + 1]:
        last += 1
    slope, shallow, steep = float(slopes[at]), float(slopes[first]), float(slopes[last])
    near = slice(max(at - 8, 0), at + 9)
    bread = -np.polyfit(slopes[near], scores[:, near].sum(axis=0), 1)[0] / people
    bend = np.array([np.polyfit(slopes[near], row, 1)[0] for row in intercepts[:, near]])
    b = slope + (scores[:, at] - scores[:, at].mean()) / max(float(bread), 1e-9)
    c = intercepts[:, at] + bend * (b - slope)
    intercept = float(c.mean())
    (rise, both), (_, shift) = np.cov(b, c) / people
    middle, span = likelihood.scale
    if steep > 0:
        log_95 = (float(np.log(span / steep)), float(np.log(span / shallow)) if shallow > 0 else np.inf)
    else:  # falling
        log_95 = (np.nan, np.nan)
    # Fieller: levels at which the mean of c + b u does not differ from zero.
    two, one, zero = slope**2 - t * t * rise, slope * intercept - t * t * both, intercept**2 - t * t * shift
    inner = one * one - two * zero
    low, high = -np.inf, np.inf
    if inner > 0 and steep > 0:
        roots = sorted((-one + sign * np.sqrt(inner)) / two for sign in (-1.0, 1.0))
        if shallow > 0 and two > 0:
            low, high = roots
        elif intercept > 0:
            high = roots[0]
        else:
            low = roots[1]
    unknown = (np.nan, np.nan)
    mean = float(np.log(span / slope)) if slope > 0 else np.inf
    place = middle - span * intercept / slope if slope != 0 else np.nan
    return Population(
        people,
        NormalEffect(place, (middle + span * low, middle + span * high), np.nan, unknown),
        NormalEffect(mean, log_95, np.nan, unknown), _LAPSE_PRIOR_MEDIAN, by_slope=True,
    )  # fmt: skip


def fit_normal_effect(values: Array, likelihoods: Array) -> NormalEffect:
    """Fit x_i ~ N(mean, sd²) to likelihoods (people, n) at `values` (n,), equal steps.

    InputError with fewer than two participants.
    """
    from scipy.special import stdtrit

    people = len(likelihoods)
    if people < 2:
        raise InputError(f"a group needs at least two people; got {people}")
    fine, finer = _refine(values, likelihoods)
    sd, sd_95, floor = _estimate_sd(fine, finer)
    used = max(sd, floor)
    mean = _mean_at(fine, finer, np.array([used]))
    score, information = _scores(fine, finer, mean, np.array([used]))
    # Jackknife scores (MacKinnon & White 1985), since participants are unequally informative.
    share = np.clip(information[:, 0] / information.sum(), 0.0, 0.9)
    left_out = score[:, 0] / (1 - share)
    error = np.sqrt((people - 1) / people * (left_out**2).sum()) / information.sum()
    half = float(stdtrit(people - 1, 0.975) * error)
    return NormalEffect(float(mean[0]), (float(mean[0]) - half, float(mean[0]) + half), sd, sd_95)


def fit_population(grid: PsychometricGrid) -> Population:
    """Fit the population of the participants in `grid`. InputError with fewer than two participants."""
    likelihoods, alone = (array[grid.answered.of.any(axis=1)] for array in (grid.likelihoods, grid.posterior))
    people = len(likelihoods)
    if people < 2:
        raise InputError(f"a group needs at least two people; got {people}")
    x, y = grid.thresholds, grid.log_spreads
    at = np.array([
        (alone.sum(axis=(2, 3)) @ x).mean(), (alone.sum(axis=(1, 3)) @ y).mean(), np.log(_LAPSE_PRIOR_MEDIAN),
    ])  # fmt: skip
    t = u = 0.0
    t_95 = u_95 = (0.0, 0.0)
    scores, information = np.zeros((people, 3)), np.eye(3)
    for _ in range(_MAX_ITERATIONS):
        before = at.copy(), t, u
        weights = _weigh(y, at[1], u), _weigh_lapses(at[2])
        t, t_95, _ = _estimate_sd(*_refine(x, (likelihoods @ weights[1]) @ weights[0]))
        weights = _weigh(x, at[0], t), _weigh_lapses(at[2])
        u, u_95, _ = _estimate_sd(*_refine(y, np.einsum("pms,m->ps", likelihoods @ weights[1], weights[0])))
        for _ in range(3 if before[1] == 0 else 2):
            scores, information = _joint_scores(likelihoods, (x, y), at, (t, u))
            at = at + _limit_step(np.linalg.solve(information, scores.sum(axis=0)), x, y)
        size = np.sqrt(np.diag(np.linalg.inv(information)))
        if (np.abs(at - before[0]) < 0.03 * size).all() and abs(t - before[1]) + abs(u - before[2]) < 0.02 * (t + u):
            break
    inverse = np.linalg.inv(information)
    error = np.sqrt(np.diag(inverse @ (scores.T @ scores) @ inverse) * people / (people - 1))
    half = _halve(error, np.sqrt(np.diag(inverse)), people)[0]
    return Population(
        people,
        NormalEffect(float(at[0]), (float(at[0] - half), float(at[0] + half)), t, t_95),
        NormalEffect(*_bound_log_spread(likelihoods, (x, y), at, (t, u)), u, u_95),
        float(np.exp(at[2])),
    )  # fmt: skip


def _bound_log_spread(
    likelihoods: Array, axes: tuple[Array, Array], at: Array, sds: tuple[float, float]
) -> tuple[float, tuple[float, float]]:
    """S and its 95 % interval: Student's, averaged over distributions of lapse rates by their likelihood."""
    from scipy.optimize import brentq

    people, found, logs = len(likelihoods), [], []
    place = at[:2].copy()
    for mean, shape in _LAPSE_MODELS:
        known = likelihoods @ _weigh_lapses(np.log(mean), shape)
        for _ in range(2):
            scores, information, _ = _place_scores(known, axes, place, sds)
            place = place + _limit_step(np.append(np.linalg.solve(information, scores.sum(axis=0)), 0.0), *axes)[:2]
        scores, information, value = _place_scores(known, axes, place, sds)
        inverse = np.linalg.inv(information)
        error = np.sqrt((inverse @ (scores.T @ scores) @ inverse)[1, 1] * people / max(people - 1, 1))
        wider = 1.0 + _LAPSE_WIDENING * mean
        found.append((place[1], wider * error, wider * np.sqrt(inverse[1, 1])))
        logs.append(value)
    means, errors, expected = np.array(found).T
    weights = np.exp(np.array(logs) - max(logs)) * np.tile(_share_lapses(), 2)
    weights /= weights.sum()

    def share_below(place: float, share: float) -> float:
        return float(weights @ _tail(means - place, errors, expected, people)) - share

    far = 200 * float(np.maximum(errors, expected).max())
    low, high = (float(brentq(share_below, means.min() - far, means.max() + far, (share,))) for share in (0.025, 0.975))
    return float(weights @ means), (low, high)


def _share_lapses() -> Array:
    """(6,) weights of the mean lapse rates: widths of their cells."""
    edges = np.concatenate([[0.0], (_MEAN_LAPSES[1:] + _MEAN_LAPSES[:-1]) / 2, _MEAN_LAPSES[-1:]])
    found: Array = np.diff(edges) / edges[-1]
    return found


def _place_scores(
    known: Array, axes: tuple[Array, Array], at: Array, sds: tuple[float, float]
) -> tuple[Array, Array, float]:
    """As `_joint_scores` for (M, S) only, from likelihoods (people, m, s) with lapse rates integrated out."""
    bases, least = [], []
    for values, mean, sd in zip(axes, at, sds, strict=True):
        least.append(_least_sd(values, sd))
        w, a = _weigh(values, mean, sd), (values - mean) / least[-1] ** 2
        bases.append(np.stack([w, w * a, w * a**2], axis=1))
    moments = np.einsum("pmb,ma->pab", known @ bases[1], bases[0], optimize=True)
    value = float(np.log(moments[:, 0, 0]).sum())
    moments /= moments[:, :1, :1]
    score = np.stack([moments[:, 1, 0], moments[:, 0, 1]], axis=1)
    both = moments[:, 1, 1]
    square = np.stack([np.stack([moments[:, 2, 0], both], axis=1), np.stack([both, moments[:, 0, 2]], axis=1)], axis=1)
    curved = np.diag(len(known) / np.array(least) ** 2)
    information = curved - (square - score[:, :, None] * score[:, None, :]).sum(axis=0)
    size = np.linalg.eigvalsh(information)
    if size[0] <= 1e-6 * size[-1]:
        information = score.T @ score + np.diag(np.diag(np.abs(information))) * 0.1
    return score, information, value


def _tail(away: Array, error: Array, expected: Array, people: int) -> Array:
    """Probability of more than `away`, with the standard errors and quantiles of `_halve`."""
    from scipy.special import ndtr, stdtr

    alike = _halve(error, expected, people) == 1.96 * expected
    with np.errstate(divide="ignore", invalid="ignore"):
        found: Array = np.where(alike, ndtr(-away / expected), stdtr(people - 1, -away / error))
    return found


def _halve(error: Array, expected: Array, people: int) -> Array:
    """Half widths of 95 % intervals, from sandwich standard errors or those `expected` from the likelihood.

    The latter if participants differ less than by chance in 999 of 1000 groups.
    """
    from scipy.special import chdtri, stdtrit

    least = expected * np.sqrt(chdtri(people - 1, 0.999) / (people - 1))
    found: Array = np.where(error < least, 1.96 * expected, stdtrit(people - 1, 0.975) * error)
    return found


def _refine(values: Array, likelihoods: Array) -> tuple[Array, Array]:
    """(g,) and (people, g): interpolation to steps of a quarter of the most certain participant's SD."""
    from scipy.interpolate import CubicSpline

    mass = likelihoods / likelihoods.sum(axis=1, keepdims=True)
    spread = np.sqrt(np.maximum(mass @ values**2 - (mass @ values) ** 2, 0.0)).min()
    step = max(float(spread) / 4, float(values[1] - values[0]) / 8)
    fine = np.linspace(values[0], values[-1], int(np.ceil((values[-1] - values[0]) / step)) + 1)
    logs = CubicSpline(values, np.log(np.maximum(likelihoods, 1e-300)), axis=1)(fine)
    return fine, np.exp(logs - logs.max(axis=1, keepdims=True))


def _estimate_sd(values: Array, likelihoods: Array) -> tuple[float, tuple[float, float], float]:
    """SD between participants, its 95 % interval, and the smallest that the grid resolves."""
    from scipy.interpolate import CubicSpline

    floor = float(values[1] - values[0])
    candidates = np.geomspace(floor, values[-1] - values[0], _SD_CANDIDATES)
    mean = _mean_at(values, likelihoods, candidates)
    _, information = _scores(values, likelihoods, mean, candidates)
    joint = np.maximum(likelihoods @ _normal(values, mean, candidates), 1e-300)
    logs = np.log(joint).sum(axis=0) - np.log(np.maximum(information.sum(axis=0), 1e-12)) / 2
    above = np.linspace(np.log(candidates[0]), np.log(candidates[-1]), 600)[1:]
    # Below the smallest candidate the grid cannot be integrated; near zero the likelihood is linear in the variance.
    below = np.linspace(0.0, floor, 30)
    slope = (logs[1] - logs[0]) / (candidates[1] ** 2 - candidates[0] ** 2)
    sds = np.append(below, np.exp(above))
    fine = np.append(logs[0] + slope * (below**2 - floor**2), CubicSpline(np.log(candidates), logs)(above))
    best = int(np.argmax(fine))
    low = high = best
    while low > 0 and fine[low - 1] >= fine[best] - _HALF_CHI2_95:
        low -= 1
    while high < len(fine) - 1 and fine[high + 1] >= fine[best] - _HALF_CHI2_95:
        high += 1
    return float(sds[best]), (float(sds[low]), float(sds[high])), floor


def _normal(values: Array, mean: Array, sd: Array) -> Array:
    """(n, k) probabilities of `values` (n,), equal steps, under k normal distributions."""
    step = values[1] - values[0]
    found: Array = np.exp(-0.5 * ((values[:, None] - mean) / sd) ** 2) * (step / (sd * np.sqrt(2 * np.pi)))
    return found


def _mean_at(values: Array, likelihoods: Array, sd: Array) -> Array:
    """(k,) maximum-likelihood mean for each SD: grid search, then Newton steps."""
    mass = likelihoods / likelihoods.sum(axis=1, keepdims=True)
    places = mass @ values
    away = float(np.sqrt(np.maximum(mass @ values**2 - places**2, 0.0)).max())
    tried = np.linspace(max(places.min() - away, values[0]), min(places.max() + away, values[-1]), _MEAN_CANDIDATES)
    weights = np.exp(-0.5 * ((values[:, None, None] - tried[:, None]) / sd) ** 2).reshape(len(values), -1)
    joint = np.log(np.maximum(likelihoods @ weights, 1e-300)).sum(axis=0).reshape(_MEAN_CANDIDATES, -1)
    mean: Array = tried[np.argmax(joint, axis=0)]
    step = tried[1] - tried[0]
    for _ in range(3):
        score, information = _scores(values, likelihoods, mean, sd)
        bread = information.sum(axis=0)
        change = np.where(bread > 0, score.sum(axis=0) / np.where(bread > 0, bread, 1.0), 0.0)
        mean = np.clip(mean + np.clip(change, -step, step), values[0], values[-1])
    return mean


def _scores(values: Array, likelihoods: Array, mean: Array, sd: Array) -> tuple[Array, Array]:
    """(people, k) derivatives of the log likelihood with respect to the mean, and its negative second derivatives."""
    weights = _normal(values, mean, sd)
    away = (values[:, None] - mean) / sd**2
    total = np.maximum(likelihoods @ weights, 1e-300)
    first = (likelihoods @ (weights * away)) / total
    second = (likelihoods @ (weights * away**2)) / total
    return first, 1 / sd**2 - (second - first**2)


def _weigh(values: Array, mean: float, sd: float) -> Array:
    """(n,) probabilities on a grid whose step limits the SD."""
    return _normal(values, np.array([mean]), np.array([_least_sd(values, sd)]))[:, 0]


def _least_sd(values: Array, sd: float) -> float:
    return max(sd, float(values[1] - values[0]))


def _weigh_lapses(log_mean: float, shape: float = 1.0) -> Array:
    """(9,) probabilities of the cells of the lapse rate under Beta(a, a/m − a), m = exp(log_mean), a = `shape`."""
    from scipy.special import betainc

    if shape == 1.0:
        cells = np.diff(1 - (1 - LAPSE_EDGES) ** (np.exp(-log_mean) - 1))
    else:
        cells = np.diff(betainc(shape, shape * (np.exp(-log_mean) - 1), LAPSE_EDGES))
    found: Array = np.maximum(cells, 1e-300) / cells.sum()
    return found


def _joint_scores(
    likelihoods: Array, axes: tuple[Array, Array], at: Array, sds: tuple[float, float]
) -> tuple[Array, Array]:
    """(people, 3) scores for (M, S, log m), and (3, 3) their observed information (Louis 1982)."""
    people = len(likelihoods)
    parts = []
    for values, mean, sd in zip(axes, at[:2], sds, strict=True):
        least = _least_sd(values, sd)
        away = (values - mean) / least**2
        parts.append((_weigh(values, mean, sd), away, np.full(len(values), -1 / least**2)))
    h = 1e-3
    low, middle, high = (np.log(_weigh_lapses(at[2] + shift)) for shift in (-h, 0.0, h))
    parts.append((np.exp(middle), (high - low) / (2 * h), (high - 2 * middle + low) / h**2))
    bases = [np.stack([w, w * a, w * a**2, w * b], axis=1) for w, a, b in parts]
    moments = likelihoods @ bases[2]  # (p, m, s, 4)
    moments = np.einsum("pmsc,sb->pmbc", moments, bases[1], optimize=True)
    moments = np.einsum("pmbc,ma->pabc", moments, bases[0], optimize=True)
    moments /= moments[:, :1, :1, :1]
    index = np.eye(3, dtype=int)
    score = np.stack([moments[:, i, j, k] for i, j, k in index], axis=1)
    square = np.empty((people, 3, 3))
    for n in range(3):
        for m in range(3):
            i, j, k = index[n] + index[m]
            square[:, n, m] = moments[:, i, j, k]
    curvature = np.zeros((3, 3))
    for n in range(3):
        i, j, k = 3 * index[n]
        curvature[n, n] = moments[:, i, j, k].sum()
    information = -curvature - (square - score[:, :, None] * score[:, None, :]).sum(axis=0)
    score[:, 2] -= (at[2] - np.log(_LAPSE_PRIOR_MEDIAN)) / _LAPSE_PRIOR_LOG_SD**2 / people
    information[2, 2] += 1 / _LAPSE_PRIOR_LOG_SD**2
    size = np.linalg.eigvalsh(information)
    if size[0] <= 1e-6 * size[-1]:  # far from the maximum: the scores' spread scales the step
        information = score.T @ score + np.diag(np.diag(np.abs(information))) * 0.1
    return score, information


def _limit_step(step: Array, x: Array, y: Array) -> Array:
    """Limit a step to a tenth of the grid and a factor e of the lapse rate."""
    most = np.array([np.ptp(x) / 10, np.ptp(y) / 10, 1.0])
    return np.clip(step, -most, most)
