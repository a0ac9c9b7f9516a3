"""Bai 2012, section 3.2, through the whole chain: a tilted plug is pulled (phase 1), then righted (phase 2).

Nothing is fed in but a hand that turns the handle. The rotor's magnets make a field, 48 sensors read it with their
noise, the orientation and the torque characteristic are estimated from it, the two modes move the plug, the outlet
answers, currents are allocated, the simulated coils carry them, and the torque on the rotor is what comes out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.control.allocation import MinimumPowerAllocator
from haptorb.control.linkage import Gains, ModedLinkage
from haptorb.devices.base import WrenchMap
from haptorb.devices.motor import Grasp, motor
from haptorb.estimation.types import Estimate, Estimator, Sample
from haptorb.recording.row import RowLayout
from haptorb.runtime.assembly import allocator_of, estimator_of
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.tick import Tick
from haptorb.runtime.trackers.base import Goal
from haptorb.simulation.hand import handle_quaternion
from haptorb.simulation.motor import SimulatedMotor
from haptorb.worlds.snap_fit import PublishedOutlet

__all__ = ["ARM", "FORCE_SCALE", "TILT", "X_0", "PhaseRecord", "euler_axes", "two_phases"]

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

    def hand(now: float) -> Goal:
        lam = _FROM + _PULL * min(max((now - starts[1]) / _PHASE_1, 0.0), 1.0)
        phi = spin * _smooth((now - starts[3]) / _PHASE_2)
        return Goal(np.zeros(3), handle_quaternion(0.0, lam, phi), now, False)

    driver = SimDriver(SimulatedMotor(known, seed, grasp=_STEEL), _DT, hand, seed=seed)
    recorder = _RecordingEstimator(estimator_of(known, estimator, None))
    linkage = ModedLinkage(gains, position=(X_0, 0.0, 0.0), attitude=(0.0, 0.0, -TILT))
    tick = Tick(known, _WORLD, driver, recorder, allocator_of(known), _DT, linkage)
    parts = MinimumPowerAllocator(known.coils.current_limit, resistance=known.coils.resistance)
    layout, row = tick.layout, tick.layout.empty()
    asked = layout["asked"]
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
