"""Directional statistics against scipy's distributions, against each other, and where directions are undefined."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import vonmises_fisher

from haptorb.errors import InputError
from haptorb_study.statistics.sphere import error_vectors, find_away_axes, local_axes, summarize_directions

angles = st.tuples(st.floats(0.01, 3.13), st.floats(-3.14, 3.14))


def way(theta: float, phi: float) -> np.ndarray:
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


@given(angles, st.floats(0.01, 1.0))
def test_up_raises_and_round_keeps_the_height(at: tuple[float, float], step: float) -> None:
    n = way(*at)
    up, around = local_axes(n)
    basis = np.stack([n, up, around])
    assert np.allclose(basis @ basis.T, np.eye(3), atol=1e-12)
    # A step along the meridian towards the top lessens θ by just as much.
    step = min(step, at[0] / 2)
    assert np.arccos(np.clip((np.cos(step) * n + np.sin(step) * up)[2], -1, 1)) == pytest.approx(at[0] - step, abs=1e-7)
    assert around[2] == 0.0


@given(angles, angles)
def test_an_error_is_as_long_as_the_arc_and_leads_to_the_answer(
    asked: tuple[float, float], given_: tuple[float, float]
) -> None:
    n, a = way(*asked), way(*given_)
    error = np.radians(error_vectors(n[None], a[None])[0])
    size = np.linalg.norm(error)
    assert error @ n == pytest.approx(0.0, abs=1e-9)
    assert np.cos(size) * n + np.sinc(size / np.pi) * error == pytest.approx(a, abs=1e-7)


def test_where_there_is_no_direction_there_is_no_number() -> None:
    top = [0.0, 0.0, 1.0]
    assert np.isnan(np.stack(local_axes([top, [0.0, 0.0, -1.0]]))).all()
    assert np.isnan(error_vectors([top, top], [[0.0, 0.0, -1.0], [np.nan] * 3])).all()  # opposite; no answer
    assert error_vectors([top], [[0.0, 0.0, 2.0]]).tolist() == [[0.0, 0.0, 0.0]]  # right, at any distance
    assert np.isnan(find_away_axes([1.0, 0.0, 0.0], 0.0)).all()  # the hand's own direction is the normal there
    with pytest.raises(InputError, match="length zero"):
        local_axes([0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="shape"):
        summarize_directions(np.empty((0, 3)))


@pytest.mark.parametrize("hand", [0.0, 90.0, 200.0])
def test_away_from_the_hand_is_the_same_way_at_the_top_and_beside_it(hand: float) -> None:
    axes = find_away_axes([way(0.0, 0.0), way(0.3, 0.5)], hand)
    horizontal = -np.array([np.cos(np.radians(hand)), np.sin(np.radians(hand)), 0.0])
    assert axes[0] == pytest.approx(horizontal, abs=1e-12)
    assert axes[1] @ horizontal > 0.95
    assert np.linalg.norm(axes, axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("kappa", [5.0, 60.0])
def test_concentration_and_mean_are_found_again_and_agree_with_scipy(kappa: float) -> None:
    mean = way(0.9, 1.2)
    rng = np.random.default_rng(3)
    drawn = vonmises_fisher(mean, kappa).rvs(4000, random_state=rng)
    found = summarize_directions(drawn)
    assert (found.theta_deg, found.phi_deg) == pytest.approx(np.degrees((0.9, 1.2)), abs=1.0)
    assert found.kappa == pytest.approx(kappa, rel=0.06)
    # With few directions the greatest likelihood is too sure; Fisher's κ is not: its inverse has no bias.
    few = [summarize_directions(drawn[k : k + 4]).kappa for k in range(0, 4000, 4)]
    assert 1 / np.mean(1 / np.array(few)) == pytest.approx(kappa, rel=0.12)
    assert found.spread_deg == pytest.approx(np.degrees(1 / np.sqrt(found.kappa)))
    if kappa > 20:
        assert found.kappa == pytest.approx(vonmises_fisher.fit(drawn)[1], rel=1e-3)


def test_directions_that_cancel_have_no_mean_and_equal_ones_no_spread() -> None:
    opposite = summarize_directions([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    assert opposite.resultant == 0.0
    assert np.isnan([opposite.theta_deg, opposite.phi_deg]).all()
    same = summarize_directions([[0.0, 0.0, 1.0]] * 3)
    assert (same.resultant, same.kappa, same.spread_deg) == (1.0, np.inf, 0.0)
    assert np.isnan([(alone := summarize_directions([[0.0, 1.0, 0.0]])).kappa, alone.spread_deg]).all()
    assert alone.theta_deg == pytest.approx(90.0)
