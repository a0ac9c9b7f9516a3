"""Validation of a file of measured steps before it is continued."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from haptorb.cli.calibration_progress import ProgressFile
from haptorb.devices.loader import load

OMNI = load("omni")
MAGNETIC = {
    "moment_per_current_m2": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "uncertainty_m2": [[0.1] * 3] * 3,
    "offsets_t": [[0.0] * 3] * OMNI.sensors,
    "residual_t": 0.0,
    "condition": 1.0,
    "repeatability": 0.0,
    "failed": [],
}


@pytest.mark.parametrize(
    ("name", "result", "resumes"),
    [
        ("currents", {"resistance_ohm": [0.6] * 3}, True),
        ("currents", {"resistance_ohm": [0.6] * 4}, False),
        ("currents", {"resistance_ohm": [0.6, 0.6, 6.0]}, False),
        ("currents", {"resistance_ohm": [0.6, 0.6, 0.06]}, False),
        ("currents", {"resistance_ohm": [-0.6] * 3}, False),
        ("rest", {"temperatures_k": [298.0] * 52}, False),
        ("magnetic", MAGNETIC, True),
        ("magnetic", MAGNETIC | {"offsets_t": [[0.0] * 3]}, False),
        ("magnetic", MAGNETIC | {"moment_per_current_m2": [[1.0, 0.0, 0.0]] * 3}, False),
    ],
)
def test_results_that_this_device_cannot_give_are_ignored(
    tmp_path: Path, name: str, result: dict[str, Any], resumes: bool
) -> None:
    ProgressFile(tmp_path / "a", OMNI, "sim", lambda: 1000.0).store(name, result)
    again = ProgressFile(tmp_path / "a", OMNI, "sim", lambda: 1001.0)
    assert bool(again.results) is resumes
    assert bool(again.left) is not resumes
