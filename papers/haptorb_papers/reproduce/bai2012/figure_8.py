"""Bai 2012, Fig. 8: forces, torques and currents while a tilted plug is pulled and then righted.

The paper's curves are not legible as numbers; its text says that F_X' is constant, that F_Y' is not zero and shrinks as
x grows, and that the torque becomes zero with the tilt. Magnitudes follow from Table 3 with E = 113 GPa (E7), corrected
by E9 and E10; h is assumed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.control.allocation import MinimumPowerAllocator
from haptorb.control.linkage import Gains, ModedLinkage
from haptorb.control.registry import make_allocator
from haptorb.devices.api import motor
from haptorb.devices.base import WrenchMap
from haptorb.devices.motor import Grasp
from haptorb.estimation.network import networks_path
from haptorb.estimation.registry import make_estimator
from haptorb.estimation.types import Estimate, Estimator, HandGoal, Sample
from haptorb.recording.row import RowLayout
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.tick import Tick
from haptorb.simulation.hand_motion import handle_quaternion
from haptorb.simulation.motor import SimulatedMotor
from haptorb.worlds.snap_fit import PublishedOutlet
from haptorb_papers.reproduce.hook_quadrature import compute_pull_stiffness
from haptorb_papers.reproduce.item import Basis, Item

__all__ = ["ARM", "FORCE_SCALE", "TILT", "X_0", "PhaseRecord", "euler_axes", "items", "two_phases"]


# --------------------------------------------------------------------------------------------------
# Bai 2012, section 3.2, through the whole chain: a tilted plug is pulled (phase 1), then righted (phase 2).
#
# Nothing is fed in but a hand that turns the handle. The rotor's magnets make a field, 48 sensors read it with their
# noise, the orientation and the torque characteristic are estimated from it, the two modes move the plug, the outlet
# answers, currents are allocated, the simulated coils carry them, and the torque on the rotor is what comes out.


TILT = math.radians(2.0)  #: ε_z at the start
_WORLD = PublishedOutlet(creep=1e-4)  #: sliding friction from 0.1 mm/s on, as (15) has it at any speed
ARM = _WORLD.arm  #: h, assumed [m]
X_0 = 0.5 * _WORLD.plug_width * math.sin(TILT)  #: where a tilted plug begins [m]
#: 280 N sideways are more than a motor of 1 N·m renders with the default gains: all torques times this
FORCE_SCALE = 0.25

_DT = 1e-3
_FROM, _PULL = math.radians(-12.0), 0.3  #: λ at the start, and turned by in phase 1 [rad]: 6 mm of pull
_READY, _PHASE_1, _SWITCH, _PHASE_2 = 0.8, 1.0, 0.5, 1.0  #: duration of settling, pulling, clutching, righting [s]
#: a hand of steel: the paper prescribes the motion, so the handle must not yield
_STEEL = Grasp(mass=0.3, stiffness=1e5, damping=500.0, radius=0.04)


@dataclass(frozen=True)
class PhaseRecord:
    """Rows of one phase, one per tick.

    rows        (n, width) as recorded, by `layout`
    psi, lam    (n, m) currents that T_ψ and T_λ of the asked torque, eqs. (5b) and (6b), take by themselves [A]
    phi, rest   (n, m) those of T_φ, and those that hold up weight and regulator [A]
    """

    layout: RowLayout
    rows: Array
    psi: Array
    lam: Array
    phi: Array
    rest: Array

    def __getitem__(self, name: str) -> Array:
        """(n, width) the field `name`."""
        return self.rows[:, self.layout[name]]

    def euler_torque(self, name: str) -> Array:
        """(n, 3) T_ψ, T_λ, T_φ [N·m], as (5b) and (6b) mean them, of the wrench `name`."""
        torque: Array = np.einsum("nij,nj->ni", euler_axes(self["q"]), self[name][:, 3:])
        return torque

    @property
    def tilt(self) -> Array:
        """(n,) ε_z [rad], clockwise about Z'."""
        q = self["object_q"]
        x, y, z, w = q.T
        tilt: Array = -np.arctan2(2 * (x * y + z * w), 1 - 2 * (y * y + z * z))
        return tilt


@final
class _RecordingEstimator(Estimator):
    """An estimator whose last word is kept: what the currents were allocated with."""

    def __init__(self, inner: Estimator) -> None:
        self.inner = inner
        self.map = WrenchMap(np.zeros((6, 1)), np.zeros(6))

    def update(self, sample: Sample) -> Estimate:
        estimate = self.inner.update(sample)
        self.map = estimate.wrench_map
        return estimate


def euler_axes(q: Array) -> Array:
    """(..., 3, 3) the axes that ψ, λ and φ turn about at the orientation `q` (..., 4), as rows, stator frame.

    R = Rx(ψ) Ry(λ) Rz(φ): X itself, Y turned by ψ, Z turned by both. They are at right angles only where λ = 0.

    >>> (euler_axes(np.array([0.0, 0.0, 0.0, 1.0])) + 0.0).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    x, y, z, w = np.moveaxis(q, -1, 0)
    spin = np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], axis=-1)
    axes = np.zeros((*spin.shape, 3))
    axes[..., 0, 0] = 1.0
    sideways = np.hypot(spin[..., 1], spin[..., 2])
    axes[..., 1, 1], axes[..., 1, 2] = spin[..., 2] / sideways, -spin[..., 1] / sideways
    axes[..., 2, :] = spin
    return axes


def _smooth(s: float) -> float:
    s = min(max(s, 0.0), 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


def two_phases(
    device: str = "pmsm", estimator: str = "least-squares", seed: int = 0, report: Callable[[float], None] | None = None
) -> tuple[PhaseRecord, PhaseRecord]:
    """Phase 1 and phase 2 on `device` with the named estimator; `report` receives the share that is done."""
    known = motor(device)
    gains = Gains().scale(FORCE_SCALE)
    spin = TILT / gains.rotate[2]  # of the handle: 8°
    starts = (0.0, _READY, _READY + _PHASE_1, _READY + _PHASE_1 + _SWITCH)

    def hand(now: float) -> HandGoal:
        lam = _FROM + _PULL * min(max((now - starts[1]) / _PHASE_1, 0.0), 1.0)
        phi = spin * _smooth((now - starts[3]) / _PHASE_2)
        return HandGoal(np.zeros(3), handle_quaternion(0.0, lam, phi), now, False)

    driver = SimDriver(SimulatedMotor(replace(known, tolerance=None), seed, grasp=_STEEL), _DT, hand, seed=seed)
    recorder = _RecordingEstimator(make_estimator(known, estimator, None))
    linkage = ModedLinkage(gains, position=(X_0, 0.0, 0.0), attitude=(0.0, 0.0, -TILT))
    tick = Tick(known, _WORLD, driver, recorder, make_allocator(known), _DT, linkage)
    parts = MinimumPowerAllocator(known.coils.current_limit, resistance=known.coils.resistance)
    layout, row = tick.layout, tick.layout.empty()
    asked = layout["wrench_commanded"]
    rows: list[Any] = []
    split: list[Any] = []
    total = round((starts[3] + _PHASE_2 + 0.2) / _DT)
    with driver:
        for n in range(total):
            if n == round(starts[2] / _DT):
                linkage.set_mode("rotate")
            tick.step(row, n * _DT)
            rows.append(row.copy())
            bare = WrenchMap(recorder.map.matrix, np.zeros(6))
            torque = row[asked][3:]
            axes = euler_axes(row[layout["q"]])
            alone = np.linalg.inv(axes)  # columns: what has a component along one of them and none along the others
            shares = [np.r_[0, 0, 0, part] for part in (alone * (axes @ torque)).T]
            shares.append(-recorder.map.passive)
            split.append([parts.allocate(bare, share).currents for share in shares])
            if report is not None and n % 100 == 0:
                report(n / total)
    every, currents = np.array(rows), np.array(split)

    def course(begin: float, end: float) -> PhaseRecord:
        keep = slice(round(begin / _DT), round(end / _DT))
        return PhaseRecord(layout, every[keep], *(currents[keep, part] for part in range(4)))

    # The hand takes a moment to get under way; the phases are what follows.
    return course(starts[1] + 0.1, starts[2]), course(starts[3], starts[3] + _PHASE_2 + 0.1)


_PAPER, _WHERE = "bai2012", "Fig. 8"


def items(report: Callable[[float], None]) -> tuple[tuple[Item, ...], Callable[[Path], Path]]:
    """The statements about Fig. 8, and what draws it."""
    trained = networks_path(motor("pmsm")).is_file()
    pull, right = two_phases(report=lambda done: report(0.5 * done if trained else done))
    force = pull["object_wrench"]
    place = pull["object"][:, 0]
    line = np.polynomial.Polynomial.fit(place, force[:, 1], 1)
    stiffness = compute_pull_stiffness()
    width = 6.3e-3 / math.cos(math.radians(2.0))
    torque = np.linalg.norm(np.concatenate([pull["wrench_commanded"], right["wrench_commanded"]])[:, 3:], axis=1)
    last = right["object_wrench"][-50:, 5].mean()

    def one(
        name: str, what: str, published: float | None, computed: float, unit: str, tolerance: float | None,
        erratum: str = "", basis: Basis = "computed",
    ) -> Item:  # fmt: skip
        why = "" if tolerance is None else "noise of sensors and hand; the loop runs at 1 kHz"
        return Item(
            f"fig8-{name}",
            _PAPER,
            _WHERE,
            what,
            published,
            float(computed),
            unit,
            tolerance,
            erratum,
            why=why,
            implied=published is not None,
            basis=basis,
        )

    found: tuple[Item, ...] = (
        one("fx", "F_X' of phase 1, eq. (17) with E9 and E10", stiffness * 0.134 * (width - 4.8e-3),
            -force[:, 0].mean(), "N", 0.05, "E9"),
        one("fx-constant", "greatest change of F_X' over its mean: 'constant'", 0.0,
            np.ptp(force[:, 0]) / abs(force[:, 0].mean()), "1", 2e-3),
        one("fy-start", "F_Y' where phase 1 begins, eq. (17) with E9 and E10",
            stiffness * 2 * math.tan(math.radians(2.0)) * (ARM - X_0), line(X_0), "N", 1.0, "E9"),
        one("fy-line", "greatest departure of F_Y' from a straight line, over its mean", 0.0,
            np.abs(force[:, 1] - line(place)).max() / force[:, 1].mean(), "1", 5e-3),
        one("fy-falls", "decrease of F_Y' per displacement, eq. (17) with E9 and E10",
            -stiffness * 2 * math.tan(math.radians(2.0)) * 1e-3, line.deriv()(X_0) * 1e-3, "N/mm", 0.2, "E9"),
        one("torque-zero", "torque about Z' when the plug is upright, over that at 2°: 'becomes zero'", 0.0,
            abs(last) / abs(right["object_wrench"][:20, 5].mean()), "1", 5e-3, "E20"),
        one("wrench_actual", "torque on the rotor against the torque asked, both phases, rms over rms", 0.0,
            _departure(pull, right), "1", 0.02, basis="own"),
        one("sum", "sum of the currents of the parts against the commanded currents, largest difference", 0.0,
            max(_explanation_error(pull), _explanation_error(right)), "A", 5e-3, basis="own"),
        one("torque", "greatest torque asked of the motor", None, torque.max(), "N·m", None),
    )  # fmt: skip
    if trained:  # by `haptorb train`: the paper's own way from the field to the torque per ampere
        other = two_phases(estimator="network", report=lambda done: report(0.5 + 0.5 * done))
        what = "the same with the network in place of least squares"
        found += (one("given-network", what, None, _departure(*other), "1", None),)
    return found, lambda path: _draw_figure(pull, right, path)


def _departure(*courses: PhaseRecord) -> float:
    asked = np.concatenate([course["wrench_commanded"][:, 3:] for course in courses])
    given = np.concatenate([course["wrench_actual"][:, 3:] for course in courses])
    return float(np.sqrt(((given - asked) ** 2).sum() / (asked**2).sum()))


def _explanation_error(course: PhaseRecord) -> float:
    parts = course.psi + course.lam + course.phi + course.rest
    return float(np.abs(parts - course["current_commanded"]).max())


def _draw_figure(pull: PhaseRecord, right: PhaseRecord, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 14), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(5, 2)
    gains = Gains().scale(FORCE_SCALE)
    of_forces, of_torques = np.array(gains.translate_torque), np.array(gains.rotate_torque)
    for column, (course, along, label) in enumerate(
        ((pull, 1e3 * (pull["object"][:, 0] - X_0), "X' − x₀ (mm)"), (right, np.degrees(right.tilt), "ε_z (°)"))
    ):
        top, torques, *lower = axes[:, column]
        wrench = course["object_wrench"]
        if column == 0:
            top.plot(along, wrench[:, 0], "C1", label="F_X' on the plug: −1 times (17)'s, which is the pull")
            top.plot(along, wrench[:, 1], "C0", label="F_Y' on the plug")
            top.set(ylabel="N", title="Phase 1, translating: pulled at a tilt of 2°")
            expected = [
                (of_forces[0] * wrench[:, 1], "η̂₁ F_Y' of (6b)"),
                (of_forces[1] * wrench[:, 0], "η̂₂ F_X' of (6b)"),
            ]
        else:
            top.plot(along, wrench[:, 5], "C2", label="T_Z' about o' on the plug")
            top.set(ylabel="N·m", title="Phase 2, rotating: turned upright")
            expected = [(of_torques[2] * wrench[:, 5], "η₃ T_φ' of (5b)")]
        asked, given = course.euler_torque("wrench_commanded"), course.euler_torque("wrench_actual")
        for axis, name in enumerate(("T_ψ", "T_λ", "T_φ")):
            torques.plot(along, given[:, axis], color=f"C{axis}", linewidth=0.8, alpha=0.6)
            torques.plot(along, asked[:, axis], color=f"C{axis}", linestyle="--", label=name)
        for values, name in expected:
            torques.plot(along[::60], values[::60], "k.", ms=4, label=name)
        torques.set(ylabel="N·m", title=f"torque about ψ, λ, φ (× {FORCE_SCALE:g}): asked dashed, given solid")
        # Phase 2 turns the handle about φ, where phase 1 asks for nothing of its own.
        parts = (
            (course.psi, "T_ψ, from F_Y'") if column == 0 else (course.phi, "T_φ, from T_φ'"),
            (course.lam, "T_λ, from F_X'") if column == 0 else (course.lam, "T_λ"),
        )
        for panel, (currents, name) in zip(lower[:2], parts, strict=True):
            _currents(panel, along, currents, f"currents for {name}")
        _currents(
            lower[2], along, course["current_commanded"], "all currents summed, with those for weight and regulator"
        )
        top.legend(fontsize=8)
        if column == 0:  # between the lines
            torques.legend(fontsize=8, ncols=5, loc="center", bbox_to_anchor=(0.5, 0.64))
        else:
            torques.legend(fontsize=8, ncols=2)
        for panel in axes[:, column]:
            panel.set_xlabel(label)
            if column == 1:
                panel.invert_xaxis()
    lines = axes[4, 0].get_lines()
    figure.legend(
        lines,
        [str(n + 1) for n in range(len(lines))],
        loc="outside lower center",
        ncols=12,
        title="channel",
        fontsize=8,
    )
    figure.savefig(path, dpi=110)
    return path


def _currents(panel: Any, along: Array, currents: Array, title: str) -> None:
    for channel in range(currents.shape[1]):
        colour = f"C{channel % 10}"
        panel.plot(along, currents[:, channel], color=colour, linewidth=0.9, linestyle="-" if channel < 10 else "--")
    panel.set(ylabel="A", title=title)
    if np.abs(currents).max() < 1e-3:  # noise around nothing is to look like nothing
        panel.set_ylim(-0.05, 0.05)
