"""The command line: `haptorb`. Each command is one file that imports what it needs when it runs."""

from __future__ import annotations

from haptorb.cli.program import main

__all__ = ["main"]
