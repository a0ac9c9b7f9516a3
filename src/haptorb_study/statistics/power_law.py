"""Stevens' power law ψ = k φⁿ for one participant's magnitude estimates, least squares in logarithms (Stevens 1957)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["PowerLaw", "fit_power_law"]


@dataclass(frozen=True)
class PowerLaw:
    """log ψ = log_at_reference + exponent · log(φ/reference); NaN with fewer than two levels."""

    exponent: float
    log_at_reference: float  #: natural logarithm of the law at the reference


def fit_power_law(levels: ArrayLike, estimates: ArrayLike, reference: float) -> PowerLaw:
    """Fit the law to `estimates` (n,) at `levels` (n,); all positive, as the reference.

    >>> law = fit_power_law([1.0, 2.0, 4.0], [10.0, 20.0, 40.0], 2.0)
    >>> round(law.exponent, 3), round(float(np.exp(law.log_at_reference)), 3)
    (1.0, 20.0)
    """
    x = np.log(np.asarray(levels, dtype=float) / reference)
    if len(np.unique(x)) < 2:
        return PowerLaw(math.nan, math.nan)
    exponent, constant = np.polyfit(x, np.log(np.asarray(estimates, dtype=float)), 1)
    return PowerLaw(float(exponent), float(constant))
