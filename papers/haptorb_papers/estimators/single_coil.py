"""K of one electromagnet from the field by a separate network, as in Bai 2012 §2.3; its tracking error.

Each component is judged by itself: by R², the share of its variance that is met, and by the greatest error over the
component's own range. An error over the mean would hide much where a component hardly changes: along Fig. 4, K_Y of
electromagnet 17 changes by a ninth of its mean.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.estimation.network import (
    GRID,
    REACH,
    Neighbourhood,
    Perceptron,
    Scaling,
    neighbourhoods,
    train_network,
    workspace_grid,
)

__all__ = ["CoilNetwork", "ComponentFit", "fit_components", "train_coil"]


@dataclass(frozen=True)
class ComponentFit:
    """Tracking error of the estimate of one component of K."""

    component: str  #: "X", "Y" or "Z"
    r_squared: float  #: share of its variance that is met
    greatest: float  #: greatest error, over the range
    span: float  #: greatest less smallest true value, the range [N·m/A]


def fit_components(found: Array, true: Array) -> dict[str, ComponentFit]:
    """Component → how well `found` (n, 3) follows `true` (n, 3); a component that is zero throughout has none.

    >>> t = np.linspace(0, 1, 5)
    >>> true = np.stack([0 * t, 10 + t, t], axis=1)
    >>> fit = fit_components(true + [0, 0.1, 0], true)
    >>> sorted(fit), round(fit["Y"].greatest, 6), round(fit["Y"].r_squared, 6), fit["Z"].r_squared
    (['Y', 'Z'], 0.1, 0.92, 1.0)
    """
    fits = {}
    for axis, name in enumerate("XYZ"):
        goal, error = true[:, axis], found[:, axis] - true[:, axis]
        span = float(np.ptp(goal))
        if span > 1e-9 * float(np.abs(true).max()):
            share = float((error**2).sum() / ((goal - goal.mean()) ** 2).sum())
            fits[name] = ComponentFit(name, 1.0 - share, float(np.abs(error).max()) / span, span)
    return fits


@dataclass(frozen=True)
class CoilNetwork:
    """A network that gives K of one electromagnet of a motor, and of every other whose sensors lie alike around it."""

    coil: int  #: number, from 0, of the one that it was trained for
    near: Neighbourhood
    network: Perceptron
    samples: int

    @cached_property
    def members(self) -> dict[int, int]:
        """Number of a coil, from 0 → its number in the neighbourhood."""
        return {int(coil): member for member, coil in enumerate(self.near.coils)}

    @property
    def inputs(self) -> int:
        """Number of readings: three of every sensor."""
        return 3 * int(self.near.sensors.shape[1])

    def torque(self, field: Array, coil: int | None = None) -> Array:
        """(n, 3) [N·m/A] of `coil`, from 0 (its own, if not given), stator frame, at `field` (n, k, 3) [T]."""
        member = self.members[self.coil if coil is None else coil]
        across: Array = self.network(self.near.inputs(field, member)) @ self.near.frames[member][:, :2].T
        return across


def train_coil(
    motor: SphericalMotor,
    coil: int,
    *,
    nodes: int = 10,
    reach: float = REACH,
    components: int = 0,
    starts: int = 8,
    iterations: int = 120,
    grid: tuple[int, int, int] = GRID,
    report: Callable[[float], None] | None = None,
) -> CoilNetwork:
    """A network with one hidden layer for `coil`, from 0: by default the paper's 10 nodes and 16 200 samples.

    Its inputs are the readings of the sensors within `reach` [rad] of the coil's axis. With `components` above zero
    they pass through as many principal components of theirs; these are multiplied into the weights in the end, so that
    the network still takes readings, and learns sooner. InputError for a coil that the motor does not have.
    """
    groups = neighbourhoods(motor, reach)
    near = next((near for near in groups if coil in near.coils), None)
    if near is None:
        raise InputError(
            f"coil {coil + 1} does not exist: there are {len(motor.electromagnets)} on device '{motor.name}'"
        )
    member = int(np.flatnonzero(near.coils == coil)[0])
    R = workspace_grid(motor, grid)
    x, y = (
        near.inputs(motor.sensor_field(R, "table"), member),
        near.outputs(motor.torque_characteristic(R, "table"), member),
    )
    mixed = np.random.default_rng(1).permutation(len(x))  # a part of them must look like all of them
    x, y = x[mixed], y[mixed]
    mean = x.mean(axis=0)
    basis = np.linalg.svd(x - mean, full_matrices=False)[2][:components] if components else np.eye(x.shape[1])
    result = train_network((x - mean) @ basis.T, y, nodes, starts=starts, iterations=iterations, report=report)
    network = _take_readings(result.network, mean, basis)
    return CoilNetwork(coil, near, network, len(x))


def _take_readings(network: Perceptron, mean: Array, basis: Array) -> Perceptron:
    """The same network with `basis` (c, n) and `mean` (n,) multiplied in: it takes (n,) readings."""
    scaling = network.inputs
    per_reading = basis / scaling.spread[:, None]
    # The components have no mean: the readings' own is subtracted before, here and in training.
    hidden = np.column_stack([network.hidden[:, :-1] @ per_reading, network.hidden[:, -1]])
    return Perceptron(hidden, network.output, Scaling(mean, np.ones_like(mean)), network.outputs)
