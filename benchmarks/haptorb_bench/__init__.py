"""Benchmarks of this library against others and against its limits: same run, same problem, one table."""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.lazy_names import lazy_names

if TYPE_CHECKING:
    from haptorb_bench.result import BENCHMARKS, BenchResult, Metric, load_result, run_benchmarks

__all__ = ["BENCHMARKS", "BenchResult", "Metric", "load_result", "run_benchmarks"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "haptorb_bench.result": "BENCHMARKS BenchResult Metric load_result run_benchmarks",
    },
)
