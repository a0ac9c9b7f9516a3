"""Error budget of a device: sources of error, error model, Monte Carlo propagation and sensitivity indices.

A trial is one possible device at one place. Every source draws standard normal deviates and changes the trial by its
standard uncertainty times these. So a new source is one row of a table.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from haptorb.arrays import Array
from haptorb.display import format_quantity
from haptorb.errors import InputError

__all__ = [
    "COVERAGE",
    "Component",
    "ErrorBudget",
    "ErrorModel",
    "ErrorSource",
    "P",
    "SourceShare",
    "T",
    "WrenchBand",
    "choose_size",
    "error_budget",
]


T = TypeVar("T")  #: the trial that a source perturbs: one possible device
P = TypeVar("P")  #: pose of the mover and commanded wrench


@dataclass(frozen=True)
class ErrorSource(Generic[T]):
    """Cause of a difference between delivered and commanded wrench.

    Parameters
    ----------
    name : str
        Short name for tables and JSON.
    standard : str
        Standard uncertainty with unit, as text.
    origin : str
        Origin of the uncertainty: "device file", "assumed", "default" or "calibration".
    dimension : int
        Number of independent standard normal deviates.
    perturb : callable
        Changes a trial, one possible device, by the standard uncertainty times standard normal deviates:
        `perturb(deviates, trial)` with the deviates (dimension,) [1] and the trial, which is changed in place.
    """

    name: str
    standard: str
    origin: str
    dimension: int
    perturb: Callable[[Array, T], None]


@dataclass(frozen=True)
class Component:
    """One component of the error for tables; equivalent axes are combined.

    Parameters
    ----------
    name : str
        Name of the component.
    axes : tuple of int
        Numbers of its axes in the error (3,) of a trial.
    """

    name: str
    axes: tuple[int, ...]


class ErrorModel(ABC, Generic[T, P]):
    """Device, sources of error, and the chain from the commanded to the delivered wrench.

    Attributes
    ----------
    device : str
        Its name.
    estimator : str
        Estimator of the mover's pose.
    sources : tuple of ErrorSource
        Sources of error, independent of each other.
    regions : tuple of str
        Names of the regions of the workspace, each with its own budget.
    components : tuple of Component
        Components of the error.
    unit : str
        "N" or "N·m".
    jnd : float
        Just-noticeable difference, relative [1].
    asked : float
        Magnitude of the commanded wrench [N or N·m]; its direction is random.
    motion : str
        Its change over time, in words.
    left_out : str
        Known error of the model that is not in the budget, a sentence; empty: none.
    """

    device: str
    estimator: str
    sources: tuple[ErrorSource[T], ...]
    regions: tuple[str, ...]
    components: tuple[Component, ...]
    unit: str
    jnd: float
    asked: float
    motion: str
    left_out: str = ""

    @abstractmethod
    def draw_point(self, region: int, rng: np.random.Generator) -> P:
        """Random point in that region and a commanded wrench."""

    @abstractmethod
    def make_trial(self) -> T:
        """Device without errors."""

    @abstractmethod
    def wrench_error(self, point: P, trial: T) -> Array:
        """(3,) delivered minus commanded wrench of `trial` at `point` [N or N·m], along the axes of `components`."""

    @property
    def dimension(self) -> int:
        """Number of deviates of all sources."""
        return sum(source.dimension for source in self.sources)

    def try_error(self, point: P, deviates: Array, only: int | None = None) -> Array:
        """(3,) error with `deviates` (dimension,), or with those of source number `only` alone [N or N·m]."""
        trial, first = self.make_trial(), 0
        for number, source in enumerate(self.sources):
            last = first + source.dimension
            if only is None or only == number:
                source.perturb(deviates[first:last], trial)
            first = last
        return self.wrench_error(point, trial)


# --------------------------------------------------------------------------------------------------
# Propagation of distributions by Monte Carlo (JCGM 101), with Sobol's sensitivity indices.
#
# Band: the 2.5 % and 97.5 % quantiles of each component's error and the 95 % quantile of its norm, over devices,
# positions and directions. Shares: for every position and direction the variance over devices is split, and the
# variances are averaged. The first-order index of a source is the share of the variance that it causes by itself, the
# total index the share that would vanish if it were known exactly; for a nearly linear chain both agree, and the
# first-order indices add up to one. The error is a vector: variances are sums over its components (Lamboni, Monod and
# Makowski 2011). Estimators: Saltelli et al. 2010, Table 2 (b) and (f), with the same position and direction in all
# matrices.


COVERAGE = 0.95  #: probability of the bands
_MIN_SAMPLES = 100
_RESAMPLES = 1000  #: number of bootstrap resamples for the intervals of the shares
_SENSITIVITY_FRACTION = 0.2  #: share of the samples used for the sensitivity indices, which need many trials each
Report = Callable[[float], None]


@dataclass(frozen=True)
class WrenchBand:
    """Error of the delivered wrench in one region of the workspace.

    low, high  (c,) bounds of the 95 % interval of every component [N or N·m]
    standard   (c,) combined standard uncertainty of every component [N or N·m]
    size       95 % quantile of the errors' norm [N or N·m]
    """

    region: str
    low: Array
    high: Array
    standard: Array
    size: float

    def contains(self, component: int, error: float) -> bool:
        """Whether `error` of that component is within the band."""
        return bool(self.low[component] <= error <= self.high[component])


@dataclass(frozen=True)
class SourceShare:
    """Contribution of one source.

    alone        95 % quantile of the errors' norm if everything else is exact [N or N·m]
    first_order  share of the variance caused by it alone: first-order Sobol index
    total        share of the variance that would vanish without it: total Sobol index
    first_order_interval, total_interval
                 95 % intervals of the two estimates, bootstrapped over the devices. An estimate from samples may be
                 negative, or its first-order index above its total one, within these intervals
    """

    name: str
    standard: str
    origin: str
    alone: float
    first_order: float
    total: float
    first_order_interval: tuple[float, float]
    total_interval: tuple[float, float]


@dataclass(frozen=True)
class ErrorBudget:
    """Bands by region, the whole workspace last, and sources by their share in descending order."""

    device: str
    estimator: str
    unit: str
    jnd: float
    asked: float
    motion: str
    components: tuple[str, ...]
    samples: int
    seed: int
    bands: tuple[WrenchBand, ...]
    shares: tuple[SourceShare, ...]
    left_out: str = ""

    def count_jnd(self, size: float) -> float:
        """Express an error `size` [N or N·m] in just-noticeable differences of the commanded wrench."""
        return size / (self.jnd * self.asked)


def error_budget(
    model: ErrorModel[T, P], samples: int = 2000, seed: int = 0, report: Report | None = None
) -> ErrorBudget:
    """Error budget of `model` from `samples` devices in each region; `report` receives the progress, 0 to 1.

    Raises InputError for fewer than 100 samples or a negative seed.
    """
    if samples < _MIN_SAMPLES or seed < 0:
        raise InputError(f"samples must be {_MIN_SAMPLES} or more and seed 0 or more; got {samples} and {seed}")
    rng = np.random.default_rng(seed)
    regions, pairs = len(model.regions), samples // 2
    shared = max(int(_SENSITIVITY_FRACTION * pairs), _MIN_SAMPLES // 2)
    errors = np.empty((regions, 2 * pairs, 3))
    lone: list[Array] = []
    split: list[Array] = []
    for region in range(regions):
        for pair in range(pairs):
            point = model.draw_point(region, rng)
            a, b = rng.standard_normal((2, model.dimension))
            here = errors[region, 2 * pair : 2 * pair + 2]
            here[0], here[1] = model.try_error(point, a), model.try_error(point, b)
            if pair < shared:
                first, total, alone = _split_error(model, point, a, b, here)
                whole_variance = 0.5 * float(((here[0] - here[1]) ** 2).sum())
                split.append(np.concatenate([first, total, [whole_variance]]))
                lone.append(alone)
            if report is not None and pair % 20 == 0:
                report((region + pair / pairs) / regions)
    bands = [_find_band(model, name, errors[number]) for number, name in enumerate(model.regions)]
    whole = _find_band(model, "whole workspace", errors.reshape(-1, 3))
    return ErrorBudget(
        model.device, model.estimator, model.unit, model.jnd, model.asked, model.motion,
        tuple(component.name for component in model.components), 2 * pairs * regions, seed, (*bands, whole),
        _rank_sources(model, np.array(lone), np.array(split), seed), model.left_out,
    )  # fmt: skip


def _split_error(model: ErrorModel[T, P], point: P, a: Array, b: Array, errors: Array) -> tuple[Array, Array, Array]:
    """(sources,) products whose means are the parts of the variance: first-order and total; (sources,) norms of the
    error of each source alone."""
    first, total, alone = (np.empty(len(model.sources)) for _ in range(3))
    start = 0
    for number, source in enumerate(model.sources):
        mixed, end = a.copy(), start + source.dimension
        mixed[start:end] = b[start:end]
        with_b = model.try_error(point, mixed)
        first[number] = float(errors[1] @ (with_b - errors[0]))
        total[number] = 0.5 * float(((errors[0] - with_b) ** 2).sum())
        alone[number] = float(np.linalg.norm(model.try_error(point, a, number)))
        start = end
    return first, total, alone


def _find_band(model: ErrorModel[T, P], region: str, errors: Array) -> WrenchBand:
    tails = 50 * (1 - COVERAGE), 50 * (1 + COVERAGE)
    parts = [errors[:, component.axes].ravel() for component in model.components]
    low, high = np.array([np.percentile(part, tails) for part in parts]).T
    standard = np.array([part.std() for part in parts])
    size = float(np.percentile(np.linalg.norm(errors, axis=1), 100 * COVERAGE))
    return WrenchBand(region, low, high, standard, size)


def _rank_sources(model: ErrorModel[T, P], alone: Array, split: Array, seed: int) -> tuple[SourceShare, ...]:
    """Sort by total index, descending. alone (n, sources); split (n, 2 · sources + 1): products for both indices,
    variance."""
    sizes = np.percentile(alone, 100 * COVERAGE, axis=0)
    count = len(split)
    # multiplicity of each device in each resample: the sums of a resample are one row of a matrix product
    drawn = np.random.default_rng((seed, count)).multinomial(count, np.full(count, 1 / count), size=_RESAMPLES)
    sums = drawn @ split
    indices, resampled = (
        (part[:, :-1] / np.maximum(part[:, -1:], 1e-300)).reshape(len(part), 2, -1)
        for part in (split.sum(axis=0, keepdims=True), sums)
    )
    indices = indices[0]
    low, high = np.percentile(resampled, (50 * (1 - COVERAGE), 50 * (1 + COVERAGE)), axis=0)
    order = np.argsort(-indices[1])
    return tuple(
        SourceShare(
            model.sources[n].name, model.sources[n].standard, model.sources[n].origin, float(sizes[n]),
            float(indices[0, n]), float(indices[1, n]), (float(low[0, n]), float(high[0, n])),
            (float(low[1, n]), float(high[1, n])),
        )
        for n in order
    )  # fmt: skip


# --------------------------------------------------------------------------------------------------
# Magnitude of the commanded wrench: feasible everywhere in the workspace.


_DEFAULT_FRACTION = 0.5  #: of the smallest peak wrench: the default magnitude


def choose_size(device: str, asked: float | None, most: float, unit: str) -> float:
    """Magnitude of the commanded wrench [N or N·m]; `most` is feasible everywhere in every direction.

    None: half of `most`, to one digit. Raises InputError for zero or for more than `most`.

    >>> choose_size("omni", None, 0.136, "N")
    0.07
    """
    if asked is None:
        digit = 10.0 ** np.floor(np.log10(_DEFAULT_FRACTION * most))
        return float(f"{np.round(_DEFAULT_FRACTION * most / digit) * digit:.1g}")
    if not 0.0 < asked <= most:
        raise InputError(
            f"device '{device}' produces at most {format_quantity(most, unit)} in every direction everywhere in its "
            f"workspace; an error budget needs a wrench above 0 and up to that, got {asked:g} {unit}"
        )
    return asked
