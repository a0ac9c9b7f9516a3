"""Hands that move through a world with memory, and the energy that they extract from it."""

import numpy as np

from haptorb.devices.base import State
from haptorb.worlds.dynamic import bind_world

DT = 1e-3


def wander(seed, seconds, centre=(0.0, 0.0, 0.053), size=0.006):
    """A smooth random path (n, 3) [m] about `centre`, and its velocity."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds / DT)) * DT
    p, v = np.tile(np.asarray(centre, float), (len(t), 1)), np.zeros((len(t), 3))
    for hertz in (0.3, 0.7, 1.3, 2.9):
        a, b = rng.normal(size=(2, 3)) * size / (1 + hertz)
        w = 2 * np.pi * hertz
        p += np.outer(np.sin(w * t), a) + np.outer(np.cos(w * t), b)
        v += w * (np.outer(np.cos(w * t), a) - np.outer(np.sin(w * t), b))
    return p, v


def feel(world, p, v=None, dt=DT, bound=None):
    """Forces (n, 3) of `world` along a path (n, 3), and what binds it to its memory."""
    bound = bound or bind_world(world, dt)
    v = np.zeros_like(p) if v is None else v
    forces = [
        bound.wrench(State(n * dt, np.eye(3), q, np.zeros(3), u))[:3] for n, (q, u) in enumerate(zip(p, v, strict=True))
    ]
    return np.array(forces), bound


def sum_work(forces, p):
    """Energy [J] that the hand has been given up to each place (n,): the trapezoid of force and way."""
    steps = 0.5 * (forces[1:] + forces[:-1]) * np.diff(p, axis=0)
    return np.concatenate([[0.0], np.cumsum(steps.sum(axis=1))])
