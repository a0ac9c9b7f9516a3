"""Bai 2012 §2.3 and Fig. 4: from field to torque per ampere by network, by linear map, and by least squares."""

import json
import subprocess
import sys

import numpy as np
import pytest

import haptorb
from haptorb.cli.training import figure_4, random_workspace, relative_error
from haptorb.estimation.motor_orientation import LeastSquaresOrientation
from haptorb.estimation.network import LinearTorque, read_networks
from haptorb.estimation.types import Pose, Sample
from oracles.repetitions import repetitions

EM17 = 16


@pytest.fixture(scope="module")
def pmsm():
    return haptorb.load("pmsm")


def map_error(torque_map, motor, R):
    """NRMSE of K_17 at R (n, 3, 3), ideal sensors."""
    true = motor.torque_characteristic(R, "table")
    found, known = np.empty_like(true), np.empty(true.shape[2])
    for number, field in enumerate(motor.sensor_field(R, "table")):
        torque_map.torque(field, np.ones(motor.sensors), found[number], known)
    return relative_error(found[:, :, EM17], true[:, :, EM17])


@pytest.mark.slow
def test_ten_nodes_over_nine_sensors_reach_what_the_paper_s_method_can(tmp_path):
    path = tmp_path / "pmsm.network"
    program = "import sys; from haptorb.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", program, "train", "pmsm", "--out", str(path), "--json"]
    told = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert max(item["inputs"] for item in told["networks"]) <= 27
    assert {item["samples"] for item in told["networks"]} == {16_200}
    assert told["nodes"] == 10
    assert told["judged"]["workspace"] < 0.03  # 2.1 %
    assert told["judged"]["figure_4"] < 0.025  # 2.3 %
    assert told["peak_megabytes"] < 500  # 330
    assert read_networks(path).digest == haptorb.load("pmsm").digest


def test_a_linear_map_of_all_readings_is_a_tenth_off(pmsm):
    assert 0.07 < map_error(LinearTorque(pmsm), pmsm, random_workspace(pmsm, 400, 1)) < 0.11


def test_least_squares_follow_figure_4_exactly_and_with_noise_to_a_two_thousandth(pmsm):
    R = figure_4(repetitions(91, 721))
    true = pmsm.torque_characteristic(R, "table")[:, :, EM17]
    nobody = Pose(0.0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), False)
    for sigma, most in ((0.0, 1e-6), (1e-4, 5e-4), (1e-3, 5e-3)):
        rng, estimator = np.random.default_rng(0), LeastSquaresOrientation(pmsm)
        found = []
        for t, field in zip(np.linspace(0, 2 * np.pi, len(R)), pmsm.sensor_field(R, "table"), strict=True):
            noisy = field + sigma * rng.standard_normal(field.shape)
            estimate = estimator.update(Sample(float(t), np.zeros(12), np.full(12, 293.0), noisy, nobody))
            assert estimate.valid
            found.append(0.5 * estimate.wrench_map.torque[:, 8])  # EM17 and its antipode, in series, turn alike
        assert relative_error(np.array(found), true) < most


def test_peaks_of_figure_4(pmsm):
    K = pmsm.torque_characteristic(figure_4(721), "table")[:, :, EM17]
    np.testing.assert_allclose(np.abs(K).max(axis=0), [0.0, 0.21063, 0.02601], atol=1e-5)
