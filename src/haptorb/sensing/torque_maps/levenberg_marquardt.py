"""Levenberg–Marquardt for a network with one hidden layer, with the normal matrix built from its blocks.

The Jacobian of all samples would take gigabytes. It is never formed: with h = tanh(W x̃), x̃ = (x, 1), h̃ = (h, 1) and
g = 1 − h²,

    ∂y_o/∂V_p = δ_op h̃,    ∂y_o/∂W_j = V_oj g_j x̃,

so JᵀJ has the blocks δ_op Σ h̃ h̃ᵀ, Σ V_oj g_j x̃ h̃ᵀ and (VᵀV)_jk Σ g_j g_k x̃ x̃ᵀ: three products of matrices that are
as long as the training set and as wide as the parameters, whatever the number of outputs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.linalg import LinAlgError

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, check_finite
from haptorb.sensing.torque_maps.perceptron import Perceptron, Scaling

__all__ = ["TrainingResult", "fit_weights", "train_network"]

_MOST = 1e12  #: damping beyond which no step helps any more

Report = Callable[[float], None]  #: called with the share that is done, 0 … 1


@dataclass(frozen=True)
class TrainingResult:
    """A network, and how it came about."""

    network: Perceptron
    rms: float  #: root mean square error of the standardised outputs
    iterations: int
    course: Array  #: (iterations + 1,) rms after each iteration of the start that won
    starts: Array  #: (starts,) rms of every start when the best was chosen


def train_network(
    x: Array,
    y: Array,
    nodes: int = 10,
    *,
    starts: int = 4,
    iterations: int = 60,
    seed: int = 0,
    report: Report | None = None,
) -> TrainingResult:
    """The network with `nodes` hidden nodes for y (samples, m) at x (samples, n), the best of several starts.

    Every start runs on every eighth sample, the best continues with all of them: results of single starts differ by a
    factor of two. Raises InputError for a training set that cannot determine the weights.

    >>> x = np.linspace(-2, 2, 400)[:, None]
    >>> result = train_network(x, np.sin(2 * x), nodes=6)
    >>> bool(np.abs(result.network(x) - np.sin(2 * x)).max() < 1e-2)
    True
    """
    x, y = check_finite(x, "x"), check_finite(y, "y")
    if x.ndim != 2 or y.ndim != 2 or len(x) != len(y):
        raise InputError(f"x and y must be (samples, n) and (samples, m); got shapes {x.shape} and {y.shape}")
    for value, what in ((nodes, "nodes"), (starts, "starts"), (iterations, "iterations")):
        if value < 1:
            raise InputError(f"{what} must be at least 1; got {value}")
    weights = nodes * (x.shape[1] + 1) + y.shape[1] * (nodes + 1)
    if x.shape[0] * y.shape[1] < 2 * weights:
        raise InputError(
            f"{weights} weights need at least {-(-2 * weights // y.shape[1])} samples; the training set has {len(x)}"
        )
    inputs, outputs = Scaling.of(x, "inputs"), Scaling.of(y, "outputs")
    u, v = inputs.to_standard(x), outputs.to_standard(y)
    thin = max(1, min(8, len(x) * y.shape[1] // (4 * weights)))
    rng = np.random.default_rng(seed)
    scouting, runs = max(iterations // 2, 10), []
    share = 0.3
    for start in range(starts):
        first = _start(rng, u.shape[1], v.shape[1], nodes)
        runs.append(fit_weights(u[::thin], v[::thin], *first, iterations=scouting))
        if report is not None:
            report(share * (start + 1) / starts)
    best = min(runs, key=lambda run: run[2][-1])

    def rest(done: float) -> None:
        if report is not None:
            report(share + (1 - share) * done)

    hidden, output, course = fit_weights(u, v, best[0], best[1], iterations=iterations, report=rest)
    return TrainingResult(
        Perceptron(hidden, output, inputs, outputs),
        float(course[-1]),
        len(course) - 1,
        course,
        np.array([run[2][-1] for run in runs]),
    )


def _start(rng: np.random.Generator, n: int, m: int, nodes: int) -> tuple[Array, Array]:
    """Weights with which the hidden nodes are neither linear nor saturated."""
    hidden = rng.normal(0.0, 1.0, (nodes, n + 1)) / np.sqrt(n)
    return hidden, rng.normal(0.0, 0.3, (m, nodes + 1))


def fit_weights(
    x: Array, y: Array, hidden: Array, output: Array, *, iterations: int, report: Report | None = None
) -> tuple[Array, Array, Array]:
    """(hidden, output, course): weights after at most `iterations` steps from the given ones, and the rms on the way.

    x (samples, n), y (samples, m), hidden (h, n + 1), output (m, h + 1) as in `Perceptron`, all standardised. A step
    that makes the error greater is not taken; the damping grows until one helps.
    """
    ones = np.ones((len(x), 1))
    x1 = np.concatenate([x, ones], axis=1)
    damping, course = 1e-2, []
    h1 = np.concatenate([np.tanh(x1 @ hidden.T), ones], axis=1)
    residual = y - h1 @ output.T
    error = float((residual**2).mean())
    course.append(np.sqrt(error))
    for step in range(iterations):
        normal, downhill = _normal_equations(x1, h1, output, residual)
        diagonal = np.diag(normal).copy()
        while damping < _MOST:
            new_hidden, new_output = _step_weights(normal, diagonal, downhill, damping, hidden, output)
            new_h1 = np.concatenate([np.tanh(x1 @ new_hidden.T), ones], axis=1)
            new_residual = y - new_h1 @ new_output.T
            new_error = float((new_residual**2).mean())
            if new_error < error:
                break
            damping *= 4.0
        else:
            break
        gain = 1.0 - new_error / error
        hidden, output, h1, residual, error = new_hidden, new_output, new_h1, new_residual, new_error
        damping = max(damping / 5.0, 1e-12)
        course.append(np.sqrt(error))
        if report is not None:
            report((step + 1) / iterations)
        if gain < 1e-6:
            break
    if report is not None:
        report(1.0)
    return hidden, output, np.array(course)


def _step_weights(
    normal: Array, diagonal: Array, downhill: Array, damping: float, hidden: Array, output: Array
) -> tuple[Array, Array]:
    from scipy.linalg import cho_factor, cho_solve  # a fifth of a second that only those who train should wait

    damped = normal.copy()
    damped[np.diag_indices(len(damped))] += damping * np.maximum(diagonal, 1e-9 * diagonal.max())
    try:
        step = cho_solve(cho_factor(damped, lower=False, overwrite_a=True), downhill)
    except LinAlgError:
        return hidden, output  # no descent: the caller damps more
    return hidden + step[: hidden.size].reshape(hidden.shape), output + step[hidden.size :].reshape(output.shape)


def _normal_equations(x1: Array, h1: Array, output: Array, residual: Array) -> tuple[Array, Array]:
    """JᵀJ (upper triangle) and Jᵀ r, hidden weights first, node by node."""
    from scipy.linalg.blas import dsyrk  # as above

    samples, width = x1.shape
    outputs, nodes = output.shape[0], output.shape[1] - 1
    g = 1.0 - h1[:, :-1] ** 2
    gx = (g[:, :, None] * x1[:, None, :]).reshape(samples, nodes * width)
    many = nodes * width
    normal = np.zeros((many + outputs * (nodes + 1),) * 2)
    v = output[:, :-1]
    # (VᵀV)_jk belongs to the whole block (j, k)
    normal[:many, :many] = dsyrk(1.0, gx.T, lower=0) * np.kron(v.T @ v, np.ones((width, width)))
    mixed, plain = gx.T @ h1, h1.T @ h1
    for o in range(outputs):
        here = slice(many + o * (nodes + 1), many + (o + 1) * (nodes + 1))
        normal[:many, here] = mixed * np.repeat(v[o], width)[:, None]
        normal[here, here] = plain
    back = (residual @ v) * g
    downhill = np.concatenate([(back.T @ x1).ravel(), (residual.T @ h1).ravel()])
    return normal, downhill
