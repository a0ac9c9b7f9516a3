"""Simulated noise: normal, reproducible, and quantised."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from haptorb.errors import InputError
from haptorb.simulation.hall_sensors import quantise
from haptorb.simulation.noise_generator import fill_normal, seed_noise


def test_it_is_standard_normal_and_white():
    x = np.empty(200_001)
    fill_normal(seed_noise(7), x)
    assert stats.kstest(x, "norm").pvalue > 0.01
    assert abs(x.mean()) < 4 / np.sqrt(len(x))
    for lag in (1, 2, 33):
        assert abs(np.corrcoef(x[:-lag], x[lag:])[0, 1]) < 4 / np.sqrt(len(x))


def test_the_generator_is_the_published_one():
    """The first outputs of xoshiro256++ from state (1, 2, 3, 4), by whole-number arithmetic."""
    mask, s, words = (1 << 64) - 1, [1, 2, 3, 4], []

    def rotate(x, k):
        return ((x << k) | (x >> (64 - k))) & mask

    for _ in range(4):
        words.append((rotate((s[0] + s[3]) & mask, 23) + s[0]) & mask)
        t = (s[1] << 17) & mask
        s[2] ^= s[0]
        s[3] ^= s[1]
        s[1] ^= s[2]
        s[0] ^= s[3]
        s[2] ^= t
        s[3] = rotate(s[3], 45)
    assert words[0] == 41943041
    u = [((word >> 11) + 1) / 2**53 for word in words]
    expected = []
    for a, b in (u[:2], u[2:]):
        expected += [np.sqrt(-2 * np.log(a)) * f(2 * np.pi * b) for f in (np.cos, np.sin)]
    x = np.empty(4)
    fill_normal(np.array([1, 2, 3, 4], dtype=np.uint64), x)
    assert np.allclose(x, expected, rtol=1e-12)


def test_a_seed_is_a_sequence():
    a, b, c = np.empty(9), np.empty(9), np.empty(9)
    state = seed_noise(3)
    fill_normal(state, a)
    fill_normal(seed_noise(3), b)
    fill_normal(state, c)
    assert np.array_equal(a, b)
    assert (a != c).all()


@given(st.floats(-50, 50), st.floats(1e-3, 5))
def test_a_converter_answers_in_its_steps(value, step):
    read = quantise(value, step)
    assert abs(read - value) <= step / 2 * (1 + 1e-12)
    assert abs(read / step - round(read / step)) < 1e-9
    assert quantise(value, 0.0) == value


@pytest.mark.parametrize("bad", [-1, 1.5, "a", None, True])
def test_seeds_are_whole_numbers_from_zero(bad):
    with pytest.raises(InputError, match="seed"):
        seed_noise(bad)
