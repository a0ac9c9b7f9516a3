"""Stops, requests, trips and failures in any order: no current after a Stop without a later request."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.timeout(300)
def test_no_order_of_events_switches_on_after_a_stop() -> None:
    spec = importlib.util.spec_from_file_location("interleavings", ROOT / "tests" / "fuzz" / "study_interleavings.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found = module.study_interleavings(2000, seed=3)
    assert found.broken == []
    assert found.switched_on > 1000
    assert found.resumed > 100


def test_no_order_of_stops_and_engages_of_python_console_and_study_leaves_it_on() -> None:
    """In a process of its own: it winds the clock of the console's event loop."""
    program = ROOT / "tests" / "fuzz" / "stop_interleavings.py"
    command = [sys.executable, str(program), "--interleavings", "300", "--seed", "2"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
