"""This library against its peers and its own promises: same run, same problem, one table."""

from haptorb_bench.magnetics import magnetics
from haptorb_bench.result import BENCHMARKS, BenchResult, load_result, run_benchmarks
from haptorb_bench.row import Metric

__all__ = ["BENCHMARKS", "BenchResult", "Metric", "load_result", "magnetics", "run_benchmarks"]
