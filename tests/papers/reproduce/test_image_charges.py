"""Second computation of the tool's wrench against the models: they share only the device file."""

from dataclasses import replace

import numpy as np
import pytest

from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb_papers.reproduce.zarate2020.inverse_error import compute_second_wrench
from haptorb_papers.reproduce.zarate2020.true_wrench import true_wrench

OMNI = load("omni")


@pytest.mark.parametrize("permeability", [np.inf, 4000.0, 7.0, 1.0 + 1e-9])
@pytest.mark.parametrize(
    ("place", "axis"),
    [pytest.param((0, 0, 0.05), (0, 0, 1), marks=pytest.mark.slow), ((0.03, -0.02, 0.045), (0.6, 0.1, 1.0))],
)
def test_currents_and_images_meet_charges_and_harmonics(permeability, place, axis):
    device = replace(OMNI, core_permeability=permeability)
    state = State.at(place, np.array(axis) / np.linalg.norm(axis))
    second, currents = compute_second_wrench(device, state), np.array([3.0, -8.0, 5.0])
    passive = true_wrench(device, state, np.zeros(3), radial=4, azimuth=24)
    active = true_wrench(device, state, currents, radial=4, azimuth=24) - passive
    assert second.per_ampere @ currents == pytest.approx(active, rel=2e-4, abs=2e-4 * np.abs(active).max())
    assert second.passive == pytest.approx(passive, rel=1e-5, abs=1e-8)
    if permeability > 2.0:
        assert np.linalg.norm(passive[:3]) > 5e-3
