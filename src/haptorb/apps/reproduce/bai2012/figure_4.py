"""Bai 2012, Fig. 4: K of electromagnet 17 along a trajectory, from the field by a network; and what else can do it.

The paper prints curves without numbers; its text says 16 200 samples, one hidden layer of 10 nodes, and that the
network "agrees excellently well". Beside it here: a linear map and least squares, against noise and broken sensors.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from haptorb.apps.estimators import compare, plot_comparison
from haptorb.apps.reproduce.item import Item
from haptorb.devices.motor.api import motor
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.sensing.torque_maps.network import TrainedNetworks, train
from haptorb.sensing.torque_maps.network_file import check_networks, networks_path, write_networks

__all__ = ["items"]

_PAPER, _WHERE = "bai2012", "Fig. 4"
_TRAINING = 0.6  #: share of the time, where the network must be trained first


def items(report: Callable[[float], None]) -> tuple[tuple[Item, ...], Callable[[Path], Path]]:
    """The statements about Fig. 4, and what draws it; networks are trained and kept where there are none yet."""
    device = motor("pmsm")
    networks = _networks(device, lambda done: report(_TRAINING * done))
    result = compare(device, networks, orientations=300, report=lambda done: report(_TRAINING + (1 - _TRAINING) * done))
    own = networks.record["networks"][-1]  # of electromagnet 17
    peak = np.abs(result.course.true).max(axis=0)

    def one(
        name: str,
        what: str,
        published: float | None,
        computed: float,
        unit: str,
        tolerance: float | None,
        why: str = "",
    ) -> Item:
        return Item(f"fig4-{name}", _PAPER, _WHERE, what, published, float(computed), unit, tolerance, why=why)

    def error(name: str, where: str = "figure_4", reading: str = "ideal sensors") -> float:
        return float(getattr(result.row(name, reading), where))

    found = (
        one("samples", "samples of the training", 16200, own["samples"], "1", 0, "a count"),
        one("nodes", "nodes of the hidden layer", 10, networks.networks[-1].nodes, "1", 0, "a count"),
        one("network", "NRMSE of K17 by the network: 'agrees excellently well'", 0.0, error("network"), "1", 0.025,
            "what ten nodes can do; the curves' width in print"),
        one("network-workspace", "the same over the workspace", None, error("network", "workspace"), "1", None),
        one("linear", "NRMSE of K17 by a linear map of all readings", None, error("linear"), "1", None),
        one("least-squares", "NRMSE of K17 by least squares", 0.0, error("least-squares"), "1", 1e-4, "no noise"),
        one("least-squares-noise", "the same with 0.1 mT of noise", None,
            error("least-squares", reading="noise 0.1 mT"), "1", None),
        one("peak-y", "greatest K17 about Y", None, peak[1], "N·m/A", None),
        one("peak-z", "greatest K17 about Z", None, peak[2], "N·m/A", None),
        one("jnd", "error of a torque delivered through the network, 95 % of the workspace, in JND", None,
            result.row("network", "as in the device file").jnd, "1", None),
    )  # fmt: skip

    def draw(path: Path) -> Path:
        plot_comparison(result, path)
        return path

    return found, draw


def _networks(device: SphericalMotor, report: Callable[[float], None]) -> TrainedNetworks:
    """Those of the cache, if they are the usual ones; else trained now, and kept where the cache had none."""
    try:
        known = check_networks(device)
        known.select_neighbourhoods(device)
        if known.networks[-1].nodes == 10:
            return known
    except InputError:
        known = None
    networks = train(device, report=report)
    if known is None:
        write_networks(networks, networks_path(device))
    return networks
