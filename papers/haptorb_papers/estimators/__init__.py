"""Comparison of the estimators of a spherical motor: Bai 2012 fig. 4 and beyond."""

from __future__ import annotations

from haptorb_papers.estimators.comparison import EstimatorComparison, compare, print_comparison
from haptorb_papers.estimators.sensor_effects import SensorEffects, find_effects, print_effects
from haptorb_papers.estimators.show import plot_comparison, plot_disturbances, plot_noise

__all__ = [
    "EstimatorComparison",
    "SensorEffects",
    "compare",
    "find_effects",
    "plot_comparison",
    "plot_disturbances",
    "plot_noise",
    "print_comparison",
    "print_effects",
]
