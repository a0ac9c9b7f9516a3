"""`haptorb design report`: the results of a design as one page, and its best designs as device files."""

from __future__ import annotations

from haptorb.apps.design.report.writing import write_report

__all__ = ["write_report"]
