"""Trainer: normal equations against a Jacobian by differences, convergence, and rejected inputs."""

import numpy as np
import pytest

from haptorb.errors import InputError
from haptorb.estimation.network import _normal_equations, fit_weights, train_network

RNG = np.random.default_rng(0)


def predict(x, hidden, output):
    h = np.tanh(x @ hidden[:, :-1].T + hidden[:, -1])
    return h @ output[:, :-1].T + output[:, -1]


def test_normal_equations_are_those_of_the_jacobian():
    x, y = RNG.standard_normal((40, 4)), RNG.standard_normal((40, 3))
    hidden, output = RNG.standard_normal((5, 5)), RNG.standard_normal((3, 6))
    weights = np.concatenate([hidden.ravel(), output.ravel()])

    def at(w):
        return predict(x, w[:25].reshape(5, 5), w[25:].reshape(3, 6)).ravel()

    step = 1e-6
    J = np.stack([(at(weights + step * e) - at(weights - step * e)) / (2 * step) for e in np.eye(len(weights))], axis=1)
    residual = y - predict(x, hidden, output)
    x1 = np.concatenate([x, np.ones((40, 1))], axis=1)
    h1 = np.concatenate([np.tanh(x1 @ hidden.T), np.ones((40, 1))], axis=1)
    normal, downhill = _normal_equations(x1, h1, output, residual)
    np.testing.assert_allclose(np.triu(normal), np.triu(J.T @ J), atol=1e-6 * np.abs(J.T @ J).max())
    np.testing.assert_allclose(downhill, J.T @ residual.ravel(), atol=1e-6 * np.abs(downhill).max())


def test_it_finds_a_network_that_was_hidden_in_the_data():
    x = RNG.standard_normal((600, 3))
    hidden, output = RNG.standard_normal((3, 4)), RNG.standard_normal((2, 4))
    result = train_network(x, predict(x, hidden, output), nodes=3, starts=6, iterations=200, seed=1)
    assert result.rms < 1e-6


def test_no_step_makes_the_error_greater_and_seeds_repeat():
    x = np.linspace(-3, 3, 500)[:, None]
    y = np.stack([np.sin(x[:, 0]), np.abs(x[:, 0])], axis=1)
    one, same = (train_network(x, y, nodes=5, seed=3) for _ in range(2))
    assert (np.diff(one.course) <= 0).all()
    assert one.rms == same.rms
    assert len(one.starts) == 4
    assert one.rms <= 1.05 * one.starts.min()


def test_progress_is_told_and_reaches_the_end():
    told = []
    x = np.linspace(-1, 1, 200)[:, None]
    train_network(x, x**2, nodes=3, starts=2, iterations=5, report=told.append)
    assert told[-1] == 1.0
    assert told == sorted(told)


def test_a_perfect_fit_ends_early():
    x = RNG.standard_normal((50, 2))
    hidden, output = RNG.standard_normal((3, 3)), RNG.standard_normal((1, 4))
    _, _, course = fit_weights(x, predict(x, hidden, output), hidden, output, iterations=30)
    assert len(course) < 5


@pytest.mark.parametrize(
    ("x", "y", "changes", "said"),
    [
        (np.zeros((300, 2)), np.ones((300, 1)), {}, "do not change"),
        (np.arange(600.0).reshape(300, 2), np.ones((300, 1)), {}, "outputs 1 do not change"),
        (np.stack([np.arange(300.0), np.ones(300)], axis=1), np.arange(300.0)[:, None], {}, "inputs 2 do not change"),
        (np.full((300, 2), np.nan), np.ones((300, 1)), {}, "finite"),
        (np.arange(20.0).reshape(10, 2), np.arange(10.0)[:, None], {}, "samples"),
        (np.arange(20.0).reshape(10, 2), np.arange(11.0)[:, None], {}, "shapes"),
        (np.arange(600.0).reshape(300, 2), np.arange(300.0)[:, None], {"nodes": 0}, "nodes"),
        (np.arange(600.0).reshape(300, 2), np.arange(300.0)[:, None], {"starts": 0}, "starts"),
    ],
)
def test_training_sets_that_cannot_teach_are_refused(x, y, changes, said):
    with pytest.raises(InputError, match=said):
        train_network(x, y, **{"nodes": 3, **changes})
