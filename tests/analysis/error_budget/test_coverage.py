"""Simulated devices with drawn errors lie within the predicted band: reduced form of benchmarks/error_budget.py."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from haptorb.cli.error_report import report_errors
from haptorb.devices.loader import load
from haptorb.estimation.registry import make_estimator

DEVICES = {"omni": 18, "pmsm": 18}


@pytest.fixture
def benchmark_of_budgets(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "benchmarks")
    return importlib.import_module("error_budget")


@pytest.mark.parametrize("name", ["omni", pytest.param("pmsm", marks=pytest.mark.slow)])
def test_true_errors_are_as_large_as_the_budget_says(benchmark_of_budgets: ModuleType, name: str) -> None:
    """Three components of 18 devices: their rms is known to 10 %, so that a factor of 1.35 is 3 deviations."""
    device = load(name)
    budget = report_errors(device, samples=200).budget
    tries = benchmark_of_budgets.try_electromagnets if name == "omni" else benchmark_of_budgets.try_motors
    estimator = make_estimator(device, budget.estimator, None)
    trials = tries(device, budget.asked, 77)
    standard = budget.bands[-1].standard
    axes = [standard[1], standard[1], standard[0]] if name == "omni" else standard
    errors = [benchmark_of_budgets.run_loop(device, estimator, next(trials), n) / axes for n in range(DEVICES[name])]
    assert 1 / 1.35 < float(np.sqrt(np.mean(np.square(errors)))) < 1.35
