"""How probable what was found is by chance: exact guessing, signs of paired differences."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import InputError
from haptorb.numerics.arrays import check_finite

__all__ = ["binomial_tail", "sign_flip"]


def binomial_tail(right: int, of: int, chance: float) -> float:
    """Probability of at least so many right answers by guessing: the binomial tail, exactly.

    >>> round(binomial_tail(3, 3, 0.5), 3)
    0.125
    """
    from scipy.special import bdtrc

    return 1.0 if right <= 0 else float(bdtrc(right - 1, of, chance))


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
