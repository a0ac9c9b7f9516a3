"""A console over a fake servo, served on a free port."""

from __future__ import annotations

import importlib.util
import threading
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from haptorb.web.console import Console


def _fake() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fake_servo", Path(__file__).with_name("fake_servo.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


FAKE = _fake()


def flat_map(name, values, model, points):
    """A force map that costs nothing: one newton of push everywhere."""
    return np.ones(len(points)), np.zeros(len(points), dtype=bool)


@pytest.fixture
def servo():
    return FAKE.FakeServo()


@pytest.fixture
def refusal():
    return FAKE.refusal()


@pytest.fixture
def console(servo) -> Iterator[Console]:
    with Console(servo, 0, force_map=flat_map) as console:
        serving = threading.Thread(target=console.serve)
        serving.start()
        yield console
        console.close()
        serving.join(10)
        assert not serving.is_alive()
