"""Psychometric curves of constant stimuli, by condition."""

from __future__ import annotations

import numpy as np

from haptorb.apps.study.inference.psychometric import PsychometricCurve, psychometric_fit
from haptorb.apps.study.store.columns import Columns
from haptorb.numerics.arrays import Array

__all__ = ["fit_curves"]


def fit_curves(main: Columns) -> dict[str, tuple[Array, Array, Array, PsychometricCurve]]:
    """By condition: how often the comparison was called the stronger, over its level, participants pooled."""
    found: dict[str, tuple[Array, Array, Array, PsychometricCurve]] = {}
    for name in dict.fromkeys(main["condition"].tolist()):
        here = main["condition"] == name
        levels, which = np.unique(main["level"][here], return_inverse=True)
        stronger = main["answer"][here] == main["interval"][here]
        yes: Array = np.bincount(which, stronger, len(levels)).astype(float)
        of: Array = np.bincount(which, minlength=len(levels)).astype(float)
        if len(levels) > 1:
            found[name] = (levels, yes, of, psychometric_fit(levels, yes, of))
    return found
