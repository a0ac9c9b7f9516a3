"""Bai 2012, Fig. 4: K of electromagnet 17 along a trajectory, from the field by a network and by alternatives.

The paper prints curves without numbers; its text says 16 200 samples, one hidden layer of 10 nodes, training after
Levenberg and Marquardt, and that the network "agrees excellently well". Which readings it takes stands in Fig. 3 only,
whose text does not tell. Each component of K of electromagnet 17 is judged over its own range, twice: by the printed
ten nodes, with the readings of the 9 sensors within 35° of the coil, and by a network with more nodes that takes all
readings. Beside it: the pair that the coil is wired in, a linear map and least squares, against noise and broken
sensors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb.cli.training import figure_4, random_workspace
from haptorb.devices.api import motor
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.estimation.network import TrainedNetworks, check_networks, networks_path, train, write_networks
from haptorb_papers.estimators import EstimatorComparison, compare, plot_disturbances, plot_noise
from haptorb_papers.estimators.single_coil import CoilNetwork, ComponentFit, fit_components, train_coil
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.entry import Entry
from haptorb_papers.reproduce.item import Item

__all__ = ["items"]

_AT = Citation("bai2012", "fig4", "Fig. 4")
_EM17 = 16
_PAPERS_NODES = 10
_MORE_NODES, _COMPONENTS = 80, 40  #: of a network that takes all readings, through so many principal components
_COARSER = (15, 15, 36)  #: orientations that it learns from: half as many as the paper, to be done in half the time
_SHARES = (0.3, 0.85, 1.0)  #: of the time: training of the shared networks and of both of EM17's, then comparison
_KNOWN = {
    _PAPERS_NODES: "K_Y hardly changes along the trajectory, so 2 % of its range is 0.2 % of K: ten nodes cannot "
    "follow the field of the whole workspace so closely. "
    f"{_MORE_NODES} nodes over all readings come close (rows below), and least squares does it. "
    "The paper may have taken other readings than those around the coil: its text does not say which",
    _MORE_NODES: "the error is above 2 % of the small range that K_Y has along the trajectory, and about a tenth of "
    "that over its range in the workspace (rows below). More nodes and a longer training would be needed; least "
    "squares needs neither",
}  #: by number of nodes
_EXCELLENT = "'agrees excellently well': R² of 0.999, and an error of 2 % of the range, the width of a printed line"


@dataclass(frozen=True)
class Course:
    """K of electromagnet 17, or of its pair, at many orientations, by the model and by a network."""

    whose: str
    true: Array  #: (n, 3) [N·m/A]
    found: Array  #: (n, 3) [N·m/A]

    @property
    def fits(self) -> dict[str, ComponentFit]:
        """By component."""
        return fit_components(self.found, self.true)


def items(report: Callable[[float], None]) -> tuple[tuple[Item, ...], Callable[[Path], Path]]:
    """The statements about Fig. 4, and what draws it; networks are trained, and those of the device kept."""
    device = motor("pmsm")
    networks = _networks(device, lambda done: report(_SHARES[0] * done))

    def report_training(done: float) -> None:
        report(_SHARES[0] + (_SHARES[1] - _SHARES[0]) * done)

    single = {
        _PAPERS_NODES: train_coil(device, _EM17, report=lambda done: report_training(0.1 * done)),
        _MORE_NODES: train_coil(
            device, _EM17, nodes=_MORE_NODES, reach=np.pi, components=_COMPONENTS, starts=1, iterations=100,
            grid=_COARSER,
            report=lambda done: report_training(0.1 + 0.9 * done),
        ),
    }  # fmt: skip
    result = compare(
        device, networks, orientations=300, report=lambda done: report(_SHARES[1] + (1 - _SHARES[1]) * done)
    )
    along, over = figure_4(721), random_workspace(device, 4000, 1)
    courses = {nodes: _follow(device, network, along) for nodes, network in single.items()}
    paper, larger = single.values()

    def error(name: str, where: str = "figure_4", reading: str = "ideal sensors") -> float:
        return float(getattr(result.row(name, reading), where))

    found = [
        _AT.item(
            "samples", "samples of the training", 16200, Entry(paper.samples, "haptorb's training"), "1", 0, "a count"
        ),
        _AT.item(
            "nodes",
            "nodes of the hidden layer",
            10,
            Entry(paper.network.nodes, "haptorb's training"),
            "1",
            0,
            "a count",
        ),
    ]
    for network in (paper, larger):
        alone, pair = courses[network.network.nodes]
        found += _judge(alone, network)
        found += _describe(pair, network, "along the trajectory")
        for course in _follow(device, network, over):
            found += _describe(course, network, "over the workspace")
    found += [
        _AT.note("linear", "error of K17 by a linear map of all readings, rms over rms", error("linear")),
        *_describe_least_squares(result),
        _AT.note("least-squares", "the same by least squares, no noise", error("least-squares")),
        _AT.note("least-squares-noise", "the same with 0.1 mT of noise",
                 error("least-squares", reading="noise 0.1 mT")),
        _AT.note("jnd", "error of a torque delivered through the shared networks, 95 % of the workspace, in JND",
                 result.row("network", "as in the device file").jnd),
    ]  # fmt: skip
    return tuple(found), lambda path: _draw_figure(courses, result, path)


def _follow(device: SphericalMotor, network: CoilNetwork, R: Array) -> tuple[Course, Course]:
    """Electromagnet 17 alone, and the mean of its pair, at R (n, 3, 3), ideal sensors."""
    field, true = device.sensor_field(R, "table"), device.torque_characteristic(R, "table")
    channel = device.groups[:, int(np.flatnonzero(device.groups[_EM17])[0])]
    pair = np.flatnonzero(channel)
    mean = channel[pair] / len(pair)
    found = sum(share * network.torque(field, int(coil)) for share, coil in zip(mean, pair, strict=True))
    return (
        Course("EM17 alone", true[:, :, _EM17], network.torque(field)),
        Course(f"pair EM{pair[0] + 1} and EM{pair[1] + 1}", true[:, :, pair] @ mean, np.asarray(found)),
    )


def _judge(course: Course, network: CoilNetwork) -> list[Item]:
    """R² and greatest error of each component along the trajectory, compared with what the paper says."""
    found = []
    for fit in course.fits.values():
        key, who = _key(course, network, fit), f"{course.whose}, {_describe_network(network)}"
        found += [
            _AT.claim(f"{key}-r2", f"R² of K_{fit.component} along the trajectory: {who}", 1.0, fit.r_squared, "1",
                      1e-3, _EXCELLENT),
            _AT.claim(f"{key}-error", f"greatest error of K_{fit.component} along the trajectory, over its range of "
                      f"{1e3 * fit.span:.3g} mN·m/A: {who}", 0.0, 100 * fit.greatest, "%", 2.0, _EXCELLENT),
        ]  # fmt: skip
    return [replace(item, known=_KNOWN[network.network.nodes]) for item in found]


def _describe(course: Course, network: CoilNetwork, place: str) -> list[Item]:
    """The same where the paper shows nothing: over the whole workspace, or by another network."""
    found = []
    for fit in course.fits.values():
        key = f"{_key(course, network, fit)}-{place.split()[-1]}"
        who = f"of K_{fit.component} {place}: {course.whose}, {_describe_network(network)}"
        found += [
            _AT.note(f"{key}-r2", f"R² {who}", fit.r_squared),
            _AT.note(f"{key}-error", f"greatest error {who}, over its range of {1e3 * fit.span:.3g} mN·m/A",
                     100 * fit.greatest, "%"),
        ]  # fmt: skip
    return found


def _describe_least_squares(result: EstimatorComparison) -> list[Item]:
    """The same for the pair by least squares from sensors as they are in the device file, with noise and steps."""
    found = []
    for name, fit in fit_components(result.course.estimated["least-squares"], result.course.true).items():
        who = f"of K_{name} along the trajectory: pair of EM17, least squares, sensors with noise"
        found += [
            _AT.note(f"least-squares-{name.lower()}-r2", f"R² {who}", fit.r_squared),
            _AT.note(f"least-squares-{name.lower()}-error", f"greatest error {who}, over its range", 100 * fit.greatest,
                     "%"),
        ]  # fmt: skip
    return found


def _key(course: Course, network: CoilNetwork, fit: ComponentFit) -> str:
    return f"{network.network.nodes}-{'single' if 'alone' in course.whose else 'pair'}-{fit.component.lower()}"


def _describe_network(network: CoilNetwork) -> str:
    return f"{network.network.nodes} nodes over {network.inputs} readings, {network.samples} samples"


def _networks(device: SphericalMotor, report: Callable[[float], None]) -> TrainedNetworks:
    """Those of the cache, if they are the usual ones; else trained now, and kept where the cache had none."""
    try:
        known = check_networks(device)
        known.select_neighbourhoods(device)
        if known.networks[-1].nodes == _PAPERS_NODES:
            return known
    except InputError:
        known = None
    networks = train(device, report=report)
    if known is None:
        write_networks(networks, networks_path(device))
    return networks


def _draw_figure(courses: dict[int, tuple[Course, Course]], result: EstimatorComparison, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 13), layout="constrained")
    FigureCanvasAgg(figure)
    halves: Any = figure.subfigures(2, 1, height_ratios=(1.5, 1))
    above, below = halves
    panels: Any = above.subplots(2, 3)
    t = np.linspace(0, 2 * np.pi, len(courses[_PAPERS_NODES][0].true))
    for row, which in zip(panels, (0, 1), strict=True):
        whose = courses[_PAPERS_NODES][which].whose
        for panel, (axis, component) in zip(row, ((1, "Y"), (2, "Z")), strict=False):
            panel.plot(t, 1e3 * courses[_PAPERS_NODES][which].true[:, axis], "k", lw=4, alpha=0.25, label="eq. (9)")
            for colour, (nodes, both) in zip(("C1", "C0"), courses.items(), strict=True):
                panel.plot(t, 1e3 * both[which].found[:, axis], colour, lw=1.2, label=f"{nodes} nodes")
                error = 100 * np.abs(both[which].found - both[which].true)[:, axis] / both[which].fits[component].span
                row[2].semilogy(t, np.maximum(error, 1e-3), colour + ("-" if axis == 1 else ":"), lw=1.2,
                                label=f"K_{component}, {nodes} nodes")  # fmt: skip
            panel.set_title(f"K_{component} of {whose} [mN·m/A]", loc="left", fontsize=10)
            panel.legend(fontsize=8, frameon=False)
        row[2].axhline(2.0, color="k", lw=0.8, ls="--")
        row[2].set_title(f"{whose}: error over its range [%]", loc="left", fontsize=10)
        row[2].legend(fontsize=8, frameon=False)
        for panel in row:
            panel.set_xlabel("t [s]")
            panel.grid(alpha=0.3)
    left, right = below.subplots(1, 2, width_ratios=(1, 2))
    plot_noise(left, result)
    plot_disturbances(right, result)
    below.suptitle("All coils: shared networks of 10 nodes, linear map, least squares", x=0.01, ha="left", fontsize=10)
    figure.savefig(path, dpi=110)
    return path
