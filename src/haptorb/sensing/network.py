"""Torque per ampere by small networks over each coil's own sensors: the `network` estimator, Bai 2012 §2.3.

One network serves all coils whose sensors lie alike around them. Each has one hidden layer; its inputs are what the
sensors within 35° of the coil read, in the coil's own frame, its outputs the two components of K across the coil's
axis.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from haptorb.devices.spherical_motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.physics.arrays import Array
from haptorb.physics.compiled import kernel
from haptorb.sensing.levenberg_marquardt import trained
from haptorb.sensing.neighbourhood import REACH, Neighbourhood, Numbers, neighbourhoods
from haptorb.sensing.perceptron import Perceptron
from haptorb.sensing.torque_map import TorqueMap
from haptorb.sensing.training_set import GRID, workspace_grid

__all__ = ["NetworkTorque", "TrainedNetworks", "train"]


@dataclass(frozen=True)
class TrainedNetworks:
    """One network per neighbourhood of a device, and the record of how they were trained."""

    device: str  #: name
    digest: str  #: of the device file
    reach: float  #: of each coil's sensors from its axis [rad]
    networks: tuple[Perceptron, ...]
    record: Mapping[str, Any] = field(default_factory=dict)

    def fitting(self, motor: SphericalMotor) -> tuple[Neighbourhood, ...]:
        """The neighbourhoods of `motor` in the networks' order; InputError if they were trained for another device."""
        if self.digest != motor.digest:
            raise InputError(
                f"these networks were trained for device '{self.device}' (digest {self.digest[:12]}), not for "
                f"'{motor.name}' ({motor.digest[:12]}): its magnetics differ; run `haptorb train {motor.name}`"
            )
        found = neighbourhoods(motor, self.reach)
        sizes = [3 * near.sensors.shape[1] for near in found]
        if [network.hidden.shape[1] - 1 for network in self.networks] != sizes:
            raise InputError(f"these networks do not have the inputs of device '{motor.name}': {sizes}; train again")
        return found


def train(
    motor: SphericalMotor,
    *,
    nodes: int = 10,
    starts: int = 16,
    iterations: int = 120,
    seed: int = 0,
    grid: tuple[int, int, int] = GRID,
    reach: float = REACH,
    report: Callable[[float], None] | None = None,
) -> TrainedNetworks:
    """Networks for all coils of `motor`, from its own tables over the workspace's `grid` of (ψ, λ, φ).

    Every orientation is seen by one coil of each neighbourhood in turn: 16 200 samples for each network by default.
    `report` is called with the share that is done. Raises InputError for a grid that cannot determine the weights.
    """
    R = workspace_grid(motor, grid)
    if len(R) < 2 * len(motor.electromagnets):
        raise InputError(f"a training grid of {len(R)} orientations cannot teach anything; the usual one is {GRID}")
    B, K = motor.sensor_field(R, "table"), motor.torque_characteristic(R, "table")
    groups = neighbourhoods(motor, reach)
    order = np.random.default_rng(seed).permutation(len(R))  # which coil sees which orientation
    networks, told = [], []
    for number, near in enumerate(groups):
        many = len(near.coils)
        x = np.concatenate([near.inputs(B[order[i::many]], i) for i in range(many)])
        y = np.concatenate([near.outputs(K[order[i::many]], i) for i in range(many)])
        mixed = np.random.default_rng(seed + 1).permutation(len(x))  # a part of them must look like all of them

        def share(done: float, number: int = number) -> None:
            if report is not None:
                report((number + done) / len(groups))

        result = trained(
            x[mixed], y[mixed], nodes, starts=starts, iterations=iterations, seed=seed, report=share
        )  # fmt: skip
        networks.append(result.network)
        told.append(
            {
                "electromagnets": (near.coils + 1).tolist(),
                "inputs": int(x.shape[1]),
                "samples": len(x),
                "rms_of_standardised_outputs": result.rms,
                "iterations": result.iterations,
                "course": result.course.round(6).tolist(),
                "starts": result.starts.round(6).tolist(),
            }
        )
    record = {"nodes": nodes, "grid": list(grid), "iterations": iterations, "seed": seed, "networks": told}
    return TrainedNetworks(motor.name, motor.digest, reach, tuple(networks), record)


class NetworkTorque(TorqueMap):
    """All networks of a device as one kernel: frames and scalings are multiplied into the weights beforehand.

    A coil with a sensor that cannot be believed is not known: a network has no way of doing without an input.
    """

    def __init__(self, motor: SphericalMotor, networks: TrainedNetworks) -> None:
        coils = len(motor.electromagnets)
        groups = networks.fitting(motor)
        nodes = max(network.nodes for network in networks.networks)
        most = max(near.sensors.shape[1] for near in groups)
        self._sensors = np.full((coils, most), -1, dtype=np.int64)
        self._hidden = np.zeros((coils, nodes, 3 * most + 1))
        self._output = np.zeros((coils, 3, nodes + 1))
        for near, network in zip(groups, networks.networks, strict=True):
            hidden, output = network.folded()
            many, some = near.sensors.shape[1], network.nodes
            for coil, frame, sensors in zip(near.coils, near.frames, near.sensors, strict=True):
                self._sensors[coil, :many] = sensors
                own = hidden[:, :-1].reshape(some, many, 3) @ frame.T  # frameᵀ B is what the network was taught
                self._hidden[coil, :some, : 3 * many] = own.reshape(some, -1)
                self._hidden[coil, :some, -1] = hidden[:, -1]
                self._output[coil, :, :some] = frame[:, :2] @ output[:, :-1]
                self._output[coil, :, -1] = frame[:, :2] @ output[:, -1]

    def torque(self, field: Array, usable: Array, out: Array, known: Array) -> None:
        """As `TorqueMap.torque`. (3, coils) [N·m/A]."""
        _forward(self._sensors, self._hidden, self._output, field, usable, out, known)


@kernel
def _forward(
    sensors: Numbers, hidden: Array, output: Array, field: Array, usable: Array, out: Array, known: Array
) -> None:
    nodes, bias = hidden.shape[1], hidden.shape[2] - 1
    x = np.empty(bias)
    for c in range(sensors.shape[0]):
        many, sure = 0, 1.0
        for s in range(sensors.shape[1]):
            k = sensors[c, s]
            if k >= 0:
                sure *= usable[k]
                x[many], x[many + 1], x[many + 2] = field[k, 0], field[k, 1], field[k, 2]
                many += 3
        known[c] = sure
        kx, ky, kz = output[c, 0, nodes], output[c, 1, nodes], output[c, 2, nodes]
        for n in range(nodes):
            total = hidden[c, n, bias]
            for i in range(many):
                total += hidden[c, n, i] * x[i]
            h = math.tanh(total)
            kx += output[c, 0, n] * h
            ky += output[c, 1, n] * h
            kz += output[c, 2, n] * h
        out[0, c], out[1, c], out[2, c] = kx, ky, kz
