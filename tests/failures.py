"""Failed tests, for fixtures that then report more."""

from __future__ import annotations

import pytest

__all__ = ["FAILED"]

FAILED = pytest.StashKey[bool]()  #: in a test's stash, before its fixtures end: whether its last try failed
