"""No garbage collection in a servo; growth of memory is reported."""

from __future__ import annotations

import os
from typing import Any

import pytest

from haptorb.runtime import liveness
from haptorb.runtime.liveness import MemoryGrowth, resident_memory


def test_memory_of_a_process_and_of_one_that_has_ended() -> None:
    mine = resident_memory(os.getpid())
    assert mine is not None
    assert 5e6 < mine < 1e11
    assert resident_memory(2**22 + 1) is None


def test_growth_is_told_from_a_hundred_megabytes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = iter([300e6, 350e6, None, 401e6])
    monkeypatch.setattr(liveness, "resident_memory", lambda pid: next(sizes))
    growth = MemoryGrowth(1)
    assert growth.facts() == {}
    growth.update(10.0)
    growth.update(10.5)  # too early
    growth.update(11.0)
    assert growth.facts() == {"start": 300.0, "now": 350.0}
    assert growth.warning == ""
    growth.update(12.0)
    growth.update(12.1)
    assert "grown by 101 MB" in growth.warning


def test_a_servo_says_what_it_holds_and_warns(fake_servo: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(liveness, "_WARN_GROWTH_BYTES", -1.0)
    with fake_servo(record=False).servo as servo:
        servo.run(0.3)
    report = servo.report()
    assert report["memory_mb"]["now"] > 10
    assert "never collects garbage" in report["warning"]
    assert report["scheduler"]["collects_garbage"] is False
