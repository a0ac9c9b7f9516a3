"""Comparison of guidance along a path: simulated persons, kinds of guidance, tables and figure."""

from haptorb_papers.guidance.comparison import WAYS, GuidanceComparison, compare_guidance
from haptorb_papers.guidance.show import plot_guidance, print_guidance

__all__ = ["WAYS", "GuidanceComparison", "compare_guidance", "plot_guidance", "print_guidance"]
