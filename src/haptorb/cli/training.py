"""Train a motor's networks and measure their errors, over the workspace and on the trajectory of Bai 2012 fig. 4."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from rich.console import Console

from haptorb.arrays import Array
from haptorb.devices.api import motor
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.estimation.network import NetworkTorque, TrainedNetworks, networks_path, train, write_networks
from haptorb.notebook import NotebookReport
from haptorb.rotations import rotation_from_euler
from haptorb.terminal import Column, TextTable, print_table, print_text

__all__ = ["Training", "figure_4", "random_workspace", "relative_error", "train_networks"]


# --------------------------------------------------------------------------------------------------
# Test sets for estimators: the trajectory of Bai 2012 fig. 4, and the whole workspace; error measure.


def figure_4(count: int = 361) -> Array:
    """Return (count, 3, 3) one period of ψ = 10° sin t, λ = 5° sin t, φ = 5°.

    >>> figure_4(5).shape
    (5, 3, 3)
    """
    t = np.linspace(0, 2 * np.pi, count)
    return rotation_from_euler(np.radians(10) * np.sin(t), np.radians(5) * np.sin(t), np.radians(5))


def random_workspace(motor: SphericalMotor, count: int, seed: int) -> Array:
    """Draw (count, 3, 3) orientations uniformly over |ψ|, |λ| ≤ the workspace's tilt and all φ."""
    rng = np.random.default_rng(seed)
    tilt = motor.workspace_tilt
    psi, lam = rng.uniform(-tilt, tilt, (2, count))
    return rotation_from_euler(psi, lam, rng.uniform(-np.pi, np.pi, count))


def relative_error(found: Array, true: Array) -> float:
    """Return the NRMSE: root mean square error of all components over their root mean square.

    >>> relative_error(np.array([1.0, 1.0]), np.array([1.0, 0.0]))
    1.0
    """
    return float(np.sqrt(((found - true) ** 2).mean() / (true**2).mean()))


_TEST_ORIENTATIONS = 4000  #: test orientations; none of them was used for training


@dataclass(frozen=True)
class Training(NotebookReport):
    """Trained networks, their file, and their errors."""

    networks: TrainedNetworks
    path: Path

    def _summarize(self) -> str:
        return f"<Training of {len(self.networks.record['networks'])} networks of {self.networks.device}: {self.path}>"

    def numbers(self) -> dict[str, Any]:
        """Return all results as plain JSON types."""
        return {
            "device": self.networks.device,
            "digest": self.networks.digest,
            "file": str(self.path),
            **self.networks.record,
        }

    def show(self, console: Console) -> None:
        """Print the results on `console`."""
        record = self.networks.record
        table = TextTable((Column("network of", kind="key"), Column("inputs"), Column("samples"), Column("steps"),
                           Column("rms of training", "%")))  # fmt: skip
        for network in record["networks"]:
            coils = network["electromagnets"]
            table.add_row(
                f"EM {coils[0]}–{coils[-1]}",
                str(network["inputs"]),
                str(network["samples"]),
                str(network["iterations"]),
                f"{100 * network['rms_of_standardised_outputs']:.2f}",
            )
        print_table(console, table)
        judged = record["judged"]
        shares = {name: f"{100 * judged[name]:.2f} %" for name in ("workspace", "figure_4", "all_coils")}
        print_text(
            console,
            f"\nK of electromagnet {judged['electromagnet']}: NRMSE {shares['workspace']} over the workspace, "
            f"{shares['figure_4']} on the trajectory of Fig. 4; all coils {shares['all_coils']}",
        )
        memory = f", {record['peak_megabytes']:.0f} MB" if record["peak_megabytes"] is not None else ""
        print_text(console, f"{record['seconds']:.0f} s{memory}; stored in {self.path}")


def train_networks(
    device: str,
    *,
    nodes: int = 10,
    starts: int = 16,
    iterations: int = 120,
    seed: int = 0,
    path: Path | None = None,
    overwrite: bool = True,
    report: Callable[[float], None] | None = None,
) -> Training:
    """Train the networks of `device`, test them and write them to `path` (None: the device's place in the cache).

    Raises InputError before training if `path` cannot be written.
    """
    if not 1 <= nodes <= 200:
        raise InputError(f"a hidden layer must have 1 to 200 nodes; got {nodes}")
    if not (1 <= starts <= 100 and 1 <= iterations <= 2000) or seed < 0:
        raise InputError(
            f"starts must be 1 to 100, iterations 1 to 2000, seed 0 or more; got {starts}, {iterations}, {seed}"
        )
    known = motor(device)
    place = networks_path(known) if path is None else path
    if path is not None and not path.parent.is_dir():
        raise InputError(f"the folder of '{path}' does not exist")
    if place.exists() and not overwrite:
        text = f"'{place}' exists; choose another file, or replace it"
        raise InputError(f"{text} with overwrite=True", command=f"{text} with --force")
    start = monotonic()
    networks = train(known, nodes=nodes, starts=starts, iterations=iterations, seed=seed, report=report)
    seconds = monotonic() - start
    peak = _peak_memory()
    chosen = _reference_coil(known.electromagnets.directions)
    torque = NetworkTorque(known, networks)

    def judge(R: Array) -> tuple[float, float]:
        B, K = known.sensor_field(R, "table"), known.torque_characteristic(R, "table")
        usable, sure = np.ones(known.sensors), np.empty(K.shape[2])
        found = np.empty_like(K)
        for number, field in enumerate(B):
            torque.torque(field, usable, found[number], sure)
        return relative_error(found[:, :, chosen], K[:, :, chosen]), relative_error(found, K)

    over, everywhere = judge(random_workspace(known, _TEST_ORIENTATIONS, seed + 1))
    record = {
        **networks.record,
        "seconds": seconds,
        "peak_megabytes": peak,
        "judged": {
            "electromagnet": chosen + 1,
            "workspace": over,
            "figure_4": judge(figure_4())[0],
            "all_coils": everywhere,
        },
    }
    networks = replace(networks, record=record)
    write_networks(networks, place)
    return Training(networks, place)


def _peak_memory() -> float | None:
    """Peak memory of this process so far [MB]; None if the system does not report it."""
    try:
        import resource
    except ImportError:
        return None
    unit = 1024**2 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def _reference_coil(directions: Array) -> int:
    """Number, from 0, of the coil on the X axis, the paper's EM17; if there is none, of the nearest one."""
    return int(np.argmax(directions[:, 0]))
