"""`haptorb check`: verdict from the numbers, advice from the cause."""

from __future__ import annotations

import io
import json
import os
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from haptorb.cli.check_computer import (
    Fitness,
    Machine,
    StolenTime,
    StolenTimeCounter,
    drag_position,
    measure_fitness,
    print_fitness,
    this_machine,
)
from haptorb.errors import InputError, UnknownName

GOOD = Machine("a processor", 4, "6.1 PREEMPT", True, False, "performance", "3.11")
QUIET = StolenTime(0, 0.0, 1.0)


def _fitness(machine: Machine = GOOD, took: StolenTime = QUIET, **changes: Any) -> Fitness:
    report: dict[str, Any] = {
        "device": "omni",
        "world": "dome",
        "driver": "sim",
        "rate_hz": 1000.0,
        "ticks": 29_999,
        "missed": 1,
        "success_rate": 0.99997,
        "lateness_us": {"p50": 2.0, "p99": 30.0, "p999": 90.0},
        "compute_us": {"p50": 50.0, "p99": 80.0, "p999": 120.0},
        "stage_us": {"read": 2.0},
        "ahead_us": {"p50": 31.0, "p99": 64.0},
        "trips": [],
        "scheduler": {"policy": "SCHED_FIFO", "memory_locked": True},
    }
    return Fitness({**report, **changes}, machine, took, 30.0, True)


def _late(p99: float | None) -> dict[str, float | None]:
    return {"p50": 2.0, "p99": p99, "p999": None}


def test_fit() -> None:
    fitness = _fitness()
    assert fitness.fit
    assert fitness.advice == ()
    assert [verdict.fit for verdict in fitness.verdicts] == [True, True, True]


@pytest.mark.parametrize(
    ("changes", "which"),
    [
        ({"success_rate": 0.9989}, 0),
        ({"success_rate": None}, 0),
        ({"lateness_us": _late(151.0)}, 1),
        ({"lateness_us": _late(None)}, 1),
        ({"trips": [{"t": 1.0, "code": "POSE_EXPIRED", "reason": ""}]}, 2),
    ],
)
def test_not_fit(changes: dict[str, Any], which: int) -> None:
    fitness = _fitness(**changes)
    assert not fitness.fit
    assert [verdict.fit for verdict in fitness.verdicts].index(False) == which
    assert fitness.advice


def test_at_the_edge() -> None:
    assert _fitness(success_rate=0.999, lateness_us=_late(150.0)).fit


def test_a_missed_limit_does_not_read_like_the_limit() -> None:
    on_time, lateness, _ = _fitness(success_rate=0.9989999, lateness_us=_late(150.2)).verdicts
    assert (on_time.fit, on_time.measured, on_time.wanted) == (False, "99.89999 %", "at least 99.9 %")
    assert (lateness.fit, lateness.measured, lateness.wanted) == (False, "150.2 µs", "at most 150 µs")


@pytest.mark.parametrize(
    ("machine", "took", "changes", "word"),
    [
        (GOOD, QUIET, {"scheduler": {"policy": "SCHED_OTHER"}}, "rtprio"),
        (GOOD, QUIET, {"compute_us": {"p50": 700.0, "p99": 1250.0, "p999": 1300.0}}, "--rate 400"),
        (replace(GOOD, virtual=True), replace(QUIET, stolen=0.05), {}, "virtual machine"),
        (replace(GOOD, virtual=True), QUIET, {"missed": 60}, "virtual machine"),
        (GOOD, replace(QUIET, others=3.5), {"scheduler": {"policy": "SCHED_OTHER"}}, "3.5 of 4 cores"),
        (replace(GOOD, cores=1), QUIET, {}, "two or more"),
        (replace(GOOD, governor="powersave"), QUIET, {}, "powersave"),
        (replace(GOOD, preemptible=False), QUIET, {"lateness_us": _late(300.0)}, "PREEMPT"),
        (GOOD, QUIET, {"missed": 60}, "No clear cause"),
    ],
)
def test_advice_names_the_cause(machine: Machine, took: StolenTime, changes: dict[str, Any], word: str) -> None:
    assert word in " ".join(_fitness(machine, took, **{"success_rate": 0.9, **changes}).advice)
    assert word not in " ".join(_fitness(success_rate=0.9, missed=0, ticks=1).advice) or word.startswith("No clear")


def test_numbers_are_json_and_complete() -> None:
    numbers = json.loads(json.dumps(_fitness(success_rate=0.5).numbers()))
    assert numbers["fit"] is False
    for key in ("device", "rate_hz", "ticks", "success_rate", "lateness_us", "compute_us", "machine", "advice"):
        assert key in numbers
    assert numbers["machine"]["cores"] == 4


def test_shown() -> None:
    for fitness, words in ((_fitness(), "is fit"), (_fitness(success_rate=None), "not yet fit")):
        out = io.StringIO()
        print_fitness(fitness, Console(file=out, width=120))
        assert words in out.getvalue()
        assert "at least 99.9 %" in out.getvalue()


def test_this_machine() -> None:
    machine = this_machine()
    assert machine.cores >= 1
    assert machine.kernel
    watch = StolenTimeCounter(os.getpid())
    sum(range(2_000_000))
    took = watch.measure()
    assert 0 <= took.stolen <= 1
    assert 0 <= took.others <= (os.cpu_count() or 1)
    assert StolenTimeCounter(2**22 + 1).measure().preempted == 0  # a process that is not there


def test_dragging_stays_on_the_dome() -> None:
    path = np.array([drag_position(t) for t in np.linspace(0, 60, 1000)])
    assert np.linalg.norm(path, axis=1) == pytest.approx(0.048)
    assert path[:, 2].min() > 0.048 * np.cos(np.radians(28))


@pytest.mark.parametrize(("device", "dragging"), [("omni", True), ("omni", False), ("pmsm", True)])
@pytest.mark.realtime(retry=False)
@pytest.mark.usefixtures("quick_starts")
def test_measured(device: str, dragging: bool) -> None:
    fitness = measure_fitness(1.0, device=device, dragging=dragging, progress=False)
    numbers = json.loads(json.dumps(fitness.numbers()))
    assert fitness.report["device"] == device
    assert numbers["ticks"] + numbers["missed"] >= 900
    assert numbers["dragging"] is dragging
    assert 0 < numbers["success_rate"] <= 1


@pytest.mark.parametrize("duration", [0.0, -1.0, float("nan"), float("inf")])
def test_duration_must_be_a_time(duration: float) -> None:
    with pytest.raises(InputError, match="duration"):
        measure_fitness(duration)


def test_bad_rate_and_device() -> None:
    with pytest.raises(InputError, match="rate"):
        measure_fitness(1.0, rate=10.0, progress=False)
    with pytest.raises(UnknownName, match="omni"):
        measure_fitness(1.0, device="omny", progress=False)
