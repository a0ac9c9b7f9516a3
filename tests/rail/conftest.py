"""Device of `rail.py`: a module of the test, which the servo's process cannot import."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import cloudpickle
import pytest

from haptorb.devices import register_kind
from haptorb.devices.registry import REGISTERED


def load_rail() -> ModuleType:
    """The module `rail.py`, whose classes go to other processes by value."""
    spec = importlib.util.spec_from_file_location("rail_of_a_test", Path(__file__).with_name("rail.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    cloudpickle.register_pickle_by_value(module)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def rail() -> Iterator[ModuleType]:
    """The module, its kind known to the loader for as long as the tests run."""
    module = load_rail()
    register_kind(module.RAIL)
    yield module
    del REGISTERED[module.RAIL.name]


@pytest.fixture(scope="session")
def rail_file() -> Path:
    """The file of a rail."""
    return Path(__file__).with_name("rail.toml")
