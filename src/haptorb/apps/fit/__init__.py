"""`haptorb fit-multipole`: a distributed multipole model for a motor's magnet or coil, and how right it is."""

from __future__ import annotations

from haptorb.apps.fit.multipole import PARTS, FitComparison, compare

__all__ = ["PARTS", "FitComparison", "compare"]
