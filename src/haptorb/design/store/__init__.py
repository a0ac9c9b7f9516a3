"""Results of a design: one SQLite file, or a PostgreSQL database, with every candidate that was computed.

>>> from haptorb.design.store import open_results, read_results
"""

from __future__ import annotations

from haptorb.design.store.results import Results, ResultsWriter, Run, open_results, read_results

__all__ = ["Results", "ResultsWriter", "Run", "open_results", "read_results"]
