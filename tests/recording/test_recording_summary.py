"""Summary of a recording: which limit reduced the wrench, and how often."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb.recording.recording import list_facts
from haptorb.recording.row import Field, RowLayout

FIELDS = {field.name: field for field in RowLayout(channels=3, sensors=0).fields}


class Rows:
    """Ticks of which only the saturation is known."""

    path, truncated, long, checked, lost, worlds = Path("run.mcap"), False, False, True, 0, ()
    missing, damage, programs = (), (), ()
    fields: tuple[Field, ...] = (FIELDS["saturated"],)

    def __init__(self, saturated: list[float]) -> None:
        self.saturated = np.array(saturated)
        self.metadata: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        assert name == "saturated"
        return self.saturated

    def __len__(self) -> int:
        return len(self.saturated)


@pytest.mark.parametrize(
    ("saturated", "expected"),
    [
        ([0, 1, 2, 2], "25 % of the ticks by a coil's current limit, 50 % of the ticks by the supply's power limit"),
        ([0, 2, float("nan"), 0], "25 % of the ticks by the supply's power limit"),
        ([0, 0], None),
    ],
)
def test_the_limit_that_held_the_wrench_back_is_stated(saturated: list[float], expected: str | None) -> None:
    recording: Any = Rows(saturated)
    assert dict(list_facts(recording)).get("wrench limited") == expected
