"""This library against its peers and its own promises: same run, same problem, one table."""

from haptorb.apps.bench.gathered import BENCHMARKS, Gathered, gathered, stored
from haptorb.apps.bench.magnetics import magnetics
from haptorb.apps.bench.row import Row

__all__ = ["BENCHMARKS", "Gathered", "Row", "gathered", "magnetics", "stored"]
