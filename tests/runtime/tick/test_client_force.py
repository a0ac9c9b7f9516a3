"""A client's force through the whole chain: its part of the wrench alone has a rate limit, on a tool and on a motor."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.control.trips import GuardState
from haptorb.devices.loader import load
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.pointer import PointerTracker
from haptorb.worlds import Fluid, Remote

DT = 1e-3


class Rig:
    def __init__(self, device, world):
        self.device = load(device)
        self.tick = assemble(RunConfig(device=self.device, world=world, rate=1 / DT), PointerTracker())
        self.row, self.n = self.tick.layout.empty(), 0
        self.tick.driver.open()

    def go(self, ticks, force, session=1.0, mapping=0.0):
        """(ticks, 6) what is asked while a client commands `force`."""
        found = []
        for _ in range(ticks):
            client = self.tick.client
            client["force"], client["session"], client["mapping"] = force, session, mapping
            client["age"] = client["lost"] = 0.0
            self.tick.prepare(self.n * DT)
            self.tick.step(self.row, self.n * DT)
            self.n += 1
            found.append(self.row[self.tick.layout["wrench_commanded"]].copy())
        return np.array(found)


@pytest.mark.parametrize(("device", "part"), [("omni", slice(0, 3)), ("pmsm", slice(3, 6))])
def test_a_clients_force_that_turns_round_comes_back_at_the_rate_of_the_device(device, part):
    rig = Rig(device, Remote())
    limits = rig.device.limits
    rate = limits.force_rate if device == "omni" else limits.torque_rate
    rig.go(700, (0.0, 0.0, 100.0))
    assert rig.row[rig.tick.layout["guard"]][0] == GuardState.RUNNING
    asked = rig.go(120, (0.0, 0.0, -100.0), mapping=1.0)[:, part]
    steps = np.linalg.norm(np.diff(asked, axis=0), axis=1)
    assert 0.5 * rate * DT < steps.max() <= rate * DT * (1 + 1e-6)
    assert (np.linalg.norm(asked, axis=1) == 0.0).any()
    along = asked @ asked[-1]
    assert along[0] < 0.0 < along[-1]


def test_of_a_sum_the_clients_part_alone_is_limited():
    rig = Rig("omni", Fluid() + Remote())
    rig.go(500, (0.0, 0.0, 0.0))
    before = rig.go(1, (0.0, 0.0, 0.0))[0]
    first = rig.go(1, (0.5, 0.0, 0.0))[0]
    assert (first - before)[0] == pytest.approx(rig.device.limits.force_rate * DT, abs=0.02)
    assert rig.tick.protection.commanded[:3] == pytest.approx([0.5, 0.0, 0.0])
