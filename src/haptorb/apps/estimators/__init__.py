"""The estimators of a spherical motor side by side: Bai 2012 fig. 4 and beyond."""

from __future__ import annotations

from haptorb.apps.estimators.comparison import Comparison, compare
from haptorb.apps.estimators.show import plotted, shown

__all__ = ["Comparison", "compare", "plotted", "shown"]
