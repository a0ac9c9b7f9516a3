"""The two compiled passes of a tick give what passivity control, guard and drive give one by one."""

import numpy as np
import pytest

from haptorb.control.protection.drive import Drive, pass_time
from haptorb.control.protection.guard import Guard
from haptorb.control.protection.passivity import PassivityControl
from haptorb.control.protection.trip import GuardState, Trip
from haptorb.devices.loader import load
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.runtime.tick.kernels import asked, driven
from haptorb.sensing.sample import Estimate, Pose, Sample

DT = 1e-3
OMNI = load("omni")


class Parts:
    """Passivity control, guard and drive of a device in one hand."""

    def __init__(self) -> None:
        self.guard, self.drive, self.passivity = Guard(OMNI, DT), Drive(OMNI, DT), PassivityControl(DT)
        self.applied = np.zeros(3)
        self.guard.check.coils["limit"] = 1e9  # the currents are random here: whether they match is asked elsewhere


def one_by_one(parts: Parts, wrench, estimate: Estimate, sample: Sample, wanted) -> tuple[np.ndarray, np.ndarray]:
    """(6,) admitted and (3,) duties, through the doors for people."""
    state, guard = estimate.state, parts.guard
    guard.pass_time(sample.t)
    damped = parts.passivity.damped(wrench, state.p, state.R_SR, sample.t, estimate.age, guard.gain, passive=True)
    admitted = guard.admit(damped, estimate).copy()
    currents = guard.limit(wanted, sample)
    matrix = estimate.wrench_map.matrix
    emf = matrix[:3].T @ state.v + matrix[3:].T @ state.w
    drive = parts.drive
    pass_time(drive.numbers, guard.clock["elapsed"][0])
    duties = drive.duties(currents, sample.currents, parts.applied, emf) if guard.gain else drive.rest()
    return admitted, duties.copy()


def at_once(parts: Parts, wrench, estimate: Estimate, sample: Sample, wanted) -> tuple[np.ndarray, np.ndarray]:
    """The same as the tick does it."""
    state, guard, drive, admitted = estimate.state, parts.guard, parts.drive, np.empty(6)
    asked(
        parts.passivity.memory, guard.numbers, guard.coils, guard.clock, wrench, state.p, state.R_SR, sample.t,
        estimate.age, True, estimate.valid, estimate.reversed, admitted,
    )  # fmt: skip
    heat = guard.heat
    driven(
        guard.numbers, guard.coils, guard.clock, heat.numbers, heat.coils, guard.check.coils, drive.numbers,
        drive.coils, wanted, sample.currents, 0.0, sample.temperatures, parts.applied, estimate.wrench_map.matrix,
        state.v, state.w,
    )  # fmt: skip
    return admitted, drive.chosen.copy()


@pytest.mark.parametrize("seed", range(5))
def test_two_passes_are_the_parts_in_a_row(seed):
    random = np.random.default_rng(seed)
    first, second = Parts(), Parts()
    reasons, states = set(), set()
    for tick in range(1500):
        p = np.array([0.0, 0.0, 0.052]) + 2e-3 * np.sin(0.01 * tick + np.arange(3))
        state = State.at(p, v=random.normal(0, 0.1, 3), w=random.normal(0, 1.0, 3), t=tick * DT)
        event = random.random()
        age = 1.0 if event < 0.002 else 0.0
        estimate = Estimate(state, WrenchMap(random.normal(0, 0.05, (6, 3)), np.zeros(6)), event > 0.001, age)
        wrench = random.normal(0, 0.8, 6) * (1, 1, 1, 0.02, 0.02, 0.02)
        wanted, measured = random.normal(0, 12.0, 3), random.normal(0, 5.0, 3)
        if event > 0.998:
            (wrench if event > 0.999 else wanted)[1] = np.nan
        if 0.996 < event < 0.997:
            measured[2] = 1e3 if event > 0.9965 else np.nan
        pose = Pose(tick * DT, state.R_SR, p, state.w, state.v, True)
        heat = 298.15 + 0.06 * tick * (seed == 4)
        sample = Sample(tick * DT, measured, np.full(3, heat), np.zeros((0, 3)), pose)
        before = one_by_one(first, wrench, estimate, sample, wanted)
        after = at_once(second, wrench, estimate, sample, wanted)
        for one, two in zip(before, after, strict=True):
            assert one == pytest.approx(two, rel=1e-12, abs=1e-15)
        assert first.guard.numbers == pytest.approx(second.guard.numbers, rel=1e-12)
        assert first.guard.currents == pytest.approx(second.guard.currents, rel=1e-12, abs=1e-15)
        if first.guard.gain == 0.0:
            assert not after[1].any()
        reasons.add(first.guard.reason)
        states.add(first.guard.state)
        first.applied, second.applied = before[1], after[1]
        if first.guard.state in (GuardState.OFF, GuardState.TRIPPED) and tick % 50 == 0:
            assert first.guard.engage() == second.guard.engage()
    assert len(reasons) > 3  # among them what every guard must see
    assert {GuardState.RAMPING, GuardState.TRIPPED} <= states
    assert Trip.NONE in reasons
