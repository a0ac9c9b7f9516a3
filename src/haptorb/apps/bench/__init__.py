"""`haptorb bench`: this library against its peers, same run, same geometry, error beside every time."""

from __future__ import annotations

from haptorb.apps.bench.contest import Contest, Result
from haptorb.apps.bench.magnetics import magnetics

__all__ = ["Contest", "Result", "magnetics"]
