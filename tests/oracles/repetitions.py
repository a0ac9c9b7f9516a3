"""Number of drawn examples per test: few in `make test`, all in `make nightly`."""

from __future__ import annotations

import os

#: set by `make nightly`
LONG = "HAPTORB_LONG_TESTS" in os.environ


def repetitions(few: int, many: int) -> int:
    """`few` here, `many` in the nightly run. The law is the same; not for what protects a person."""
    return many if LONG else few
