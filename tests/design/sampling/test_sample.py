"""Samples: reproducible by seed, within ranges and on steps, evenly distributed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptorb.errors import InputError, RecordingError, UnknownName
from haptorb_design.problem import Design
from haptorb_design.sampling import METHODS, list_settings, sample, sweep
from oracles.designs.small_design import TEXT, make_design


@pytest.fixture(scope="module")
def design(tmp_path_factory: pytest.TempPathFactory) -> Design:
    return make_design(tmp_path_factory.mktemp("design"))


@pytest.mark.parametrize("method", METHODS)
def test_values_are_those_of_the_design_and_the_same_each_time(design: Design, method: str) -> None:
    values = sample(design, method, 60, 3)
    assert values == sample(design, method, 60, 3)
    for one in values:
        assert list(one) == ["radius", "angle", "shell"]
        assert 26.0 <= float(one["radius"]) <= 34.0
        assert one["angle"] in (50.0, 55.0, 60.0, 65.0, 70.0)
        assert one["shell"] in ("thin", "thick")
    if method != "grid":
        assert values != sample(design, method, 60, 4)


def test_a_longer_sobol_sequence_continues_a_shorter_one(design: Design) -> None:
    assert sample(design, "sobol", 100, 1)[:37] == sample(design, "sobol", 37, 1)
    assert list_settings("sobol", [{}] * 5) == list_settings("sobol", [{}] * 6)
    assert list_settings("latin-hypercube", [{}] * 5) != list_settings("latin-hypercube", [{}] * 6)


def test_ranges_are_covered_evenly(design: Design) -> None:
    for method in ("sobol", "latin-hypercube"):
        values = sample(design, method, 64, 5)
        radius = np.sort([float(one["radius"]) for one in values])
        assert np.abs(radius - np.linspace(26, 34, 65)[:-1] - 0.0625).max() < 0.126  # one in each of 64 parts
        assert sum(one["shell"] == "thin" for one in values) == 32


def test_a_grid_has_every_combination(design: Design, tmp_path: Path) -> None:
    values = sample(design, "grid", 40, 0)
    assert len(values) == 4 * 5 * 2
    assert len({tuple(one.values()) for one in values}) == 40
    assert {one["radius"] for one in values} == {26.0, 28.666_666_7, 31.333_333_3, 34.0}
    with pytest.raises(InputError, match="at least 20 candidates"):
        sample(design, "grid", 19, 0)
    steps = make_design(tmp_path, TEXT.replace('high = "34 mm"', 'high = "34 mm"\nstep = "3 mm"'))
    assert len(sample(steps, "grid", 1000, 0)) == 3 * 5 * 2


def test_what_cannot_be_sampled(design: Design) -> None:
    with pytest.raises(UnknownName, match="sobol"):
        sample(design, "sobl", 3, 0)
    for count, seed in ((0, 0), (3, -1), (3, 2**40)):
        with pytest.raises(InputError):
            sample(design, "sobol", count, seed)


def test_a_run_that_goes_on_must_be_of_this_sample(design: Design) -> None:
    from haptorb_design.workers import LocalWorker

    values = sample(design, "sobol", 6, 1)
    worker = LocalWorker(design)
    whole = list(sweep(values, worker.evaluate, {}))
    half = {one.number: one for one in whole[:3]}
    assert [one.number for one in sweep(values, worker.evaluate, half)] == [3, 4, 5]
    with pytest.raises(RecordingError, match="candidate 0 of the results has radius"):
        list(sweep(sample(design, "sobol", 6, 2), worker.evaluate, half))
