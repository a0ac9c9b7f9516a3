"""Which values a sweep tries: a grid, a Latin hypercube, or a Sobol sequence.

>>> from haptorb.design.sampling import METHODS
"""

from __future__ import annotations

from haptorb.design.sampling.sample import METHODS, sample
from haptorb.design.sampling.sweep import list_settings, sweep
from haptorb.design.sampling.values import make_values

__all__ = ["METHODS", "list_settings", "make_values", "sample", "sweep"]
