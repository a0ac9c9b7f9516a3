"""Filter of the Hall tracker: bandwidth, delay, overshoot and noise as in its docstring."""

import numpy as np
import pytest

from haptorb.estimation.hall_tracker import FILTER, correct_pose, extrapolate_pose, memory, noise_share, predict


def filter_places(places, rate, bandwidth=100.0):
    """(n, 3) places and velocities from `places` (n, 3) [m] measured at `rate` [Hz], and the filter."""
    belief = np.zeros(1, FILTER)[0]
    out, rates = np.empty_like(places), np.empty_like(places)
    for n, one in enumerate(places):
        p, R, v, w = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty(3)
        dt = 1 / rate if n else -1.0
        if n:
            predict(belief, dt, p, R)
        p[:], R[:] = one, np.eye(3)
        correct_pose(belief, dt, bandwidth, p, R, v, w)
        out[n], rates[n] = p, v
    return out, rates, belief


@pytest.mark.parametrize("rate", [250.0, 500.0, 1000.0, 2000.0, 4000.0])
@pytest.mark.parametrize("bandwidth", [30.0, 100.0])
def test_three_decibels_at_the_bandwidth_at_every_rate(rate, bandwidth):
    t = np.arange(round(40 * rate / bandwidth)) / rate
    wave = np.sin(2 * np.pi * bandwidth * t)
    late = filter_places(np.column_stack([wave, wave, wave]), rate, bandwidth)[0][len(t) // 2 :, 0]
    basis = np.column_stack([np.sin(2 * np.pi * bandwidth * t), np.cos(2 * np.pi * bandwidth * t)])[len(t) // 2 :]
    gain = np.linalg.norm(np.linalg.lstsq(basis, late, rcond=None)[0])
    assert gain == pytest.approx(np.sqrt(0.5), rel=1e-3)


@pytest.mark.parametrize("rate", [50.0, 150.0, 200.0])
def test_a_loop_slower_than_twice_the_bandwidth_is_not_filtered(rate):
    places = np.random.default_rng(0).normal(size=(20, 3))
    out, rates, _ = filter_places(places, rate)
    assert out == pytest.approx(places)
    assert rates[1:] == pytest.approx(np.diff(places, axis=0) * rate)
    assert noise_share(100.0, rate) == 1.0


def test_a_steady_motion_is_not_late_and_a_step_is_overshot_by_a_seventh():
    steady = np.outer(np.arange(100) * 1e-3, (0.2, 0.0, -0.1))
    out, rates, _ = filter_places(steady, 1000.0)
    assert out[60:] == pytest.approx(steady[60:], abs=1e-7)
    assert rates[60:] == pytest.approx(np.broadcast_to((0.2, 0.0, -0.1), (40, 3)), abs=1e-5)
    step = np.zeros((80, 3))
    step[10:] = 1.0
    out = filter_places(step, 1000.0)[0]
    assert 1.10 < out.max() < 1.145
    assert out[60:] == pytest.approx(np.ones((20, 3)), abs=1e-4)


@pytest.mark.parametrize(("rate", "bandwidth"), [(1000.0, 100.0), (4000.0, 100.0), (1000.0, 30.0)])
def test_noise_is_averaged_as_the_formula_and_the_spread_say(rate, bandwidth):
    places = np.random.default_rng(1).normal(size=(20_000, 3))
    out, rates, belief = filter_places(places, rate, bandwidth)
    assert np.std(out[200:]) == pytest.approx(noise_share(bandwidth, rate), rel=0.03)
    assert np.sqrt(belief["variance"]) == pytest.approx(noise_share(bandwidth, rate), rel=1e-6)
    assert np.std(rates[200:]) == pytest.approx(np.sqrt(belief["rate_variance"]), rel=0.03)


def test_memory_grows_with_the_rate():
    thetas = [memory(2 * np.pi * 100 / rate) for rate in (201.0, 300.0, 1000.0, 4000.0)]
    assert thetas == sorted(thetas)
    assert 0.0 < thetas[0] < thetas[-1] < 1.0


def test_what_is_carried_goes_on_as_it_went():
    """Without anything measured: straight on, the axis turning at its rate, and the belief as it was."""
    belief = np.zeros(1, FILTER)[0]
    belief["place"], belief["axis"] = (0.01, 0.0, 0.05), (0.0, 0.0, 1.0)
    belief["velocity"], belief["axis_rate"] = (0.1, -0.2, 0.0), (0.5, 0.0, 0.0)
    before, p, R, v, w = belief.copy(), np.empty(3), np.empty((3, 3)), np.empty(3), np.empty(3)
    extrapolate_pose(belief, 4e-3, p, R, v, w)
    assert p == pytest.approx([0.0104, -0.0008, 0.05])
    assert R[:, 2] == pytest.approx(np.array([2e-3, 0.0, 1.0]) / np.hypot(2e-3, 1.0))
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert v == pytest.approx([0.1, -0.2, 0.0])
    assert w == pytest.approx([0.0, 0.5, 0.0])
    assert belief == before
