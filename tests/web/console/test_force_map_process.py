"""Force map from a separate process: identical numbers, mistakes in words, and no process left behind."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.devices.loader import load
from haptorb.errors import HaptorbError
from haptorb.simulation.force_map import force_map
from haptorb.web.force_map_process import ForceMapProcess
from haptorb.worlds import find_world

POINTS = 0.05 * np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -0.6, 0.8]])


@pytest.fixture
def felt():
    felt = ForceMapProcess(load("omni"))
    yield felt
    felt.close()


def test_same_numbers_as_computed_here_and_mistakes_in_words(felt):
    force, saturated = felt("dome", {"moment": 1.7}, "exact", POINTS)
    expected, at_limit = force_map(load("omni"), find_world("dome")(moment=1.7), POINTS)
    assert force == pytest.approx(expected)
    assert (saturated == at_limit).all()
    with pytest.raises(HaptorbError, match="moment must lie between"):
        felt("dome", {"moment": 99.0}, "exact", POINTS)
    with pytest.raises(HaptorbError, match="unknown world 'dme'; did you mean 'dome'"):
        felt("dme", {}, "exact", POINTS)
    compensated, _ = felt("nothing", {}, "exact", POINTS)
    assert abs(compensated).max() < 1e-3
    force, _ = felt("nothing", {}, "published", POINTS)
    assert (force < 0).all(), "the core pulls, and the published model does not know it"


def test_ends_with_close_and_starts_again_after_a_death(felt):
    felt("nothing", {}, "exact", POINTS)
    process = felt._process
    process.kill()
    process.wait()
    force, _ = felt("nothing", {}, "exact", POINTS)
    assert len(force) == 3
    process = felt._process
    felt.close()
    assert process.returncode is not None
    felt.close()
