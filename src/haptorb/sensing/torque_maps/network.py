"""Torque per ampere by small networks over each coil's own sensors: the `network` estimator, Bai 2012 §2.3.

One network serves all coils whose sensors lie alike around them. Each has one hidden layer; its inputs are what the
sensors within 35° of the coil read, in the coil's own frame, its outputs the two components of K across the coil's
axis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import InputError, quote
from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel
from haptorb.sensing.torque_maps.levenberg_marquardt import train_network
from haptorb.sensing.torque_maps.neighbourhood import REACH, Neighbourhood, Numbers, neighbourhoods
from haptorb.sensing.torque_maps.perceptron import Perceptron
from haptorb.sensing.torque_maps.tanh import squash
from haptorb.sensing.torque_maps.torque_map import TorqueMap
from haptorb.sensing.torque_maps.training_set import GRID, workspace_grid

__all__ = ["NetworkTorque", "TrainedNetworks", "train"]

_LANES = 16  #: inputs that are summed up side by side


@dataclass(frozen=True)
class TrainedNetworks:
    """One network per neighbourhood of a device, and the record of how they were trained."""

    device: str  #: name
    digest: str  #: of the device file
    reach: float  #: of each coil's sensors from its axis [rad]
    networks: tuple[Perceptron, ...]
    record: Mapping[str, Any] = field(default_factory=dict)

    def select_neighbourhoods(self, motor: SphericalMotor) -> tuple[Neighbourhood, ...]:
        """The neighbourhoods of `motor` in the networks' order; InputError if they were trained for another device."""
        if self.digest != motor.digest:  # safety: network-device
            raise InputError(
                f"these networks were trained for device {quote(self.device)} (digest {quote(self.digest[:12])}), not "
                f"for '{motor.name}' ({motor.digest[:12]}): its magnetics differ; run `haptorb train {motor.name}`"
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
        raise InputError(f"a training grid of {len(R)} orientations is too small; the default is {GRID}")
    B, K = motor.sensor_field(R, "table"), motor.torque_characteristic(R, "table")
    groups = neighbourhoods(motor, reach)
    order = np.random.default_rng(seed).permutation(len(R))  # which coil sees which orientation
    networks, records = [], []
    for number, near in enumerate(groups):
        many = len(near.coils)
        x = np.concatenate([near.inputs(B[order[i::many]], i) for i in range(many)])
        y = np.concatenate([near.outputs(K[order[i::many]], i) for i in range(many)])
        mixed = np.random.default_rng(seed + 1).permutation(len(x))  # a part of them must look like all of them

        def share(done: float, number: int = number) -> None:
            if report is not None:
                report((number + done) / len(groups))

        result = train_network(
            x[mixed], y[mixed], nodes, starts=starts, iterations=iterations, seed=seed, report=share
        )  # fmt: skip
        networks.append(result.network)
        records.append(
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
    record = {"nodes": nodes, "grid": list(grid), "iterations": iterations, "seed": seed, "networks": records}
    return TrainedNetworks(motor.name, motor.digest, reach, tuple(networks), record)


class NetworkTorque(TorqueMap):
    """All networks of a device as one kernel: scalings are multiplied into the weights beforehand.

    A coil with an unusable sensor is unknown: a network cannot do without an input.
    """

    def __init__(self, motor: SphericalMotor, networks: TrainedNetworks) -> None:
        groups = networks.select_neighbourhoods(motor)
        coils, nodes = len(motor.electromagnets), max(network.nodes for network in networks.networks)
        most = max(near.sensors.shape[1] for near in groups)
        inputs = _LANES * -(-(3 * most + 1) // _LANES)  # whole vectors; the last input is always 1, for the biases
        self._sensors = np.full((coils, most), -1, dtype=np.int64)
        self._frames = np.zeros((coils, 3, 3))
        self._hidden = np.zeros((len(groups), nodes, inputs))
        self._output = np.zeros((len(groups), 2, nodes + 1))
        batches = []
        for number, (near, network) in enumerate(zip(groups, networks.networks, strict=True)):
            hidden, output = network.fold_scalings()
            many, some = near.sensors.shape[1], network.nodes
            self._sensors[near.coils, :many] = near.sensors
            self._frames[near.coils] = near.frames
            self._hidden[number, :some, : 3 * many], self._hidden[number, :some, -1] = hidden[:, :-1], hidden[:, -1]
            self._output[number, :, :some], self._output[number, :, -1] = output[:, :-1], output[:, -1]
            for first in range(0, len(near.coils), 4):  # the last four may name a coil twice
                batches.append((number, *np.resize(near.coils[first : first + 4], 4).tolist()))
        self._batches = np.array(batches, dtype=np.int64)

    def torque(self, field: Array, usable: Array, out: Array, known: Array) -> None:
        """As `TorqueMap.torque`. (3, coils) [N·m/A]."""
        _forward(
            self._batches, self._sensors, self._frames, self._hidden, self._output, field, usable, out, known
        )  # fmt: skip


@kernel
def _fill_coil_inputs(sensors: Numbers, F: Array, field: Array, usable: Array, out: Array) -> float:
    """out (inputs,) becomes the field in the axes F (3, 3) of the coil; returns 1.0 if all of it is usable, else 0."""
    sure = 1.0
    for s in range(sensors.shape[0]):
        k = sensors[s]
        if k >= 0:
            sure *= usable[k]
            x, y, z = field[k, 0], field[k, 1], field[k, 2]
            out[3 * s] = F[0, 0] * x + F[1, 0] * y + F[2, 0] * z
            out[3 * s + 1] = F[0, 1] * x + F[1, 1] * y + F[2, 1] * z
            out[3 * s + 2] = F[0, 2] * x + F[1, 2] * y + F[2, 2] * z
    return sure


@kernel
def _forward(
    batches: Numbers, sensors: Numbers, frames: Array, hidden: Array, output: Array, field: Array, usable: Array,
    out: Array, known: Array,
) -> None:  # fmt: skip
    """batches (b, 5): a network and four coils that share it; sensors (c, s), −1 where a coil has fewer; frames
    (c, 3, 3); hidden (networks, nodes, inputs), output (networks, 2, nodes + 1) along ϑ̂ and φ̂, biases last."""
    nodes, inputs = hidden.shape[1], hidden.shape[2]
    h = np.empty((frames.shape[0], nodes))
    x = np.zeros((4, inputs))
    for b in range(batches.shape[0]):
        batch = batches[b]
        for q in range(4):
            c = batch[1 + q]
            known[c] = _fill_coil_inputs(sensors[c], frames[c], field, usable, x[q])
            x[q, inputs - 1] = 1.0
        weights, x0, x1, x2, x3 = hidden[batch[0]], x[0], x[1], x[2], x[3]
        for n in range(nodes):  # four coils at once: every weight is fetched once for them
            row = weights[n]
            h0, h1, h2, h3 = 0.0, 0.0, 0.0, 0.0
            for i in range(inputs):
                h0 += row[i] * x0[i]
                h1 += row[i] * x1[i]
                h2 += row[i] * x2[i]
                h3 += row[i] * x3[i]
            h[batch[1], n], h[batch[2], n], h[batch[3], n], h[batch[4], n] = h0, h1, h2, h3
    squash(h.reshape(-1))
    for b in range(batches.shape[0]):
        weights = output[batches[b, 0]]
        for q in range(4):
            c = batches[b, 1 + q]
            F, node = frames[c], h[c]
            south, east = weights[0, nodes], weights[1, nodes]
            for n in range(nodes):
                south += weights[0, n] * node[n]
                east += weights[1, n] * node[n]
            for i in range(3):
                out[i, c] = F[i, 0] * south + F[i, 1] * east
