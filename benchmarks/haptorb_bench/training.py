"""Training of one network of the motor: own Levenberg–Marquardt, and SciPy from the same start to the same rms."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from time import perf_counter

import numpy as np
from scipy.optimize import least_squares, minimize

from haptorb.arrays import Array
from haptorb.devices.api import motor
from haptorb.estimation.network import fit_weights, workspace_grid
from haptorb_bench.result import Metric

__all__ = ["rows"]

_NODES, _ITERATIONS = 10, 120


def rows(effort: float, notify: Callable[[str], None]) -> list[Metric]:
    """Seconds for 120 steps on 16 200 samples, both less for less `effort`, and what SciPy needs from the same start,
    or where it is after ten times as long."""
    x, y = _samples(max(int(16_200 * effort), 600))
    steps = min(max(int(400 * effort), 8), _ITERATIONS)
    rng = np.random.default_rng(1)
    hidden = rng.normal(0.0, 1.0, (_NODES, x.shape[1] + 1)) / np.sqrt(x.shape[1])
    output = rng.normal(0.0, 0.3, (y.shape[1], _NODES + 1))
    notify("Levenberg–Marquardt")
    fit_weights(x[:200], y[:200], hidden, output, iterations=1)
    t0 = perf_counter()
    *_, course = fit_weights(x, y, hidden, output, iterations=steps)
    own, goal = perf_counter() - t0, float(course[-1])
    what = f"{len(x)} samples, {x.shape[1]} inputs, {_NODES} nodes, to an rms of {goal:.4f}"
    out = []
    for name, run in (("SciPy L-BFGS-B", _lbfgs), ("SciPy least_squares trf", _trf)):
        notify(name)
        took, reached = run(x, y, hidden, output, goal, 10 * own)
        there = reached <= goal * 1.001
        note = "" if there else f"{name} was at {reached:.4f} after {took:.3g} s"
        out.append(Metric("training", what, own, "s", name, took if there else None, note=note))
    return out


def _samples(count: int) -> tuple[Array, Array]:
    """Standardised readings of the nine sensors around electromagnet 17, and its torque per ampere."""
    device = motor("pmsm")
    R = workspace_grid(device)
    R = R[np.random.default_rng(0).permutation(len(R))[:count]]
    near = np.argsort(-(device.sensor_layout.directions @ device.electromagnets.directions[16]))[:9]
    x = device.sensor_field(R, "table")[:, near].reshape(count, -1)
    y = device.torque_characteristic(R, "table")[:, :, 16]
    y = y[:, y.std(axis=0) > 1e-9 * y.std()]  # a coil has no torque about its own axis
    return (x - x.mean(axis=0)) / x.std(axis=0), (y - y.mean(axis=0)) / y.std(axis=0)


class _TargetReached(Exception):
    pass


class _Network:
    """The same network with its weights in one vector, for optimisers that want that."""

    def __init__(self, x: Array, y: Array, hidden: Array, output: Array, goal: float, seconds: float) -> None:
        self.x1 = np.concatenate([x, np.ones((len(x), 1))], axis=1)
        self.y, self.cut, self.shapes = y, hidden.size, (hidden.shape, output.shape)
        self.start = np.concatenate([hidden.ravel(), output.ravel()])
        self.goal, self.end, self.best = goal, perf_counter() + seconds, float("inf")

    def layers(self, w: Array) -> tuple[Array, Array, Array]:
        """h̃ (n, h + 1), V (m, h + 1), residual (n, m); ends the run at the goal or out of time."""
        W, V = w[: self.cut].reshape(self.shapes[0]), w[self.cut :].reshape(self.shapes[1])
        h = np.concatenate([np.tanh(self.x1 @ W.T), np.ones((len(self.x1), 1))], axis=1)
        residual = h @ V.T - self.y
        self.best = min(self.best, float(np.sqrt((residual**2).mean())))
        if self.best <= self.goal or perf_counter() > self.end:
            raise _TargetReached
        return h, V, residual

    def error(self, w: Array) -> tuple[float, Array]:
        """Mean square and its gradient."""
        h, V, residual = self.layers(w)
        back = (residual @ V[:, :-1]) * (1 - h[:, :-1] ** 2)
        gradient = np.concatenate([(back.T @ self.x1).ravel(), (residual.T @ h).ravel()])
        return float((residual**2).mean()), 2 * gradient / residual.size

    def residual(self, w: Array) -> Array:
        """(n m,)."""
        return np.asarray(self.layers(w)[2].ravel())

    def jacobian(self, w: Array) -> Array:
        """(n m, weights), in full: what the block form never builds."""
        h, V, residual = self.layers(w)
        n, m = residual.shape
        J = np.zeros((n, m, len(w)))
        slope = V[None, :, :-1] * (1 - h[:, None, :-1] ** 2)
        J[:, :, : self.cut] = (slope[..., None] * self.x1[:, None, None, :]).reshape(n, m, -1)
        for o in range(m):
            start = self.cut + o * h.shape[1]
            J[:, o, start : start + h.shape[1]] = h
        return J.reshape(n * m, -1)


def _lbfgs(x: Array, y: Array, hidden: Array, output: Array, goal: float, seconds: float) -> tuple[float, float]:
    network, t0 = _Network(x, y, hidden, output, goal, seconds), perf_counter()
    with suppress(_TargetReached):
        minimize(network.error, network.start, jac=True, method="L-BFGS-B", options={"maxiter": 10**6, "maxfun": 10**6})
    return perf_counter() - t0, network.best


def _trf(x: Array, y: Array, hidden: Array, output: Array, goal: float, seconds: float) -> tuple[float, float]:
    network, t0 = _Network(x, y, hidden, output, goal, seconds), perf_counter()
    with suppress(_TargetReached):
        least_squares(network.residual, network.start, jac=network.jacobian, method="trf")
    return perf_counter() - t0, network.best
