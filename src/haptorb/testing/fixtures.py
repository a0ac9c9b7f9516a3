"""Fixtures of haptorb for pytest: `haptic_device` and `scripted_hand`; recordings are kept in the test's `tmp_path`.

Loaded by pytest in every environment in which haptorb is installed: it imports nothing before a fixture is used.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import pytest

__all__ = ["haptic_device", "scripted_hand"]


@pytest.fixture
def haptic_device(tmp_path: Path) -> Callable[..., Any]:
    """`haptorb.testing.haptic_device`, whose recordings are `run-1.mcap` and so on in `tmp_path`."""
    from haptorb.testing import run

    numbers = count(1)

    def open_device(*given: Any, **choices: Any) -> Any:
        return run.haptic_device(*given, **{"record": tmp_path / f"run-{next(numbers)}.mcap", **choices})

    return open_device


@pytest.fixture
def scripted_hand() -> Callable[..., Any]:
    """`haptorb.testing.scripted_hand`."""
    from haptorb.testing import run

    return run.scripted_hand
