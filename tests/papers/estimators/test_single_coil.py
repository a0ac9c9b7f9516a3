"""A network for a single electromagnet: training data, users, and evaluation."""

import numpy as np
import pytest

import haptorb
from haptorb.cli.training import random_workspace, relative_error
from haptorb.errors import InputError
from haptorb_papers.estimators.single_coil import fit_components, train_coil

EM17 = 16


@pytest.fixture(scope="module")
def pmsm():
    return haptorb.load("pmsm")


@pytest.mark.parametrize("components", [0, 20])
def test_it_serves_its_coil_and_the_opposite_one_in_the_stator_frame(pmsm, components):
    network = train_coil(pmsm, EM17, nodes=6, components=components, starts=1, iterations=12, grid=(7, 7, 24))
    assert network.samples == 7 * 7 * 24
    assert network.inputs == 27
    R = random_workspace(pmsm, 200, 3)
    field, true = pmsm.sensor_field(R, "table"), pmsm.torque_characteristic(R, "table")
    (opposite,) = np.flatnonzero(pmsm.groups[:, int(np.flatnonzero(pmsm.groups[EM17])[0])][: EM17 + 8])[1:]
    for coil in (EM17, int(opposite)):
        assert relative_error(network.torque(field, coil), true[:, :, coil]) < 0.15
    # by the other's readings it would be lost
    assert relative_error(network.torque(field, EM17), true[:, :, EM17 + 1]) > 0.5


def test_an_error_over_the_mean_hides_what_one_over_the_range_shows():
    t = np.linspace(0, 2 * np.pi, 361)
    true = np.stack([0 * t, 200 + 10 * np.sin(t), 20 * np.sin(t)], axis=1)
    found = true + np.stack([0 * t, 4 * np.cos(t), 0 * t], axis=1)
    assert relative_error(found, true) < 0.015
    fits = fit_components(found, true)
    assert set(fits) == {"Y", "Z"}  # X is zero throughout
    assert fits["Y"].greatest == pytest.approx(0.2)
    assert fits["Y"].r_squared == pytest.approx(0.84, abs=0.01)
    assert fits["Z"].r_squared == 1.0


def test_a_coil_that_the_motor_does_not_have(pmsm):
    with pytest.raises(InputError, match="there are 24 on device 'pmsm'"):
        train_coil(pmsm, 24)
